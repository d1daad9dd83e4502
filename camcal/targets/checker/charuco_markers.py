"""Which markers of a ChArUco board lie between the corners of a checker pattern, and so which corners these are.

The corners say where every cell of every marker is: nothing is searched for, and blur, tilt and small squares do little
harm. Two markers that put the pattern in the same place on the board, more than speak for any other, settle it.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from camcal import opencv
from camcal.arrays import Array
from camcal.targets.board import Board
from camcal.targets.checker import grid as grids
from camcal.targets.checker.checker import Checker

WRONG_BITS = 12  # one of so many may be read wrong
BORDER = 0.8  # share of the border's cells that must be dark
LEAST_VOTES = 2
MAJORITY = 3  # times the votes for any other place; in the other pattern half of the markers agree
_SUB = (np.arange(3) - 1) / 4  # places of samples in a cell, in cells from its middle
TURNS = (
    ((1, 0), (0, 1)),
    ((0, 1), (-1, 0)),
    ((-1, 0), (0, -1)),
    ((0, -1), (1, 0)),
)  # of np.rot90: row, column by i, j


@dataclass(frozen=True)
class Seat:
    """Where a pattern sits on its board: corner (i, j) of the pattern is at turn · (i, j) + (row, column).

    legacy: in which of the two patterns of markers. votes: how many markers say so.
    """

    turn: int
    row: int
    column: int
    legacy: bool
    votes: int

    def on_board(self, grid: Array, board: Board) -> Array:
        """Return the corners (rows, columns, 2) of a pattern by their places on the board; NaN where none is."""
        i, j = np.nonzero(~np.isnan(grid[..., 0]))
        row, column = np.array(TURNS[self.turn]) @ np.stack([i, j]) + np.array([[self.row], [self.column]])
        inside = (row >= 0) & (row < board.rows) & (column >= 0) & (column < board.columns)
        result = np.full((board.rows, board.columns, 2), np.nan)
        result[row[inside], column[inside]] = grid[i[inside], j[inside]]
        return result


@dataclass(frozen=True, eq=False)
class Reading:
    """The M markers read in the bright squares of a pattern.

    square: (M, 2) row and column of the corner after each. marker: (M,) numbers among the board's, from 0. turn: (M,)
    quarter turns, see Seat. mirrored: how many can be read only from behind.
    """

    square: Array
    marker: Array
    turn: Array
    mirrored: int


def read_markers(gray: Array, checker: Checker, board: Board) -> Reading:
    """Return the markers of a ChArUco board that are seen between the corners of a pattern in `gray`, (H, W) uint8."""
    words = cells(board.dictionary or "", board.first_marker, (board.rows + 1) * (board.columns + 1) // 2)
    square, corners = bright_squares(checker)
    share = (board.marker or 0.0) / board.pitch
    seen, clear = read_bits(gray, corners, share, words.shape[1], checker.contrast)
    square, seen = square[clear], seen[clear]
    if not len(square):
        return Reading(square, np.zeros(0, np.intp), np.zeros(0, np.intp), 0)
    marker, turn, wrong = nearest(seen, words[:, 1:-1, 1:-1])
    behind = nearest(seen, words[:, 1:-1, -2:0:-1])[2]
    known = wrong * WRONG_BITS <= seen[0].size
    mirrored = int((~known & (behind * WRONG_BITS <= seen[0].size)).sum())
    return Reading(square[known], marker[known], turn[known], mirrored)


def seat(reading: Reading, board: Board, legacies: Sequence[bool]) -> Seat | None:
    """Return where a pattern sits on a ChArUco board by its markers, None where they are too few or at odds."""
    seats = [one for one in (_elected(reading, board, legacy) for legacy in legacies) if one]
    most = max((one.votes for one in seats), default=0)
    best = [one for one in seats if one.votes == most]
    return best[0] if len(best) == 1 else None  # markers of a single row fit both patterns


@lru_cache(maxsize=16)
def cells(dictionary: str, first: int, count: int) -> Array:
    """Return the cells (count, n, n) of markers from the id `first` on, border included, 1 where bright."""
    words = opencv.marker_dictionary(dictionary)
    side = words.markerSize + 2
    return np.stack([words.generateImageMarker(first + marker, side) for marker in range(count)]) / 255.0


def bright_squares(checker: Checker) -> tuple[Array, Array]:
    """Return the bright squares (S, 2) of a pattern, row and column of the corner after each, and their corners.

    corners: (4, S, 2) pixels: upper left, upper right, lower left, lower right. Squares beyond the outer corners are
    among them.
    """
    wide = grids.predict(grids.padded(checker.grid))
    wide[1:-1, 1:-1] = np.where(checker.found[..., None], checker.grid, wide[1:-1, 1:-1])
    row, column = np.indices((wide.shape[0] - 1, wide.shape[1] - 1)).reshape(2, -1)
    corners = np.stack([wide[row, column], wide[row, column + 1], wide[row + 1, column], wide[row + 1, column + 1]])
    bright = ((row + column) % 2 == 1) == (checker.sign > 0)
    used = bright & ~np.isnan(corners).any(axis=(0, 2))
    return np.stack([row, column], axis=1)[used], corners[:, used]


def read_bits(gray: Array, corners: Array, share: float, side: int, contrast: float) -> tuple[Array, Array]:
    """Return the bits (S, side - 2, side - 2) within squares, and in which (S,) they have a dark border around them.

    corners: (4, S, 2) of bright squares. share: the marker's of a square. side: cells across a marker, border included.
    """
    if not corners.shape[1]:
        return np.zeros((0, side - 2, side - 2), bool), np.zeros(0, bool)
    levels, margin = _levels(gray, corners, share, side)
    border = np.ones((side, side), dtype=bool)
    border[1:-1, 1:-1] = False
    dark = levels[:, border].mean(axis=1)
    bits = levels > ((dark + margin) / 2)[:, None, None]
    clear = ((~bits[:, border]).mean(axis=1) >= BORDER) & (margin - dark > 0.5 * contrast)
    return bits[:, 1:-1, 1:-1], np.asarray(clear)


def _levels(gray: Array, corners: Array, share: float, side: int) -> tuple[Array, Array]:
    """Return the mean gray levels of a marker's cells (S, side, side) and of the margin around it (S,).

    corners: (4, S, 2) pixels of the squares: upper left, upper right, lower left, lower right.
    """
    cell = share / side
    place = (1 - share) / 2 + cell * (np.arange(side)[:, None] + 0.5 + _SUB).ravel()
    v, u = (axis.ravel() for axis in np.meshgrid(place, place, indexing="ij"))
    count = corners.shape[1]
    values = in_squares(gray, corners, u, v).reshape(count, side, len(_SUB), side, len(_SUB))
    ring, near = np.linspace(0.2, 0.8, 7), (1 - share) / 4
    u = np.concatenate([ring, ring, np.full(7, near), np.full(7, 1 - near)])
    v = np.concatenate([np.full(7, near), np.full(7, 1 - near), ring, ring])
    return values.mean(axis=(2, 4)), np.median(in_squares(gray, corners, u, v), axis=1)


def in_squares(gray: Array, corners: Array, u: Array, v: Array) -> Array:
    """Return the gray levels (S, K) at places u to the right and v down (K,) in squares, 0 to 1."""
    weights = np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v])
    x, y = (corners[..., axis].T @ weights for axis in (0, 1))
    return opencv.sampled(gray, x, y)


def nearest(seen: Array, bits: Array) -> tuple[Array, Array, Array]:
    """Return the marker (S,) of `bits` (N, b, b) most like each seen (S, b, b), its turn, and how many bits differ."""
    codes = np.stack([np.rot90(bits, turn, axes=(1, 2)) for turn in range(4)], axis=1).reshape(-1, bits[0].size)
    flat = seen.reshape(len(seen), -1).astype(np.float32)
    codes = (codes > 0.5).astype(np.float32)
    differ = flat.sum(axis=1, keepdims=True) + codes.sum(axis=1) - 2 * flat @ codes.T
    best = differ.argmin(axis=1)
    marker, turn = np.divmod(best, 4)
    return marker, turn, differ[np.arange(len(best)), best]


def _elected(reading: Reading, board: Board, legacy: bool) -> Seat | None:
    """Return the place that most markers put the pattern in, None if they are at odds."""
    home = marker_squares(board, legacy=legacy)[reading.marker]
    turned = np.einsum("sij,sj->si", np.array(TURNS)[reading.turn], reading.square - 0.5)
    moved = np.rint(home - 0.5 - turned).astype(np.intp)
    ranked = Counter(map(tuple, np.column_stack([reading.turn, moved]).tolist())).most_common(2)
    if not ranked or ranked[0][1] < LEAST_VOTES or (len(ranked) > 1 and ranked[0][1] < MAJORITY * ranked[1][1]):
        return None
    (turn, row, column), votes = ranked[0]
    return Seat(turn, row, column, legacy, votes)


def marker_squares(board: Board, *, legacy: bool) -> Array:
    """Return row and column (M, 2) of the squares with markers, outer squares counted, in the order of the markers."""
    row, column = np.indices((board.rows + 1, board.columns + 1))
    first = 1 if legacy and (board.rows + 1) % 2 == 0 else 0
    return np.argwhere((row + column + first) % 2 == 1)
