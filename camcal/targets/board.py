"""Boards and what is seen of them: the Board record, the Detection record, the short form of a board.

The points of a board are the inner corners of its checker pattern, on a grid of `columns` × `rows`;
id = row · columns + column, x along a row, y down the rows, z into the board, the origin at id 0.
"""

import re
from dataclasses import dataclass, replace

import numpy as np

from camcal.arrays import Array, readonly
from camcal.errors import InvalidInput

CHESSBOARD = "chessboard"
CHARUCO = "charuco"
METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}

_SIZE = re.compile(r"(\d+)x(\d+)$")
_LENGTH = re.compile(r"(\d+(?:\.\d*)?|\.\d+)\s*(mm|cm|m|in)$")


@dataclass(frozen=True)
class Board:
    """A planar target, as drawn.

    columns, rows: the grid of inner corners (a ChArUco board of 9 × 7 squares has 8 × 6).
    square: side of a square in metres, None when unknown (lengths are then in squares).
    marker: side of a ChArUco marker in the same unit (as a fraction of the square when that is unknown).
    legacy: True for the ChArUco pattern of OpenCV before 4.6, None when it is to be found out.
    """

    type: str
    columns: int
    rows: int
    square: float | None = None
    marker: float | None = None
    dictionary: str | None = None
    first_marker: int = 0
    legacy: bool | None = None

    def __post_init__(self) -> None:
        if self.type not in (CHESSBOARD, CHARUCO):
            raise InvalidInput(f"board type {self.type!r} is unknown; use chessboard or charuco")
        if min(self.columns, self.rows) < 2:
            raise InvalidInput(f"a board needs at least 2 × 2 inner corners, found {self.columns} × {self.rows}")
        if max(self.columns, self.rows) > 1000:
            raise InvalidInput(f"{self.columns} × {self.rows} inner corners is more than the limit of 1000 a side")
        lengths = [length for length in (self.square, self.marker) if length is not None]
        if not all(np.isfinite(length) and length > 0 for length in lengths):
            raise InvalidInput("lengths of a board must be positive")
        if self.type == CHARUCO:
            if self.marker is None or self.dictionary is None:
                raise InvalidInput("a ChArUco board needs a marker size and a dictionary")
            if self.marker >= (self.square or 1.0):
                raise InvalidInput("the marker of a ChArUco board must be smaller than its square")

    @property
    def count(self) -> int:
        """The number of points."""
        return self.columns * self.rows

    @property
    def unit(self) -> str:
        """The unit of every length that follows from this board: 'm', or 'squares' when the size is unknown."""
        return "squares" if self.square is None else "m"

    @property
    def pitch(self) -> float:
        """The distance of neighbouring points in `unit`."""
        return 1.0 if self.square is None else self.square

    @property
    def extent(self) -> tuple[float, float]:
        """Width and height of the grid of points in `unit`."""
        return (self.columns - 1) * self.pitch, (self.rows - 1) * self.pitch

    def points(self) -> Array:
        """Return the points (columns · rows, 3) in `unit`, in the order of their ids, as drawn (z = 0)."""
        row, column = np.divmod(np.arange(self.count), self.columns)
        return np.column_stack([column, row, np.zeros(self.count)]) * self.pitch

    def transposed(self) -> "Board":
        """Return the same board with columns and rows exchanged."""
        return replace(self, columns=self.rows, rows=self.columns)

    def symmetries(self) -> tuple[Array, ...]:
        """Return the permutations of ids, the identity first, that a detector cannot tell from each other.

        permutation[id] is the id that a turned board shows where `id` is expected. A chessboard with columns + rows
        even looks the same turned by 180°, a square one by 90°; ChArUco markers leave no doubt.
        """
        grid = np.arange(self.count).reshape(self.rows, self.columns)
        if self.type == CHARUCO or (self.columns + self.rows) % 2:
            turns = [grid]
        elif self.columns == self.rows:
            turns = [np.rot90(grid, k) for k in range(4)]
        else:
            turns = [grid, np.rot90(grid, 2)]
        return tuple(readonly(turn.ravel(), (self.count,), "permutation", np.intp) for turn in turns)


