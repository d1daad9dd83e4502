"""Pictures of boards for the tests: drawn through a homography, every pixel the mean of rays through its square."""

import cv2
import numpy as np
from opencv_charuco import drawn_by_opencv

from camcal.targets.board import CHARUCO, Board

RAYS = 6  # per pixel and axis
DARK, BRIGHT, BEHIND = 30.0, 220.0, 120.0
MARGIN = 0.6  # white around the squares, in squares


def pose(corners):
    """Return the homography that takes the board's grid of corners, as a unit square, to four pixels (4, 2)."""
    unit = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    return cv2.getPerspectiveTransform(unit, np.array(corners, np.float32))


def upright(board, size, share=0.6):
    """Return the homography of a board seen straight, `share` of the image's width or height."""
    width, height = size
    step = share * min(width / (board.columns - 1), height / (board.rows - 1))
    half = step * np.array([board.columns - 1, board.rows - 1]) / 2
    left, top = np.array([width, height]) / 2 - 0.5 - half
    right, bottom = np.array([width, height]) / 2 - 0.5 + half
    return pose([(left, top), (right, top), (right, bottom), (left, bottom)])


def truth(board, homography):
    """Return the pixels (N, 2) of a board's corners in the order of their ids."""
    row, column = np.divmod(np.arange(board.count), board.columns)
    unit = np.column_stack([column / (board.columns - 1), row / (board.rows - 1), np.ones(board.count)])
    pixels = unit @ homography.T
    return pixels[:, :2] / pixels[:, 2:]


def picture(board, homography, size, *, blur=0.7, noise=0.0, seed=0):
    """Return the image (H, W) uint8 of a board on its white sheet before a gray wall."""
    width, height = size
    offsets = (np.arange(RAYS) + 0.5) / RAYS - 0.5
    x = (np.arange(width)[:, None] + offsets).ravel()
    y = (np.arange(height)[:, None] + offsets).ravel()
    inverse = np.linalg.inv(homography)
    u, v, w = (inverse[i, 0] * x + inverse[i, 1] * y[:, None] + inverse[i, 2] for i in range(3))
    shade = _shade(board, u / w * (board.columns - 1), v / w * (board.rows - 1))
    shade = cv2.GaussianBlur(shade, (0, 0), blur * RAYS) if blur else shade
    image = shade.reshape(height, RAYS, width, RAYS).mean(axis=(1, 3))
    image = image + np.random.default_rng(seed).normal(0, noise, image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def _shade(board: Board, x, y):
    """Return the gray level at board coordinates in squares, corner 0 at (0, 0)."""
    sheet = (x > -1 - MARGIN) & (x < board.columns + MARGIN) & (y > -1 - MARGIN) & (y < board.rows + MARGIN)
    squares = (x > -1) & (x < board.columns) & (y > -1) & (y < board.rows)
    if board.type == CHARUCO:
        dark = drawn_by_opencv(board, _CELLS)[_places(board, x, y)] < 128
    else:
        dark = (np.floor(x) + np.floor(y)) % 2 == 0  # the square before corner 0 is dark
    return np.where(squares & dark, DARK, np.where(sheet, BRIGHT, BEHIND))


_CELLS = 64  # samples of a square's side


def _places(board, x, y):
    column = np.clip((x + 1) * _CELLS, 0, (board.columns + 1) * _CELLS - 1).astype(int)
    row = np.clip((y + 1) * _CELLS, 0, (board.rows + 1) * _CELLS - 1).astype(int)
    return row, column
