"""Two maps made one: every case of what each matcher may have found."""

import numpy as np
import pytest

from camcal.stereo.disparity import Confidence
from camcal.stereo.matching.matchers import Found, fused, single_matcher

NOT = np.nan


def found(least, believed, difference=NOT, *, ambiguous=False):
    values = (np.array([[value]], np.float32) for value in (least, believed, difference))
    return Found(*values, np.array([[ambiguous]]), np.zeros((1, 1), np.int8))


@pytest.mark.parametrize(
    ("census", "gray_levels", "disparity", "confidence"),
    [
        (found(9, 9), found(9.25, 9.25), 9.125, Confidence.AGREED),
        (found(9, 9), found(9.375, 9.375), 9.1875, Confidence.NEAR),
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


def test_what_has_a_rival_is_as_unsure_as_what_one_matcher_says():
    result = fused(found(9, 9, ambiguous=True), found(9.25, 9.25))
    assert result.disparity == 9.125
    assert result.confidence == Confidence.SINGLE
    assert np.isnan(result.difference)
    assert single_matcher(found(9, 9, 0.1, ambiguous=True)).difference == 1


@pytest.mark.parametrize(("believed", "confidence"), [(9, Confidence.SINGLE), (NOT, Confidence.FILLED)])
def test_one_matcher_is_taken_at_its_word(believed, confidence):
    result = single_matcher(found(9, believed, 0.5))
    np.testing.assert_array_equal(result.disparity, [[believed]])
    np.testing.assert_array_equal(result.confidence, [[confidence]])
    np.testing.assert_array_equal(result.difference, [[0.5]])
