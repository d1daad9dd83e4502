"""ChArUco boards as OpenCV draws and finds them, for a second opinion."""

import cv2
import numpy as np

from camcal.opencv import marker_dictionary


def opencv_board(board):
    """Return OpenCV's record of a ChArUco board; one that does not say is of the current pattern."""
    squares = (board.columns + 1, board.rows + 1)
    markers = board.first_marker + np.arange(squares[0] * squares[1] // 2)
    result = cv2.aruco.CharucoBoard(
        squares, 1.0, board.marker / board.spacing, marker_dictionary(board.dictionary), markers
    )
    result.setLegacyPattern(bool(board.legacy))
    return result


def drawn_by_opencv(board, square_px):
    """Return the squares of a ChArUco board, without a border, `square_px` pixels each."""
    return opencv_board(board).generateImage(((board.columns + 1) * square_px, (board.rows + 1) * square_px))


def found_by_opencv(gray, board, markers=2):
    """Return the ids (N,) and pixels (N, 2) of the corners beside so many markers at least; 2 is OpenCV's default."""
    parameters = cv2.aruco.CharucoParameters()
    parameters.minMarkers = markers
    corners, ids, _, _ = cv2.aruco.CharucoDetector(opencv_board(board), parameters).detectBoard(gray)
    if ids is None or corners is None:
        return np.zeros(0, np.intp), np.zeros((0, 2))
    return np.ravel(ids), np.reshape(corners, (-1, 2))
