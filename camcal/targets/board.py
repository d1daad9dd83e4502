"""Boards: the record of one as drawn, its short form, and the shape it has when it is printed.

The points of a chessboard and of a ChArUco board are the inner corners of the checker pattern, those of a circle grid
the centres: id = row · columns + column, x along a row, y down the rows, z into the board, the origin at id 0.
An AprilGrid has Kalibr's numbering and frame: the corners of its tags, id = 4 · tag + corner, tag 0 at the lower left,
tags along a row to the right, rows upwards, corners from the lower left counter-clockwise, y up, z out of the board.

The shape of a printed board has a deformation basis in tiers. In it x and y are normalised to [-1, 1] over the bounding
box of the points. The out-of-plane terms are Legendre products without 1, x and y, which a pose can take; the in-plane
terms are the ones a camera's scale and skew could be mistaken for.
"""

from collections.abc import Mapping
from dataclasses import fields
from functools import cached_property, lru_cache

import numpy as np

from camcal.arrays import Array, FloatArray, IntArray, readonly
from camcal.dataclass import dataclass, field, replace
from camcal.errors import InvalidInput
from camcal.records import Brief
from camcal.targets.board_types import (
    APRILGRID,
    ASYMMETRIC_CIRCLES,
    BOARD_TYPES,
    CHARUCO,
    CHESSBOARD,
    CIRCLES,
    dotted_squares,
    fields_of,
    grid_points,
    grid_turns,
    half_turns,
    staggered,
    tag_corners,
    unchanged,
)

__all__ = [
    "APRILGRID",
    "ASYMMETRIC_CIRCLES",
    "CHARUCO",
    "CHESSBOARD",
    "CIRCLES",
    "Board",
    "parse_board",
]

LARGEST = 1000  # a side
LENGTHS = 1e-6, 100.0  # m, of squares, markers and discs


