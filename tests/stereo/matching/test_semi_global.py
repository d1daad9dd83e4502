"""Semi-global matching against the recurrence of the paper written out, and its symmetries."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.stereo.matching.semi_global import (
    BITS,
    JUMP,
    STEP,
    UNSEEN,
    aggregate,
    census,
    equiangular_offset,
    fraction,
    is_ambiguous,
    least,
    matching_costs,
    right_costs,
    rough_fraction,
    smoothness_penalties,
)

PATHS = ((0, 1), (0, -1), (1, 0), (-1, 0))


def penalty_of_a_jump(here, before):
    """Return what a jump costs between two gray levels: less by the twelfth of their difference, but more than STEP."""
    return max(min(JUMP, 12 * JUMP // max(1, abs(int(here) - int(before)))), STEP + 1)


def sums_of_loops(costs, guide):
    """Return the sums (D, H, W) over four paths, Hirschmüller 2008, eq. 13, in whole numbers without limit."""
    count, height, width = costs.shape
    total = np.zeros(costs.shape, int)
    for down, across in PATHS:
        rows = range(height) if down >= 0 else range(height - 1, -1, -1)
        columns = range(width) if across >= 0 else range(width - 1, -1, -1)
        path = {}
        for y in rows:
            for x in columns:
                own = [int(cost) for cost in costs[:, y, x]]
                before = path.get((y - down, x - across))
                if before is not None:
                    jump = min(before) + penalty_of_a_jump(guide[y, x], guide[y - down, x - across])
                    for d in range(count):
                        beside = [before[near] + STEP for near in (d - 1, d + 1) if 0 <= near < count]
                        own[d] += min(before[d], jump, *beside) - min(before)
                path[y, x] = own
                total[:, y, x] += own
    return total


def some_volume(seed, shape):
    """Return costs (D, H, W) that leave little to chance, and a guide (H, W) with alike and unlike neighbours."""
    rng = np.random.default_rng(seed)
    costs = rng.integers(0, BITS + 1, shape).astype(np.uint8)
    guide = np.cumsum(rng.choice([0, 5, 14, 40, 200], shape[1:]), axis=1).astype(np.uint8)
    return costs, guide


volumes = st.tuples(st.integers(2, 9), st.integers(1, 5), st.integers(1, 6))


@given(volumes, st.integers(0, 2**32 - 1))
def test_sums_are_those_of_the_recurrence(shape, seed):
    costs, guide = some_volume(seed, shape)
    np.testing.assert_array_equal(aggregate(costs, guide), sums_of_loops(costs, guide))


def test_strips_of_tall_images_make_no_difference():
    costs, guide = some_volume(3, (4, 1030, 6))
    total = aggregate(costs, guide)
    across = aggregate(costs[:, 700:701], guide[700:701]).astype(
        int
    )  # a row alone: nothing but its own costs from above
    column = aggregate(costs[..., 2:3], guide[:, 2:3]).astype(int)
    own = 2 * costs[:, 700, 2].astype(int)  # that both count twice
    np.testing.assert_array_equal(total[:, 700, 2], across[:, 0, 2] - own + column[:, 700, 0] - own)


def test_the_greatest_sums_fit_eight_bits():
    costs = np.zeros((60, 3, 9), np.uint8)
    costs[:, :, ::2] = BITS  # jumps are worth their price: beside each pixel all disparities are costly but one
    for x in range(0, 9, 2):
        costs[7 * x, :, x] = 0
    guide = np.full((3, 9), 90, np.uint8)
    total = aggregate(costs, guide)
    np.testing.assert_array_equal(total, sums_of_loops(costs, guide))
    assert total.max() <= 4 * (BITS + JUMP)


def test_a_jump_is_cheaper_where_gray_levels_jump():
    levels = np.arange(256, dtype=np.uint8)
    guide = np.stack([np.zeros_like(levels), levels])
    expected = [penalty_of_a_jump(level, 0) for level in levels]
    np.testing.assert_array_equal(smoothness_penalties(guide, 0)[1], expected)
    np.testing.assert_array_equal(smoothness_penalties(guide.T, 1)[:, 1], expected)


@pytest.mark.parametrize(
    "flipped", [np.s_[::-1], np.s_[:, ::-1], np.s_[:, :, ::-1]], ids=["disparity", "rows", "columns"]
)
def test_turned_volumes_have_turned_sums(flipped):
    costs, guide = some_volume(4, (7, 12, 15))
    turned = guide[flipped[1:]] if isinstance(flipped, tuple) else guide
    np.testing.assert_array_equal(aggregate(costs[flipped], turned), aggregate(costs, guide)[flipped])


@given(st.integers(1, 300), st.integers(0, 2**32 - 1))
def test_the_least_is_the_first_of_the_least(count, seed):
    total = np.random.default_rng(seed).integers(0, 253, (count, 3, 4)).astype(np.uint8)
    np.testing.assert_array_equal(least(total), np.argmin(total, axis=0))


@given(st.integers(-9, 9), st.integers(1, 6), st.integers(0, 2**32 - 1))
def test_costs_seen_from_the_right_are_those_of_mirrored_images_swapped(first, count, seed):
    left, right = (census(image) for image in np.random.default_rng(seed).integers(0, 99, (2, 3, 8)).astype(np.uint8))
    mirrored = matching_costs(right[:, ::-1], left[:, ::-1], first, count)[..., ::-1]
    seen = right_costs(matching_costs(left, right, first, count), first)
    for index in range(count):
        for x in range(8):
            if 0 <= x + first + index < 8:
                np.testing.assert_array_equal(seen[index, :, x], mirrored[index, :, x])
            else:
                assert (seen[index, :, x] > 4 * (BITS + JUMP)).all()
                assert (mirrored[index, :, x] == UNSEEN).all()


@pytest.mark.parametrize("method", [fraction, rough_fraction])
@pytest.mark.parametrize("quarters", [-2, -1, 0, 1, 2])
def test_the_fraction_is_exact_where_costs_are_a_v(method, quarters):
    # each arm as steep as the other, its least between the fourth and the sixth place
    arms = np.abs(4 * np.arange(10) - (20 + quarters)).astype(np.uint8)
    costs = np.tile(arms[:, None, None], (1, 12, 12))
    found = method(costs, np.full((12, 12), 5))
    np.testing.assert_allclose(found, quarters / 4, atol=1e-6)  # float32


def test_a_least_cost_at_an_end_of_the_range_has_no_fraction():
    costs = np.tile(np.arange(10, dtype=np.uint8)[:, None, None], (1, 6, 6))
    for method in (fraction, rough_fraction):
        assert not method(costs, np.zeros((6, 6), int)).any()
        assert not method(costs[::-1], np.full((6, 6), 9)).any()


@given(st.lists(st.floats(0, 1e4, width=32), min_size=3, max_size=3))
def test_a_fraction_is_at_most_half_a_pixel(three):
    found = equiangular_offset(np.array(three, np.float32).reshape(3, 1, 1), np.ones((1, 1), bool))
    assert -0.5 <= found[0, 0] <= 0.5


@pytest.mark.parametrize(("place", "more", "ambiguous"), [(9, 20, True), (9, 21, False), (6, 20, True), (5, 0, False)])
def test_a_second_minimum_is_at_least_three_disparities_away_and_hardly_higher(place, more, ambiguous):
    total = np.full((12, 1, 1), 200, np.uint8)
    total[3] = 50
    total[place] = 50 + more
    assert is_ambiguous(total, np.full((1, 1), 3)).tolist() == [[ambiguous]]
