"""Board types: names, meaning of the fields of a Board, layouts of points, short forms.

Layouts say where the points lie and which turns are similar; their lengths are in pitches. The short form of a board is
one word for the command line, such as chessboard:9x6:25mm.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from camcal.arrays import Array, readonly
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.parsing import nearest, parse_number

CHESSBOARD = "chessboard"
CHARUCO = "charuco"
APRILGRID = "aprilgrid"
CIRCLES = "circles"
ASYMMETRIC_CIRCLES = "asymmetric_circles"

METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}
TAG_FAMILY = "tag36h11"  # of an AprilGrid that does not say
TAG_BORDER = 2  # cells of black around the bits of an AprilGrid's tags; other markers have one


@dataclass(frozen=True)
class BoardType:
    """One type of board.

    counted: what columns and rows count. least: how few of them, each way, make a board. words: how it is called, with
    its size. own: the fields beside the size and the square that it may have. element: what its size is told by.
    needs, crowded: what to say if marker or dictionary are missing, or if what is printed has no room; nearest: the
    distance of neighbours that must leave it, in squares.
    border: how many more a person counts than columns and rows (a ChArUco board is known by its squares).
    """

    counted: str
    least: int
    words: str
    own: frozenset[str]
    element: str
    needs: str = ""
    crowded: str = ""
    nearest: float = 1.0
    border: int = 0


_TOUCHING = "circles overlap: give a smaller diameter"

BOARD_TYPES: Mapping[str, BoardType] = {
    CHESSBOARD: BoardType("inner corners", 2, "chessboard of {size} inner corners", frozenset({"dots"}), "square"),
    CHARUCO: BoardType(
        "inner corners",
        2,
        "ChArUco board of {size} squares",
        frozenset({"marker", "dictionary", "first_marker", "legacy"}),
        "square",
        needs="a ChArUco board needs a marker size and a dictionary",
        crowded="the marker of a ChArUco board must be smaller than its square",
        border=1,
    ),
    APRILGRID: BoardType(
        "tags",
        1,
        "AprilGrid of {size} tags",
        frozenset({"marker", "dictionary", "first_marker"}),
        "tag",
        needs="an AprilGrid needs the side of a tag and a family",
        crowded="tags overlap: give a positive spacing",
    ),
    CIRCLES: BoardType("circles", 2, "grid of {size} circles", frozenset({"diameter"}), "step", crowded=_TOUCHING),
    ASYMMETRIC_CIRCLES: BoardType(
        "circles",
        2,
        "asymmetric grid of {size} circles",
        frozenset({"diameter"}),
        "step",
        crowded=_TOUCHING,
        nearest=math.sqrt(2),
    ),
}


# Kalibr's order of a tag's corners: lower left, lower right, upper right, upper left; x right, y up
_CORNERS = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])


def grid_points(columns: int, rows: int) -> Array:
    """Return the points (rows · columns, 2) of a plain grid, row by row."""
    row, column = np.divmod(np.arange(columns * rows), columns)
    return np.column_stack([column, row]).astype(float)


def staggered(columns: int, rows: int) -> Array:
    """Return the points (rows · columns, 2) of OpenCV's asymmetric grid: two apart in a row, odd rows one further."""
    row, column = np.divmod(np.arange(columns * rows), columns)
    return np.column_stack([2 * column + row % 2, row]).astype(float)


def tag_corners(columns: int, rows: int, side: float) -> Array:
    """Return the corners (4 · rows · columns, 2) of tags, one apart, in Kalibr's order: y points up."""
    return np.asarray((grid_points(columns, rows)[:, None] + side * _CORNERS).reshape(-1, 2))


def grid_turns(columns: int, rows: int, *, half: bool) -> tuple[Array, ...]:
    """Return the permutations of a grid's ids under the turns that map it to itself, the identity first.

    half: whether it looks the same after half a turn; one of as many columns as rows then does after a quarter too.
    """
    ids = np.arange(columns * rows).reshape(rows, columns)
    if not half:
        return _permutations([ids])
    if columns == rows:
        return _permutations([np.rot90(ids, turns) for turns in range(4)])
    return half_turns(columns * rows)


