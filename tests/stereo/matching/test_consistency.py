"""What both images agree on, against loops over pixels."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from camcal.stereo.matching.matchers import AGREEMENT, difference_seen, has_texture, ordering_holds, without_speckles

shapes = st.tuples(st.integers(1, 4), st.integers(1, 14))


def some_maps(seed, shape):
    """Return maps (2, H, W) of halves and quarters, near each other in many places, a fifth of them NaN."""
    rng = np.random.default_rng(seed)
    maps = rng.integers(-24, 40, (2, *shape)) / np.float32(4)
    maps[1] = np.where(rng.random(shape) < 0.5, 2.25, maps[1])
    maps[rng.random(maps.shape) < 0.2] = np.nan
    return maps


@given(shapes, st.integers(0, 2**32 - 1))
def test_the_difference_is_what_the_right_pixel_says_otherwise(shape, seed):
    left, right = some_maps(seed, shape)
    expected = np.full(shape, np.nan, np.float32)
    for y, x in np.ndindex(shape):
        if np.isfinite(left[y, x]):
            there = round(float(x - left[y, x]))  # to the even neighbour, as numpy
            if 0 <= there < shape[1]:
                expected[y, x] = abs(right[y, there] - left[y, x])
    np.testing.assert_array_equal(difference_seen(left, right), expected)


@given(shapes, st.integers(0, 2**32 - 1))
def test_out_of_order_is_what_something_to_the_right_stands_left_of(shape, seed):
    disparity = some_maps(seed, shape)[0]
    there = np.arange(shape[1]) - disparity
    expected = np.array(
        [
            [
                not any(there[y, x] > there[y, other] + AGREEMENT for other in range(x, shape[1]))
                for x in range(shape[1])
            ]
            for y in range(shape[0])
        ]
    )
    known = np.isfinite(disparity)
    np.testing.assert_array_equal(ordering_holds(disparity)[known], expected[known])


def test_what_a_near_thing_hides_is_out_of_order():
    disparity = np.full((1, 40), 5.0, np.float32)
    disparity[0, 20:28] = 15
    hidden = np.flatnonzero(~ordering_holds(disparity)[0])
    # Columns 10 to 17 are behind it; two more stand to its right in the right image. A pixel of difference is allowed.
    np.testing.assert_array_equal(hidden, range(12, 20))


def test_small_patches_are_left_out_and_large_ones_kept():
    disparity = np.full((40, 40), 5.0, np.float32)
    disparity[2:9, 2:9] = 30  # 49 pixels
    disparity[20:30, 20:25] = -30  # 50
    disparity[0, 39] = np.nan
    cleaned = without_speckles(disparity)
    assert np.isnan(cleaned[2:9, 2:9]).all()
    assert np.isnan(cleaned).sum() == 49 + 1
    np.testing.assert_array_equal(cleaned[20:30, 20:25], -30)


def test_a_slope_is_one_patch():
    disparity = np.tile(np.linspace(-20, 20, 60, dtype=np.float32), (3, 1))  # 0.68 px from pixel to pixel
    np.testing.assert_array_equal(without_speckles(disparity), disparity)


def test_texture_is_missing_only_farther_than_15_pixels_from_any():
    gray = np.full((40, 60), 200, np.uint8)
    gray[:, :10] = np.arange(40)[:, None] * 5
    texture = has_texture(gray)
    assert texture[:, :25].all()
    assert not texture[:, 25:].any()


def test_a_step_of_one_gray_level_is_no_texture():
    gray = np.full((20, 40), 250, np.uint8)
    gray[:, 20:] = 251
    assert not has_texture(gray).any()
