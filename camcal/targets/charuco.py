"""A ChArUco board in an image: OpenCV reads the markers, the corners between them are verified and located here.

Markers are arranged in two ways: as OpenCV draws boards today, and as it did before 4.6, which differs where the board
has an even number of rows of squares. A board drawn with its sizes exchanged has other markers in other places too.
"""

from dataclasses import replace

import numpy as np

from camcal import opencv
from camcal.arrays import Array
from camcal.targets.board import Board
from camcal.targets.checker import settle
from camcal.targets.sighting import MIN_CORNERS, Sighting

MARGIN_USED = 0.8  # of a marker's white margin, so that a blurred marker stays out of the samples


def arrangements(board: Board) -> tuple[Board, ...]:
    """Return the boards that `board` may stand for, the one it literally is first, each with `legacy` settled."""
    result = []
    for candidate in (board, board.transposed()):
        both = candidate.legacy is None and _patterns_differ(candidate)
        legacies = (False, True) if both else (bool(candidate.legacy),)
        result += [replace(candidate, legacy=legacy) for legacy in legacies]
    return tuple(dict.fromkeys(result))


def require_markers(board: Board) -> None:
    """Raise InvalidInput if the dictionary of a ChArUco board is unknown or has too few markers for it."""
    _detector(board)


def find_charuco(gray: Array, board: Board) -> Sighting:
    """Return the corners of a ChArUco board in `gray`, (H, W) uint8, or the reason why there are none.

    A board whose `legacy` is None is looked for in both patterns, and the one with more corners is taken.
    Raises InvalidInput if the dictionary is unknown or too small.
    """
    if board.legacy is None and _patterns_differ(board):
        sightings = [find_charuco(gray, replace(board, legacy=legacy)) for legacy in (False, True)]
        return max(sightings, key=lambda sighting: len(sighting.ids))
    detector = _detector(board)
    ids, pixels, markers = opencv.find_charuco(detector, gray)
    if len(ids) < MIN_CORNERS and _markers_mirrored(detector, gray) > markers:
        return Sighting.nothing("the image is mirrored: its markers can be read only from behind")
    if not len(ids):
        seen = f"{markers} markers, but no corner between them that fits the board"
        return Sighting.nothing(seen if markers else f"no marker of {board.dictionary} found")
    start = np.full((board.rows, board.columns, 2), np.nan)
    start[np.divmod(ids, board.columns)] = pixels
    checker = settle(gray, start, clearance(board))
    if checker.found.any() and checker.sign != _sign(board):
        return Sighting.nothing("dark and bright squares are exchanged: not this board")
    return Sighting.of(checker.grid)


def clearance(board: Board) -> float:
    """Return how far from an edge, in squares, an image of a ChArUco board shows nothing but squares."""
    return MARGIN_USED * (1 - _ratio(board)) / 2


def _detector(board: Board) -> opencv.CharucoDetector:
    squares = (board.columns + 1, board.rows + 1)
    dictionary = str(board.dictionary)
    return opencv.charuco_detector(squares, _ratio(board), dictionary, board.first_marker, legacy=bool(board.legacy))


def _ratio(board: Board) -> float:
    return float(board.marker or 0) / (board.square or 1.0)


def _patterns_differ(board: Board) -> bool:
    return (board.rows + 1) % 2 == 0


def _sign(board: Board) -> int:
    """Return 1 if the square at the board's first corner is dark, else -1."""
    return -1 if board.legacy and _patterns_differ(board) else 1


def _markers_mirrored(detector: opencv.CharucoDetector, gray: Array) -> int:
    """Return the number of markers that are read in the mirrored image; a few of them are read by accident."""
    return opencv.find_charuco(detector, np.ascontiguousarray(gray[:, ::-1]))[2]
