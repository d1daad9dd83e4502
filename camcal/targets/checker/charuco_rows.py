"""Where the rows of a ChArUco board end: a board with more rows has the same markers, so only the image can tell.

Beyond its last row of squares there is white paper, and a further row would have dark squares. What hides the rest, a
hand or a clamp, is not white just where the squares end.
"""

import numpy as np

from camcal import opencv
from camcal.arrays import Array
from camcal.targets.board import Board
from camcal.targets.board_map import map_of
from camcal.targets.detection import MIN_CORNERS

_ASIDE = 0.15  # squares, from the last row's edge to the samples inside and outside
_SPREAD = np.array([-0.25, -0.1, 0.1, 0.25])  # squares, along the edge from the middle of a square
_LEAST_SHARE = 0.75  # of a row's squares, that look so
_BRIGHT = 0.95  # quantile of the row


def rows_seen(board: Board, ids: Array) -> int:
    """Return how many rows of squares of a ChArUco board its corners `ids` (N,) tell of; an even number if need be."""
    rows = int(ids.max()) // board.columns + 2 if len(ids) else 0
    return rows + int(bool(board.legacy) and rows % 2)


def ends_after(gray: Array, board: Board, rows: int, ids: Array, pixels: Array) -> bool:
    """Return whether an image shows that a ChArUco board ends after so many rows of squares.

    gray: (H, W) uint8. ids (N,), pixels (N, 2): its corners. False also where the edge is not in the image.
    """
    size = gray.shape[1], gray.shape[0]
    places = board.points()[:, :2] / board.pitch
    if len(ids) < MIN_CORNERS or np.ptp(places[ids], axis=0).min() < 1:
        return False
    seen = map_of(places[ids], pixels, size, rough=True)
    column = np.arange(board.columns + 1)
    # the first corner is at (0, 0), so that square (row, column) is around (column, row) - 0.5
    along = (column[:, None] - 0.5 + _SPREAD).ravel()
    inside, outside = (
        seen.pixels(np.column_stack([along, np.full_like(along, rows - 1 + away)])) for away in (-_ASIDE, _ASIDE)
    )
    if not all(((side > 0) & (side < np.array(size) - 1)).all() for side in (inside, outside)):
        return False
    dark = (column + rows - 1 + bool(board.legacy)) % 2 == 0
    within, beyond = _mean(gray, inside, len(column))[dark], _mean(gray, outside, len(column))
    every = np.linspace(-0.9, board.columns - 0.1, 8 * (board.columns + 1))
    row = seen.pixels(np.column_stack([every, np.full_like(every, rows - 1.5)]))
    bright = float(np.quantile(opencv.sampled(gray, row[None, :, 0], row[None, :, 1]), _BRIGHT))
    middle = (float(np.median(within)) + bright) / 2
    return bool(min((within < middle).mean(), (beyond > middle).mean()) >= _LEAST_SHARE)


def _mean(gray: Array, places: Array, count: int) -> Array:
    """Return the mean gray levels (count,) over places (count · K, 2)."""
    x, y = (places[:, axis].reshape(count, -1) for axis in (0, 1))
    return np.asarray(opencv.sampled(gray, x, y).mean(axis=1))
