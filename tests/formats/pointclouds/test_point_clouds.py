"""What all point cloud formats promise: the cloud comes back, and damage is an error with a name."""

from functools import cache
from importlib.util import find_spec

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.errors import CamcalError, FileError, InvalidInput
from camcal.formats import pointclouds
from camcal.stereo.depth import VertexStream, vertex_type

LASER = (".las", ".laz")
SUFFIXES = [
    pytest.param(suffix, marks=pytest.mark.skipif(suffix in LASER and find_spec("laspy") is None, reason="no laspy"))
    for suffix in pointclouds.SUFFIXES
]
FORMS = [(".ply", False), (".ply", True), (".pcd", False), (".pcd", True), (".xyz", False), (".npz", False)]
FORMS += [(".glb", False)]
EVERYTHING = {"colour": True, "intensity": True, "normals": True, "sigma": True}


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("has", [{}, {"colour": True}, {"colour": True, "intensity": True}, EVERYTHING])
def test_a_cloud_comes_back(tmp_path, vertices, stream, suffix, has):
    path, cloud = tmp_path / f"cloud{suffix}", vertices(50, **has)
    pointclouds.write(path, stream(cloud))
    found = pointclouds.read(path)
    assert found.vertices.dtype == cloud.dtype
    assert found.unit == "m"
    tolerance = 1e-5 if suffix in LASER else 0  # a micrometre, float32 at 30 m, and 1/65535 of intensity
    for name in cloud.dtype.names:
        np.testing.assert_allclose(found.vertices[name], cloud[name], rtol=0, atol=tolerance)


@pytest.mark.parametrize("suffix", [suffix for suffix in SUFFIXES if suffix.values[0] != ".xyz"])
def test_a_file_says_its_frame_and_its_notes(tmp_path, vertices, stream, suffix):
    path = tmp_path / f"cloud{suffix}"
    notes = {"fx": "718.856", "from": "Bilder/größe 1: links.png"}
    pointclouds.write(path, stream(vertices(3), frame="world: x east, y north, z up", notes=notes))
    found = pointclouds.read(path)
    assert found.frame == "world: x east, y north, z up"
    assert found.notes == notes


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_millimetres_are_not_taken_for_metres(tmp_path, vertices, stream, suffix):
    path, cloud = tmp_path / f"cloud{suffix}", vertices(20, sigma=True)
    pointclouds.write(path, stream(cloud, unit="mm"))
    found = pointclouds.read(path)
    scale = {"m": 1e3, "mm": 1.0}[found.unit]
    for name in cloud.dtype.names:
        # LAS turns 30 mm into 0.030 m, to a micrometre
        np.testing.assert_allclose(found.vertices[name] * scale, cloud[name], atol=2e-3 if suffix in LASER else 0)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("has", [{}, EVERYTHING])
def test_an_empty_cloud_is_a_readable_file(tmp_path, vertices, stream, suffix, has):
    path = tmp_path / f"cloud{suffix}"
    pointclouds.write(path, stream(vertices(0, **has)))
    assert len(pointclouds.read(path).vertices) == 0


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_the_same_cloud_is_the_same_bytes(tmp_path, vertices, stream, suffix):
    first, second = tmp_path / f"first{suffix}", tmp_path / f"second{suffix}"
    for path in (first, second):
        pointclouds.write(path, stream(vertices(40, **EVERYTHING)))
    assert first.read_bytes() == second.read_bytes()


@pytest.mark.parametrize("suffix", [".pcd", ".npz"])
def test_the_pixels_of_an_image_keep_their_rows_and_columns(tmp_path, vertices, stream, suffix):
    path, cloud = tmp_path / f"cloud{suffix}", vertices(12, colour=True)
    cloud["x"][5] = cloud["y"][5] = cloud["z"][5] = np.nan
    pointclouds.write(path, stream(cloud, grid=(4, 3)))
    found = pointclouds.read(path)
    assert found.grid == (4, 3)
    assert found.vertices.tobytes() == cloud.tobytes()


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_blocks_are_asked_for_one_at_a_time(tmp_path, vertices, suffix):
    """Each block is overwritten once the next one is asked for, so a writer that keeps them would write the last."""
    path, cloud, seat = tmp_path / f"cloud{suffix}", vertices(9, colour=True), vertices(3, colour=True)

    def blocks():
        for start in range(0, 9, 3):
            seat[:] = cloud[start : start + 3]
            yield seat

    pointclouds.write(path, VertexStream(9, cloud.dtype, blocks()))
    np.testing.assert_allclose(pointclouds.read(path).vertices["x"], cloud["x"], rtol=0, atol=1e-5)


