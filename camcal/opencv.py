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

_SB_THOROUGH = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
_CLASSIC = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
_SEED_LIMIT = 1 << 31

CharucoDetector = cv2.aruco.CharucoDetector


@contextmanager
def repeatable(seed: int) -> Iterator[None]:
    """Give OpenCV one thread and a fixed random state for the block.

    findChessboardCornersSB of OpenCV 5 finds other corners from run to run with several threads.
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


def find_chessboard_sb(gray: Array, columns: int, rows: int, *, thorough: bool = False) -> Array | None:
    """Return the inner corners (rows, columns, 2) in pixels found by the sector-based detector, None without a board.

    Source: Duda and Frese, Accurate Detection and Localization of Checkerboard Corners for Calibration, BMVC 2018.
    """
    found, corners = cv2.findChessboardCornersSB(gray, (columns, rows), flags=_SB_THOROUGH if thorough else 0)
    return corner_array(corners).reshape(rows, columns, 2) if found else None


def find_chessboard_classic(gray: Array, columns: int, rows: int) -> Array | None:
    """Return the inner corners (rows, columns, 2) in pixels found by linking dark squares, None without a board."""
    found, corners = cv2.findChessboardCorners(gray, (columns, rows), flags=_CLASSIC)
    return corner_array(corners).reshape(rows, columns, 2) if found else None


def largest_chessboard(gray: Array) -> Array | None:
    """Return the corners (rows, columns, 2) of the largest checker pattern of any size seen, None without one."""
    found, corners, meta = cv2.findChessboardCornersSBWithMeta(gray, (3, 3), flags=cv2.CALIB_CB_LARGER)
    if not found:
        return None
    rows, columns = meta.shape[:2]
    return corner_array(corners).reshape(rows, columns, 2)


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
