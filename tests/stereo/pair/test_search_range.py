"""The range of disparities a pair tells: it holds the truth, is not much wider, and says when it knows nothing."""

import cv2
import numpy as np
import pytest
from textured import darker, noisy, textured_pair, waves

from camcal.errors import InvalidInput
from camcal.stereo.coarse import coarse_map, default_range, range_in

SLACK = 8  # px; two pixels of a look 256 wide, and rounding, on either side


def shown_range(left, right):
    return range_in(coarse_map(left, right), left.shape[1])


def assert_holds(found, truth, slack=SLACK):
    low, high = found
    assert low <= truth.min()
    assert high >= truth.max()
    assert high - low <= 1.4 * np.ptp(truth) + slack


@pytest.mark.parametrize("ends", [(3, 20), (-12, 9), (40, 75), (0.5, 2.5), (-40, -20)])
def test_the_range_holds_all_disparities_and_is_not_much_wider(ends):
    truth = waves(*ends)
    assert_holds(shown_range(*textured_pair(truth)), truth)


@pytest.mark.parametrize(
    "spoilt",
    [
        lambda left, right: (noisy(left), noisy(right, seed=3)),
        lambda left, right: (left, darker(right)),
        lambda left, right: (left, np.roll(right, 1, axis=0)),
        lambda left, right: (noisy(darker(left)), np.roll(noisy(right, seed=3), -1, axis=0)),
    ],
    ids=["noise", "exposure", "rows", "all"],
)
def test_noise_exposure_and_a_row_off_do_not_matter(spoilt):
    truth = waves(5, 32)
    assert_holds(shown_range(*spoilt(*textured_pair(truth))), truth)


@pytest.mark.parametrize("slope", [0.175, 0.25, 0.4])
@pytest.mark.parametrize("side", ["left", "right"])
def test_the_range_of_a_steep_wall_holds_all_that_the_right_image_shows(slope, side):
    across = np.arange(720) if side == "left" else np.arange(720)[::-1]
    truth = np.tile(10 + slope * across, (300, 1))
    low, high = shown_range(*textured_pair(truth))
    shown = truth[(np.arange(720) >= truth) & np.ones_like(truth, bool)]
    assert low <= shown.min()
    assert high >= shown.max()


def test_swapped_images_have_the_opposite_range():
    truth = waves(8, 30)
    left, right = textured_pair(truth)
    assert_holds(shown_range(right, left), -truth)


@pytest.mark.slow
def test_large_images_have_large_disparities():
    truth = waves(180, 700, (4000, 3000))
    small = textured_pair(waves(18, 70, (400, 300)))
    left, right = (cv2.resize(image, (4000, 3000), interpolation=cv2.INTER_CUBIC) for image in small)
    assert_holds(shown_range(left, right), truth, slack=SLACK * 4000 / 256)


def test_disparities_of_a_quarter_of_the_width_are_found():
    small = textured_pair(waves(50, 80))
    left, right = (cv2.resize(image, (640, 480), interpolation=cv2.INTER_CUBIC) for image in small)
    assert_holds(shown_range(left, right), waves(100, 160, (640, 480)), slack=SLACK * 640 / 256)


def striped_pair(disparity, rows, period):
    """Return a pair (H, W) uint8 whose first rows are a wall of stripes, at the disparity of the first pixel."""
    left, right = (image.astype(float) for image in textured_pair(disparity))
    across = np.arange(disparity.shape[1])
    left[:rows] = 128 + 60 * np.sin(2 * np.pi * (across - disparity[0, 0]) / period)
    right[:rows] = 128 + 60 * np.sin(2 * np.pi * across / period)
    return noisy(left, 2), noisy(right, 2, seed=3)


@pytest.mark.parametrize("period", [8, 10, 12])
def test_stripes_that_match_a_period_off_do_not_widen_the_range(period):
    truth = waves(12, 36)
    assert_holds(shown_range(*striped_pair(truth, 120, period)), truth)


def test_identical_images_have_a_narrow_range_about_zero():
    left, _ = textured_pair(waves(8, 30))
    low, high = shown_range(left, left)
    assert -6 <= low <= 0 <= high <= 6


@pytest.mark.parametrize("contrast", [0, 3, 30])
def test_images_that_share_nothing_tell_no_range_and_the_default_is_a_sixth_of_the_width(contrast):
    flat = np.full((240, 320), 100, np.uint8)
    left, right = noisy(flat, contrast, seed=1), noisy(flat, contrast, seed=2)
    assert np.isnan(coarse_map(left, right).disparities).all()
    assert shown_range(left, right) is None
    assert default_range(320) == (0, 53)


@pytest.mark.parametrize("shape", [(1, 1), (1, 50), (50, 1), (3, 5), (9, 14), (300, 16), (4, 2000)])
def test_images_of_any_size_get_a_range(shape):
    left, right = (noisy(np.full(shape, 100, np.uint8), 30, seed) for seed in (1, 2))
    low, high = shown_range(left, right) or default_range(shape[1])
    assert low < high


def test_a_small_pair_is_measured_in_full():
    truth = waves(2, 6, (48, 36))
    assert_holds(shown_range(*textured_pair(truth)), truth)


def test_the_range_does_not_depend_on_the_number_of_threads():
    pair = textured_pair(waves(5, 32))
    threads = cv2.getNumThreads()
    try:
        found = []
        for count in (1, 4):
            cv2.setNumThreads(count)
            found.append(coarse_map(*pair).disparities)
    finally:
        cv2.setNumThreads(threads)
    np.testing.assert_array_equal(*found)


def test_images_of_different_sizes_are_refused():
    with pytest.raises(InvalidInput, match="differ in size: 8x6 and 8x7"):
        coarse_map(np.zeros((6, 8), np.uint8), np.zeros((7, 8), np.uint8))
