"""NPZ, as NumPy alone reads and writes it."""

from io import BytesIO

import numpy as np
import pytest

from camcal.errors import FileError
from camcal.formats import pointclouds
from camcal.formats.pointclouds import write

POINTS = np.arange(6.0).reshape(2, 3)


def npz_of(**arrays):
    content = BytesIO()
    np.savez(content, **arrays)
    return content.getvalue()


def test_numpy_finds_an_array_per_kind_of_number(tmp_path, vertices, stream):
    cloud = vertices(12, colour=True, intensity=True, normals=True, sigma=True)
    write(tmp_path / "cloud.npz", stream(cloud, unit="mm"))
    with np.load(tmp_path / "cloud.npz") as found:
        assert set(found.files) == {"points", "colours", "intensity", "normals", "sigma", "unit", "frame", "notes"}
        assert found["points"].dtype == np.float32
        assert found["colours"].shape == (12, 3)
        assert found["sigma"].shape == (12,)
        assert str(found["unit"]) == "mm"
        np.testing.assert_array_equal(found["points"][:, 2], cloud["z"])


def test_the_arrays_of_an_image_have_rows_and_columns(tmp_path, vertices, stream):
    write(tmp_path / "cloud.npz", stream(vertices(12, colour=True, sigma=True), grid=(4, 3)))
    with np.load(tmp_path / "cloud.npz") as found:
        assert found["points"].shape == found["colours"].shape == (3, 4, 3)
        assert found["sigma"].shape == (3, 4)


def test_points_alone_are_a_cloud_in_metres():
    found = pointclouds.read_npz(npz_of(points=POINTS))
    assert (found.unit, found.frame, found.notes, found.grid) == ("m", "", {}, None)
    assert found.vertices.tolist() == [(0, 1, 2), (3, 4, 5)]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"PK but no archive", "not a readable NPZ file"),
        (npz_of(xyz=POINTS), "no array points; its arrays are xyz"),
        (npz_of(points=POINTS[:, :2]), r"points has float64 of shape \(2, 2\), expected numbers of shape \(2, 3\)"),
        (npz_of(points=POINTS[0]), r"points have the shape \(3,\), expected"),
        (
            npz_of(points=POINTS, sigma=np.ones(3)),
            r"sigma has float64 of shape \(3,\), expected numbers of shape \(2,\)",
        ),
        (npz_of(points=POINTS.astype(str)), "points has <U"),
        (npz_of(points=np.array([[None] * 3])), "not a readable NPZ file"),
    ],
)
def test_a_file_that_is_none_says_what_was_expected_and_found(content, message):
    with pytest.raises(FileError, match=message):
        pointclouds.read_npz(content)


def test_an_array_alone_is_no_npz_file():
    content = BytesIO()
    np.save(content, POINTS)
    with pytest.raises(FileError, match="not a readable NPZ file"):
        pointclouds.read_npz(content.getvalue())
