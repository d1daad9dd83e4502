"""What is printed: families of square markers by their common names, and the patterns of boards.

tag36h11 and DICT_APRILTAG_36h11 are the same markers drawn two ways: OpenCV draws AprilTags upside down, turned by 180°
to the images of the AprilTag project. Which corner is the top-left follows from the name that is given. The pattern of
a board is black and white rectangles, and discs.
"""

import re

import numpy as np

from camcal.arrays import Array, readonly
from camcal.dataclass import dataclass, field
from camcal.errors import InvalidInput
from camcal.opencv import marker_dictionary
from camcal.parsing import nearest
from camcal.targets.board import APRILGRID, CHARUCO, Board
from camcal.targets.board_types import TAG_BORDER, dotted_squares

_ROOT_TWO_PI = np.sqrt(2 * np.pi)
_LARGEST_CORRELATION = 0.9


@dataclass(frozen=True, eq=False)
class MarkerDrawing:
    """The cells (n, n) of a marker, black border included: 0 black, 1 white; white all around.

    Its frame has u along the rows and v down the columns, from -1 to 1 between the outer edges of the border.
    """

    ink: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "ink", readonly(self.ink, (None, len(self.ink)), "ink"))

    @property
    def lines(self) -> Array:
        """The places (n + 1,) of the lines between cells, along u as along v."""
        return np.linspace(-1, 1, len(self.ink) + 1)

    @property
    def edges(self) -> tuple[Array, Array]:
        """Starts and ends (E, 2), as u, v, of the sides of cells where black meets white."""
        padded = np.pad(self.ink, 1, constant_values=1.0)
        row, line = np.nonzero(np.diff(padded[1:-1], axis=1))
        upright = np.stack([np.stack([line, row], axis=1), np.stack([line, row + 1], axis=1)])
        line, column = np.nonzero(np.diff(padded[:, 1:-1], axis=0))
        level = np.stack([np.stack([column, line], axis=1), np.stack([column + 1, line], axis=1)])
        starts, ends = self.lines[np.concatenate([upright, level], axis=1)]
        return starts, ends

    def blurred(self, places: Array, gradients: Array, blur: Array | float) -> tuple[Array, Array, Array]:
        """Return brightness (K,), 0 to 1, at places (K, 2), as u, v, its derivatives (K, 2) by these, and (K,) by the
        blur's logarithm.

        gradients: (K, 2, 2) of u and of v by x and y, 1/px. blur: standard deviation of the Gaussian, px.
        The drawing is a sum of quadrants, whose corners the blur turns into bivariate normal distributions; for a
        skewed marker those are correlated: two terms of the tetrachoric series (Pearson 1900).
        """
        from scipy.special import ndtr

        slopes = np.linalg.norm(gradients, axis=2)
        skew = (gradients[:, 0] * gradients[:, 1]).sum(axis=1) / slopes.prod(axis=1)
        skew = np.clip(skew, -_LARGEST_CORRELATION, _LARGEST_CORRELATION)
        widths = slopes * blur
        # Places along the last axis: sums over the few lines between cells are then sums of long rows.
        across, down = (((places[:, k] - self.lines[:, None]) / widths[:, k]).astype(np.float32) for k in (0, 1))
        jumps = np.diff(np.diff(np.pad(self.ink, 1, constant_values=1.0), axis=0), axis=1).astype(np.float32)
        p, q = (np.exp(-(z**2) / 2) / np.float32(_ROOT_TWO_PI) for z in (across, down))
        yq, yyq, below = down * q, down**2 * q, ndtr(down)
        summed, level, tilted = jumps @ ndtr(across), jumps @ p, jumps @ (across * p)
        curved = jumps @ (across**2 * p)
        half = skew**2 / 2
        value = 1 + _sum(below, summed) + skew * _sum(q, level) + half * _sum(yq, tilted)
        by_u = _sum(below, level) - skew * _sum(q, tilted) + half * _sum(yq, level - curved)
        by_v = _sum(q, summed) - skew * _sum(yq, level) + half * _sum(q - yyq, tilted)
        by_blur = skew * (_sum(q, curved) + _sum(yyq, level)) - _sum(below, tilted) - _sum(yq, summed)
        return value, np.stack([by_u, by_v], axis=1) / widths, by_blur


def _sum(one: Array, other: Array) -> Array:
    """Return the inner products (K,) of columns (n, K)."""
    return np.asarray(np.einsum("nk,nk->k", one, other))


APRILTAGS = ("tag16h5", "tag25h9", "tag36h10", "tag36h11")
ARUCO = (
    *(f"DICT_{cells}X{cells}_{count}" for cells in (4, 5, 6, 7) for count in (50, 100, 250, 1000)),
    "DICT_ARUCO_ORIGINAL",
    "DICT_ARUCO_MIP_36h12",
)
FAMILIES = (*APRILTAGS, *ARUCO, *(f"DICT_APRILTAG_{name.removeprefix('tag')}" for name in APRILTAGS))