@dataclass(frozen=True, eq=False)
class Detection:
    """What was found in one image: ids (N,), pixels (N, 2), covariance (N, 2, 2) px² or None.

    reason: why nothing was found, None where points were. orientation: the EXIF tag 1…8 (never applied).
    """

    image: str
    size: tuple[int, int]
    ids: Array
    pixels: Array
    covariance: Array | None = None
    camera: str = ""
    reason: str | None = None
    orientation: int = 1

    def __post_init__(self) -> None:
        object.__setattr__(self, "ids", readonly(self.ids, (None,), "ids", np.intp))
        object.__setattr__(self, "pixels", readonly(self.pixels, (len(self.ids), 2), "pixels"))
        if self.covariance is not None:
            object.__setattr__(self, "covariance", readonly(self.covariance, (len(self.ids), 2, 2), "covariance"))

    @classmethod
    def nothing(cls, image: str, size: tuple[int, int], reason: str) -> "Detection":
        """Return the record of an image without points."""
        return cls(image, size, np.zeros(0, np.intp), np.zeros((0, 2)), reason=reason)

    @property
    def found(self) -> bool:
        return len(self.ids) > 0


@dataclass(frozen=True)
class Detections:
    """What was found in a set of images, in their order, and the board that was looked for (None: unknown)."""

    board: Board | None
    views: tuple[Detection, ...]


def parse_board(text: str) -> Board:
    """Return the board of a short form such as chessboard:9x6:25mm or charuco:9x7:30mm:22mm:DICT_5X5_100[:legacy].

    Chessboard sizes count inner corners, ChArUco sizes count squares. The square may be left out of a chessboard;
    a ChArUco marker is then given as a fraction of the square: charuco:9x7:0.75:DICT_5X5_100.
    Raises InvalidInput that names the part at fault.
    """
    kind, _, rest = text.partition(":")
    parts = rest.split(":") if rest else []
    if kind not in (CHESSBOARD, CHARUCO) or not parts:
        raise InvalidInput(
            f"board {text!r}: expected chessboard:COLUMNSxROWS[:SQUARE] (inner corners), "
            "charuco:COLUMNSxROWS:SQUARE:MARKER:DICTIONARY[:legacy] (squares) or a YAML file"
        )
    match = _SIZE.match(parts[0])
    if not match:
        raise InvalidInput(f"board {text!r}: {parts[0]!r} is not a size; write 9x6")
    columns, rows = int(match[1]), int(match[2])
    if kind == CHESSBOARD:
        if len(parts) > 2:
            raise InvalidInput(f"board {text!r}: too many parts; a chessboard is chessboard:9x6[:25mm]")
        return Board(CHESSBOARD, columns, rows, _length(text, parts[1]) if len(parts) == 2 else None)
    return _parse_charuco(text, columns, rows, parts[1:])


def _parse_charuco(text: str, columns: int, rows: int, parts: list[str]) -> Board:
    legacy: bool | None = None
    if parts and parts[-1] in ("legacy", "current"):
        legacy, parts = parts[-1] == "legacy", parts[:-1]
    if len(parts) == 3:
        square: float | None = _length(text, parts[0])
        marker = _length(text, parts[1])
    elif len(parts) == 2:
        square, marker = None, _fraction(text, parts[0])
    else:
        raise InvalidInput(f"board {text!r}: a ChArUco board is charuco:9x7:30mm:22mm:DICT_5X5_100[:legacy]")
    return Board(CHARUCO, columns - 1, rows - 1, square, marker, parts[-1], legacy=legacy)


def _length(text: str, part: str) -> float:
    match = _LENGTH.match(part)
    if not match:
        raise InvalidInput(f"board {text!r}: {part!r} is not a length with its unit; write 25mm, 2.5cm, 0.025m or 1in")
    return float(match[1]) * METRES[match[2]]


def _fraction(text: str, part: str) -> float:
    try:
        return float(part)
    except ValueError:
        raise InvalidInput(f"board {text!r}: {part!r} is not the marker's share of the square, such as 0.75") from None
