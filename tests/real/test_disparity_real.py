"""Disparities of real pairs with known ones: all pixels get one, and those without are counted as wrong."""

from functools import cache

import cv2
import numpy as np
import pytest
from stereo_truth import MAPS, STREET, pair_of
from textured import darker, noisy

from camcal.formats import disparity
from camcal.stereo.disparity import Confidence
from camcal.stereo.matching.match import match
from camcal.stereo.options import ALL, BALANCED, BEST, FAST, MatchOptions
from camcal.stereo.truth import evaluate, visible_in_both

CONES, TEDDY, VENUS, MOTORCYCLE = (
    "middlebury2003-cones", "middlebury2003-teddy", "middlebury2001-venus", "middlebury2014-motorcycleQ",
)  # fmt: skip


@cache
def truth_and_mask(data, name):
    """Return the known disparity (H, W), pixels, NaN elsewhere, and which pixels (H, W) both images show."""
    folder, scale = data / "stereo_gt" / name, float(MAPS[name][-1])
    if name == MOTORCYCLE:
        return disparity.read(folder / "disp0GT.pfm").matched(), cv2.imread(str(folder / "mask0nocc.png"), 0) == 255
    left, right = (disparity.read(folder / f"disp{view}.png", scale).matched() for view in (2, 6))
    return left, visible_in_both(left, right)


@cache
def found_in(data, name, quality=BEST):
    return match(*pair_of(data, name), MatchOptions(quality, fill=ALL))


def bad2(data, name, found):
    """Return the share of the pixels both images show that are off by more than 2 px, percent."""
    figures = evaluate(found.values, *truth_and_mask(data, name)).figures["nocc"]
    assert figures["density"] == 100
    return figures["bad2"]


@pytest.mark.parametrize(
    ("name", "quality", "most"),
    [
        (CONES, BEST, 2.5), (TEDDY, BEST, 3.1), (MOTORCYCLE, BEST, 3.2), (VENUS, BEST, 0.4),
        (CONES, BALANCED, 2.7), (TEDDY, BALANCED, 2.7),
        (CONES, FAST, 3.3), (TEDDY, FAST, 5.2), (MOTORCYCLE, FAST, 4.9),
    ],
)  # fmt: skip
def test_few_pixels_of_a_real_pair_are_wrong(real_data, name, quality, most):
    # The textbook's matcher has 13.1, 17.3 and 12.0 % on the first three. Limits: a tenth above what was measured.
    assert bad2(real_data, name, found_in(real_data, name, quality)) <= most


@pytest.mark.parametrize("name", [CONES, TEDDY, MOTORCYCLE])
def test_a_row_of_misalignment_is_repaired(real_data, name):
    left, right = pair_of(real_data, name)
    repaired = match(left, np.roll(right, 1, axis=0), MatchOptions(fill=ALL))
    assert bad2(real_data, name, repaired) <= bad2(real_data, name, found_in(real_data, name)) + 0.3


@pytest.mark.parametrize("name", [CONES, TEDDY, VENUS, MOTORCYCLE])
def test_two_rows_of_misalignment_are_repaired_with_fast_too(real_data, name):
    left, right = pair_of(real_data, name)
    repaired = match(left, np.roll(right, 2, axis=0), MatchOptions(FAST, fill=ALL))
    assert bad2(real_data, name, repaired) <= 5.0  # 16 to 26 % as they are


@pytest.mark.parametrize("name", [CONES, TEDDY, VENUS, MOTORCYCLE])
def test_a_closer_scene_is_matched_by_fast_as_well_as_by_a_padded_matcher(real_data, name):
    # What is beyond the crop only one image shows: histograms of the two differ, their exposures do not.
    left, right = pair_of(real_data, name)
    width = left.shape[1] - 240 * left.shape[1] // 741
    found = match(
        np.ascontiguousarray(left[:, :width]), np.ascontiguousarray(right[:, -width:]), MatchOptions(FAST, fill=ALL)
    )
    truth, visible = (values[:, :width] for values in truth_and_mask(real_data, name))
    truth = truth + left.shape[1] - width
    seen = visible & (np.arange(width) - truth >= 0)
    assert 100 * np.mean(~(np.abs(found.values - truth) <= 2)[seen]) <= 5.7  # as three-way matching, padded and filled
    assert max(found.at_ends) < 0.02  # nothing to warn of


@pytest.mark.parametrize("name", [CONES, TEDDY, MOTORCYCLE])
def test_another_exposure_costs_little(real_data, name):
    left, right = pair_of(real_data, name)
    exposed = match(left, darker(right), MatchOptions(fill=ALL))
    assert bad2(real_data, name, exposed) <= 1.2 * bad2(real_data, name, found_in(real_data, name))


@pytest.mark.parametrize(("name", "most"), [(CONES, 4.1), (TEDDY, 6.8), (MOTORCYCLE, 6.0)])
def test_noise_of_five_gray_levels_is_survived(real_data, name, most):
    left, right = pair_of(real_data, name)
    found = match(noisy(left), noisy(right, seed=3), MatchOptions(fill=ALL))
    assert bad2(real_data, name, found) <= most  # eight paths, padded and filled, have 4.8, 11.9 and 10.9


@pytest.mark.parametrize("quality", [BALANCED, BEST])
@pytest.mark.parametrize("name", MAPS)
def test_sigma_holds_two_thirds_of_the_errors_of_a_real_pair(real_data, name, quality):
    found, truth = found_in(real_data, name, quality), truth_and_mask(real_data, name)[0]
    off = np.abs(found.values - truth - np.nanmedian(found.values - truth))[np.isfinite(truth)]  # truths have offsets
    # Of truths in whole quarters and eighths of a pixel nobody says whose error the rounding is.
    rounding = 0 if name == MOTORCYCLE else 1 / MAPS[name][-1] / np.sqrt(12)
    sigma = found.sigma[np.isfinite(truth)]
    assert np.mean(off <= sigma) >= 0.62
    assert np.mean(off <= np.hypot(sigma, rounding)) <= 0.78


def test_most_of_a_street_is_matched(real_data):
    found = match(*pair_of(real_data, STREET[0]))
    assert np.isfinite(found.values).mean() > 0.64  # much of the rest is sky, or beside the right image
    assert np.mean(found.confidence >= Confidence.NEAR) > 0.5
    assert np.nanmin(found.values) > -1  # nothing lies beyond the horizon, but for noise
