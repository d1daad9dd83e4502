"""Detection of a ChArUco board: its checker pattern, and the markers that identify its position.

Markers are arranged in two ways: as OpenCV draws boards today, and as it did before 4.6, which differs where the board
has an even number of rows of squares. A board drawn with its sizes exchanged has other markers in other places too.

The corners say where every cell of every marker is: nothing is searched for, and blur, tilt and small squares do little
harm. Two markers that put the pattern in the same place on the board, more than support any other, settle it.

A board with more rows has the same markers, so only the image can tell where the rows end. Beyond the last one there is
white paper, and a further row would have dark squares. What hides the rest, a hand or a clamp, is not white just where
the squares end.
"""

from collections import Counter
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from camcal import opencv
from camcal.arrays import Array, IntArray
from camcal.dataclass import dataclass, replace
from camcal.targets.board import Board
from camcal.targets.board_map import map_of
from camcal.targets.checker import proposals as grids
from camcal.targets.checker.checker import Checker, clear_corners, trimmed, verified_corners, with_hidden_corners
from camcal.targets.checker.proposals import proposals
from camcal.targets.detection import MIN_CORNERS, BoardDetection
from camcal.targets.pattern import family_named

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
class BoardPlacement:
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
class MarkerReadings:
    """The M markers read in the bright squares of a pattern.

    square: (M, 2) row and column of the corner after each. marker: (M,) numbers among the board's, from 0. turn: (M,)
    quarter turns, see BoardPlacement. mirrored: how many can be read only from behind.
    """

    square: Array
    marker: Array
    turn: Array
    mirrored: int

    @property
    def count(self) -> int:
        """How many markers were read, or seen from behind if those are more."""
        return max(len(self.marker), self.mirrored)


