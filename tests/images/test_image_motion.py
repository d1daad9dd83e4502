"""Sharpness and motion of frames: the one against blurred copies, the other against known shifts."""

import cv2
import numpy as np
import pytest

from camcal.images.video import PIXELS, focus, motion, reduced


def scene(shape=(600, 800), seed=0):
    """Return an image (H, W) of soft spots of several sizes."""
    rng = np.random.default_rng(seed)
    layers = [cv2.GaussianBlur(rng.standard_normal(shape), (0, 0), sigma) * sigma for sigma in (3, 8, 20)]
    total = sum(layers)
    return np.clip(128 + 60 * total / total.std(), 0, 255).astype(np.uint8)


def shifted(gray, across, down):
    height, width = gray.shape
    moved = np.array([[1.0, 0, across], [0, 1, down]])
    return cv2.warpAffine(gray, moved, (width, height), borderMode=cv2.BORDER_REFLECT)


GRID = np.stack(np.meshgrid(np.arange(250.0, 551, 50), np.arange(200.0, 401, 50)), axis=-1).reshape(-1, 2)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (3.3, -1.4), (-40.0, 25.0), (60.0, 0.0)])
def test_the_motion_is_the_length_of_the_shift(shift):
    before = scene()
    after = shifted(before, *shift)
    copies = reduced(before), reduced(after)
    scale = before.shape[1] // copies[0].shape[1]
    found = motion(*copies, GRID + shift, scale)
    assert found == pytest.approx(np.hypot(*shift), abs=0.2)  # a tenth of a pixel of the copy


def test_what_is_not_met_again_has_moved_too_far():
    assert np.isinf(motion(scene(seed=1), np.full((600, 800), 128, np.uint8), GRID, 1.0))


def test_focus_falls_with_blur():
    sharp = scene()
    values = [focus(cv2.blur(sharp, (width, 1))) for width in (1, 5, 9, 15)]
    assert values == sorted(values, reverse=True)
    assert values[0] > 1.2 * values[-1]


def test_copies_have_few_pixels_and_small_images_are_their_own():
    copy = reduced(np.zeros((1024, 1280), np.uint8))
    assert copy.shape == (512, 640)
    assert copy.size <= PIXELS
    assert reduced(np.zeros((1025, 1281), np.uint8)).shape == (512, 640)
    small = np.zeros((240, 320), np.uint8)
    assert reduced(small) is small