_SHORT = re.compile(r"(16h5|25h9|36h10|36h11)", re.IGNORECASE)
# Of the bits a code could correct: OpenCV takes 0.6 for all, with which 3 % of all squares pass for a tag16h5
_CORRECTED = {"16h5": 0.0}
_USUALLY_CORRECTED = 0.6


@dataclass(frozen=True, eq=False)
class Family:
    """A family of markers.

    name: one of FAMILIES. dictionary: OpenCV's name. turned: whether the marker is printed upside down to OpenCV's
    drawing. count: ids run from 0 to count - 1.
    """

    name: str
    dictionary: str
    turned: bool
    count: int

    def require(self, first: int, count: int) -> None:
        """Raise InvalidInput unless the family has `count` markers from the id `first` on."""
        if first + count > self.count:
            raise InvalidInput(
                f"the board needs markers {first} to {first + count - 1}, {self.name} ends at {self.count - 1}"
            )

    @property
    def bits(self) -> int:
        """The number of cells across a marker within its black border."""
        return int(marker_dictionary(self.dictionary).markerSize)

    @property
    def corrected(self) -> float:
        """The share of the bits a code could correct that is corrected."""
        return _CORRECTED.get(self.dictionary.removeprefix("DICT_APRILTAG_"), _USUALLY_CORRECTED)

    def drawing(self, marker: int) -> MarkerDrawing:
        """Return what OpenCV draws of a marker."""
        return MarkerDrawing(self._cells(range(marker, marker + 1), 1)[0])

    def printed(self, markers: range, border: int = 1) -> Array:
        """Return the cells (M, n, n) of markers as they are printed, 1 is white; border: of black, around the bits."""
        cells = self._cells(markers, border)
        return np.rot90(cells, 2, axes=(1, 2)) if self.turned else cells

    def _cells(self, markers: range, border: int) -> Array:
        dictionary, side = marker_dictionary(self.dictionary), self.bits + 2 * border
        drawings = [dictionary.generateImageMarker(marker, side, borderBits=border) for marker in markers]
        return np.array(drawings) / 255.0

    def as_printed(self, corners: Array) -> Array:
        """Return corners (..., 4, k) from the top-left of OpenCV's drawing on, from the top-left as printed on."""
        return np.roll(corners, 2, axis=-2) if self.turned else corners


def family_named(name: str) -> Family:
    """Return a family by its name; 36h11 and the like stand for tag36h11. Raises InvalidInput with the nearest name."""
    by_name = {family.lower(): family for family in FAMILIES}
    full = by_name.get(f"tag{name}".lower() if _SHORT.fullmatch(name) else name.lower())
    if full is None:
        near = nearest(name.lower(), by_name, likeness=0.3)
        advice = f"did you mean {by_name[near]}?" if near else f"one of {', '.join(FAMILIES)}"
        raise InvalidInput(f"marker family {name!r} is unknown; {advice}")
    turned = full in APRILTAGS
    dictionary = f"DICT_APRILTAG_{full.removeprefix('tag')}" if turned else full
    return Family(full, dictionary, turned, len(marker_dictionary(dictionary).bytesList))


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
    drawn = _add_border(board, _checker(board), np.array([0.0]))
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
    return _add_border(board, ink, steps)


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


def _add_border(board: Board, ink: Array, steps: Array) -> Pattern:
    """Return the pattern of ink (rows, columns) whose lines repeat in every square at `steps`, shares of its side."""
    lines = []
    for count in (board.columns, board.rows):  # of corners: the second square begins at 0
        inner = (np.arange(count + 1)[:, None] - 1 + steps).ravel()
        lines.append(np.concatenate([[-1 - QUIET], inner, [count, count + QUIET]]) * board.spacing)
    x, y = lines
    return Pattern(x, y, np.pad(ink, 1, constant_values=WHITE))


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
    side, gap, lines = board.marker or 0.0, ink_reach(board), []
    for count in (board.columns, board.rows):
        inner = (np.arange(count)[:, None] * board.spacing + side * np.linspace(0, 1, cells + 1)).ravel()
        outer = np.array([gap, gap + QUIET * board.spacing])
        lines.append(np.concatenate([-outer[::-1], inner, inner[-1] + outer]))
    x, y = lines
    return Pattern(x, y, np.pad(ink, 1, constant_values=WHITE))


def _circles(board: Board) -> Pattern:
    if board.diameter is None:
        raise InvalidInput(f"the {board.words} needs a diameter to be drawn, such as {board.type}:10x8:25mm:15mm")
    reach = ink_reach(board) + QUIET * board.spacing
    x, y = (np.array([-reach, side + reach]) for side in board.extent)
    centres = board.points()[:, :2]
    discs = np.column_stack([centres, np.tile([board.diameter / 2, BLACK], (board.count, 1))])
    return Pattern(x, y, np.array([[WHITE]]), discs)
