"""Rows of a pair: what is put into it is measured, with an honest error, and can be put right."""

from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from textured import noisy, textured_pair, waves

from camcal.errors import InsufficientData, InvalidInput
from camcal.stereo.alignment import align_rows, quick_residual, residual_of, row_correction, vertical_residual
from camcal.stereo.coarse import Matches

SIZE = (300, 240)


@cache
def pair_off_by(rows):
    """Return a pair (H, W) uint8 whose row differences so much."""
    return textured_pair(waves(5, 30, SIZE), rows)


@cache
def residual_off_by(rows):
    return vertical_residual(*pair_off_by(rows))


def matches_of(rows, *, count=600, wrong=0.0, scatter=0.2, per_disparity=0.0, seed=1):
    """Return matches of a pair whose row differences an affine map, some of them wrong."""
    rng = np.random.default_rng(seed)
    right = rng.uniform((0, 0), np.subtract(SIZE, 1), (count, 2))
    disparity = rng.uniform(2, 40, count)
    left = np.column_stack([right[:, 0] + disparity, right[:, 1]])
    right[:, 1] += rows[0] * right[:, 0] + rows[1] * left[:, 1] + rows[2] + per_disparity * disparity
    right[:, 1] += rng.normal(0, scatter, count)
    bad = rng.random(count) < wrong
    right[bad, 1] = rng.uniform(0, SIZE[1], bad.sum())
    return Matches(left, right, np.zeros(count), SIZE, 40.0)