@dataclass(frozen=True)
class Board(Brief):
    """A planar target, as drawn.

    type: one of BOARD_TYPES. columns, rows: the grid of inner corners (a ChArUco board of 9 × 7 squares has 8 × 6), of
    tags or of circles; asymmetric circles count those of one row, as OpenCV does.
    square: in metres, None when unknown (lengths are then in squares): the side of a square, the distance of
    neighbouring tags or circles from centre to centre; of asymmetric circles the distance of rows.
    marker: side of a ChArUco marker or of a tag's black border in the same unit (as a share of the square when that is
    unknown). dictionary, first_marker: their family and the id of the first one.
    legacy: True for the ChArUco pattern of OpenCV before 4.6, None when it is to be found out.
    diameter: of a circle in the same unit as the square (a share of it when that is unknown), None when unknown.
    dots: whether a chessboard has the three dots in its middle that tell its corners apart.
    """

    type: str
    columns: int
    rows: int
    square: float | None = None
    marker: float | None = None
    dictionary: str | None = None
    first_marker: int = 0
    legacy: bool | None = None
    diameter: float | None = None
    dots: bool = False

    def __post_init__(self) -> None:
        if self.type not in BOARD_TYPES:
            raise InvalidInput(f"board type {self.type!r} is unknown; use {', '.join(BOARD_TYPES)}")
        _require_counts(self)
        allowed = BOARD_TYPES[self.type].own | {"type", "columns", "rows", "square"}
        for item in fields(self):
            if item.name not in allowed and getattr(self, item.name) != item.default:
                raise InvalidInput(f"a board of type {self.type} has no {item.name}")
        _require_lengths(self)

    @property
    def has_grid(self) -> bool:
        """Whether the ids number a grid of columns × rows points, row by row."""
        return self.type in (CHESSBOARD, CHARUCO, CIRCLES)

    @property
    def checker(self) -> bool:
        """Whether the points are inner corners of a checker pattern."""
        return self.type in (CHESSBOARD, CHARUCO)

    @property
    def has_saddle_corners(self) -> bool:
        """Whether two edges cross at every point."""
        return self.checker or self.type == APRILGRID

    @property
    def has_ids(self) -> bool:
        """Whether every point of a part of the board can be distinguished from the others."""
        return self.type in (CHARUCO, APRILGRID) or self.dots

    @property
    def z_sign(self) -> int:
        """1 if z points into the board, away from its printed side; -1 if out of it (AprilGrid)."""
        return -1 if self.type == APRILGRID else 1

    @property
    def count(self) -> int:
        """The number of points."""
        return self.columns * self.rows * (4 if self.type == APRILGRID else 1)

    @property
    def unit(self) -> str:
        """The unit of every length that follows from this board: 'm', or 'squares' when the size is unknown."""
        return "squares" if self.square is None else "m"

    @property
    def spacing(self) -> float:
        """The distance of neighbouring corners, tags or circles (rows of asymmetric ones) in `unit`."""
        return 1.0 if self.square is None else self.square

    @cached_property
    def extent(self) -> tuple[float, float]:
        """Width and height of the points' bounding box, which begins at the origin, in `unit`."""
        width, height = self._flat().max(axis=0).tolist()
        return width, height

    @property
    def words(self) -> str:
        """What the board is, such as 'chessboard of 9x6 inner corners'."""
        kind = BOARD_TYPES[self.type]
        size = f"{self.columns + kind.border}x{self.rows + kind.border}"
        return kind.words.format(size=size) + (" and three dots" if self.dots else "")

    @property
    def members(self) -> Mapping[str, "Board"]:
        """The boards that are numbered one after another, by their names: itself alone, without a name."""
        return {"": self}

    def points(self) -> FloatArray:
        """Return the points (count, 3) in `unit`, in the order of their ids, as drawn (z = 0)."""
        return np.column_stack([self._flat(), np.zeros(self.count)])

    def _flat(self) -> Array:
        if self.type == APRILGRID:
            return tag_corners(self.columns, self.rows, (self.marker or 0.0) / self.spacing) * self.spacing
        layout = staggered if self.type == ASYMMETRIC_CIRCLES else grid_points
        return layout(self.columns, self.rows) * self.spacing

    def transposed(self) -> "Board":
        """Return the same board with columns and rows exchanged."""
        return replace(self, columns=self.rows, rows=self.columns)

    def of_size(self, columns: int, rows: int) -> "Board":
        """Return the same board with another number of points each way, wide or high as this one is.

        One without room for dots has none.
        """
        wide = self.type == ASYMMETRIC_CIRCLES or (columns >= rows) == (self.columns >= self.rows)
        columns, rows = (columns, rows) if wide else (rows, columns)
        dots = self.dots and bool(dotted_squares(columns, rows))
        return replace(self, columns=columns, rows=rows, dots=dots)

    def symmetries(self) -> tuple[IntArray, ...]:
        """Return the permutations of ids, the identity first, that a detector cannot distinguish.

        permutation[id] is the id that a turned board shows where `id` is expected. A chessboard with columns + rows
        even looks the same turned by 180°, a square one by 90°, so does any plain grid of circles; an asymmetric one
        of an even number of rows turned by 180°. Markers, tags and dots leave no doubt.
        """
        if self.has_ids:
            return unchanged(self.count)
        if self.type == ASYMMETRIC_CIRCLES:
            return unchanged(self.count) if self.rows % 2 else half_turns(self.count)
        half = self.type == CIRCLES or (self.columns + self.rows) % 2 == 0
        return grid_turns(self.columns, self.rows, half=half)


def _require_counts(board: Board) -> None:
    kind, size = BOARD_TYPES[board.type], f"{board.columns} × {board.rows}"
    if min(board.columns, board.rows) < kind.least:
        raise InvalidInput(f"a board needs at least {kind.least} × {kind.least} {kind.counted}, found {size}")
    if max(board.columns, board.rows) > LARGEST:
        raise InvalidInput(f"{size} {kind.counted} is more than the limit of {LARGEST} a side")
    if board.dots and not dotted_squares(board.columns, board.rows):
        raise InvalidInput(f"a chessboard of {size} inner corners is too small for three dots (minimum 4 × 3)")


