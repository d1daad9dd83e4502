"""A chessboard in an image: proposals, verified, numbered so that the same id is the same corner in every view.

Where columns + rows is odd the colours tell the two ends apart: the square before corner 0, at the board's own corner,
is dark. Otherwise the board looks the same turned, and the turn whose rows run most to the right is taken. Given
transposed it is the same object, found and numbered along the columns it is given.
"""

import numpy as np

from camcal.arrays import Array
from camcal.targets import grid as grids
from camcal.targets.board import Board
from camcal.targets.checker import SIDE, Checker, extended, settle
from camcal.targets.proposals import largest_pattern, proposals
from camcal.targets.sighting import Sighting

MIN_SHARE = 0.75  # of the corners; a proposal of which the image bears out fewer is not this board
MIN_PATTERN = 0.5  # of the corners of a pattern that is only told of


def find_chessboard(gray: Array, board: Board) -> Sighting:
    """Return the corners of a chessboard in `gray`, (H, W) uint8, or the reason why there are none."""
    best = 0
    for proposal in proposals(gray, board.columns, board.rows):
        checker = settle(gray, grids.right_handed(proposal))
        if checker.found.mean() >= MIN_SHARE:
            return _judged(gray, extended(gray, checker), board)
        best = max(best, int(checker.found.sum()))
    pattern = largest_pattern(gray)
    if pattern is not None:
        checker = settle(gray, grids.right_handed(pattern))
        if checker.found.mean() >= MIN_PATTERN:
            return _judged(gray, extended(gray, checker), board)
    seen = f"of {board.count} corners only {best} look like a checker pattern; blurred or hidden?"
    return Sighting.nothing(seen if best else "no chessboard found")


def _judged(gray: Array, checker: Checker, board: Board) -> Sighting:
    """Return the corners of a checker pattern if it is the board, else what it is."""
    rows, columns = checker.grid.shape[:2]
    if (rows, columns) == (board.columns, board.rows):
        checker = _quarter_turned(checker)
    if checker.grid.shape[:2] == (board.rows, board.columns):
        return Sighting.of(_numbered(checker))
    size = (max(rows, columns), min(rows, columns))
    seen, wanted = f"{size[0]} x {size[1]}", f"{board.columns} x {board.rows}"
    if size[0] > max(board.columns, board.rows) or size[1] > min(board.columns, board.rows):
        return Sighting.nothing(f"a checker pattern of {seen} corners, not {wanted}", size)
    if _leaves(gray, checker.grid):
        return Sighting.nothing(f"board partly outside the image ({seen} corners in sight)")
    return Sighting.nothing(f"only {seen} of {wanted} corners in sight", size)


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