@pytest.mark.parametrize("rows", [0.5, -1.25, (0.004, 0.0, -0.3), (-0.002, 0.003, 0.8)])
def test_rows_put_into_a_pair_are_measured(rows):
    expected = np.array([0, 0, rows] if np.isscalar(rows) else rows)
    residual = residual_off_by(rows)
    middle = expected @ [(SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2, 1]
    assert residual.trend.centre.value == pytest.approx(middle, abs=0.02)  # slopes of disparity shear the features
    assert residual.trend.tilt.value == pytest.approx(expected[0] * (SIZE[0] - 1), abs=0.08)
    assert residual.trend.scale.value == pytest.approx(expected[1] * (SIZE[1] - 1), abs=0.08)
    np.testing.assert_allclose(residual.rows @ [100, 50, 1], expected @ [100, 50, 1], atol=0.05)


@pytest.mark.parametrize("rows", [0.0, 0.5, (-0.002, 0.003, 0.8), 3.5])
def test_corners_that_are_followed_tell_rows_as_features_do(rows):
    expected = np.array([0, 0, rows] if np.isscalar(rows) else rows)
    residual = quick_residual(*pair_off_by(rows))
    np.testing.assert_allclose(residual.rows @ [150, 120, 1], expected @ [150, 120, 1], atol=0.02)  # as above


def test_what_cannot_be_followed_is_compared():
    lost = np.full((192, 256), np.nan, np.float32)
    assert quick_residual(*pair_off_by(0.5), lost).median == residual_off_by(0.5).median


@pytest.mark.parametrize("wrong", [0.0, 0.3, 0.6])
def test_wrong_matches_are_left_out(wrong):
    residual = residual_of(matches_of((0.01, -0.005, 2.0), wrong=wrong))
    off = np.abs(residual.rows - (0.01, -0.005, 2.0))
    assert (off < (6e-4, 8e-4, 0.15)).all()  # four standard errors
    assert residual.seen == 600
    # 600 right ones of deviation 0.2; the biweight leaves out one in 10 000, wrong ones are rarely that near
    assert len(residual.dy) == pytest.approx((1 - wrong) * 600, abs=30)


def test_standard_errors_tell_how_far_off_the_trend_is():
    off, told = [], []
    for seed in range(60):
        trend = residual_of(matches_of((0.002, 0.0, 0.3), count=150, wrong=0.2, seed=seed)).trend
        off.append([trend.centre.value - 0.3 - 0.002 * (SIZE[0] - 1) / 2, trend.tilt.value - 0.002 * (SIZE[0] - 1)])
        told.append([trend.centre.std, trend.tilt.std])
    ratio = np.sqrt(np.mean(np.square(off), axis=0)) / np.mean(told, axis=0)
    np.testing.assert_allclose(ratio, 1, atol=0.3)  # of 60 draws: three times 1 / sqrt(120)


def test_the_standard_error_of_the_median_tells_how_far_off_it_is():
    found = [residual_of(matches_of((0, 0, 0.3), count=150, seed=seed)).median for seed in range(60)]
    off = np.array([median.value for median in found]) - 0.3
    assert off.std() == pytest.approx(np.mean([median.std for median in found]), rel=0.3)  # as above


def test_rows_that_change_with_disparity_are_told_from_a_slope():
    residual = residual_of(matches_of((0.001, 0.0, 0.0), per_disparity=0.02))
    assert residual.convergence.value == pytest.approx(0.02, abs=4 * residual.convergence.std)
    assert residual.convergence.std < 0.002
    assert residual_of(matches_of((0.001, 0.0, 0.0))).convergence.value == pytest.approx(0, abs=0.004)


def test_rows_cannot_be_told_to_change_with_a_disparity_that_does_not():
    left, right = textured_pair(np.full(SIZE[::-1], 12.0), 0.4)
    residual = vertical_residual(left, right)
    assert residual.convergence is None
    off = np.abs(residual.partners - residual.pixels - (-12, 0.4))
    assert np.quantile(off, 0.95) < 0.2  # single features; SIFT finds them to 0.1 px


def test_noise_widens_the_error_and_moves_nothing():
    left, right = pair_off_by(0.5)
    clean, spoilt = residual_off_by(0.5), vertical_residual(noisy(left, 8), noisy(right, 8, seed=3))
    assert spoilt.median.value == pytest.approx(0.5, abs=0.03)  # four standard errors
    assert spoilt.median.std > clean.median.std


def test_large_images_are_measured_at_reduced_size_in_their_own_pixels():
    left, right = textured_pair(waves(2, 8, (320, 240)), 0.25, grain=2.5)  # so coarse that enlarging it leaves no grid
    left, right = (cv2.resize(image, None, fx=5, fy=5, interpolation=cv2.INTER_CUBIC) for image in (left, right))
    for measure in (vertical_residual, quick_residual):
        residual = measure(left, right)
        assert residual.size == (1600, 1200)
        assert residual.median.value == pytest.approx(1.25, abs=0.1)  # 0.02 px of the small pair
        assert np.quantile(residual.disparity, 0.99) == pytest.approx(40, abs=3)


def test_rows_that_agree_are_left_alone():
    assert row_correction(residual_off_by(0.0)) is None
    assert row_correction(residual_of(matches_of((0, 0, 0.08)))) is None  # significant, and not worth drawing anew


def test_a_trend_that_may_be_chance_is_left_alone():
    few = residual_of(matches_of((0, 0, 0.15), count=20, scatter=0.4, seed=4))
    assert few.trend.rms > 0.1
    assert row_correction(few) is None


def test_rows_off_by_more_than_five_pixels_are_refused():
    with pytest.raises(InvalidInput, match=r"rows differ by up to 5\.\d px, more than the 5 px .* rectify the pair"):
        row_correction(residual_of(matches_of((0, 0, 5.6))))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_aligned_rows_agree(dtype):
    scale = np.iinfo(dtype).max // 255
    rows = 0.003, -0.002, 1.2
    left, right = pair_off_by(rows)
    aligned = align_rows(right.astype(dtype) * dtype(scale), row_correction(residual_off_by(rows)))
    assert aligned.dtype == dtype
    assert vertical_residual(left, (aligned // scale).astype(np.uint8)).trend.rms < 0.05  # linear interpolation blurs


@given(slope=st.floats(-0.02, 0.02), level=st.floats(-4.5, 4.5))
def test_aligning_moves_rows_by_what_the_correction_says(slope, level):
    ramp = np.repeat(1000 + 500 * np.arange(60, dtype=np.uint16)[:, None], 50, axis=1)
    moved = align_rows(ramp, np.array([slope, 0.0, level]))
    across, down = np.meshgrid(np.arange(50), np.arange(60))
    expected = 1000 + 500 * np.clip(down + slope * across + level, 0, 59)
    np.testing.assert_allclose(moved, expected, atol=500 / 60)  # OpenCV 4.14 rounds to 1/32 px


def test_images_that_share_nothing_are_too_little():
    left, _ = pair_off_by(0.0)
    other, _ = textured_pair(waves(5, 30, SIZE), seed=2)
    with pytest.raises(InsufficientData, match="check that both images show the same scene"):
        vertical_residual(left, other)


@pytest.mark.parametrize(
    ("shape", "reason"),
    [
        ((1, 1), "images of 1x1 pixels are too small"),
        ((3, 40), "images of 40x3 pixels are too small"),
        ((240, 320), "image without texture: standard deviation of the gray levels 0.0 of 255"),
    ],
)
def test_images_without_features_are_too_little_and_it_is_said_why(shape, reason):
    flat = np.full(shape, 100, np.uint8)
    with pytest.raises(InsufficientData, match=f"0 matched features.*; {reason}"):
        vertical_residual(flat, flat)


def test_one_image_without_texture_is_enough_to_be_too_little():
    left, _ = pair_off_by(0.0)
    with pytest.raises(InsufficientData, match="without texture"):
        vertical_residual(left, noisy(np.full_like(left, 100), 2))


def test_the_residual_does_not_depend_on_the_number_of_threads():
    pair = pair_off_by(0.5)
    threads = cv2.getNumThreads()
    try:
        found = []
        for count in (1, 4):
            cv2.setNumThreads(count)
            found.append(vertical_residual(*pair))
    finally:
        cv2.setNumThreads(threads)
    np.testing.assert_array_equal(found[0].dy, found[1].dy)
    assert found[0].trend == found[1].trend