def half_turns(count: int) -> tuple[Array, ...]:
    """Return the identity and half a turn of points that are numbered row by row."""
    return _permutations([np.arange(count), np.arange(count)[::-1]])


def unchanged(count: int) -> tuple[Array, ...]:
    """Return the identity alone."""
    return _permutations([np.arange(count)])


def _permutations(turns: Sequence[Array]) -> tuple[Array, ...]:
    return tuple(readonly(turn.ravel(), (turn.size,), "permutation", np.intp) for turn in turns)


def dotted_squares(columns: int, rows: int) -> tuple[tuple[int, int], ...]:
    """Return row and column of the three squares of a chessboard that carry a dot, counted with its outer squares.

    The first is a white one near the middle, the origin that OpenCV searches for (findChessboardCornersSBWithMeta); the
    others are the black ones to its right and below. None lies at the rim. A board without room for them has none.
    """
    rim = [(row, column) for row in range(1, rows - 1) for column in range(1, columns - 1) if (row + column) % 2]
    if not rim:
        return ()
    row, column = min(rim, key=lambda place: (2 * place[0] - rows + 1) ** 2 + (2 * place[1] - columns + 1) ** 2)
    return (row, column), (row, column + 1), (row + 1, column)


FORMS: Mapping[str, str] = {
    CHESSBOARD: "chessboard:9x6[:25mm][:dots] (inner corners, square)",
    CHARUCO: "charuco:9x7:30mm:22mm:DICT_5X5_100[:legacy] (squares, square, marker)",
    APRILGRID: "aprilgrid:6x6:88mm:0.3[:tag36h11] (tags, tag, spacing as a share of the tag)",
    CIRCLES: "circles:10x8[:25mm[:15mm]] (circles, distance of centres, diameter)",
    ASYMMETRIC_CIRCLES: "asymmetric_circles:4x11[:20mm[:15mm]] (circles in a row and rows, distance of rows, diameter)",
}
Fields = dict[str, Any]

_SIZE = re.compile(r"([0-9]{1,9})x([0-9]{1,9})$")
_NAME = re.compile(r"(?!nan|inf)[A-Za-z]", re.IGNORECASE)
_LIKENESS = 0.7  # of a misspelt type
_DIGITS = 17  # that tell any number of 64 bits from the next
_LENGTH = re.compile(r"([0-9]+(?:\.[0-9]*)?|\.[0-9]+)\s*(mm|cm|m|in)$")


def fields_of(text: str) -> Fields:
    """Return the fields of the Board a short form stands for. Raises InvalidInput that names the part at fault."""
    kind, *parts = text.split(":")
    if kind not in FORMS:
        near = nearest(kind, FORMS, _LIKENESS)
        if meant := ":".join((near, *parts)) if near else _meant(text):
            raise InvalidInput(f"board {text!r}: did you mean {meant!r}?")
        raise InvalidInput(f"board {text!r}: expected {'; '.join(FORMS.values())}; or a YAML file")
    if not parts:
        raise _unlike(text, "expected", kind)
    match = _SIZE.match(parts[0])
    if not match:
        meant = _meant(text)
        hint = f"did you mean {meant!r}?" if meant else f"{parts[0]!r} is not a size; write 9x6"
        raise InvalidInput(f"board {text!r}: {hint}")
    size = {"type": kind, "columns": int(match[1]), "rows": int(match[2])}
    return size | _READERS[kind](text, parts[1:])


def _meant(text: str) -> str:
    """Return the short form of a board whose parts are put together in another way, a chessboard if no type is among
    them; "" if there is none.
    """
    words = [word for word in re.split(r"[\s,;:/]+", text) if word]
    types = [near for word in words if (near := nearest(word, FORMS, _LIKENESS))] or [CHESSBOARD]
    sizes = [word for word in words if _SIZE.match(word)]
    others = [word for word in words if word not in sizes and not nearest(word, FORMS, _LIKENESS)]
    form = ":".join([types[0], *sizes, *(others or ["25mm"] if types[0] == CHESSBOARD else others)])
    if not sizes or form == text:
        return ""
    try:
        fields_of(form)
    except InvalidInput:
        return ""
    return form


