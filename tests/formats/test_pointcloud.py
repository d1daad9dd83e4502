"""Point cloud files, read back by a reader of its own that knows only the PLY specification."""

import numpy as np
import pytest

from camcal.errors import FileError, InvalidInput
from camcal.formats import pointcloud
from camcal.stereo.cloud import PointCloud

TYPES = {b"float": "<f4", b"uchar": "u1"}


def cloud_of(count, *, colour=True, intensity=True):
    rng = np.random.default_rng(count)
    return PointCloud(
        rng.normal(0, 30, (count, 3)),
        rng.integers(0, 256, (count, 3)) if colour else None,
        rng.random(count) if intensity else None,
    )


def read_ply(path):
    """Return the header lines and the columns of a PLY file by name."""
    header, body = path.read_bytes().split(b"end_header\n", 1)
    lines = header.splitlines()
    count = next(int(line.split()[2]) for line in lines if line.startswith(b"element vertex"))
    fields = [(line.split()[2].decode(), TYPES[line.split()[1]]) for line in lines if line.startswith(b"property")]
    if b"format ascii 1.0" in lines:
        rows = [row.split() for row in body.splitlines()]
        assert len(rows) == count
        return lines, {name: np.array([row[i] for row in rows], float) for i, (name, _) in enumerate(fields)}
    vertices = np.frombuffer(body, np.dtype(fields))
    assert len(vertices) == count
    return lines, {name: vertices[name] for name, _ in fields}


@pytest.mark.parametrize("ascii_text", [False, True])
@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize("intensity", [False, True])
def test_a_ply_file_holds_the_cloud_bit_for_bit(tmp_path, ascii_text, colour, intensity):
    cloud = cloud_of(50, colour=colour, intensity=intensity)
    pointcloud.write(tmp_path / "cloud.ply", cloud, ascii_text=ascii_text)
    _, columns = read_ply(tmp_path / "cloud.ply")
    expected = dict(zip("xyz", cloud.points.T, strict=True))
    if colour:
        expected |= dict(zip(("red", "green", "blue"), cloud.colours.T, strict=True))
    if intensity:
        expected["intensity"] = cloud.intensity
    assert list(columns) == list(expected)
    for name, values in expected.items():
        np.testing.assert_array_equal(columns[name].astype(np.float32), values)


def test_a_coloured_vertex_takes_fifteen_bytes(tmp_path):
    path = tmp_path / "cloud.ply"
    pointcloud.write(path, cloud_of(100, intensity=False))
    assert len(path.read_bytes().split(b"end_header\n", 1)[1]) == 1500


def test_the_header_says_unit_and_frame(tmp_path):
    pointcloud.write(tmp_path / "cloud.ply", cloud_of(1))
    lines, _ = read_ply(tmp_path / "cloud.ply")
    assert b"comment unit metre" in lines
    assert b"comment frame left camera: x right, y down, z forward" in lines


def test_a_cloud_larger_than_a_block_is_complete(tmp_path, monkeypatch):
    monkeypatch.setattr(pointcloud, "_BLOCK", 7)
    cloud = cloud_of(23)
    pointcloud.write(tmp_path / "cloud.ply", cloud)
    _, columns = read_ply(tmp_path / "cloud.ply")
    np.testing.assert_array_equal(columns["z"], cloud.points[:, 2])


@pytest.mark.parametrize("name", ["cloud.ply", "cloud.xyz"])
def test_an_empty_cloud_is_a_readable_file(tmp_path, name):
    pointcloud.write(tmp_path / name, cloud_of(0))
    assert (tmp_path / name).exists()
    if name == "cloud.ply":
        _, columns = read_ply(tmp_path / name)
        assert len(columns["x"]) == 0


def test_xyz_is_a_row_of_numbers_per_point(tmp_path):
    cloud = cloud_of(9)
    pointcloud.write(tmp_path / "cloud.XYZ", cloud)
    table = np.loadtxt(tmp_path / "cloud.XYZ")
    np.testing.assert_array_equal(table[:, :3].astype(np.float32), cloud.points)
    np.testing.assert_array_equal(table[:, 3:6], cloud.colours)
    np.testing.assert_array_equal(table[:, 6].astype(np.float32), cloud.intensity)


@pytest.mark.parametrize("name", ["cloud.pcd", "cloud"])
def test_another_suffix_is_refused_with_those_that_exist(tmp_path, name):
    with pytest.raises(InvalidInput, match=r"\.ply or \.xyz"):
        pointcloud.write(tmp_path / name, cloud_of(3))


def test_a_folder_that_cannot_be_made_is_a_file_error(tmp_path):
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(FileError, match="cannot be written"):
        pointcloud.write(tmp_path / "file" / "cloud.ply", cloud_of(3))
