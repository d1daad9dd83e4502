"""A square before a wall: what it hides in the right image is known by counting columns."""

import numpy as np
import pytest

from camcal.errors import InvalidInput
from camcal.stereo.truth import unoccluded, visible_in_both

WALL, SQUARE = 4.0, 10.0
SIZE = (8, 60)


def scene():
    """The truths of both images, and what the right camera sees of the left image (8, 60)."""
    left, right = np.full(SIZE, WALL), np.full(SIZE, WALL)
    left[:, 30:40] = SQUARE
    right[:, 20:30] = SQUARE
    seen = np.ones(SIZE, bool)
    seen[:, :4] = False  # would be left of the right image
    seen[:, 24:30] = False  # at 20 … 25 there, where the square is
    return left, right, seen


def test_the_truths_of_both_images_tell_what_is_occluded():
    left, right, seen = scene()
    np.testing.assert_array_equal(visible_in_both(left, right), seen)


def test_the_left_truth_alone_tells_the_same_of_what_it_knows():
    left, _, seen = scene()
    np.testing.assert_array_equal(unoccluded(left), seen)


def test_what_is_unknown_is_not_seen_and_hides_nothing():
    left, right, _ = scene()
    left[:, 30:40] = np.nan
    found = unoccluded(left)
    assert not found[:, 30:40].any()
    assert found[:, 24:30].all()
    assert not visible_in_both(left, right)[:, 24:40].any()


def test_a_slanted_surface_hides_nothing_of_itself():
    across = np.arange(60)
    truth = np.broadcast_to(5 + 0.3 * across, SIZE)  # each column of the right image is less than one of the left
    inside = np.broadcast_to(across - truth[0] >= 0, SIZE)
    np.testing.assert_array_equal(unoccluded(truth), inside)


def test_a_surface_that_is_stretched_in_the_right_image_has_no_holes():
    truth = np.broadcast_to(20 - 0.3 * np.arange(60), SIZE).copy()
    truth[:, :10] = 5.0  # behind it, and seen if there were holes between its columns
    assert not unoccluded(truth)[:, :10].any()


def test_truths_of_different_sizes_are_refused():
    with pytest.raises(InvalidInput, match="60 × 8 and 30 × 8"):
        visible_in_both(np.zeros(SIZE), np.zeros((8, 30)))
