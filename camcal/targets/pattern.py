"""What is printed on a board: a drawing of black and white rectangles between lines."""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array, readonly
from camcal.errors import InvalidInput
from camcal.opencv import marker_dictionary
from camcal.targets.board import CHARUCO, Board

BLACK, WHITE = 0.0, 1.0
QUIET = 0.75  # width of the white border in squares


@dataclass(frozen=True, eq=False)
class Pattern:
    """A drawing whose ink changes only at lines x (M,) and y (N,), in the board's frame and unit, ascending.

    ink: (N - 1, M - 1), 0 is black and 1 is white; the sheet ends at the first and the last lines.
    """

    x: Array
    y: Array
    ink: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "x", readonly(self.x, (None,), "x"))
        object.__setattr__(self, "y", readonly(self.y, (None,), "y"))
        object.__setattr__(self, "ink", readonly(self.ink, (len(self.y) - 1, len(self.x) - 1), "ink"))


def pattern_of(board: Board) -> Pattern:
    """Return the drawing of a board with its white border; a ChArUco board that does not say is of the current kind.

    Raises InvalidInput if its dictionary is unknown or has too few markers.
    """
    squares = _checker(board)
    if board.type != CHARUCO:
        return _bordered(board, squares, np.array([0.0]))
    bits = _markers(board, int(squares.sum()))
    cells = bits.shape[1]
    ink = np.kron(squares, np.ones((cells + 2, cells + 2)))  # the marker's cells and the white around them
    for marker, (row, column) in zip(bits, np.argwhere(squares == WHITE), strict=True):
        top, left = row * (cells + 2) + 1, column * (cells + 2) + 1
        ink[top : top + cells, left : left + cells] = marker
    share = (board.marker or 0.0) / board.pitch
    steps = np.concatenate([[0.0], (1 - share) / 2 + share * np.linspace(0, 1, cells + 1)])
    return _bordered(board, ink, steps)


def _checker(board: Board) -> Array:
    """Return the squares (rows + 1, columns + 1); the first is black, but white in a legacy ChArUco of even rows."""
    rows, columns = np.indices((board.rows + 1, board.columns + 1))
    first = 1 if board.legacy and (board.rows + 1) % 2 == 0 else 0
    return np.where((rows + columns + first) % 2 == 0, BLACK, WHITE)


def _markers(board: Board, count: int) -> Array:
    """Return the cells (count, n, n) of the board's markers, black border included."""
    dictionary = marker_dictionary(board.dictionary or "")
    available = len(dictionary.bytesList)
    ids = range(board.first_marker, board.first_marker + count)
    if ids.stop > available:
        raise InvalidInput(
            f"the board needs markers {ids.start} to {ids.stop - 1}, {board.dictionary} ends at {available - 1}"
        )
    side = dictionary.markerSize + 2
    return np.stack([dictionary.generateImageMarker(marker, side) for marker in ids]) / 255.0


def _bordered(board: Board, ink: Array, steps: Array) -> Pattern:
    """Return the pattern of ink (rows, columns) whose lines repeat in every square at `steps`, shares of its side."""
    x, y = (_lines(count + 1, steps) * board.pitch for count in (board.columns, board.rows))
    return Pattern(x, y, np.pad(ink, 1, constant_values=WHITE))


def _lines(squares: int, steps: Array) -> Array:
    """Return the lines of a row of squares and its border, in squares; the second square begins at 0."""
    inner = (np.arange(squares)[:, None] - 1 + steps).ravel()
    return np.concatenate([[-1 - QUIET], inner, [squares - 1, squares - 1 + QUIET]])
