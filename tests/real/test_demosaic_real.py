"""Developing real raw files: camera files whose levels, patterns and gray patches are known."""

import numpy as np
import pytest

from camcal.errors import InvalidInput
from camcal.raw.develop import develop
from camcal.raw.options import Development
from camcal.raw.reading import read_mosaic


def test_a_camera_dng_brings_pattern_levels_and_white_balance(real_data):
    frame = read_mosaic(real_data / "raw" / "tinydng-colorchart" / "colorchart.dng")
    assert (frame.values.shape, frame.pattern, frame.white) == ((1156, 1734), "RGGB", 15000)
    np.testing.assert_array_equal(frame.black, 2056)
    np.testing.assert_allclose(frame.camera_gains, [1, 0.4037, 0.6840], atol=1e-4)  # as printed by another reader


def test_linear_light_of_a_colour_chart_has_the_published_reflectances_of_its_grays(real_data):
    frame = read_mosaic(real_data / "raw" / "tinydng-colorchart" / "colorchart.dng")
    green = develop(frame, Development(depth="float")).pixels[..., 1]
    patches = np.array([green[915:945, column - 15 : column + 15].mean() for column in (700, 815, 930, 1040)])
    # ColorChecker neutrals 9.5, 8, 6.5 and 5; the light falls off over the chart by a few per cent
    np.testing.assert_allclose(patches / patches[0], np.array([0.900, 0.591, 0.362, 0.198]) / 0.900, rtol=0.05)


def test_a_file_name_with_an_accent_is_read(real_data):
    frame = read_mosaic(next((real_data / "raw" / "rawpy-kodak-dc50").glob("*.KDC")))
    assert (frame.values.shape, frame.pattern) == ((512, 768), "GRBG")


def test_a_pattern_that_contradicts_the_camera_is_refused(real_data):
    with pytest.raises(InvalidInput, match="pattern RGGB in the file, BGGR by --pattern"):
        read_mosaic(real_data / "raw" / "tinydng-colorchart" / "colorchart.dng", "BGGR")


def test_a_raw_file_in_full_colour_is_not_a_mosaic(real_data):
    with pytest.raises(InvalidInput, match="full colour"):
        read_mosaic(real_data / "raw" / "photoprism-eos6d-dng" / "canon_eos_6d.dng")
