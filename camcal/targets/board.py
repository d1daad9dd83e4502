"""Boards: the record of one, and its short form.

The points of a chessboard and of a ChArUco board are the inner corners of the checker pattern, those of a circle grid
the centres: id = row · columns + column, x along a row, y down the rows, z into the board, the origin at id 0.
An AprilGrid has Kalibr's numbering and frame: the corners of its tags, id = 4 · tag + corner, tag 0 at the lower left,
tags along a row to the right, rows upwards, corners from the lower left counter-clockwise, y up, z out of the board.
"""

from dataclasses import dataclass, fields, replace

import numpy as np

from camcal.arrays import Array, FloatArray, IntArray
from camcal.brief import Brief
from camcal.errors import InvalidInput
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
        _require_own_fields(self)
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

    @property
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


def _require_own_fields(board: Board) -> None:
    allowed = BOARD_TYPES[board.type].own | {"type", "columns", "rows", "square"}
    for item in fields(board):
        if item.name not in allowed and getattr(board, item.name) != item.default:
            raise InvalidInput(f"a board of type {board.type} has no {item.name}")


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
