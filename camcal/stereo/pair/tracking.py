"""Corners of the left image followed into the right one: the rows of a pair in a tenth of the time features take."""

from math import sqrt

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.opencv import resized
from camcal.stereo.pair.coarse import as_counts, coarse_map, evened
from camcal.stereo.pair.features import PIXELS, Matches, contrast_of, require_pair

_MOST = 800  # corners
_QUALITY = 0.01  # of the best corner's
_APART = 5.0  # px
_BLOCK = 5
_WINDOW = 15  # px; single corners are followed to 0.1 px
_EVENED = 31  # px; where it is less than texture is coarse, what remains is the rounding of counts
_LEVELS = 1  # beyond the image itself: rows that are off by four pixels are found
_ROUNDS, _STEP = 20, 0.005  # px
_ASTRAY = 2.0  # columns of the coarse map, and pixels, that the right place may be off from the guess


def track_corners(left: Array, right: Array, coarse: Array | None = None) -> Matches:
    """Return the corners of the left image, where the right image has them.

    left, right: (H, W) uint8, rows aligned to four pixels. coarse: the disparities of `coarse_map`, if they are known.
    Raises InvalidInput for images of different sizes. Source: Bouguet, Pyramidal Implementation of the Lucas Kanade
    Feature Tracker, 2000.
    """
    left, right = require_pair(left, right)
    coarse = coarse_map(left, right).disparities if coarse is None else coarse
    size = left.shape[1], left.shape[0]
    scale = min(1.0, sqrt(PIXELS / left.size))
    first, second = (image if scale == 1 else resized(image, scale) for image in (left, right))
    corners = _corners(first, np.isfinite(coarse))
    guesses = corners - np.column_stack([_looked_up(coarse, corners, first.shape) * scale, np.zeros(len(corners))])
    found, kept = _followed(first, second, corners, guesses.astype(np.float32))
    astray = np.hypot(*(found - guesses).T)
    kept &= astray < _ASTRAY * (first.shape[1] / coarse.shape[1] + 1)
    ratio = np.array(size) / first.shape[::-1]
    return Matches(
        (corners[kept] + 0.5) * ratio - 0.5,
        (found[kept] + 0.5) * ratio - 0.5,
        np.zeros(int(kept.sum())),
        size,
        contrast_of(left, right),
    )


def _corners(gray: Array, known: Array) -> Array:
    """Return the corners (N, 2) float32 of an image where its reduced mask is set, pixels."""
    mask = cv2.resize(known.astype(np.uint8), gray.shape[::-1], interpolation=cv2.INTER_NEAREST)
    corners = cv2.goodFeaturesToTrack(gray, _MOST, _QUALITY, _APART, mask=mask, blockSize=_BLOCK)
    return np.zeros((0, 2), np.float32) if corners is None else np.asarray(corners, np.float32).reshape(-1, 2)


def _looked_up(coarse: Array, pixels: Array, shape: tuple[int, ...]) -> Array:
    """Return the values (N,) of a reduced map at pixels (N, 2) of the image it is of."""
    places = (pixels + 0.5) * (np.array(coarse.shape[::-1]) / shape[::-1])
    columns, rows = np.minimum(places.astype(int), np.subtract(coarse.shape[::-1], 1)).T
    return np.asarray(np.nan_to_num(coarse[rows, columns]))


def _followed(first: Array, second: Array, corners: Array, guesses: Array) -> tuple[Array, Array]:
    """Return where corners (N, 2) of the first image are in the second, pixels, and the mask (N,) of those found."""
    if not len(corners):
        return guesses, np.zeros(0, bool)
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        as_counts(evened(first, _EVENED)),
        as_counts(evened(second, _EVENED)),
        corners,
        guesses.copy(),
        winSize=(_WINDOW, _WINDOW),
        maxLevel=_LEVELS,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, _ROUNDS, _STEP),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return np.asarray(found, np.float32).reshape(-1, 2), np.asarray(status).ravel() > 0
