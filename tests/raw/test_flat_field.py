"""Flat fields against the fall-off, the responses and the noise that made them."""

import numpy as np
import pytest

from camcal.errors import InvalidInput
from camcal.raw import MONO
from camcal.raw.calibration_frames import flat_gain
from camcal.raw.mosaic import phases

HEIGHT, WIDTH = 121, 160
ROWS, COLUMNS = np.mgrid[:HEIGHT, :WIDTH]
FALL_OFF = (1 - 0.4 * ((ROWS - 60) ** 2 + (COLUMNS - 80) ** 2) / 10000).astype(np.float32)
X_TRANS = "GGRGGBGGBGGRBRGRBGGGBGGRGGRGGBRBGBRG"


def responses(spread, seed=1):
    return np.random.default_rng(seed).normal(1, spread, (HEIGHT, WIDTH)).astype(np.float32)


def of_each_phase(pattern, levels):
    result = np.empty((HEIGHT, WIDTH), np.float32)
    for site, level in zip(phases(pattern), levels, strict=True):
        result[site] = level
    return result


LAMP = of_each_phase("RGGB", (0.2, 0.6, 0.61, 0.35))


def test_division_by_the_gain_leaves_an_even_field_in_the_colour_of_the_light():
    flat = LAMP * FALL_OFF * responses(0.01)
    even = flat / flat_gain(flat, "RGGB")
    for site in phases("RGGB"):
        np.testing.assert_allclose(even[site], flat[site].mean(), rtol=1e-5)  # float32


def test_the_gain_of_every_place_of_the_cell_is_one_on_average():
    gain = flat_gain(LAMP * FALL_OFF, "RGGB")
    assert gain.dtype == np.float32
    for site in phases("RGGB"):
        assert gain[site].mean() == pytest.approx(1, abs=1e-5)  # float32


@pytest.mark.parametrize("pattern", ["BGGR", MONO, X_TRANS])
def test_every_pattern_has_its_own_places(pattern):
    levels = np.linspace(0.2, 0.7, len(phases(pattern)))
    gain = flat_gain(of_each_phase(pattern, levels), pattern)
    np.testing.assert_allclose(gain, 1, rtol=1e-5)  # float32


def test_smoothing_removes_the_noise_and_keeps_the_fall_off():
    noisy = LAMP * FALL_OFF * responses(0.05)
    truth = flat_gain(LAMP * FALL_OFF, "RGGB")
    rough, smooth = (flat_gain(noisy, "RGGB", smoothing) / truth for smoothing in (0, 6))
    assert rough.std() == pytest.approx(0.05, rel=0.1)
    # a Gaussian of 3 samples leaves 1 / (2 √π 3) = 9 % of the noise; the slope is lost at the border
    assert smooth[12:-12, 12:-12].std() < 0.007


def test_smoothing_leaves_the_colours_apart():
    np.testing.assert_allclose(flat_gain(LAMP, "RGGB", 8), 1, rtol=1e-5)  # float32


def test_a_pixel_without_response_gets_a_gain_that_can_divide():
    flat = LAMP.copy()
    flat[3, 4] = -0.01
    assert flat_gain(flat, "RGGB")[3, 4] == np.float32(1e-3)


def test_a_few_hot_pixels_do_not_make_a_flat_saturated():
    flat = LAMP.copy()
    flat[5, 6] = 1
    assert flat_gain(flat, "RGGB")[5, 6] > 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda flat: flat * 1.7, r"saturated: 100\.0% .* row 0, column 1 of the RGGB cell above 95%"),
        (lambda flat: flat * 0.05, r"too dark: mean 1\.00% .* row 0, column 0 of the RGGB cell"),
        (lambda flat: np.where(flat > 0.6, np.nan, flat), "not finite"),
        (lambda flat: flat[0], "shape"),
    ],
)
def test_a_flat_that_tells_no_relative_light_is_refused(change, message):
    with pytest.raises(InvalidInput, match=message):
        flat_gain(change(LAMP), "RGGB")


@pytest.mark.parametrize("smoothing", [-1.0, np.nan, np.inf])
def test_a_smoothing_that_is_no_length_is_refused(smoothing):
    with pytest.raises(InvalidInput, match="smoothing"):
        flat_gain(LAMP, "RGGB", smoothing)
