"""Which disparities can be believed: those that both images agree on, and that do not stand alone."""

import cv2
import numpy as np

from camcal.arrays import Array

AGREEMENT = 1.0  # pixels by which the disparities of both images may differ
_REACH = 15  # pixels over which smoothness may carry a disparity into what has no texture
_SMALLEST = 50  # pixels of a patch
_SMOOTH = 1.0  # pixels between neighbours of a patch
_FRACTIONS = 16  # of a pixel, in the whole numbers that patches are found in
_NOTHING = -(1 << 15)


def difference_seen(left: Array, right: Array) -> Array:
    """Return by how much the disparities (H, W) of the right image differ from the left one's, pixels, absolute.

    left, right: (H, W) float32, seen from each image. NaN for what lies outside the right image: it has no witness.
    """
    width = left.shape[1]
    there = np.rint(np.arange(width, dtype=np.float32) - left)
    inside = (there >= 0) & (there < width)  # False where the disparity is NaN
    back = np.take_along_axis(right, np.where(inside, there, 0).astype(np.intp), axis=1)
    return np.where(inside, np.abs(back - left), np.float32(np.nan))


def in_order(disparity: Array) -> Array:
    """Return where nothing to the right of a pixel in the left image stands left of it in the right one (H, W), bool.

    What is out of order is hidden, or seen past something narrow in front of it.
    """
    there = np.arange(disparity.shape[1], dtype=np.float32) - disparity
    leftmost = np.fmin.accumulate(there[:, ::-1], axis=1)[:, ::-1]
    return ~(there > leftmost + AGREEMENT)


def has_texture(gray: Array) -> Array:
    """Return where an image (H, W) uint8 is more than one gray level within 15 pixels (H, W), bool.

    Elsewhere, as in what is overexposed, all disparities match alike, and both images agree on whichever comes first.
    """
    around = np.ones((2 * _REACH + 1, 2 * _REACH + 1), np.uint8)
    return np.asarray(cv2.subtract(cv2.dilate(gray, around), cv2.erode(gray, around)) > 1)


def without_specks(disparity: Array) -> Array:
    """Return disparities (H, W), pixels, NaN where a smooth patch of them is smaller than 50 pixels."""
    known = np.isfinite(disparity)
    whole = np.where(known, np.rint(np.nan_to_num(disparity) * _FRACTIONS), _NOTHING)
    patches = np.clip(whole, _NOTHING, -_NOTHING - 1).astype(np.int16)
    cv2.filterSpeckles(patches, _NOTHING, _SMALLEST - 1, int(_SMOOTH * _FRACTIONS))
    return np.where(patches == _NOTHING, np.float32(np.nan), disparity)
