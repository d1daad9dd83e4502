"""Features that two images of a pair share: where to compare their rows, their light and their order."""

from dataclasses import dataclass
from math import sqrt

import cv2
import numpy as np

from camcal.arrays import Array, readonly, require_shape
from camcal.errors import InvalidInput
from camcal.opencv import resized

PIXELS = 1e6  # of the image features are looked for in; they are found to a part of a pixel that is as large there

_MOST = 1500  # features of an image; more make the trend of the rows no surer than it is already
_CONTRAST = 0.01  # SIFT's own limit is 0.04, too much for dark images; the strongest are taken anyway


@dataclass(frozen=True, eq=False)
class Matches:
    """Features found in both images of a pair, each the other's best match; some are wrong.

    left, right: (N, 2) pixels, column and row. turns: (N,) radians from the left feature's direction to the right
    one's, -π … π, positive clockwise. size: (width, height) of the images. contrast: standard deviation of the gray
    levels in the image that has less, counts.
    """

    left: Array
    right: Array
    turns: Array
    size: tuple[int, int]
    contrast: float

    def __post_init__(self) -> None:
        count = len(self.left)
        object.__setattr__(self, "left", readonly(self.left, (count, 2), "left"))
        object.__setattr__(self, "right", readonly(self.right, (count, 2), "right"))
        object.__setattr__(self, "turns", readonly(self.turns, (count,), "turns"))

    @property
    def coarseness(self) -> float:
        """Side of the pixels that features were looked for in, pixels of the images."""
        return max(1.0, sqrt(self.size[0] * self.size[1] / PIXELS))


def match_features(left: Array, right: Array) -> Matches:
    """Return the features two images share. left, right: (H, W) uint8.

    Raises InvalidInput for images of different sizes. Source: Lowe, Distinctive Image Features from Scale-Invariant
    Keypoints, IJCV 2004.
    """
    left, right = require_pair(left, right)
    scale = min(1.0, sqrt(PIXELS / left.size))
    size, contrast = (left.shape[1], left.shape[0]), contrast_of(left, right)
    first, second = _Features(left, scale), _Features(right, scale)
    if not first.count or not second.count:
        return Matches(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), size, contrast)
    likeness = first.descriptors @ second.descriptors.T
    best, best_back = likeness.argmax(axis=1), likeness.argmax(axis=0)
    mutual = np.flatnonzero(best_back[best] == np.arange(first.count))
    partners = best[mutual]
    turns = second.angles[partners] - first.angles[mutual]
    turns = (turns + np.pi) % (2 * np.pi) - np.pi
    return Matches(first.pixels[mutual], second.pixels[partners], turns, size, contrast)


def require_pair(left: Array, right: Array) -> tuple[Array, Array]:
    """Return both images of a pair as (H, W) uint8; raises InvalidInput unless they are, and of one size."""
    left = require_shape(left, (None, None), "left", np.uint8)
    right = require_shape(right, (None, None), "right", np.uint8)
    if left.shape != right.shape:
        sizes = (*left.shape[::-1], *right.shape[::-1])
        raise InvalidInput("the images differ in size: {}x{} and {}x{}".format(*sizes))
    return left, right


def contrast_of(*images: Array) -> float:
    """Return the least standard deviation of the gray levels of images (H, W) uint8, counts."""
    return min(float(np.ravel(cv2.meanStdDev(image)[1])[0]) for image in images)


class _Features:
    """The strongest features of an image: pixels (N, 2), angles (N,) radians and descriptors (N, 128) of length 1."""

    def __init__(self, gray: Array, scale: float) -> None:
        finder = cv2.SIFT.create(nfeatures=_MOST, contrastThreshold=_CONTRAST)
        small = gray if scale == 1 else resized(gray, scale)
        points, descriptors = finder.detectAndCompute(small, np.empty(0, np.uint8))
        self.count = len(points)
        ratio = np.array(gray.shape[::-1]) / small.shape[::-1]
        self.pixels = (np.array([point.pt for point in points]).reshape(-1, 2) + 0.5) * ratio - 0.5
        self.angles = np.radians([point.angle for point in points])
        found = np.zeros((0, 128), np.float32) if descriptors is None else np.asarray(descriptors)
        self.descriptors = found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-12)
