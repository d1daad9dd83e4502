"""The one edge to what differs between OpenCV 4.14 and 5.x, and to what makes its detectors repeatable.

Corner arrays are (N, 1, 2) in 4 and (N, 2) in 5, ids likewise; everything leaves here as (N, 2) and (N,).
"""

from collections.abc import Iterator
from contextlib import contextmanager
from difflib import get_close_matches

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput

_SEED_LIMIT = 1 << 31
_REMAP_LIMIT = 1 << 15  # cv2.remap refuses maps with longer sides

CharucoDetector = cv2.aruco.CharucoDetector


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


def corner_array(corners: Array) -> Array:
    """Return the corners of any OpenCV function as (N, 2) pixels."""
    return np.asarray(corners, dtype=np.float64).reshape(-1, 2)


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
        near = get_close_matches(name.upper(), names, n=1, cutoff=0.3)
        advice = f"did you mean {near[0]}?" if near else f"known are {', '.join(names)}"
        raise InvalidInput(f"marker dictionary {name!r} is unknown; {advice}")
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def charuco_detector(
    squares: tuple[int, int], marker_ratio: float, dictionary: str, first_marker: int, *, legacy: bool
) -> CharucoDetector:
    """Return a detector for a ChArUco board of (columns, rows) squares.

    marker_ratio: side of a marker as a share of its square. legacy: the pattern of OpenCV before 4.6.
    Raises InvalidInput if the dictionary is unknown or has too few markers.
    """
    words = marker_dictionary(dictionary)
    last, available = first_marker + squares[0] * squares[1] // 2 - 1, len(words.bytesList)
    if last >= available:
        raise InvalidInput(f"the board needs markers {first_marker} to {last}, {dictionary} ends at {available - 1}")
    board = cv2.aruco.CharucoBoard(squares, 1.0, marker_ratio, words, np.arange(first_marker, last + 1))
    board.setLegacyPattern(legacy)
    parameters = cv2.aruco.CharucoParameters()
    parameters.minMarkers = 1  # corners beside an occluded marker too; what is wrong is found out by its look
    return cv2.aruco.CharucoDetector(board, parameters)


def find_charuco(detector: CharucoDetector, gray: Array) -> tuple[Array, Array, int]:
    """Return the ids (N,) and pixels (N, 2) of the corners found, and the number of markers seen."""
    corners, ids, _, markers = detector.detectBoard(gray)
    seen = 0 if markers is None else len(markers)
    if ids is None or corners is None:
        return np.zeros(0, np.intp), np.zeros((0, 2)), seen
    return np.asarray(ids, dtype=np.intp).ravel(), corner_array(corners), seen
