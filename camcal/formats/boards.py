"""Board files: the YAML form of a Board, and its short form as text.

type: charuco
squares: [9, 7]              # a chessboard has inner_corners: [9, 6] instead
square_mm: 30.0              # or square_cm, square_m, square_in; left out when unknown
marker_mm: 22.0              # or marker_ratio: 0.73, the marker's share of the square
dictionary: DICT_5X5_100
first_marker_id: 0           # optional
legacy: false                # optional: the pattern of OpenCV before 4.6; left out, it is found out
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.errors import InvalidInput
from camcal.formats import emit, strict_yaml
from camcal.formats.schema import flag, integer, items, mapping, number, one_of, text
from camcal.formats.strict_yaml import Fault
from camcal.targets.board import CHARUCO, CHESSBOARD, METRES, Board, parse_board

SUFFIXES = (".yaml", ".yml")

LENGTHS = {f"square_{unit}": number(above=0) for unit in METRES}
MARKERS = {f"marker_{unit}": number(above=0) for unit in METRES}
_CHECKS = {
    CHESSBOARD: mapping(
        {"type": text, "inner_corners": items(integer(2), 2)},
        LENGTHS,
    ),
    CHARUCO: mapping(
        {"type": text, "squares": items(integer(3), 2), "dictionary": text},
        {**LENGTHS, **MARKERS, "marker_ratio": number(above=0), "first_marker_id": integer(0), "legacy": flag},
    ),
}


def read(path: Path) -> Board:
    """Return the board a YAML file describes.

    Raises InvalidInput with a line for every fault, FileError if the file cannot be read.
    """
    return from_block(strict_yaml.load(path, check).data)


def write(path: Path, board: Board) -> None:
    """Write a board as a YAML file."""
    files.write_text(path, emit.document(block(board), "camcal board file"))


def load_board(text: str) -> Board:
    """Return the board that `text` means: the path of a YAML file, or a short form such as chessboard:9x6:25mm."""
    path = Path(text)
    if path.suffix.lower() in SUFFIXES or path.is_file():
        return read(path)
    return parse_board(text)


def check(data: Any, path: str) -> Iterator[Fault]:
    """Check that plain data is a board."""
    kind = data.get("type") if isinstance(data, dict) else None
    if not isinstance(kind, str) or kind not in _CHECKS:
        yield from mapping({"type": one_of(tuple(_CHECKS), "board type")}, others=lambda _value, _path: ())(data, path)
        return
    faults = list(_CHECKS[kind](data, path))
    yield from faults or _check_lengths(data, path)


def _check_lengths(data: Mapping[str, Any], path: str) -> Iterator[Fault]:
    squares = [key for key in LENGTHS if key in data]
    markers = [key for key in (*MARKERS, "marker_ratio") if key in data]
    if len(squares) > 1 or len(markers) > 1:
        yield Fault(path, f"{' and '.join(squares if len(squares) > 1 else markers)}: give one of them")
    elif data["type"] == CHARUCO and not markers:
        yield Fault(
            path, "a ChArUco board needs its marker's size: marker_mm, or marker_ratio as a share of the square"
        )
    elif markers and not squares and markers != ["marker_ratio"]:
        yield Fault(path, f"{markers[0]} without a square's length: add square_mm, or give marker_ratio")
    else:
        try:
            from_block(data)
        except InvalidInput as error:
            yield Fault(path, error.message)


def from_block(data: Mapping[str, Any]) -> Board:
    """Return the board of plain data that has passed `check`."""
    square = _length(data, "square")
    if data["type"] == CHESSBOARD:
        columns, rows = data["inner_corners"]
        return Board(CHESSBOARD, columns, rows, square)
    columns, rows = data["squares"]
    marker = _length(data, "marker")
    if marker is None:
        marker = float(data["marker_ratio"]) * (square or 1.0)
    board = Board(CHARUCO, columns - 1, rows - 1, square, marker, data["dictionary"])
    return replace(board, first_marker=data.get("first_marker_id", 0), legacy=data.get("legacy"))


def _length(data: Mapping[str, Any], what: str) -> float | None:
    lengths = (float(data[f"{what}_{unit}"]) * metres for unit, metres in METRES.items() if f"{what}_{unit}" in data)
    return next(lengths, None)


def block(board: Board) -> dict[str, Any]:
    """Return a board as plain data with the keys of a board file."""
    data: dict[str, Any] = {"type": board.type}
    if board.type == CHESSBOARD:
        data["inner_corners"] = [board.columns, board.rows]
    else:
        data["squares"] = [board.columns + 1, board.rows + 1]
    if board.square is not None:
        length, unit = _in_unit(board.square)
        data[f"square_{unit}"] = length
    if board.type == CHARUCO:
        data.update(_charuco_keys(board))
    return data


def _charuco_keys(board: Board) -> dict[str, Any]:
    data: dict[str, Any] = {}
    if board.square is None:
        data["marker_ratio"] = board.marker
    elif board.marker is not None:
        length, unit = _in_unit(board.marker)
        data[f"marker_{unit}"] = length
    data["dictionary"] = board.dictionary
    if board.first_marker:
        data["first_marker_id"] = board.first_marker
    if board.legacy is not None:
        data["legacy"] = board.legacy
    return data


def short_form(board: Board) -> str:
    """Return the short form of a board, which `parse_board` reads back exactly.

    Raises InvalidInput if the first marker's id is not 0, which only a board file can say.
    """
    if board.first_marker:
        raise InvalidInput(f"a board whose first marker has id {board.first_marker} has no short form")
    border = 1 if board.type == CHARUCO else 0  # a ChArUco size counts squares
    parts = [board.type, f"{board.columns + border}x{board.rows + border}"]
    if board.square is not None:
        parts.append(_length_text(board.square))
    if board.marker is not None:
        parts.append(repr(float(board.marker)) if board.square is None else _length_text(board.marker))
    if board.dictionary is not None:
        parts.append(board.dictionary)
    if board.legacy is not None:
        parts.append("legacy" if board.legacy else "current")
    return ":".join(parts)


def _length_text(metres: float) -> str:
    length, unit = _in_unit(metres)
    return np.format_float_positional(length, trim="-") + unit


def _in_unit(metres: float) -> tuple[float, str]:
    """Return a length in the unit in which it is a short number and comes back exactly: mm, else m."""
    length = float(f"{metres / METRES['mm']:.9g}")
    return (length, "mm") if length * METRES["mm"] == metres else (metres, "m")
