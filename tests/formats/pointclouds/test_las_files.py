"""LAS and LAZ, read by laspy alone, and what is said where it is missing."""

import sys

import numpy as np
import pytest

from camcal.errors import FileError, InvalidInput
from camcal.formats import pointclouds

SUFFIXES = (".las", ".laz")


@pytest.fixture
def laspy():
    return pytest.importorskip("laspy")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_without_laspy_the_extra_is_named_before_any_work(monkeypatch, tmp_path, suffix):
    monkeypatch.setitem(sys.modules, "laspy", None)
    with pytest.raises(InvalidInput, match=r"pip install 'camcal\[clouds\]'"):
        pointclouds.require_suffix(tmp_path / f"cloud{suffix}")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_laspy_finds_colour_intensity_and_extra_bytes(laspy, tmp_path, vertices, stream, suffix):
    cloud = vertices(30, colour=True, intensity=True, normals=True, sigma=True)
    pointclouds.write(tmp_path / f"cloud{suffix}", stream(cloud))
    found = laspy.read(tmp_path / f"cloud{suffix}")
    assert found.header.point_format.id == 2
    assert found.header.are_points_compressed == (suffix == ".laz")
    assert found.header.creation_date is None
    np.testing.assert_allclose(found.x, cloud["x"], rtol=0, atol=1e-6)  # the scale
    np.testing.assert_array_equal(found.red, cloud["red"].astype(np.uint16) * 257)
    np.testing.assert_array_equal(found["sigma"], cloud["sigma"])


@pytest.mark.parametrize(("extent", "scale"), [(5.0, 1e-6), (1e4, 1e-5), (1e6, 1e-3), (1e9, 1.0)])
def test_the_scale_is_as_fine_as_the_extent_allows(laspy, tmp_path, vertices, stream, extent, scale):
    cloud = vertices(2)
    cloud["z"] = 0, extent
    pointclouds.write(tmp_path / "cloud.las", stream(cloud))
    found = laspy.read(tmp_path / "cloud.las")
    assert found.header.scales[2] == pytest.approx(scale)
    assert found.z[1] == pytest.approx(extent, abs=scale)


def test_colours_of_eight_bits_and_empty_fields_of_others_are_understood(laspy, tmp_path):
    header = laspy.LasHeader(point_format=2, version="1.2")
    header.offsets, header.scales = [500000, 4649776, 0], [0.001] * 3
    data = laspy.LasData(header)
    data.x, data.y, data.z = np.array([[500000.01, 500001.51], [4649776.51, 4649777.01], [1.0, 2.0]])
    data.red, data.green, data.blue = np.array([[255, 0], [7, 8], [9, 10]])
    data.write(tmp_path / "cloud.las")
    found = pointclouds.read(tmp_path / "cloud.las")
    assert found.vertices.dtype.names == ("x", "y", "z", "red", "green", "blue")
    assert found.vertices["red"].tolist() == [255, 0]
    np.testing.assert_allclose(found.vertices["x"], [0.01, 1.51], rtol=0, atol=2e-7)  # float32
    assert found.notes["origin"] == "500000 4649776 0"


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.99])
def test_a_file_cut_short_is_a_file_error(laspy, tmp_path, vertices, stream, suffix, share):
    path = tmp_path / f"cloud{suffix}"
    pointclouds.write(path, stream(vertices(200, colour=True)))
    whole = path.read_bytes()
    path.write_bytes(whole[: max(int(share * len(whole)), 1)])
    with pytest.raises(FileError, match=r"LAS file|points end"):
        pointclouds.read(path)
