"""A chessboard in an image: proposals, verified, numbered so that the same id is the same corner in every view.

Where columns + rows is odd the colours tell the two ends apart: the square before corner 0, at the board's own corner,
is dark. Dots tell the ends of any board apart. Otherwise the board looks the same turned, and the turn whose rows run
most upright is taken. Given transposed it is the same object, found and numbered along the columns it is given.
"""

from itertools import chain

import numpy as np

from camcal.arrays import Array
from camcal.targets.board import Board
from camcal.targets.checker import grid as grids
from camcal.targets.checker import placing
from camcal.targets.checker.checker import SIDE, Checker, extended, settle, trimmed, undisturbed
from camcal.targets.checker.proposals import proposals
from camcal.targets.detection import Detection

MIN_PROPOSED = 0.5  # of a proposal's corners; one of which the image bears out fewer is a mistake
MIN_SHARE = 0.75  # of the board's corners
ENOUGH = 0.25  # of them, to believe that a pattern is the board or a part of it
SMALLER = 0.25  # of the area of such a part: a picture of a board, on a screen behind it
LEAST_PART = 3  # corners each way of a part of a board; fewer may be anything


def find_chessboard(gray: Array, board: Board, *, partial: bool = False) -> Detection:
    """Return the corners of a chessboard in `gray`, (H, W) uint8, or the reason why there are none.

    Up to a quarter of the corners may be hidden, but on each side of the board most must be seen: they say where it
    ends. partial: any part of the board will do that shows which part it is, by dots or by where the board ends.
    """
    best, most, area = Detection.nothing("no chessboard found"), 0, 0.0
    for start in chain.from_iterable(proposals(gray)):
        checker = settle(gray, start)
        if checker.found.sum() < MIN_PROPOSED * (~np.isnan(start[..., 0])).sum():
            continue
        checker = trimmed(checker)
        if min(checker.grid.shape[:2]) < 2 or checker.area < SMALLER * area:
            continue
        checker = extended(gray, checker)
        seen = _judged(gray, checker, board, partial=partial)
        large = checker.found.sum() > ENOUGH * board.count
        if len(seen.ids) >= MIN_SHARE * board.count or (large and _leaves(gray, checker.grid)):
            return seen
        if len(seen.ids) > len(best.ids) or (checker.found.sum() > most and not best.found):
            best, most = seen, int(checker.found.sum())
        area = max(area, checker.area * large)
    return best


def _judged(gray: Array, checker: Checker, board: Board, *, partial: bool) -> Detection:
    """Return the corners of a pattern if it is the board, or a part of it where that is enough, else what it is."""
    whole = sorted(checker.grid.shape[:2]) == sorted((board.rows, board.columns))
    if not whole and (not partial or min(checker.grid.shape[:2]) < LEAST_PART):
        return _part_or_another(gray, checker, board)
    if whole and not partial and checker.found.mean() < MIN_SHARE:
        return Detection.nothing(f"only {int(checker.found.sum())} of {board.count} corners are clear")
    places = placing.fitting(checker, board)
    if not whole:
        places = placing.ending(gray, checker, places, board)
    if board.dots:
        places = placing.with_dots(gray, checker, places, board)
    grid = placing.numbered(places, checker, board)
    if grid is not None:
        return Detection.of(undisturbed(gray, Checker(grid, checker.sign, checker.contrast)))
    if whole and board.dots:
        return Detection.nothing("the three dots that tell its corners apart are not to be seen")
    seen = _part_or_another(gray, checker, board)
    return Detection.nothing(f"{seen.reason}, which part of the board is not to be seen", seen.other)


def _part_or_another(gray: Array, checker: Checker, board: Board) -> Detection:
    """Return what a pattern of another size than the board is."""
    rows, columns = checker.grid.shape[:2]
    size = max(rows, columns), min(rows, columns)  # it does not say which are its rows
    other = board.of_size(*size)
    seen, wanted = f"{size[0]} x {size[1]}", f"{board.columns} x {board.rows}"
    if size[0] > max(board.columns, board.rows) or size[1] > min(board.columns, board.rows):
        return Detection.nothing(f"a checker pattern of {seen} corners, not {wanted}", other)
    if _leaves(gray, checker.grid):
        return Detection.nothing(f"board partly outside the image ({seen} corners in sight)")
    return Detection.nothing(f"only {seen} of {wanted} corners in sight", other)


def _leaves(gray: Array, pattern: Array) -> bool:
    """Return whether the next row or column of a pattern would lie outside the image."""
    wide = grids.predict(grids.padded(pattern))
    outside = np.asarray(((wide < 0) | (wide > np.array(gray.shape[::-1]) - 1)).any(axis=-1))
    return any(side.mean() > SIDE for side in grids.outer(outside))
