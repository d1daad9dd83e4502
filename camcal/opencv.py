"""OpenCV functions for target detection, the same with 4.14 and 5.x, and reproducible."""

from collections.abc import Iterator
from contextlib import contextmanager

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.parsing import nearest

_SEED_LIMIT = 1 << 31
_REMAP_LIMIT = 1 << 15  # cv2.remap refuses maps with longer sides


@contextmanager
def repeatable(seed: int) -> Iterator[None]:
    """Give OpenCV one thread and a fixed random state for the block.

    Detectors of OpenCV 5 find other corners from run to run with several threads.
    """
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    cv2.setRNGSeed(seed % _SEED_LIMIT)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


def resized(gray: Array, scale: float) -> Array:
    """Return an image at another scale: the mean over pixels when it is reduced, cubic interpolation otherwise."""
    interpolation = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(gray, None, fx=scale, fy=scale, interpolation=interpolation))


def second_derivatives(gray: Array, sigma: float) -> tuple[Array, Array, Array, Array]:
    """Return an image blurred by `sigma` px and its second derivatives by xx, xy and yy per px², (H, W) float32."""
    side = 2 * int(np.ceil(2.5 * sigma)) + 1
    smooth = cv2.GaussianBlur(gray.astype(np.float32), (side, side), sigma, borderType=cv2.BORDER_REPLICATE)
    xx = cv2.Sobel(smooth, -1, 2, 0, scale=1 / 4, borderType=cv2.BORDER_REPLICATE)
    xy = cv2.Sobel(smooth, -1, 1, 1, scale=1 / 4, borderType=cv2.BORDER_REPLICATE)
    yy = cv2.Sobel(smooth, -1, 0, 2, scale=1 / 4, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(smooth), np.asarray(xx), np.asarray(xy), np.asarray(yy)


def largest_around(values: Array, window: int) -> Array:
    """Return the largest of the values (H, W) in a square window of an odd number of pixels around each."""
    return np.asarray(cv2.dilate(values, np.ones((window, window), np.uint8)))


def sampled(image: Array, x: Array, y: Array) -> Array:
    """Return the values (N, K) of an image (H, W) uint8 or float32 at pixels x, y (N, K), linear between pixels."""
    if not x.size:
        return np.zeros(x.shape, np.float32)
    shape = (1, -1) if x.size < _REMAP_LIMIT else x.shape
    x, y = (np.ascontiguousarray(places, dtype=np.float32) for places in (x, y))
    values = cv2.remap(image, x.reshape(shape), y.reshape(shape), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(values, dtype=np.float32).reshape(x.shape)


def marker_dictionary(name: str) -> cv2.aruco.Dictionary:
    """Return the predefined ArUco or AprilTag dictionary of a name such as DICT_4X4_50.

    Raises InvalidInput with the nearest name.
    """
    names = sorted(constant for constant in dir(cv2.aruco) if constant.startswith("DICT_"))
    if name not in names:
        near = nearest(name.upper(), names, likeness=0.3)
        advice = f"did you mean {near}?" if near else f"one of {', '.join(names)}"
        raise InvalidInput(f"marker dictionary {name!r} is unknown; {advice}")
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