def read_markers(gray: Array, checker: Checker, board: Board) -> MarkerReadings:
    """Return the markers of a ChArUco board that are seen between the corners of a pattern in `gray`, (H, W) uint8."""
    words = cells(board.dictionary or "", board.first_marker, (board.rows + 1) * (board.columns + 1) // 2)
    square, corners = bright_squares(checker)
    share = (board.marker or 0.0) / board.spacing
    bits, clear = read_bits(gray, corners, share, words.shape[1], checker.contrast)
    square, bits = square[clear], bits[clear]
    if not len(square):
        return MarkerReadings(square, np.zeros(0, np.intp), np.zeros(0, np.intp), 0)
    marker, turn, wrong = nearest(bits, words[:, 1:-1, 1:-1])
    behind = nearest(bits, words[:, 1:-1, -2:0:-1])[2]
    legible = wrong * WRONG_BITS <= bits[0].size
    mirrored = int((~legible & (behind * WRONG_BITS <= bits[0].size)).sum())
    return MarkerReadings(square[legible], marker[legible], turn[legible], mirrored)


def board_placement(reading: MarkerReadings, board: Board, legacies: Sequence[bool]) -> BoardPlacement | None:
    """Return where a pattern sits on a ChArUco board by its markers, None where they are too few or at odds."""
    placements = [one for one in (_elect(reading, board, legacy) for legacy in legacies) if one]
    most = max((one.votes for one in placements), default=0)
    best = [one for one in placements if one.votes == most]
    return best[0] if len(best) == 1 else None  # markers of a single row fit both patterns


@lru_cache(maxsize=16)
def cells(dictionary: str, first: int, count: int) -> Array:
    """Return the cells (count, n, n) of markers from the id `first` on, border included, 1 where bright."""
    return family_named(dictionary).printed(range(first, first + count))


def bright_squares(checker: Checker) -> tuple[Array, Array]:
    """Return the bright squares (S, 2) of a pattern, row and column of the corner after each, and their corners.

    corners: (4, S, 2) pixels: upper left, upper right, lower left, lower right. Squares beyond the outer corners are
    among them.
    """
    wide = grids.predict(grids.widen(checker.grid))
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


def _elect(reading: MarkerReadings, board: Board, legacy: bool) -> BoardPlacement | None:
    """Return the place that most markers put the pattern in, None if they are at odds."""
    row, column = np.indices((board.rows + 1, board.columns + 1))  # of squares, outer ones counted
    first = 1 if legacy and (board.rows + 1) % 2 == 0 else 0
    home = np.argwhere((row + column + first) % 2 == 1)[reading.marker]
    turned = np.einsum("sij,sj->si", np.array(TURNS)[reading.turn], reading.square - 0.5)
    moved = np.rint(home - 0.5 - turned).astype(np.intp)
    ranked = Counter(map(tuple, np.column_stack([reading.turn, moved]).tolist())).most_common(2)
    if not ranked or ranked[0][1] < LEAST_VOTES or (len(ranked) > 1 and ranked[0][1] < MAJORITY * ranked[1][1]):
        return None
    (turn, down, right), votes = ranked[0]
    return BoardPlacement(turn, down, right, legacy, votes)


WHITE = np.uint8(255)
ENOUGH = 0.5  # of the board's corners, to look no further
INSIDE = 0.9  # share of a pattern's corners that must be the board's where its markers put it
MARGIN_USED = 0.8  # of a marker's white margin, so that a blurred marker stays out of the samples


def arrangements(board: Board) -> tuple[Board, ...]:
    """Return the boards that `board` may stand for, the one it literally is first, each with `legacy` settled."""
    result = []
    for candidate in (board, board.transposed()):
        legacies = _legacies(candidate)
        result += [replace(candidate, legacy=legacy) for legacy in legacies]
    return tuple(dict.fromkeys(result))


def require_markers(board: Board) -> None:
    """Raise InvalidInput if the dictionary of a ChArUco board is unknown or has too few markers for it."""
    name = board.dictionary or ""
    opencv.marker_dictionary(name)  # of OpenCV's own names alone
    family_named(name).require(board.first_marker, (board.columns + 1) * (board.rows + 1) // 2)


def find_charuco(gray: Array, board: Board) -> BoardDetection:
    """Return the corners of a ChArUco board in `gray`, (H, W) uint8, or the reason why there are none.

    A board whose `legacy` is None is searched for in both patterns, and the one that more markers support is taken. One
    that is printed white on black is found as well, where a checker pattern without its markers is in sight.
    Raises InvalidInput if the dictionary is unknown or too small.
    """
    require_markers(board)
    detection, bare = _find(gray, board)
    white = np.asarray(WHITE - gray)
    if detection.found or not any(
        len(read_markers(white, each.inverted, board).marker) >= LEAST_VOTES for each in bare
    ):
        return detection
    inverted, _ = _find(white, board)
    return replace(inverted, inverted=True) if inverted.found else detection


def arrangement_votes(gray: Array, boards: Sequence[Board]) -> IntArray:
    """Return how many markers in `gray`, (H, W) uint8, speak for each (N,) of the arrangements of a board.

    These have the same markers, so each pattern is read once for all of them: as drawn, and as printed inverted.
    """
    votes, white = np.zeros(len(boards), np.intp), np.asarray(WHITE - gray)
    for copy in proposals(gray):
        for start in copy:
            checker = trimmed(verified_corners(gray, start, clearance(boards[0])))
            for image, seen in ((gray, checker), (white, checker.inverted)):
                reading = read_markers(image, seen, boards[0])
                for index, board in enumerate(boards):
                    place = board_placement(reading, board, _legacies(board))
                    if place is not None and _inside(place.on_board(seen.grid, board), seen):
                        votes[index] += place.votes
        if votes.any():
            break
    return votes


def _find(gray: Array, board: Board) -> tuple[BoardDetection, list[Checker]]:
    """Return the corners of a board of dark markers on white, or why there are none, and patterns without markers."""
    legacies = _legacies(board)
    best, most = BoardDetection.nothing(f"no marker of {board.dictionary} found"), 0
    bare: list[Checker] = []
    for copy in proposals(gray):
        checkers = [trimmed(verified_corners(gray, start, clearance(board))) for start in copy]
        readings = [read_markers(gray, checker, board) for checker in checkers]
        patterns = list(zip(checkers, readings, strict=True))
        grid = _join([(board_placement(reading, board, legacies), checker) for checker, reading in patterns], board)
        bare += [checker for checker, reading in patterns if not reading.count]
        if grid is None:
            if not patterns or best.found:
                continue
            checker, reading = max(patterns, key=lambda pattern: (pattern[1].count, pattern[0].found.sum()))
            if reading.count > max(most, LEAST_VOTES - 1):
                best, most = _explain_misfit(reading, checker), reading.count
            elif not most and checker.found.sum() > len(best.refused):
                best = BoardDetection.nothing(str(best.reason), refused=checker.grid)
            continue
        checker = with_hidden_corners(gray, verified_corners(gray, grid, clearance(board)), clearance(board))
        seen = BoardDetection.of(clear_corners(gray, checker, clearance(board)))
        best = max(best, seen, key=lambda detection: len(detection.ids))
        if len(best.ids) >= ENOUGH * board.count:
            break
    return best, bare


def _join(parts: list[tuple[BoardPlacement | None, Checker]], board: Board) -> Array | None:
    """Return the corners (rows, columns, 2) of all parts of a board that belong together, those of most markers first.

    parts: patterns, and where they sit on the board as far as their markers say. None if no part says where it is.
    """
    placed = sorted(((place, checker) for place, checker in parts if place), key=lambda part: -part[0].votes)
    grid = None
    for place, checker in placed:
        corners = place.on_board(checker.grid, board)
        if not _inside(corners, checker):
            continue
        if grid is None:
            grid = corners
        elif place.legacy == placed[0][0].legacy:
            grid = np.where(np.isnan(grid), corners, grid)
    return grid


def _inside(corners: Array, checker: Checker) -> bool:
    """Return whether a pattern's corners are on the board, (rows, columns, 2), where its markers put it."""
    return bool((~np.isnan(corners[..., 0])).sum() >= INSIDE * checker.found.sum())


def _explain_misfit(reading: MarkerReadings, checker: Checker) -> BoardDetection:
    """Return why a pattern with markers is not the board."""
    count, mirrored = len(reading.marker), reading.mirrored
    reason = (
        "the image is mirrored: flip it"
        if mirrored > count
        else f"{count} markers in other positions than on this board"
    )
    return BoardDetection.nothing(reason, refused=checker.grid)


def clearance(board: Board) -> float:
    """Return how far from an edge, in squares, an image of a ChArUco board shows nothing but squares."""
    marker_ratio = float(board.marker or 0) / (board.square or 1.0)
    return MARGIN_USED * (1 - marker_ratio) / 2


def _legacies(board: Board) -> tuple[bool, ...]:
    """Return the patterns of markers to search for; both look the same with an odd number of rows of squares."""
    either = board.legacy is None and (board.rows + 1) % 2 == 0
    return (False, True) if either else (bool(board.legacy),)


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
    places = board.points()[:, :2] / board.spacing
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
