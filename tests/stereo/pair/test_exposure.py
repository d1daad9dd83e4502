"""Exposures of a pair: what was done to one image is found, and only that."""

import numpy as np
import pytest
from textured import darker, noisy, textured_pair, waves

from camcal.stereo.alignment import vertical_residual
from camcal.stereo.pair_check import exposure_of


@pytest.fixture(scope="module")
def pair():
    return textured_pair(waves(5, 30, (400, 300)))


def exposure(left, right):
    residual = vertical_residual(left, right)
    return exposure_of(left, right, residual.pixels, residual.partners)


@pytest.mark.parametrize(
    ("gamma", "gain", "offset"), [(1.4, 0.8, 10.0), (1.0, 0.7, 0.0), (0.8, 0.9, 5.0), (1.0, 1.0, 25.0)]
)
def test_gain_gamma_and_offset_of_one_image_are_found(pair, gamma, gain, offset):
    left, right = pair
    changed = darker(right, gamma, gain, offset)
    found = exposure(left, changed)
    levels = np.array([60.0, 128.0, 190.0])  # between which the counts of the pair lie
    curve = found.gain * 255 * (levels / 255) ** found.gamma + found.offset
    np.testing.assert_allclose(curve, darker(levels, gamma, gain, offset), atol=1.5)  # counts; the three trade places
    assert found.brightness.value == pytest.approx(changed.mean() / right.mean() - 1, abs=0.02)  # features, not all
    assert found.differs


def test_equal_exposures_agree_in_spite_of_noise(pair):
    found = exposure(noisy(pair[0]), noisy(pair[1], seed=3))
    assert abs(found.brightness.value) < 3 * found.brightness.std + 0.002  # rounding of counts
    assert found.brightness.std < 0.005
    assert not found.differs


def test_a_difference_no_one_would_see_is_not_worth_a_word(pair):
    found = exposure(pair[0], darker(pair[1], 1.0, 0.98, 0.0))
    assert found.brightness.value == pytest.approx(-0.02, abs=0.003)
    assert not found.differs


def test_things_that_shine_do_not_count(pair):
    left, right = pair
    spoilt = darker(right, 1.0, 0.8, 0.0)
    spoilt[60:130, 100:200] = np.minimum(spoilt[60:130, 100:200] + 60.0, 255)
    assert exposure(left, spoilt).gain == pytest.approx(0.8, abs=0.05)


def test_images_that_are_black_or_white_tell_no_exposure(pair):
    left, right = (np.where(image > 128, 255, 0).astype(np.uint8) for image in pair)
    assert exposure(left, right) is None
