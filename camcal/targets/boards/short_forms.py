"""The short form of a board: one word for the command line, such as chessboard:9x6:25mm."""

import math
import re
from collections.abc import Callable, Mapping
from typing import Any

from camcal.errors import InvalidInput
from camcal.parsing import nearest
from camcal.targets.boards.types import (
    APRILGRID,
    ASYMMETRIC_CIRCLES,
    CHARUCO,
    CHESSBOARD,
    CIRCLES,
    METRES,
    TAG_FAMILY,
)

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
        if near := nearest(kind, FORMS, _LIKENESS):
            raise _unlike(text, "did you mean", near)
        raise InvalidInput(f"board {text!r}: expected {'; '.join(FORMS.values())}; or a YAML file")
    if not parts:
        raise _unlike(text, "expected", kind)
    match = _SIZE.match(parts[0])
    if not match:
        raise InvalidInput(f"board {text!r}: {parts[0]!r} is not a size; write 9x6")
    size = {"type": kind, "columns": int(match[1]), "rows": int(match[2])}
    return size | _READERS[kind](text, parts[1:])


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
    known = {"square": square, "marker": marker}
    ratio = (1.0 if square is None else square) / marker - 1
    rounded = (float(f"{ratio:.{digits}g}") for digits in range(1, _DIGITS))
    return next((short for short in rounded if aprilgrid_fields(tag, short) == known), ratio)


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
        raise InvalidInput(f"board {text!r}: {part!r} is not a length with its unit; write 25mm, 2.5cm, 0.025m or 1in")
    return float(match[1]) * METRES[match[2]]


def _share(text: str, part: str, what: str) -> float:
    try:
        share = float(part)
    except ValueError:
        share = math.nan
    if not 0 < share < math.inf:
        raise InvalidInput(f"board {text!r}: {part!r} is not {what}")
    return share
