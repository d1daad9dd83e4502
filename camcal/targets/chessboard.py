"""A chessboard in an image: proposals, verified, numbered so that the same id is the same corner in every view.

Where columns + rows is odd the colours tell the two ends apart: the square before corner 0, at the board's own corner,
is dark. Otherwise the board looks the same turned, and the turn whose rows run most to the right is taken. Given
transposed it is the same object, found and numbered along the columns it is given.
"""

from itertools import chain

import numpy as np

from camcal.arrays import Array
from camcal.targets import grid as grids
from camcal.targets.board import Board
from camcal.targets.checker import SIDE, Checker, extended, settle, trimmed
from camcal.targets.proposals import largest_patterns, proposals
from camcal.targets.sighting import Sighting

MIN_PROPOSED = 0.5  # of a proposal's corners; one of which the image bears out fewer is a mistake
MIN_SHARE = 0.75  # of the board's corners


def find_chessboard(gray: Array, board: Board) -> Sighting:
    """Return the corners of a chessboard in `gray`, (H, W) uint8, or the reason why there are none.

    Up to a quarter of the corners may be hidden, but on each side of the board most must be seen: they say where it
    ends.
    """
    best, seen = 0, None
    for start in chain(proposals(gray, board.columns, board.rows), largest_patterns(gray)):
        checker = settle(gray, grids.right_handed(start))
        best = max(best, int(checker.found.sum()))
        if checker.found.mean() < MIN_PROPOSED:
            continue
        checker = extended(gray, trimmed(checker))
        seen = _judged(gray, checker, board)
        if seen.found or _larger(_size(checker), board):
            return seen
    return seen or Sighting.nothing(f"only {best} clear corners" if best else "no chessboard found")


def _judged(gray: Array, checker: Checker, board: Board) -> Sighting:
    """Return the corners of a checker pattern if it is the board, else what it is."""
    size = _size(checker)
    if checker.grid.shape[:2] == (board.columns, board.rows):
        checker = _quarter_turned(checker)
    if checker.grid.shape[:2] == (board.rows, board.columns):
        if checker.found.mean() < MIN_SHARE:
            return Sighting.nothing(f"only {int(checker.found.sum())} of {board.count} corners are clear")
        return Sighting.of(_numbered(checker))
    seen, wanted = f"{size[0]} x {size[1]}", f"{board.columns} x {board.rows}"
    if _larger(size, board):
        return Sighting.nothing(f"a checker pattern of {seen} corners, not {wanted}", size)
    if _leaves(gray, checker.grid):
        return Sighting.nothing(f"board partly outside the image ({seen} corners in sight)")
    return Sighting.nothing(f"only {seen} of {wanted} corners in sight", size)


def _size(checker: Checker) -> tuple[int, int]:
    """Return columns and rows of a pattern, the larger number first: it does not say which are its rows."""
    rows, columns = checker.grid.shape[:2]
    return max(rows, columns), min(rows, columns)


def _larger(size: tuple[int, int], board: Board) -> bool:
    return size[0] > max(board.columns, board.rows) or size[1] > min(board.columns, board.rows)


def _quarter_turned(checker: Checker) -> Checker:
    """Return the same pattern with what were columns as rows."""
    first = (-1) ** (checker.grid.shape[1] - 1)  # node (0, 0) is then the end of the first row
    return Checker(np.rot90(checker.grid), checker.sign * first, checker.contrast)


def _numbered(checker: Checker) -> Array:
    """Return the grid turned so that node (0, 0) is corner 0."""
    grid = checker.grid
    rows, columns = grid.shape[:2]
    if (rows + columns) % 2:
        return grid if checker.sign > 0 else grid[::-1, ::-1]
    turns = range(4) if rows == columns else (0, 2)
    return max((np.rot90(grid, turn) for turn in turns), key=grids.rightness)


def _leaves(gray: Array, pattern: Array) -> bool:
    """Return whether the next row or column of a pattern would lie outside the image."""
    wide = grids.predict(np.pad(pattern, ((1, 1), (1, 1), (0, 0)), constant_values=np.nan))
    outside = np.asarray(((wide < 0) | (wide > np.array(gray.shape[::-1]) - 1)).any(axis=-1))
    sides = (outside[0, 1:-1], outside[-1, 1:-1], outside[1:-1, 0], outside[1:-1, -1])
    return any(side.mean() > SIDE for side in sides)
