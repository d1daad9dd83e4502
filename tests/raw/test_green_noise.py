"""The noise of green samples, told by a mosaic, against what was added to it."""

import numpy as np
import pytest
from bayer import random_mosaic, sampled, scene

from camcal.raw.residual import noise_of_green, residual_interpolation


def greens(mosaic):
    return mosaic[0::2, 1::2], mosaic[1::2, 0::2]


def smooth(shape=(240, 320)):
    rows, columns = np.indices(shape)
    return (120 + 60 * np.sin(columns / 40 + rows / 90) + rows / 8).astype(np.float32)


@pytest.mark.parametrize("sigma", [5, 10, 20])
def test_the_noise_that_was_added_is_found(sigma):
    noisy = smooth() + np.random.default_rng(1).normal(0, sigma, (240, 320)).astype(np.float32)
    # the least twentieth of blocks of 36 samples: their mean square is 0.6 of the variance
    assert 0.45 * sigma**2 < noise_of_green(greens(noisy)) + 4 < 0.9 * sigma**2


@pytest.mark.parametrize("shape", [(240, 320), (10, 400), (16, 16), (2, 2)])
def test_a_smooth_frame_has_none_however_small(shape):
    assert noise_of_green(greens(smooth(shape))) == 0


def test_half_a_frame_of_texture_is_not_taken_for_noise():
    frame = smooth()
    frame[:, 160:] = 255 * np.random.default_rng(2).random((240, 160))
    assert noise_of_green(greens(frame)) == 0


def test_blocks_that_are_cut_off_do_not_hide_the_noise_of_the_others():
    noisy = smooth() + np.random.default_rng(3).normal(0, 10, (240, 320)).astype(np.float32)
    noisy[:, :100], noisy[:, 220:] = 255, 0
    assert noise_of_green(greens(noisy)) > 40


def test_a_frame_too_small_for_a_block_is_demosaiced():
    for shape in ((2, 2), (6, 40), (15, 15)):
        mosaic = random_mosaic(shape, np.uint16)
        assert residual_interpolation(mosaic, "RGGB", 65535).shape == (*shape, 3)


def test_the_noise_does_not_depend_on_the_type_of_the_counts():
    light = sampled(scene((120, 160)), "RGGB")
    found = [
        residual_interpolation((light * peak).astype(dtype), "RGGB", peak, linear=False) / peak
        for dtype, peak in ((np.uint16, 65535), (np.float32, 1.0))
    ]
    np.testing.assert_allclose(
        found[0], np.maximum(found[1], 0), rtol=0, atol=2e-4
    )  # the rounding of 16 bits, through gains that it changes