def _chessboard(text: str, parts: list[str]) -> Fields:
    dots = parts[-1:] == ["dots"]
    parts = parts[:-1] if dots else parts
    if len(parts) > 1:
        raise _unlike(text, "too many parts; a chessboard is", CHESSBOARD)
    return {"square": _length(text, parts[0]) if parts else None, "dots": dots}


def _charuco(text: str, parts: list[str]) -> Fields:
    legacy: bool | None = None
    if parts and parts[-1] in ("legacy", "current"):
        legacy, parts = parts[-1] == "legacy", parts[:-1]
    if len(parts) not in (2, 3) or (len(parts) == 2 and _LENGTH.match(parts[0])):
        raise _unlike(text, "a ChArUco board is", CHARUCO)
    square = _length(text, parts[0]) if len(parts) == 3 else None
    marker = (
        _length(text, parts[1])
        if len(parts) == 3
        else _share(text, parts[0], "the marker's share of the square, such as 0.75")
    )
    return {"square": square, "marker": marker, "dictionary": parts[-1], "legacy": legacy}


def _aprilgrid(text: str, parts: list[str]) -> Fields:
    family = TAG_FAMILY
    if parts[1:] and _NAME.match(parts[-1]):
        family, parts = parts[-1], parts[:-1]
    if len(parts) not in (1, 2):
        raise _unlike(text, "an AprilGrid is", APRILGRID)
    spacing = _share(text, parts[-1], "the spacing as a share of the tag, such as 0.3")
    return aprilgrid_fields(_length(text, parts[0]) if len(parts) == 2 else None, spacing) | {"dictionary": family}


def aprilgrid_fields(tag: float | None, spacing: float) -> Fields:
    """Return square and marker of an AprilGrid from the side of a tag and the gap between two as a share of it.

    The gap is measured between the black borders of neighbouring tags, as Kalibr's tagSpacing is.
    """
    if tag is None:
        return {"square": None, "marker": 1 / (1 + spacing)}
    return {"square": tag * (1 + spacing), "marker": tag}


def spacing_of(square: float | None, marker: float) -> float:
    """Return the spacing of `aprilgrid_fields`, as the shortest number that gives the square again if there is one."""
    tag = None if square is None else marker
    wanted = {"square": square, "marker": marker}
    ratio = (1.0 if square is None else square) / marker - 1
    rounded = (float(f"{ratio:.{digits}g}") for digits in range(1, _DIGITS))
    return next((short for short in rounded if aprilgrid_fields(tag, short) == wanted), ratio)


def _circles(text: str, parts: list[str]) -> Fields:
    if len(parts) > 2:
        raise _unlike(text, "too many parts; a grid of circles is", text.partition(":")[0])
    if len(parts) == 1 and not _LENGTH.match(parts[0]):
        what = "a length with its unit or the diameter's share of the distance, such as 0.6"
        return {"diameter": _share(text, parts[0], what)}
    lengths = [_length(text, part) for part in parts]
    return dict(zip(("square", "diameter"), lengths, strict=False))


_READERS: Mapping[str, Callable[[str, list[str]], Fields]] = {
    CHESSBOARD: _chessboard,
    CHARUCO: _charuco,
    APRILGRID: _aprilgrid,
    CIRCLES: _circles,
    ASYMMETRIC_CIRCLES: _circles,
}


def _unlike(text: str, what: str, kind: str) -> InvalidInput:
    return InvalidInput(f"board {text!r}: {what} {FORMS[kind]}")


def _length(text: str, part: str) -> float:
    match = _LENGTH.match(part)
    if not match:
        raise InvalidInput(f"board {text!r}: {without_unit(part)}")
    return float(match[1]) * METRES[match[2]]


def without_unit(text: str) -> str:
    """Return why a text is no length with its unit, and what to write."""
    try:
        length = parse_number(text)
    except ValueError:
        return f"{text!r} is not a length with its unit; write 25mm, 2.5cm, 0.025m or 1in"
    if abs(length) < 1:
        return f"{text!r} has no unit; write {text}m or {1000 * length:.12g}mm if it is in metres"
    return f"{text!r} has no unit; write {text}mm if it is in millimetres"


def _share(text: str, part: str, what: str) -> float:
    try:
        share = float(part)
    except ValueError:
        share = math.nan
    if not 0 < share < math.inf:
        raise InvalidInput(f"board {text!r}: {part!r} is not {what}")
    return share
