"""What a pair's preparation finds wrong with it, and when it keeps quiet."""

import numpy as np
import pytest
from textured import darker, noisy, textured_pair, waves

from camcal.stereo.matching.preparation import prepare
from camcal.stereo.pair_check import SWAPPED


@pytest.mark.parametrize("exposed", ["left", "right"])
@pytest.mark.parametrize(("gamma", "gain", "offset"), [(1.4, 0.8, 10), (1.5, 0.7, 8), (1.0, 0.7, 0)])
def test_the_image_of_less_contrast_is_brought_to_the_exposure_of_the_other(exposed, gamma, gain, offset):
    images = dict(zip(("left", "right"), textured_pair(waves(12, 30)), strict=True))
    changed = images | {exposed: darker(images[exposed], gamma, gain, offset)}
    found = prepare(**changed).pair
    other = "right" if exposed == "left" else "left"
    np.testing.assert_array_equal(getattr(found, other), images[other])
    off = np.abs(getattr(found, exposed).astype(int) - images[exposed])
    assert np.quantile(off, 0.95) <= 3  # gray levels; those of the dark end are rounded to one count
    np.testing.assert_array_equal(getattr(prepare(**changed, expose=False).pair, exposed), changed[exposed])


def test_a_wall_that_only_one_camera_shows_is_no_exposure():
    left, right = textured_pair(waves(110, 130))
    left[:, :100] = np.clip(left[:, :100] // 4 + 190, 0, 255)  # histograms differ by 100 gray levels
    pair = prepare(left, right).pair
    np.testing.assert_array_equal(pair.left, left)
    np.testing.assert_array_equal(pair.right, right)


def test_a_range_all_behind_infinity_is_a_failure_without_alignment():
    left, right = textured_pair(waves(12, 30))
    assert prepare(right, left, align=False).failures == (SWAPPED,)
    assert prepare(left, right, align=False).failures == ()


def test_swapped_images_fail_once():
    left, right = textured_pair(waves(12, 30))
    assert prepare(right, left).failures == (SWAPPED,)


@pytest.mark.parametrize("align", [True, False])
def test_a_negative_range_that_was_asked_for_is_no_swap(align):
    left, right = textured_pair(waves(12, 30))
    assert prepare(right, left, (-40, 0), align=align).failures == ()


def test_negative_disparities_before_what_the_geometry_puts_infinitely_far_are_no_swap():
    left, right = textured_pair(waves(-30, -12))
    assert prepare(left, right, farthest=-35.0).failures == ()
    assert prepare(left, right, farthest=-10.0).failures == (SWAPPED,)


def test_rows_that_are_off_by_more_than_can_be_corrected_are_a_failure():
    left, right = textured_pair(waves(12, 30), 9.0)
    prepared = prepare(left, right)
    assert prepared.rows == 0
    assert "more than the 5 px that can be put right" in prepared.failures[0].text


@pytest.mark.parametrize("period", [9, 14, 20, 33])
@pytest.mark.parametrize("grid", [False, True], ids=["stripes", "grid"])
def test_periodic_texture_tells_no_range_and_is_no_swap(period, grid):
    across, down = np.meshgrid(np.arange(640), np.arange(240))
    rows = 40 * np.sin(2 * np.pi * down / period) if grid else 10 * np.sin(down / 7)
    left, right = (128 + rows + 50 * np.sin(2 * np.pi * (across - moved) / period) for moved in (40, 0))
    prepared = prepare(noisy(left.astype(np.uint8), 2), noisy(right.astype(np.uint8), 2, seed=3))
    assert prepared.failures == ()
    (warning,) = prepared.warnings
    assert warning.text == "disparity range not measurable (periodic texture): 0 to 107 is used; set --range"
