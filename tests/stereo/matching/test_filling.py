"""Gaps filled, against a loop over the pixels of each row, and smoothing that keeps steps."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.stereo.matching.matchers import everywhere, from_the_background, smoothed, without_spikes

shapes = st.tuples(st.integers(1, 5), st.integers(1, 12) | st.integers(40, 90))


def some_map(seed, shape, gaps):
    rng = np.random.default_rng(seed)
    disparity = rng.integers(-20, 60, shape).astype(np.float32) / 4
    disparity[rng.random(shape) < gaps] = np.nan
    disparity[rng.random(shape[0]) < 0.2] = np.nan
    return disparity


def side_of(row, x, step):
    """Return the value at a side of a gap, and how far away it is; None if the row ends before."""
    distance = 0
    while 0 <= x < len(row) and np.isnan(row[x]):
        x, distance = x + step, distance + 1
    return (float(row[x]), distance) if 0 <= x < len(row) else None


def filled_by_a_loop(disparity):
    """Return the filled map, the choice and the distance (3, H, W).

    It is the smaller of both sides, the left of equals; or the straight line between them in a gap of more than 30
    pixels and two more for every pixel by which they differ. Maps of so few rows tell no slope.
    """
    result = np.stack([disparity, np.zeros_like(disparity), np.zeros_like(disparity)])
    for y, x in np.argwhere(np.isnan(disparity)):
        sides = [side_of(disparity[y], x, step) for step in (-1, 1)]
        known = [side for side in sides if side is not None]
        if known:
            value, distance = min(known, key=lambda side: side[0])
            choice = abs(known[0][0] - known[-1][0])
            length = sum(side[1] for side in known) - 1
            if len(known) == 2 and length > 2 * choice + 30:
                (left, before), (right, after) = known
                value, distance = left + (right - left) * before / (length + 1), min(before, after)
            result[:, y, x] = value, choice, distance
    return result


@given(shapes, st.sampled_from([0.1, 0.5, 0.9, 0.98]), st.integers(0, 2**32 - 1))
def test_gaps_are_filled_from_the_farther_side_and_wide_ones_by_a_line(shape, gaps, seed):
    disparity = some_map(seed, shape, gaps)
    filled, choice, distance = from_the_background(disparity)
    expected, expected_choice, expected_distance = filled_by_a_loop(disparity)
    np.testing.assert_allclose(filled, expected, atol=1e-5)  # of lines in float32
    np.testing.assert_array_equal(choice, expected_choice)
    known = np.isfinite(expected)  # in a row without a side a distance means nothing
    np.testing.assert_array_equal(distance[known], expected_distance[known])


def test_a_wide_gap_in_a_slanted_surface_is_filled_along_the_surface():
    surface = np.tile(np.linspace(10, 24, 141, dtype=np.float32), (5, 1))
    gappy = surface.copy()
    gappy[:, 20:110] = np.nan
    np.testing.assert_allclose(from_the_background(gappy).disparity, surface, atol=1e-4)  # float32


def wall_behind_a_board(slope):
    """Return a wall (30, 160) that is steep from left to right with a board before it, and what the board hides."""
    disparity = np.tile(12 + slope * np.arange(160, dtype=np.float32), (30, 1))
    disparity[:, 80:110] = 40
    return disparity, slice(65, 80)


@pytest.mark.parametrize("slope", [0.1, -0.06, 0.0])
def test_what_is_hidden_goes_on_as_steeply_as_the_wall_beside_it(slope):
    disparity, hidden = wall_behind_a_board(slope)
    gappy = disparity.copy()
    gappy[:, hidden] = gappy[:, :12] = np.nan
    filled = from_the_background(gappy)
    np.testing.assert_allclose(filled.disparity, disparity, atol=1e-4)  # float32
    assert filled.distance[0, 79] == 15
    assert filled.distance[0, 0] == 12


def test_nothing_hidden_comes_before_what_hides_it():
    disparity, hidden = wall_behind_a_board(0.4)
    disparity[:, 80:110] = 39
    disparity[:, hidden] = np.nan
    assert from_the_background(disparity).disparity[:, hidden].max() == 39


def test_a_surface_that_bends_beside_a_gap_tells_no_slope():
    disparity, hidden = wall_behind_a_board(0.0)
    disparity[:, :65] += 0.01 * np.arange(-64, 1) ** 2
    disparity[:, hidden] = np.nan
    np.testing.assert_array_equal(from_the_background(disparity).disparity[:, hidden], 12)


@given(shapes, st.integers(0, 2**32 - 1))
def test_rows_that_have_none_are_those_of_the_nearest_that_has(shape, seed):
    disparity = from_the_background(some_map(seed, shape, 0.5)).disparity
    dense = everywhere(disparity)
    rows = [y for y in range(shape[0]) if np.isfinite(disparity[y]).all()]
    for y in range(shape[0]):
        near = [other for other in rows if abs(other - y) == min(abs(row - y) for row in rows)]
        assert not rows or any(np.array_equal(dense[y], disparity[other]) for other in near)
    assert rows or np.isnan(dense).all()


def test_a_spike_goes_and_a_step_stays():
    disparity = np.full((20, 30), 5.0, np.float32)
    disparity[:, 15:] = 25
    expected = disparity.copy()
    disparity[10, 5] = 60
    np.testing.assert_array_equal(without_spikes(disparity), expected)
    np.testing.assert_allclose(smoothed(disparity), expected, atol=1e-3)  # exp(-89): nothing comes over the step


def test_noise_becomes_less():
    noise = np.random.default_rng(1).normal(0, 0.3, (60, 80)).astype(np.float32)
    assert smoothed(noise + 9).std() < noise.std() / 3  # the mean of some tens of pixels


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1), (2, 3)])
def test_maps_of_any_size_are_smoothed(shape):
    np.testing.assert_allclose(smoothed(np.full(shape, -7.5, np.float32)), -7.5, rtol=1e-6)  # float32
