"""Which pixels of the left image the right camera sees as well, by the truth."""

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput

_TOLERANCE = 1.0  # pixels: what quarter-pixel truths and slanted surfaces leave between the two views


def seen_by_both(truth: Array, right_truth: Array) -> Array:
    """Return where the truths of both images agree within a pixel (H, W), bool.

    truth, right_truth: (H, W) disparity of the left and the right image, pixels, NaN where unknown; both positive for
    what is in front of the cameras. A pixel whose counterpart is unknown or outside does not agree.
    Raises InvalidInput if the sizes differ.
    """
    if truth.shape != right_truth.shape:
        sizes = " and ".join("{1} × {0}".format(*image.shape) for image in (truth, right_truth))
        raise InvalidInput(f"the truths of the left and the right image are {sizes}; they must be the same size")
    column, inside = _counterparts(truth)
    there = np.take_along_axis(right_truth, column, axis=1)
    return np.asarray(inside & (np.abs(truth - there) <= _TOLERANCE))


def unhidden(truth: Array) -> Array:
    """Return where nothing nearer lies before a pixel in the right image (H, W), bool, by the left truth alone.

    truth: (H, W) pixels, NaN where unknown. What is unknown hides nothing, so this finds less than `seen_by_both`.
    """
    column, inside = _counterparts(truth)
    height, width = truth.shape
    nearest = np.full(truth.size, -np.inf, truth.dtype)
    rows = np.broadcast_to(np.arange(height)[:, None] * width, truth.shape)[inside]
    exact = (np.arange(width) - truth)[inside]
    for side in (np.floor(exact), np.ceil(exact)):  # both, so that what is stretched in the right image has no gaps
        np.maximum.at(nearest, rows + side.astype(np.intp), truth[inside])
    found = np.take_along_axis(nearest.reshape(truth.shape), column, axis=1)
    return np.asarray(inside & (truth >= found - _TOLERANCE))


def _counterparts(truth: Array) -> tuple[Array, Array]:
    """Return the nearest column to the counterpart of each pixel in the right image, and which have one inside it."""
    width = truth.shape[1]
    exact = np.arange(width) - truth
    inside = (exact >= 0) & (exact <= width - 1)  # False for NaN
    return np.where(inside, np.rint(exact), 0).astype(np.intp), inside
