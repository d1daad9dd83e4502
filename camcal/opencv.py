"""OpenCV functions that are the same with 4.14 and 5.x, reproducible, and for images of any size."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.parsing import nearest

_SEED_LIMIT = 1 << 31
LONGEST_REMAPPED = 32766  # pixels; cv2.remap refuses images and maps with a longer side
_SINGLE_TREE = 4  # FLANN_INDEX_KDTREE_SINGLE
# OpenCV's two-letter names count from the second row and column; the four-letter names mean the first cell.
BILINEAR = {
    "RGGB": cv2.COLOR_BayerRGGB2BGR,
    "GRBG": cv2.COLOR_BayerGRBG2BGR,
    "GBRG": cv2.COLOR_BayerGBRG2BGR,
    "BGGR": cv2.COLOR_BayerBGGR2BGR,
}
EDGE_AWARE = {
    "RGGB": cv2.COLOR_BayerBG2BGR_EA,
    "GRBG": cv2.COLOR_BayerGB2BGR_EA,
    "GBRG": cv2.COLOR_BayerGR2BGR_EA,
    "BGGR": cv2.COLOR_BayerRG2BGR_EA,
}
_MARGIN = 4  # an even number of pixels keeps the phase; OpenCV leaves the outermost ones unfinished
_KERNEL = 8  # pixels around a position that no interpolation goes beyond


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


def demosaiced(values: Array, code: int) -> Array:
    """Return the colour that OpenCV makes under a code of its own, the mosaic continued as its mirror image."""
    margin = (_MARGIN,) * 4
    padded = cv2.copyMakeBorder(values, *margin, borderType=cv2.BORDER_REFLECT_101)
    return cv2.demosaicing(padded, code)[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN]


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


def remap(
    image: Array,
    x: Array,
    y: Array,
    interpolation: int = cv2.INTER_LINEAR,
    border: int = cv2.BORDER_REPLICATE,
    value: Sequence[float] = (),
    result: Array | None = None,
) -> Array:
    """Return an image (h, w[, C]) at pixels x, y (H, W) float32, as cv2.remap does, with sides of any length.

    Longer sides than OpenCV takes are drawn in tiles, each from the part of the image that it shows: the numbers are
    the same. border, value: of cv2.remap. result: the array to draw into.
    """
    if result is None:
        result = np.empty((*x.shape, *image.shape[2:]), image.dtype)
    if max(*image.shape[:2], *x.shape) <= LONGEST_REMAPPED:
        cv2.remap(image, x, y, interpolation, result, border, value)
        return result
    rows, columns = (_reached(places, side, border) for places, side in ((y, image.shape[0]), (x, image.shape[1])))
    if max(*x.shape, rows.stop - rows.start, columns.stop - columns.start) <= LONGEST_REMAPPED:
        near_x, near_y = x - np.float32(columns.start), y - np.float32(rows.start)
        result[...] = cv2.remap(image[rows, columns], near_x, near_y, interpolation, None, border, value)
        return result
    for part in _halves(x.shape):
        remap(image, x[part], y[part], interpolation, border, value, result[part])
    return result


def _reached(places: Array, side: int, border: int) -> slice:
    """Return the range of a side of an image that is shown where one coordinate of positions is `places`."""
    inside = np.clip(places, 0, side - 1)
    if border == cv2.BORDER_CONSTANT:  # what lies farther outside shows nothing of the image
        inside = inside[np.abs(places - inside) <= _KERNEL]
    low, high = (float(reduce(inside, axis=None, initial=np.nan)) for reduce in (np.fmin.reduce, np.fmax.reduce))
    if np.isnan(low):
        return slice(0, 1)
    return slice(max(0, int(low) - _KERNEL), min(side, int(high) + 1 + _KERNEL))


def _halves(shape: tuple[int, ...]) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Return the halves of an array across its longer side."""
    height, width = shape
    whole = slice(None)
    if width >= height:
        return (whole, slice(width // 2)), (whole, slice(width // 2, None))
    return (slice(height // 2), whole), (slice(height // 2, None), whole)


def sampled(image: Array, x: Array, y: Array) -> Array:
    """Return the values (N, K) of an image (H, W) uint8 or float32 at pixels x, y (N, K), linear between pixels."""
    if not x.size:
        return np.zeros(x.shape, np.float32)
    shape = (1, -1) if x.size <= LONGEST_REMAPPED else x.shape
    x, y = (np.ascontiguousarray(places, dtype=np.float32) for places in (x, y))
    values = remap(image, x.reshape(shape), y.reshape(shape))
    return np.asarray(values, dtype=np.float32).reshape(x.shape)


def largest_region(mask: Array) -> Array:
    """Return the largest 4-connected region (H, W) bool of a mask, its holes filled; empty as that of an empty mask."""
    regions = cv2.connectedComponents(mask.astype(np.uint8), connectivity=4)[1]
    if not regions.any():
        return np.zeros(mask.shape, bool)
    largest = 1 + int(np.argmax(np.bincount(regions.ravel())[1:]))
    filled = np.pad((regions == largest).astype(np.uint8), 1)
    cv2.floodFill(filled, None, (0, 0), (2,), flags=4)  # all around it
    return np.asarray(filled[1:-1, 1:-1] != 2)


def convex_hull(points: Array) -> Array:
    """Return which of points (N, 2) are the corners of their convex hull, in turn; those of single precision."""
    return np.asarray(cv2.convexHull(points.astype(np.float32), returnPoints=False)).ravel()


def nearest_points(points: Array, count: int) -> tuple[Array, Array]:
    """Return the distances (N, count) of points (N, 2) from the nearest of them, themselves first, and which these are.

    One tree, searched to the end: as exact as SciPy's, which takes longer to import than many images to search.
    """
    tree = cv2.flann.Index(np.ascontiguousarray(points, np.float32), {"algorithm": _SINGLE_TREE, "leaf_max_size": 10})
    which, squared = tree.knnSearch(np.ascontiguousarray(points, np.float32), count, params={"checks": -1})
    return np.sqrt(squared.astype(np.float64)), which.astype(np.intp)


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
