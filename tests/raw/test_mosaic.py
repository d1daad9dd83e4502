"""Bare mosaics and colour patterns; camera raw files are in tests/real."""

import cv2
import numpy as np
import pytest

from camcal.errors import FileError, InvalidInput
from camcal.raw import PATTERNS
from camcal.raw.mosaic import Mosaic, by_place, channel_names, sites
from camcal.raw.reading import read_mosaic

SAMPLES = np.arange(12, dtype=np.uint16).reshape(3, 4) * 5000


def frame(values=SAMPLES, pattern="RGGB", black=0.0, white=65535.0):
    return Mosaic(values, pattern, np.full((2, 2), black), white)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_the_sites_of_the_three_colours_cover_every_pixel_once(pattern):
    count = np.zeros((5, 7), int)
    for colour in "RGB":
        for site in sites(pattern, colour):
            count[site] += 1
    assert (count == 1).all()


def test_the_letters_name_the_first_cell_in_reading_order():
    colours = np.empty((2, 2), "U1")
    for colour in "RGB":
        for site in sites("GBRG", colour):
            colours[site] = colour
    assert colours.tolist() == [["G", "B"], ["R", "G"]]


@pytest.mark.parametrize("suffix", [".png", ".tiff", ".tif", ".pgm"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_bare_mosaic_comes_back_as_it_was_written(tmp_path, suffix, dtype):
    path = tmp_path / f"mosaic{suffix}"
    values = (SAMPLES // 250).astype(dtype)
    cv2.imwrite(str(path), values)
    mosaic = read_mosaic(path, "GRBG")
    np.testing.assert_array_equal(mosaic.values, values)
    assert (mosaic.values.dtype, mosaic.pattern, mosaic.white) == (dtype, "GRBG", np.iinfo(dtype).max)


@pytest.mark.parametrize(("stored", "read"), [("<f8", "f4"), (">u2", "u2"), ("u1", "u1")])
def test_a_numpy_mosaic_is_read_in_the_order_and_precision_of_this_machine(tmp_path, stored, read):
    np.save(tmp_path / "mosaic.npy", (SAMPLES // 250).astype(stored))
    mosaic = read_mosaic(tmp_path / "mosaic.npy", "RGGB")
    assert mosaic.values.dtype == np.dtype(read)
    np.testing.assert_array_equal(mosaic.values, SAMPLES // 250)


def test_the_samples_of_a_mosaic_cannot_be_written_to():
    with pytest.raises(ValueError, match="read-only"):
        frame().values[0, 0] = 1


def test_a_bare_mosaic_without_a_pattern_is_refused_with_the_option_to_give(tmp_path):
    cv2.imwrite(str(tmp_path / "mosaic.png"), SAMPLES)
    with pytest.raises(InvalidInput, match=r"mosaic\.png: .*--pattern RGGB\|GRBG\|GBRG\|BGGR"):
        read_mosaic(tmp_path / "mosaic.png")


def test_a_colour_image_is_not_a_mosaic(tmp_path):
    cv2.imwrite(str(tmp_path / "colour.png"), np.zeros((4, 4, 3), np.uint8))
    with pytest.raises(InvalidInput, match="one channel"):
        read_mosaic(tmp_path / "colour.png", "RGGB")


@pytest.mark.parametrize("name", ["missing.npy", "missing.png", "missing.dng"])
def test_a_missing_file_is_a_file_error(tmp_path, name):
    with pytest.raises(FileError, match="no such file"):
        read_mosaic(tmp_path / name, "RGGB")


@pytest.mark.parametrize("suffix", [".npy", ".png", ".tiff", ".dng", ".cr2"])
@pytest.mark.parametrize("content", [b"", b"not an image at all"])
def test_a_file_of_another_kind_is_a_file_error(tmp_path, suffix, content):
    path = tmp_path / f"frame{suffix}"
    path.write_bytes(content)
    with pytest.raises(FileError, match=f"frame{suffix}"):
        read_mosaic(path, "RGGB")


def test_a_truncated_numpy_file_is_a_file_error(tmp_path):
    path = tmp_path / "frame.npy"
    np.save(path, SAMPLES)
    path.write_bytes(path.read_bytes()[:-3])
    with pytest.raises(FileError, match=r"frame\.npy"):
        read_mosaic(path, "RGGB")


def test_pickled_objects_are_never_loaded(tmp_path):
    path = tmp_path / "frame.npy"
    np.save(path, np.array([{"a": 1}], dtype=object))
    with pytest.raises(FileError, match="not a readable NumPy array file"):
        read_mosaic(path, "RGGB")


def test_numbers_that_are_not_finite_are_counted_and_refused():
    with pytest.raises(InvalidInput, match="2 pixels"):
        frame(np.array([[1, np.nan], [np.inf, 2]], np.float32), white=1.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"pattern": "RGBG"}, "unknown"),
        ({"values": SAMPLES.astype(np.int64)}, "int64"),
        ({"values": SAMPLES[:1]}, "4 × 1"),
        ({"white": 100.0, "black": 100.0}, "above the black level"),
        ({"white": np.nan}, "white level nan"),
    ],
)
def test_a_mosaic_that_breaks_a_rule_is_refused(change, message):
    with pytest.raises(InvalidInput, match=message):
        frame(**change)


@pytest.mark.parametrize(
    ("pattern", "names"),
    [
        ("RGGB", ("R", "Gr", "Gb", "B")),
        ("GBRG", ("Gb", "B", "R", "Gr")),
        ("MONO", ("gray",) * 4),
        ("GGRGGBGGBGGRBRGRBGGGBGGRGGRGGBRBGBRG", tuple("GGRGGBGGBGGRBRGRBGGGBGGRGGRGGBRBGBRG")),
    ],
)
def test_channels_are_named_for_every_place_of_the_cell(pattern, names):
    assert channel_names(pattern) == names


def test_places_have_the_samples_of_whole_cells_only():
    planes = by_place(np.arange(35).reshape(5, 7), "RGGB")
    assert [plane.shape for plane in planes] == [(2, 3)] * 4
    np.testing.assert_array_equal(planes[2], [[7, 9, 11], [21, 23, 25]])