def _require_lengths(board: Board) -> None:
    lengths = [length for length in (board.square, board.marker, board.diameter) if length is not None]
    if not all(np.isfinite(length) and length > 0 for length in lengths):
        raise InvalidInput("lengths of a board must be positive")
    if any(not LENGTHS[0] <= length <= LENGTHS[1] for length in lengths):
        raise InvalidInput(f"lengths of a board are from {1e6 * LENGTHS[0]:g} µm to {LENGTHS[1]:g} m")
    kind = BOARD_TYPES[board.type]
    if kind.needs and (board.marker is None or board.dictionary is None):
        raise InvalidInput(kind.needs)
    if max(board.marker or 0.0, board.diameter or 0.0) >= kind.nearest * board.spacing:
        raise InvalidInput(kind.crowded)


def parse_board(text: str) -> Board:
    """Return the board of a short form such as chessboard:9x6:25mm or charuco:9x7:30mm:22mm:DICT_5X5_100[:legacy].

    Chessboard sizes count inner corners, ChArUco sizes squares, the others tags or circles; see short_forms.FORMS.
    A length in metres may be left out; what is printed is then given as a share: charuco:9x7:0.75:DICT_5X5_100.
    Raises InvalidInput that names the part at fault.
    """
    stated = fields_of(text)
    border = BOARD_TYPES[stated["type"]].border
    return Board(**{**stated, "columns": stated["columns"] - border, "rows": stated["rows"] - border})


@dataclass(frozen=True)
class ShapeClass:
    """Terms of a board's shape that have one scale, and what printers and boards do: the prior of that scale.

    median, spread: of a log-normal distribution; scales are standard deviations of a coefficient, for lengths as a
    share of the board's longer side. Half of all boards are taken to have nothing of a class.
    """

    terms: tuple[str, ...]
    median: float
    spread: float


# Scales of the boards of 20 real data sets and two printers; a stretch or shear of 0.1 % moves an edge by 0.05 %.
CLASSES: dict[str, ShapeClass] = {
    "twist": ShapeClass(("xy",), 5e-4, 1.5),
    "bow": ShapeClass(("P2(x)", "P2(y)"), 1e-3, 1.5),
    "cubic": ShapeClass(("P3(x)", "P2(x)y", "xP2(y)", "P3(y)"), 2e-4, 1.5),
    "quartic": ShapeClass(("P4(x)", "P3(x)y", "P2(x)P2(y)", "xP3(y)", "P4(y)"), 1.5e-4, 1.5),
    "stretch": ShapeClass(("x/y scale",), 1e-3, 1.0),
    "shear": ShapeClass(("shear",), 6e-4, 1.0),
    "keystone": ShapeClass(("keystone x", "keystone y"), 1e-4, 0.7),
}
TIERS: dict[str, tuple[str, ...]] = {
    "bow": (*CLASSES["twist"].terms, *CLASSES["bow"].terms),
    **{name: CLASSES[name].terms for name in ("cubic", "quartic")},
    "stretch": (*CLASSES["stretch"].terms, *CLASSES["shear"].terms),
}
OFFSETS = "offsets"
IN_PLANE, OUT_OF_PLANE = "corners in plane", "corners out of plane"
CORNER_CLASSES: dict[str, ShapeClass] = {
    IN_PLANE: ShapeClass((), 1e-4, 0.7),
    OUT_OF_PLANE: ShapeClass((), 1e-4, 1.0),
}
TERMS = tuple(term for found in CLASSES.values() for term in found.terms)
RATIOS = ("x/y scale", "shear")  # terms without a length

