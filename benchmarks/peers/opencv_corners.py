"""Chessboard corners as OpenCV finds and refines them; its arrays differ between 4 and 5, these are (N, 2) pixels."""

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.targets.board import Board

ACCURATE = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
SECTOR_BASED = {"SB": 0, "SB accurate": ACCURATE}
_CLASSIC = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
_STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)


def sector_based(gray: Array, board: Board, flags: int = 0) -> Array | None:
    """Return the corners of findChessboardCornersSB."""
    found, corners = cv2.findChessboardCornersSB(gray, (board.columns, board.rows), flags=flags)
    return _pixels(corners) if found else None


def classic(gray: Array, board: Board) -> Array | None:
    """Return the corners of findChessboardCorners."""
    found, corners = cv2.findChessboardCorners(gray, (board.columns, board.rows), flags=_CLASSIC)
    return _pixels(corners) if found else None


def refined(gray: Array, pixels: Array, half_window: int = 5) -> Array:
    """Return corners (N, 2) after cornerSubPix."""
    start = np.ascontiguousarray(pixels[:, None], np.float32)
    return _pixels(cv2.cornerSubPix(gray, start, (half_window, half_window), (-1, -1), _STOP))


def _pixels(corners: Array) -> Array:
    return np.asarray(corners, dtype=np.float64).reshape(-1, 2)
