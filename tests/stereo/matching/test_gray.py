"""Images of every type made a pair that can be matched: one depth, one exposure, and how noisy."""

import cv2
import numpy as np
import pytest
from textured import noisy, textured_pair

from camcal.errors import InvalidInput
from camcal.stereo.matching.preparation import gray_pair, noise_of

LEFT, RIGHT = textured_pair(np.full((90, 120), 8.0))
MIRRORED = np.ascontiguousarray(LEFT[:, ::-1])  # has the same histogram


def test_gray_images_of_one_exposure_stay_as_they_are():
    pair = gray_pair(LEFT, MIRRORED)
    for image, expected in zip((pair.left, pair.right), (LEFT, MIRRORED), strict=True):
        np.testing.assert_array_equal(image, expected)


@pytest.mark.parametrize("code", [cv2.COLOR_GRAY2BGR, cv2.COLOR_GRAY2BGRA])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_gray_in_colour_is_gray(code, dtype):
    scale = np.iinfo(dtype).max // 255
    colour = [cv2.cvtColor(image.astype(dtype) * dtype(scale), code) for image in (LEFT, RIGHT)]
    if code == cv2.COLOR_GRAY2BGRA:
        colour[0][:50, :, 3] = 0  # what is transparent was seen all the same
    pair = gray_pair(*colour)
    np.testing.assert_array_equal(pair.deep_left, LEFT.astype(dtype) * dtype(scale))
    np.testing.assert_array_equal(pair.deep_right, RIGHT.astype(dtype) * dtype(scale))


def test_one_image_may_be_gray_and_the_other_in_colour():
    np.testing.assert_array_equal(gray_pair(LEFT, cv2.cvtColor(MIRRORED, cv2.COLOR_GRAY2BGR)).right, MIRRORED)


def test_deep_images_become_eight_bits_by_one_line_for_both():
    left, right = (20000 + 11 * image.astype(np.uint16) for image in (LEFT, RIGHT))
    pair = gray_pair(left, right)
    np.testing.assert_array_equal(pair.deep_left, left)
    both, shown = np.concatenate([LEFT, RIGHT]).astype(float), np.concatenate([pair.left, pair.right])
    inside = (shown > 0) & (shown < 255)
    slope, offset = np.polyfit(both[inside], shown[inside], 1)
    assert np.abs(slope * both + offset - shown)[inside].max() <= 1  # rounding
    assert np.ptp(shown) == 255


@pytest.mark.parametrize("scale", [1 / 255, 1.0, 300.0])
def test_float_images_of_any_scale_are_alike(scale):
    pair = gray_pair(*(image.astype(np.float32) * np.float32(scale) for image in (LEFT, RIGHT)))
    assert pair.deep_left.dtype == np.uint16
    expected = gray_pair(LEFT.astype(np.float32), RIGHT.astype(np.float32))
    np.testing.assert_allclose(pair.left, expected.left, atol=1)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_no_number_is_dark_and_harms_nothing_else(value):
    left = LEFT.astype(np.float32)
    left[:9, :9] = value
    pair = gray_pair(left, RIGHT.astype(np.float32))
    assert not pair.left[:9, :9].any()
    assert np.corrcoef(pair.left[9:, 9:].ravel(), LEFT[9:, 9:].ravel())[0, 1] > 0.99  # clipped at both ends


@pytest.mark.parametrize("value", [0.0, 7.5, -3.0, np.nan, np.inf])
def test_float_images_of_one_value_are_dark(value):
    flat = np.full((6, 8), value, np.float32)
    assert not gray_pair(flat, flat).left.any()


def test_noisy_images_are_denoised_and_others_are_left_alone():
    smooth = np.tile(np.linspace(60, 190, 320), (240, 1))
    pair = gray_pair(noisy(smooth, 6.0), noisy(smooth, 6.0, seed=3))
    assert pair.noise == pytest.approx(6.0, rel=0.1)
    assert max(np.std(pair.left - smooth), np.std(pair.right - smooth)) < 3.0  # a quarter of its power
    less = noisy(smooth, 3.0)
    np.testing.assert_array_equal(gray_pair(less, less).left, less)


@pytest.mark.parametrize("sigma", [2.0, 5.0, 12.0])
def test_noise_is_measured(sigma):
    smooth = np.tile(np.linspace(60, 190, 320), (240, 1))
    assert noise_of(noisy(smooth, sigma)) == pytest.approx(sigma, rel=0.05)


def test_images_of_different_sizes_are_refused():
    with pytest.raises(InvalidInput, match="the left image has 8 × 6 pixels, the right one 9 × 6: sizes must be equal"):
        gray_pair(np.zeros((6, 8), np.uint8), np.zeros((6, 9, 3), np.uint8))
