"""A ChArUco board in an image: its checker pattern is found as a chessboard's is, its markers say which part it is.

Markers are arranged in two ways: as OpenCV draws boards today, and as it did before 4.6, which differs where the board
has an even number of rows of squares. A board drawn with its sizes exchanged has other markers in other places too.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from camcal import opencv
from camcal.arrays import Array
from camcal.targets.board import Board
from camcal.targets.checker.charuco_markers import LEAST_VOTES, Reading, Seat, read_markers, seat
from camcal.targets.checker.checker import Checker, revisited, settle, trimmed, undisturbed
from camcal.targets.checker.proposals import proposals
from camcal.targets.detection import Detection
from camcal.targets.markers.families import family_named

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


def find_charuco(gray: Array, board: Board) -> Detection:
    """Return the corners of a ChArUco board in `gray`, (H, W) uint8, or the reason why there are none.

    A board whose `legacy` is None is looked for in both patterns, and the one that more markers speak for is taken.
    Raises InvalidInput if the dictionary is unknown or too small.
    """
    require_markers(board)
    legacies = _legacies(board)
    best, refused = Detection.nothing(f"no marker of {board.dictionary} found"), 0
    for copy in proposals(gray):
        parts = [_part(gray, start, board, legacies) for start in copy]
        grid = _joined(parts, board)
        if grid is None:
            closest = max(parts, key=lambda part: part.markers, default=None)
            if closest and closest.markers > max(refused, LEAST_VOTES - 1) and not best.found:
                best, refused = _reason(closest), closest.markers
            continue
        checker = revisited(gray, settle(gray, grid, clearance(board)), clearance(board))
        seen = Detection.of(undisturbed(gray, checker, clearance(board)))
        best = max(best, seen, key=lambda detection: len(detection.ids))
        if len(best.ids) >= ENOUGH * board.count:
            break
    return best


@dataclass(frozen=True, eq=False)
class _Part:
    """A checker pattern, the markers read in it, and where it sits on the board as far as they say."""

    checker: Checker
    reading: Reading
    seat: Seat | None

    @property
    def markers(self) -> int:
        """How many markers were read, or seen from behind if those are more."""
        return max(len(self.reading.marker), self.reading.mirrored)


def _part(gray: Array, start: Array, board: Board, legacies: Sequence[bool]) -> _Part:
    checker = trimmed(settle(gray, start, clearance(board)))
    reading = read_markers(gray, checker, board)
    return _Part(checker, reading, seat(reading, board, legacies))


def _joined(parts: list[_Part], board: Board) -> Array | None:
    """Return the corners (rows, columns, 2) of all parts of a board that belong together, those of most markers first.

    None if no part says where it is.
    """
    seated = sorted(((part.seat, part) for part in parts if part.seat), key=lambda pair: -pair[0].votes)
    grid = None
    for place, part in seated:
        corners = place.on_board(part.checker.grid, board)
        if (~np.isnan(corners[..., 0])).sum() < INSIDE * part.checker.found.sum():
            continue
        if grid is None:
            grid = corners
        elif place.legacy == seated[0][0].legacy:
            grid = np.where(np.isnan(grid), corners, grid)
    return grid


def _reason(part: _Part) -> Detection:
    """Return why a pattern with markers is not the board."""
    count, mirrored = len(part.reading.marker), part.reading.mirrored
    if mirrored > count:
        return Detection.nothing("the image is mirrored: its markers can be read only from behind")
    return Detection.nothing(f"{count} markers, but not where this board has them")


def clearance(board: Board) -> float:
    """Return how far from an edge, in squares, an image of a ChArUco board shows nothing but squares."""
    return MARGIN_USED * (1 - _ratio(board)) / 2


def _ratio(board: Board) -> float:
    return float(board.marker or 0) / (board.square or 1.0)


def _legacies(board: Board) -> tuple[bool, ...]:
    """Return the patterns of markers to look for; both look the same with an odd number of rows of squares."""
    either = board.legacy is None and (board.rows + 1) % 2 == 0
    return (False, True) if either else (bool(board.legacy),)
