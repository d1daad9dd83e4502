"""The census transform and its costs, against the same told pixel by pixel."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.stereo.matching.semi_global import BITS, REACH, UNSEEN, census, matching_costs, overlap


def census_of_loops(gray):
    """Return for every pixel (H, W) the neighbours that are darker, as a list of booleans; borders go on outwards."""
    height, width = gray.shape
    steps = range(-REACH, REACH + 1)

    def darker(y, x, down, across):
        there = gray[min(max(y + down, 0), height - 1), min(max(x + across, 0), width - 1)]
        return bool(there < gray[y, x])

    return [
        [[darker(y, x, down, across) for down in steps for across in steps if down or across] for x in range(width)]
        for y in range(height)
    ]


def costs_of_loops(left, right, first, count):
    words = [census_of_loops(image) for image in (left, right)]
    height, width = left.shape
    costs = np.full((count, height, width), UNSEEN)
    for index, y, x in np.ndindex(costs.shape):
        there = x - first - index
        if 0 <= there < width:
            costs[index, y, x] = sum(a != b for a, b in zip(words[0][y][x], words[1][y][there], strict=True))
    return costs


def some_pair(seed, shape, dtype=np.uint8):
    """Return images of few gray levels, so that neighbours are often alike."""
    return np.random.default_rng(seed).integers(0, 12, (2, *shape)).astype(dtype)


shapes = st.tuples(st.integers(1, 5), st.integers(1, 8))


@given(shapes, st.integers(-12, 12), st.integers(1, 9), st.integers(0, 2**32 - 1))
def test_costs_are_the_neighbours_whose_order_differs(shape, first, count, seed):
    left, right = some_pair(seed, shape)
    costs = matching_costs(census(left), census(right), first, count)
    np.testing.assert_array_equal(costs, costs_of_loops(left, right, first, count))


def test_costs_are_the_same_in_images_of_more_rows_than_are_worked_on_at_once():
    left, right = (census(image) for image in some_pair(1, (53, 30)))
    costs = matching_costs(left, right, 2, 5)
    for row in (0, 15, 16, 31, 32, 52):
        np.testing.assert_array_equal(costs[:, row], matching_costs(left[[row]], right[[row]], 2, 5)[:, 0])


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_the_transform_does_not_mind_exposure(dtype):
    gray, _ = some_pair(2, (9, 11), dtype)
    np.testing.assert_array_equal(census(gray), census((17 * gray + 3).astype(dtype)))


def test_a_pixel_brighter_than_all_others_has_every_bit():
    gray = np.zeros((9, 9), np.uint8)
    gray[4, 4] = 1
    transform = census(gray)
    assert transform[4, 4] == 2**BITS - 1
    assert np.count_nonzero(transform) == 1


@given(st.integers(-40, 40), st.integers(1, 20))
def test_the_overlap_is_what_both_images_show(disparity, width):
    here, there = overlap(disparity, width)
    columns = np.arange(width)
    np.testing.assert_array_equal(columns[here], [x for x in columns if 0 <= x - disparity < width])
    np.testing.assert_array_equal(columns[there], columns[here] - disparity)
