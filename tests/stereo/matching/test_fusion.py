"""Two maps made one: every case of what each matcher may have found."""

import numpy as np
import pytest

from camcal.stereo.disparity import Confidence
from camcal.stereo.matching.fusion import alone, fused
from camcal.stereo.matching.matchers import Found

NOT = np.nan


def found(least, believed, difference=NOT):
    return Found(*(np.array([[value]], np.float32) for value in (least, believed, difference)))


@pytest.mark.parametrize(
    ("census", "gray_levels", "disparity", "confidence"),
    [
        (found(9, 9), found(9.25, 9.25), 9.125, Confidence.AGREED),
        (found(-9, -9), found(-9.75, -9.75), -9.375, Confidence.NEAR),
        (found(9, 9), found(10, 10), 9.5, Confidence.NEAR),
        (found(9, 9), found(10.5, 10.5), 9, Confidence.APART),
        (found(9, 9), found(9.25, NOT), 9, Confidence.SINGLE),
        (found(9, NOT), found(9.75, 9.75), 9.75, Confidence.SINGLE),
        (found(9, NOT), found(20, 20), NOT, Confidence.FILLED),
        (found(9, NOT), found(9, NOT), NOT, Confidence.FILLED),
        (found(9, NOT), found(NOT, NOT), NOT, Confidence.FILLED),
    ],
)
def test_two_matchers_make_one_map(census, gray_levels, disparity, confidence):
    result = fused(census, gray_levels)
    np.testing.assert_array_equal(result.disparity, [[disparity]])
    np.testing.assert_array_equal(result.confidence, [[confidence]])
    np.testing.assert_array_equal(result.difference, np.abs(census.believed - gray_levels.believed))


@pytest.mark.parametrize(("believed", "confidence"), [(9, Confidence.SINGLE), (NOT, Confidence.FILLED)])
def test_one_matcher_is_taken_at_its_word(believed, confidence):
    result = alone(found(9, believed, 0.5))
    np.testing.assert_array_equal(result.disparity, [[believed]])
    np.testing.assert_array_equal(result.confidence, [[confidence]])
    np.testing.assert_array_equal(result.difference, [[0.5]])