def test_a_stream_that_breaks_its_promise_leaves_no_file(tmp_path, vertices):
    cloud = vertices(5)
    with pytest.raises(ValueError, match=r"hold 5 vertices.*promised 6"):
        pointclouds.write(tmp_path / "cloud.ply", VertexStream(6, cloud.dtype, [cloud]))
    with pytest.raises(ValueError, match="a block holds"):
        pointclouds.write(tmp_path / "cloud.ply", VertexStream(5, vertices(0, colour=True).dtype, [cloud]))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", [suffix for suffix in SUFFIXES if suffix.values[0] not in LASER])
def test_millimetres_of_what_is_far_away_need_no_origin(tmp_path, vertices, stream, suffix):
    path, cloud = tmp_path / f"cloud{suffix}", vertices(500)
    cloud["z"] = np.random.default_rng(1).uniform(1e5, 9e7, 500)
    pointclouds.write(path, stream(cloud, unit="mm"))
    found = pointclouds.read(path)
    np.testing.assert_array_equal(found.vertices, cloud)
    assert "origin" not in found.notes


@pytest.mark.parametrize("name", ["cloud.obj", "cloud"])
def test_another_suffix_is_refused_with_those_that_exist(tmp_path, vertices, stream, name):
    with pytest.raises(InvalidInput, match=r"use one of \.ply \.pcd \.xyz \.npz \.glb \.las \.laz"):
        pointclouds.write(tmp_path / name, stream(vertices(3)))
    with pytest.raises(InvalidInput, match="is not a point cloud format; use one of "):
        pointclouds.read(tmp_path / name)


def test_text_is_refused_where_a_format_has_none(tmp_path):
    pointclouds.require_suffix(tmp_path / "cloud.xyz", ascii_text=True)
    with pytest.raises(InvalidInput, match=r"no text form; use \.ply \.pcd \.xyz"):
        pointclouds.require_suffix(tmp_path / "cloud.glb", ascii_text=True)


def test_a_missing_an_empty_and_an_impossible_file_are_file_errors(tmp_path, vertices, stream):
    (tmp_path / "empty.ply").touch()
    with pytest.raises(FileError, match="no such file"):
        pointclouds.read(tmp_path / "none.ply")
    with pytest.raises(FileError, match=r"empty\.ply: is empty"):
        pointclouds.read(tmp_path / "empty.ply")
    with pytest.raises(FileError, match="cannot be written"):
        pointclouds.write(tmp_path / "empty.ply" / "cloud.ply", stream(vertices(3)))


@cache
def file_of(folder, suffix, ascii_text):
    """Return the bytes of a file of twelve vertices."""
    rng = np.random.default_rng(3)
    cloud = np.zeros(12, vertex_type(**EVERYTHING))
    for name in cloud.dtype.names:
        cloud[name] = rng.integers(1, 9, 12)
    path = folder / f"whole{suffix}"
    pointclouds.write(path, VertexStream(12, cloud.dtype, [cloud]), ascii_text=ascii_text)
    return path.read_bytes()


def vertices_or_error(path):
    try:
        return pointclouds.read(path).vertices
    except CamcalError as error:
        return error


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("damaged")


@pytest.mark.parametrize(("suffix", "ascii_text"), FORMS)
@given(data=st.data())
def test_a_file_cut_short_is_a_file_error_or_text_that_lost_digits(folder, suffix, ascii_text, data):
    whole = file_of(folder, suffix, ascii_text)
    path = folder / f"cut{suffix}"
    path.write_bytes(whole[: data.draw(st.integers(0, len(whole) - 1))])
    found = vertices_or_error(path)
    if isinstance(found, CamcalError):
        assert isinstance(found, FileError)
        assert found.where == str(path)
    else:
        assert ascii_text or suffix == ".xyz"
        assert len(found) <= 12


@pytest.mark.parametrize(("suffix", "ascii_text"), FORMS)
@given(data=st.data())
def test_a_damaged_file_never_ends_in_a_traceback(folder, suffix, ascii_text, data):
    damaged = bytearray(file_of(folder, suffix, ascii_text))
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    path = folder / f"damaged{suffix}"
    path.write_bytes(damaged)
    found = vertices_or_error(path)
    assert found.where == str(path) if isinstance(found, FileError) else found.dtype.names[:3] == ("x", "y", "z")


@pytest.mark.parametrize("suffix", [".ply", ".pcd", ".xyz", ".npz", ".glb"])
@given(content=st.binary(min_size=1, max_size=200))
def test_bytes_of_any_kind_never_end_in_a_traceback(folder, suffix, content):
    path = folder / f"noise{suffix}"
    path.write_bytes(content)
    found = vertices_or_error(path)
    assert isinstance(found, FileError) or suffix == ".xyz"  # the only one that begins in no special way
