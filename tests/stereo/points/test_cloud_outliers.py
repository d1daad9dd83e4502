"""Pixels and points that stand alone, against counting neighbours one by one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from camcal.errors import InvalidInput
from camcal.stereo.selection import NEIGHBOURS, has_neighbours, has_similar_neighbours

VALUES = st.sampled_from([np.nan, 5.0, 5.5, 6.0, 6.5, 7.0, 300.0])


def company_one_by_one(disparity):
    found = np.zeros(disparity.shape, bool)
    for row, column in np.ndindex(disparity.shape):
        window = disparity[max(row - 2, 0) : row + 3, max(column - 2, 0) : column + 3]
        found[row, column] = np.count_nonzero(np.abs(window - disparity[row, column]) <= 1) - 1 >= NEIGHBOURS
    return found


@given(arrays(np.float32, array_shapes(min_dims=2, max_dims=2, max_side=9), elements=VALUES))
def test_company_is_what_counting_neighbours_gives(disparity):
    np.testing.assert_array_equal(
        has_similar_neighbours(disparity, slice(0, len(disparity))), company_one_by_one(disparity)
    )


@given(arrays(np.float32, (9, 6), elements=VALUES), st.integers(0, 8), st.integers(1, 9))
def test_rows_around_the_block_count_too(disparity, start, length):
    stop = min(start + length, 9)
    first, last = max(start - 2, 0), min(stop + 2, 9)
    found = has_similar_neighbours(disparity[first:last], slice(start - first, stop - first))
    np.testing.assert_array_equal(found, company_one_by_one(disparity)[start:stop])


def test_a_single_wrong_pixel_and_a_speck_of_six_are_alone_and_seven_are_not():
    disparity = np.full((20, 20), 10.0, np.float32)
    disparity[3, 3] = 50
    disparity[10:12, 3:6] = 50
    disparity[10:12, 12:15] = disparity[12, 12] = 50
    lonely = ~has_similar_neighbours(disparity, slice(0, 20))
    assert np.argwhere(lonely).tolist() == [[3, 3], *([row, column] for row in (10, 11) for column in (3, 4, 5))]


def test_an_empty_map_has_no_company():
    assert has_similar_neighbours(np.zeros((0, 5), np.float32), slice(0, 0)).shape == (0, 5)


def test_neighbours_in_space_are_what_distances_say():
    points = np.random.default_rng(0).normal(0, 1, (300, 3))
    distances = np.linalg.norm(points[:, None] - points, axis=2)
    expected = np.count_nonzero(distances <= 0.5, axis=1) - 1 >= NEIGHBOURS
    np.testing.assert_array_equal(has_neighbours(points, 0.5), expected)
    assert 0 < expected.sum() < 300


def test_the_radius_is_one_percent_of_the_median_depth_unless_it_is_given():
    points = np.zeros((8, 3))
    points[:, 2] = 100
    points[7, 0] = 1.01
    assert has_neighbours(points).tolist() == [True] * 7 + [False]


@pytest.mark.parametrize("count", [0, 1, 6])
def test_too_few_points_are_all_alone(count):
    assert not has_neighbours(np.ones((count, 3)), 1.0).any()


@pytest.mark.parametrize("radius", [0.0, -1.0, np.nan])
def test_a_radius_that_is_none_is_refused(radius):
    with pytest.raises(InvalidInput, match="radius"):
        has_neighbours(np.ones((9, 3)), radius)