_DEGREES: dict[str, tuple[int, int]] = {
    "xy": (1, 1), "P2(x)": (2, 0), "P2(y)": (0, 2),
    "P3(x)": (3, 0), "P2(x)y": (2, 1), "xP2(y)": (1, 2), "P3(y)": (0, 3),
    "P4(x)": (4, 0), "P3(x)y": (3, 1), "P2(x)P2(y)": (2, 2), "xP3(y)": (1, 3), "P4(y)": (0, 4),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Surface(Brief):
    """The estimated shape of a board: coefficients (S,) of named terms and offsets (C, 3) of single points.

    Coefficients and offsets are in the board's unit, those of RATIOS have none.
    covariance: (S, S) of the coefficients. deflection, deflection_std: peak to peak, out of plane.
    tiers: the names of the tiers in use, in the order in which they were found significant.
    classes: scale and its standard deviation by the names of CLASSES and CORNER_CLASSES: shares of the board's longer
    side, ratios for stretch and shear.
    """

    board: Board
    tiers: tuple[str, ...] = ()
    terms: tuple[str, ...] = ()
    coefficients: FloatArray = field(default_factory=lambda: np.zeros(0))
    covariance: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    offsets: FloatArray | None = None
    deflection: float = 0.0
    deflection_std: float = 0.0
    classes: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        count = len(self.terms)
        object.__setattr__(self, "coefficients", readonly(self.coefficients, (count,), "coefficients"))
        object.__setattr__(self, "covariance", readonly(self.covariance, (count, count), "covariance"))
        if self.offsets is not None:
            object.__setattr__(self, "offsets", readonly(self.offsets, (self.board.count, 3), "offsets"))

    @classmethod
    def flat(cls, board: Board) -> "Surface":
        """Return the board as drawn."""
        return cls(board)

    def coefficients_std(self) -> FloatArray:
        """Return the standard deviations (S,) of the coefficients."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def points(self) -> FloatArray:
        """Return the points (C, 3) of the board as it is, in its unit."""
        points = self.board.points() + basis(self.board, self.terms) @ self.coefficients
        return np.asarray(points if self.offsets is None else points + self.offsets)


SCALE = "scale"  # of a board whose size is measured; its unit of length otherwise
_MEMBER = ":"  # stands between the name of a board and that of a term, where there are several boards


def terms_of(board: Board, terms: tuple[str, ...] = TERMS) -> tuple[str, ...]:
    """Return the names of terms of each of a board's members, class by class."""
    classes = [[term for term in own.terms if term in terms] for own in CLASSES.values()]
    classes.append([term for term in terms if term == SCALE])
    return tuple(
        f"{name}{_MEMBER}{term}" if name else term for own in classes for name in board.members for term in own
    )


def bare_term(term: str) -> str:
    """Return the name of a term without that of its board."""
    return term.rpartition(_MEMBER)[2]


@lru_cache(maxsize=64)
def basis(board: Board, terms: tuple[str, ...]) -> Array:
    """Return the displacement (C, 3, S) of every point per unit of every term, read-only.

    A term that names none of several boards is one of each of them.
    """
    members = board.members
    if "" not in members:
        result, start = np.zeros((board.count, 3, len(terms))), 0
        for name, member in members.items():
            own = [index for index, term in enumerate(terms) if term.rpartition(_MEMBER)[0] in ("", name)]
            rows = slice(start, start + member.count)
            result[rows, :, own] = basis(member, tuple(bare_term(terms[index]) for index in own))
            start += member.count
        result.setflags(write=False)
        return result
    centred = board.points()[:, :2] - np.array(board.extent) / 2
    x, y = normalised(board).T
    result = np.zeros((board.count, 3, len(terms)))
    for index, term in enumerate(terms):
        if term == "keystone x":
            result[:, 0, index], result[:, 1, index] = x * x, x * y
        elif term == "keystone y":
            result[:, 0, index], result[:, 1, index] = x * y, y * y
        elif term == "x/y scale":  # mean scale kept: it is the unit of length
            result[:, 0, index], result[:, 1, index] = centred[:, 0] / 2, -centred[:, 1] / 2
        elif term == "shear":
            result[:, 0, index], result[:, 1, index] = centred[:, 1] / 2, centred[:, 0] / 2
        elif term == SCALE:
            result[:, :2, index] = centred
        else:
            degree_x, degree_y = _DEGREES[term]
            result[:, 2, index] = _legendre(degree_x, x) * _legendre(degree_y, y)
    result.setflags(write=False)
    return result


def normalised(board: Board) -> Array:
    """Return the places (C, 2) of the points on their boards, each coordinate over [-1, 1]."""
    halves = [(member.points()[:, :2], np.array(member.extent) / 2) for member in board.members.values()]
    return np.concatenate([(points - half) / half for points, half in halves])


def _legendre(degree: int, values: Array) -> Array:
    coefficients = np.zeros(degree + 1)
    coefficients[degree] = 1
    return np.asarray(np.polynomial.legendre.legval(values, coefficients))


def scale_unit(board: Board, term: str) -> float:
    """Return what the scale of a term's class is a share of: the board's longer side, 1 for ratios."""
    return 1.0 if bare_term(term) in RATIOS else max(board.extent)
