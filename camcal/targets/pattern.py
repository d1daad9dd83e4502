"""The printed pattern of a board: black and white rectangles, and discs."""

from dataclasses import dataclass, field

import numpy as np

from camcal.arrays import Array, readonly
from camcal.errors import InvalidInput
from camcal.targets.board import APRILGRID, CHARUCO, Board
from camcal.targets.board_types import TAG_BORDER, dotted_squares
from camcal.targets.markers.families import family_named

BLACK, WHITE = 0.0, 1.0
QUIET = 0.75  # width of the white border in squares
DOT = 0.17  # radius of a marker dot in squares, as OpenCV prints them


@dataclass(frozen=True, eq=False)
class Pattern:
    """A drawing whose ink changes only at lines x (M,) and y (N,), in the board's frame and unit, ascending, and at
    the rims of discs.

    ink: (N - 1, M - 1), 0 is black and 1 is white; the sheet ends at the first and the last lines.
    discs: (D, 4) x, y, radius and ink; each lies within one rectangle.
    """

    x: Array
    y: Array
    ink: Array
    discs: Array = field(default_factory=lambda: np.zeros((0, 4)))

    def __post_init__(self) -> None:
        object.__setattr__(self, "x", readonly(self.x, (None,), "x"))
        object.__setattr__(self, "y", readonly(self.y, (None,), "y"))
        object.__setattr__(self, "ink", readonly(self.ink, (len(self.y) - 1, len(self.x) - 1), "ink"))
        object.__setattr__(self, "discs", readonly(self.discs, (None, 4), "discs"))

    def ink_at(self, places: Array) -> Array:
        """Return the ink (K,) of the rectangles in which places (K, 2) lie, as if there were no discs."""
        row, column = np.searchsorted(self.y, places[:, 1]) - 1, np.searchsorted(self.x, places[:, 0]) - 1
        return np.asarray(self.ink[row, column])


def pattern_of(board: Board) -> Pattern:
    """Return the drawing of a board with its white border; a ChArUco board that does not say is of the current kind.

    Raises InvalidInput if its dictionary is unknown or has too few markers, or the size of its circles is unknown.
    """
    if board.type == CHARUCO:
        return _charuco(board)
    if board.checker:
        return _chessboard(board)
    return _aprilgrid(board) if board.type == APRILGRID else _circles(board)


def ink_reach(board: Board) -> float:
    """Return how far the drawing reaches beyond the bounding box of a board's points, in its unit."""
    if board.checker:
        return board.spacing
    return board.spacing - (board.marker or 0.0) if board.type == APRILGRID else (board.diameter or 0.0) / 2


def _chessboard(board: Board) -> Pattern:
    drawn = _bordered(board, _checker(board), np.array([0.0]))
    if not board.dots:
        return drawn
    row, column = np.transpose(dotted_squares(board.columns, board.rows))
    places = (np.column_stack([column, row]) - 0.5) * board.spacing
    radius = np.full(len(places), DOT * board.spacing)
    return Pattern(drawn.x, drawn.y, drawn.ink, np.column_stack([places, radius, WHITE - drawn.ink_at(places)]))


def _charuco(board: Board) -> Pattern:
    squares = _checker(board)
    bits = _markers(board, int(squares.sum()))
    cells = bits.shape[1]
    ink = np.kron(squares, np.ones((cells + 2, cells + 2)))  # the marker's cells and the white around them
    for marker, (row, column) in zip(bits, np.argwhere(squares == WHITE), strict=True):
        top, left = row * (cells + 2) + 1, column * (cells + 2) + 1
        ink[top : top + cells, left : left + cells] = marker
    share = (board.marker or 0.0) / board.spacing
    steps = np.concatenate([[0.0], (1 - share) / 2 + share * np.linspace(0, 1, cells + 1)])
    return _bordered(board, ink, steps)


def _checker(board: Board) -> Array:
    """Return the squares (rows + 1, columns + 1); the first is black, but white in a legacy ChArUco of even rows."""
    rows, columns = np.indices((board.rows + 1, board.columns + 1))
    first = 1 if board.legacy and (board.rows + 1) % 2 == 0 else 0
    return np.where((rows + columns + first) % 2 == 0, BLACK, WHITE)


def _markers(board: Board, count: int) -> Array:
    """Return the cells (count, n, n) of the board's markers, black border included, as they are printed."""
    family = family_named(board.dictionary or "")
    family.require(board.first_marker, count)
    markers = range(board.first_marker, board.first_marker + count)
    return family.printed(markers, TAG_BORDER if board.type == APRILGRID else 1)


def _bordered(board: Board, ink: Array, steps: Array) -> Pattern:
    """Return the pattern of ink (rows, columns) whose lines repeat in every square at `steps`, shares of its side."""
    x, y = (_lines(count + 1, steps) * board.spacing for count in (board.columns, board.rows))
    return Pattern(x, y, np.pad(ink, 1, constant_values=WHITE))


def _lines(squares: int, steps: Array) -> Array:
    """Return the lines of a row of squares and its border, in squares; the second square begins at 0."""
    inner = (np.arange(squares)[:, None] - 1 + steps).ravel()
    return np.concatenate([[-1 - QUIET], inner, [squares - 1, squares - 1 + QUIET]])


def _aprilgrid(board: Board) -> Pattern:
    """Return the tags, and a black square at every crossing of the gaps between and around them; y points up."""
    tags = _markers(board, board.columns * board.rows)[:, ::-1]
    cells = tags.shape[1]
    tags = np.pad(tags, ((0, 0), (1, 0), (1, 0)), constant_values=WHITE)  # the gaps before a tag belong to it
    tags[:, 0, 0] = BLACK
    step = cells + 1
    ink = tags.reshape(board.rows, board.columns, step, step).swapaxes(1, 2).reshape(board.rows * step, -1)
    ink = np.pad(ink, ((0, 1), (0, 1)), constant_values=WHITE)
    ink[::step, -1] = ink[-1, ::step] = BLACK
    x, y = (_tag_lines(count, cells, board) for count in (board.columns, board.rows))
    return Pattern(x, y, np.pad(ink, 1, constant_values=WHITE))


def _tag_lines(tags: int, cells: int, board: Board) -> Array:
    """Return the lines of a row of tags, of the gaps before, between and after them, and of the border."""
    side, gap = board.marker or 0.0, ink_reach(board)
    inner = (np.arange(tags)[:, None] * board.spacing + side * np.linspace(0, 1, cells + 1)).ravel()
    outer = np.array([gap, gap + QUIET * board.spacing])
    return np.concatenate([-outer[::-1], inner, inner[-1] + outer])


def _circles(board: Board) -> Pattern:
    if board.diameter is None:
        raise InvalidInput(f"the {board.words} needs a diameter to be drawn, such as {board.type}:10x8:25mm:15mm")
    reach = ink_reach(board) + QUIET * board.spacing
    x, y = (np.array([-reach, side + reach]) for side in board.extent)
    centres = board.points()[:, :2]
    discs = np.column_stack([centres, np.tile([board.diameter / 2, BLACK], (board.count, 1))])
    return Pattern(x, y, np.array([[WHITE]]), discs)
