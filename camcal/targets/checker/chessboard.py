"""Detection of a chessboard: proposals, verification, consistent numbering.

Where columns + rows is odd the colours tell the two ends apart: the square before corner 0, at the board's own corner,
is dark. Dots tell the ends of any board apart. Otherwise the board looks the same turned, and the turn whose rows run
most upright is taken. Given transposed it is the same object, found and numbered along the columns it is given.

Where on its board a part of a pattern lies is written as the ids (R, C) of the pattern's corners. Such a place must
have the colours of the board, end where the image shows the board to end, and have its dots where dots are seen.
Nothing is guessed: if more than one is left that a look at the board could tell apart, the pattern has no place.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain

import numpy as np

from camcal import opencv
from camcal.arrays import Array
from camcal.targets.board import Board
from camcal.targets.board_types import dotted_squares
from camcal.targets.checker import proposals as grids
from camcal.targets.checker.checker import SIDE, Checker, clear_corners, extended, trimmed, verified_corners
from camcal.targets.checker.proposals import proposals
from camcal.targets.detection import BoardDetection

MIN_PROPOSED = 0.5  # of a proposal's corners; one of which the image bears out fewer is a mistake
MIN_SHARE = 0.75  # of the board's corners
ENOUGH = 0.25  # of them, to believe that a pattern is the board or a part of it
SMALLER = 0.25  # of the area of such a part: a picture of a board, on a screen behind it
LEAST_PART = 3  # corners each way of a part of a board; fewer may be anything


def find_chessboard(gray: Array, board: Board, *, partial: bool = False) -> BoardDetection:
    """Return the corners of a chessboard in `gray`, (H, W) uint8, or the reason why there are none.

    Up to a quarter of the corners may be hidden, but on each side of the board most must be seen: they say where it
    ends. partial: any part of the board will do that shows which part it is, by dots or by where the board ends.
    """
    best, most, area = BoardDetection.nothing("no chessboard found"), 0, 0.0
    for start in chain.from_iterable(proposals(gray)):
        checker = verified_corners(gray, start)
        if checker.found.sum() < MIN_PROPOSED * (~np.isnan(start[..., 0])).sum():
            continue
        checker = trimmed(checker)
        if min(checker.grid.shape[:2]) < 2 or checker.area < SMALLER * area:
            continue
        checker = extended(gray, checker)
        seen = _judge(gray, checker, board, partial=partial)
        large = checker.found.sum() > ENOUGH * board.count
        if len(seen.ids) >= MIN_SHARE * board.count or (large and _leaves(gray, checker.grid)):
            return seen
        if len(seen.ids) > len(best.ids) or (checker.found.sum() > most and not best.found):
            best, most = seen, int(checker.found.sum())
        area = max(area, checker.area * large)
    return best


def _judge(gray: Array, checker: Checker, board: Board, *, partial: bool) -> BoardDetection:
    """Return the corners of a pattern if it is the board, or a part of it where that is enough, else what it is."""
    whole = sorted(checker.grid.shape[:2]) == sorted((board.rows, board.columns))
    if not whole and (not partial or min(checker.grid.shape[:2]) < LEAST_PART):
        return _part_or_another(gray, checker, board)
    if whole and not partial and checker.found.mean() < MIN_SHARE:
        reason = f"only {int(checker.found.sum())} of {board.count} usable corners"
        return BoardDetection.nothing(reason, refused=checker.grid)
    places = fitting(checker, board)
    if not whole:
        ends = np.array([*_ends(gray, checker)])
        places = [ids for ids in places if not (ends & ~_ending_on(board, ids)).any()]
    if board.dots:
        places = select_dotted(gray, checker, places, board)
    grid = numbered(places, checker, board)
    if grid is not None:
        seen = BoardDetection.of(clear_corners(gray, Checker(grid, checker.sign, checker.contrast)))
        # most sides (of four) of an inverted pattern end with a dark margin, and none with a bright one
        unbounded = seen.found and whole and not any(_ends(gray, checker))
        inverted = unbounded and bool(np.mean([*_ends(np.asarray(WHITE - gray), checker)]) > INVERTED)
        return replace(seen, inverted=inverted)
    if whole and board.dots:
        reason = "the three dots that define its orientation are not visible"
        return BoardDetection.nothing(reason, refused=checker.grid)
    seen = _part_or_another(gray, checker, board)
    return replace(seen, reason=f"{seen.reason}, which part of the board is ambiguous")


def _part_or_another(gray: Array, checker: Checker, board: Board) -> BoardDetection:
    """Return what a pattern of another size than the board is."""
    rows, columns = checker.grid.shape[:2]
    size = max(rows, columns), min(rows, columns)  # it does not say which are its rows
    other = board.of_size(*size)
    seen, wanted = f"{size[0]} x {size[1]}", f"{board.columns} x {board.rows}"
    if size[0] > max(board.columns, board.rows) or size[1] > min(board.columns, board.rows):
        reason = f"a checker pattern of {seen} corners, not {wanted}"
        return BoardDetection.nothing(reason, other, checker.grid)
    if _leaves(gray, checker.grid):
        reason = f"board partly outside the image ({seen} corners visible)"
        return BoardDetection.nothing(reason, refused=checker.grid)
    return BoardDetection.nothing(f"only {seen} of {wanted} corners visible", other, checker.grid)


def _leaves(gray: Array, pattern: Array) -> bool:
    """Return whether the next row or column of a pattern would lie outside the image."""
    wide = grids.predict(grids.widen(pattern))
    outside = np.asarray(((wide < 0) | (wide > np.array(gray.shape[::-1]) - 1)).any(axis=-1))
    return any(side.mean() > SIDE for side in grids.outer(outside))


# Where the board ends, squares are dark and bright by turns on its side and bright on the other.
RIMS = (1.0, 0.75, 0.5)  # steps, how wide outer squares may be; many boards are cut
ASIDE = 0.3  # of that from the rim, and of a step along it, is where the squares and the margin are examined
ALTERNATING = 0.5  # smallest difference of neighbouring squares of the rim, of dark to bright
MARGIN = 0.35  # largest difference of the margin and a bright square, likewise
ENDS = 0.75  # share of a side that must look so, as far as it is in the image
LEAST_RIM = 3  # places
WHITE = np.uint8(255)
INVERTED = 0.5  # share of the sides that a dark margin must be seen at
DOT, NO_DOT = 0.55, 0.25  # of dark to bright: difference of a square's middle from its rest
_ROUND = np.arange(12) * (2 * np.pi / 12)
_DOT_RING = 0.32  # steps from the middle of a square, outside a dot and inside the square


def fitting(checker: Checker, board: Board) -> list[Array]:
    """Return the places of a pattern on a board by its size and colours, as ids (R, C) of the pattern's corners.

    Colours are asked only where a board has a light and a dark end: others are printed either way.
    """
    numbers = np.arange(board.count).reshape(board.rows, board.columns)
    rows, columns = checker.grid.shape[:2]
    result = []
    for turn in range(4):
        turned = np.rot90(numbers, turn)
        for row in range(turned.shape[0] - rows + 1):
            for column in range(turned.shape[1] - columns + 1):
                ids = turned[row : row + rows, column : column + columns]
                dark = sum(divmod(int(ids[0, 0]), board.columns)) + turn
                if (board.columns + board.rows) % 2 == 0 or (-1) ** dark == checker.sign:
                    result.append(ids)
    return result


def numbered(places: list[Array], checker: Checker, board: Board) -> Array | None:
    """Return the corners of a pattern by their ids on the board (rows, columns, 2), NaN where none was seen.

    None if several places are left. Of those that a turn of the board exchanges, the one whose rows run most upright.
    """
    alike = board.symmetries()
    if not places or len({min(tuple(turn[ids.ravel()]) for turn in alike) for ids in places}) > 1:
        return None
    grids_on_board = np.full((len(places), board.count, 2), np.nan)
    for on_board, ids in zip(grids_on_board, places, strict=True):
        on_board[ids] = checker.grid
    return max(grids_on_board.reshape(-1, board.rows, board.columns, 2), key=grids.uprightness)


def _ending_on(board: Board, ids: Array) -> Array:
    """Return which sides (4,) of a place, top, bottom, left, right, are at the end of the board."""
    row, column = np.divmod(ids, board.columns)
    sides = []
    for at, before in (((0, 0), (1, 0)), ((-1, 0), (-2, 0)), ((0, 0), (0, 1)), ((0, -1), (0, -2))):
        next_row, next_column = (2 * index[at] - index[before] for index in (row, column))
        sides.append(not (0 <= next_row < board.rows and 0 <= next_column < board.columns))
    return np.array(sides)


def _ends(gray: Array, checker: Checker) -> Iterator[bool]:
    """Yield for the top, bottom, left and right of a pattern whether the image shows the end of the board there."""
    wide = grids.predict(grids.widen(checker.grid))
    along, down = np.moveaxis(grids.steps(wide), -1, 0)
    places, across, downwards = (grids.outer(values) for values in (wide, along, down))
    beside = (*across[:2], *downwards[2:])
    outward = (-downwards[0], downwards[1], -across[2], across[3])
    for side in zip(places, beside, outward, strict=True):
        yield _has_rim(gray, *side, checker.contrast)


def _has_rim(gray: Array, beyond: Array, along: Array, outward: Array, contrast: float) -> bool:
    """Return whether outer squares of one of RIMS end beyond the last corners of a side and a margin begins.

    beyond: (K, 2) where the next corners would be. along, outward: (K, 2) steps, pixels.
    """
    widths = np.array(RIMS)[:, None, None]
    aside = ASIDE * widths
    rim = beyond - (1 - widths) * outward
    outer = rim + outward / 2
    seen = ((outer > 0) & (outer < np.array(gray.shape[::-1]) - 1)).all(axis=2)
    reach = np.stack([along, outward], axis=-1) * (aside[..., None] / 2)
    places = np.stack([rim + ASIDE * a * along + aside * b * outward for b in (-1, 1) for a in (-1, 1)])
    cells = places.reshape(-1, 2), np.broadcast_to(reach, (*places.shape, 2)).reshape(-1, 2, 2)
    left, right, outer_left, outer_right = _mean_around(gray, *cells).reshape(places.shape[:-1])
    bright = np.maximum(left, right)
    margin = np.maximum(np.abs(outer_left - bright), np.abs(outer_right - bright)) < MARGIN * 2 * contrast
    ending = margin & (np.abs(left - right) > ALTERNATING * 2 * contrast)
    count = seen.sum(axis=1)
    # not so where the rim is unknown
    known = count >= max(LEAST_RIM, len(beyond) / 2)
    return bool((known & ((ending & seen).sum(axis=1) >= ENDS * count)).any())


def _mean_around(gray: Array, places: Array, reach: Array) -> Array:
    """Return the mean (K,) over small cells about places (K, 2); reach: (K, 2, 2) pixels, half their sides."""
    u, v = (side.ravel() for side in np.meshgrid([-0.6, 0, 0.6], [-0.6, 0, 0.6]))
    x, y = (places[:, axis, None] + reach[:, axis] @ np.stack([u, v]) for axis in (0, 1))
    return np.asarray(opencv.sampled(gray, x, y).mean(axis=1))


def select_dotted(gray: Array, checker: Checker, places: list[Array], board: Board) -> list[Array]:
    """Return the places whose dots lie where dots are seen, and whose other squares are plain as far as seen."""
    seen = _dots(gray, checker)
    dotted = np.zeros((board.rows + 1, board.columns + 1), dtype=bool)
    for square in dotted_squares(board.columns, board.rows):
        dotted[square] = True
    result = []
    for ids in places:
        row, column = np.divmod(ids, board.columns)
        expected = dotted[_square(row), _square(column)]
        if not (expected & (seen < NO_DOT)).any() and not (~expected & (seen > DOT)).any():
            result.append(ids)
    return result


def _square(index: Array) -> Array:
    """Return the row or column (R - 1, C - 1), outer squares counted, of the squares between nodes (R, C)."""
    return np.asarray(np.maximum(np.maximum(index[:-1, :-1], index[1:, 1:]), index[:-1, 1:]))


def _dots(gray: Array, checker: Checker) -> Array:
    """Return by how much the middles of the squares between nodes (R - 1, C - 1) differ from their rest.

    1 for the difference of dark and bright; NaN where a square's corners were not seen.
    """
    grid = checker.grid
    corners = np.stack([grid[:-1, :-1], grid[:-1, 1:], grid[1:, :-1], grid[1:, 1:]])
    middle = corners.mean(axis=0).reshape(-1, 2)
    sides = np.stack(
        [corners[1] + corners[3] - corners[0] - corners[2], corners[2] + corners[3] - corners[0] - corners[1]], axis=-1
    )
    sides = sides.reshape(-1, 2, 2) / 2
    seen = ~np.isnan(middle[:, 0])
    result = np.full(len(middle), np.nan)
    ring = _DOT_RING * np.stack([np.cos(_ROUND), np.sin(_ROUND)])
    x, y = (middle[seen, axis, None] + sides[seen, axis] @ ring for axis in (0, 1))
    rest = opencv.sampled(gray, x, y).mean(axis=1)
    result[seen] = np.abs(_mean_around(gray, middle[seen], 0.1 * sides[seen]) - rest) / (2 * checker.contrast)
    return result.reshape(corners.shape[1:3])
