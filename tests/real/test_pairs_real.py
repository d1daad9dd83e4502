"""Rows and ranges of real pairs: what is put into them is measured."""

import cv2
import numpy as np
import pytest
from stereo_truth import MAPS, STREET, pair_of, truth_of
from textured import darker, noisy

from camcal.stereo.alignment import align_rows, quick_residual, row_correction, vertical_residual
from camcal.stereo.coarse import coarse_map, range_in
from camcal.stereo.pair_check import check_pair

SPOILT = {
    "as it is": lambda left, right: (left, right),
    "noise": lambda left, right: (noisy(left), noisy(right, seed=3)),
    "exposure": lambda left, right: (left, darker(right)),
    "rows": lambda left, right: (left, np.roll(right, 1, axis=0)),
}


@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize("state", SPOILT)
def test_the_range_holds_the_truth_of_a_real_pair_and_is_not_much_wider(real_data, name, state):
    truth = truth_of(real_data, name)
    left, right = SPOILT[state](*pair_of(real_data, name))
    low, high = range_in(coarse_map(left, right), left.shape[1])
    assert np.mean((truth < low) | (truth > high)) <= 0.0005
    assert high - low <= 1.4 * np.ptp(truth) + 8  # two pixels of a look 256 wide, and rounding, on either side


def lowered(image, rows):
    """Return an image whose rows lie lower by a part of a pixel, without the blur of linear interpolation."""
    shift = np.array([[1, 0, 0], [0, 1, rows]], float)
    return cv2.warpAffine(image, shift, image.shape[::-1], flags=cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)


@pytest.mark.parametrize("name", [*MAPS, STREET[0]])
def test_half_a_pixel_put_into_a_real_pair_is_measured_and_put_right(real_data, name):
    left, right = pair_of(real_data, name)
    before, after = vertical_residual(left, right), vertical_residual(left, lowered(right, 0.5))
    assert after.median.value - before.median.value == pytest.approx(0.5, abs=0.02)  # resampling itself moves features
    assert after.median.std < 0.03
    correction = row_correction(after)
    assert correction is not None
    repaired = vertical_residual(left, align_rows(lowered(right, 0.5), correction))
    assert repaired.trend.rms < 0.05


@pytest.mark.parametrize("name", [*MAPS, STREET[0]])
def test_corners_followed_tell_the_rows_of_a_real_pair_as_features_do(real_data, name):
    left, right = pair_of(real_data, name)
    quick, thorough = quick_residual(left, darker(lowered(right, 0.5))), vertical_residual(left, lowered(right, 0.5))
    assert quick.trend.centre.value == pytest.approx(thorough.trend.centre.value, abs=0.1)  # other places of the scene
    assert len(quick.dy) > 300  # of 400 corners that are followed


def test_real_pairs_are_not_found_to_be_anything_else_than_pairs(real_data):
    street = check_pair(*pair_of(real_data, STREET[0]))
    assert street.failure is None
    assert street.exposure is not None
    assert not street.exposure.differs
    assert street.residual.median.value == pytest.approx(-0.16, abs=0.04)  # two standard errors
    assert street.residual.trend.tilt.value == pytest.approx(-1.0, abs=0.2)  # px across the width
