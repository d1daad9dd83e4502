"""Boards as text: the YAML form of a Board, a target file of Kalibr's, and the short form `parse_board` reads back.

type: charuco
squares: [9, 7]              # chessboard: inner_corners: [9, 6]; aprilgrid: tags: [6, 6]; circles: [10, 8]
square_mm: 30.0              # or square_cm, square_m, square_in; left out when unknown; tag_mm, pitch_mm
marker_mm: 22.0              # or marker_ratio: 0.73, the marker's share of the square; spacing_ratio, diameter_mm
dictionary: DICT_5X5_100     # aprilgrid: family: tag36h11
first_marker_id: 0           # optional; aprilgrid: first_tag_id
legacy: false                # optional: the pattern of OpenCV before 4.6; left out, it is found out

Each type of board has a size (columns, rows), a length that gives the scale, such as square_mm, and may have a second
length, which can be given as a ratio of the first instead.

Several boards are in one file under their names, boards: {a: {type: …}, b: {type: …}}.

The target file of Kalibr is the board of its calibrations, as YAML:

target_type: aprilgrid       # or checkerboard, circlegrid
tagCols: 6
tagRows: 6
tagSize: 0.088               # side of a tag over its black border, metres
tagSpacing: 0.3              # the gap between two tags as a share of that
codeOffset: 0                # optional: the id of the first tag

Basalt's aprilgrid_6x6.json has the same keys without the type. Of OpenCV the settings of its calibration program are
read, XML or YAML, mm: Calibrate_Pattern, BoardSize_Width, BoardSize_Height, Square_Size, Marker_Size, ArUco_Dict_Name.

An AprilGrid keeps Kalibr's numbers and frame. The points of the others are numbered as all of camcal's grids are, row
by row; Kalibr's own frame of them has x along the columns of a checkerboard and of a plain circle grid.
"""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.dataclass import dataclass, field
from camcal.errors import InvalidInput
from camcal.formats import documents, emit
from camcal.formats.documents import Check, Fault
from camcal.formats.schema import flag, integer, items, mapping, number, one_of, text, unchecked
from camcal.targets.board import Board, parse_board
from camcal.targets.board_set import BoardSet, board_set
from camcal.targets.board_types import (
    APRILGRID,
    ASYMMETRIC_CIRCLES,
    BOARD_TYPES,
    CHARUCO,
    CHESSBOARD,
    CIRCLES,
    METRES,
    TAG_FAMILY,
    aprilgrid_fields,
    spacing_of,
)

KALIBR_KEY = "target_type"
_TAGS = {KALIBR_KEY, "tagCols"}  # Basalt leaves the type out
_PATTERNS = {
    "CHESSBOARD": CHESSBOARD,
    "CHARUCOBOARD": CHARUCO,
    "CIRCLES_GRID": CIRCLES,
    "ASYMMETRIC_CIRCLES_GRID": ASYMMETRIC_CIRCLES,
}

_LENGTH = number(positive=True)
_GRID = {KALIBR_KEY: text, "targetCols": integer(2), "targetRows": integer(2)}
_CHECKS = {
    "aprilgrid": mapping(
        {"tagCols": integer(1), "tagRows": integer(1), "tagSize": _LENGTH, "tagSpacing": _LENGTH},
        {KALIBR_KEY: text, "codeOffset": integer(0)},
    ),
    "checkerboard": mapping({**_GRID, "rowSpacingMeters": _LENGTH, "colSpacingMeters": _LENGTH}),
    "circlegrid": mapping({**_GRID, "spacingMeters": _LENGTH}, {"asymmetricGrid": flag}),
}

SUFFIXES = (".yaml", ".yml", ".json", ".xml")
_SEVERAL = "boards"
SPACING = "spacing_ratio"  # of an AprilGrid: the gap between two tags as a share of a tag's side

Data = Mapping[str, Any]


def check_kalibr(data: Any, path: str) -> Iterator[Fault]:
    """Check that plain data is a target of Kalibr's."""
    kind = data.get(KALIBR_KEY, "aprilgrid")
    if kind not in tuple(_CHECKS):
        yield from one_of(tuple(_CHECKS), "target type")(kind, KALIBR_KEY)
        return
    faults = list(_CHECKS[kind](data, path))
    if not faults and kind == "checkerboard" and data["rowSpacingMeters"] != data["colSpacingMeters"]:
        faults.append(Fault("colSpacingMeters", "differs from rowSpacingMeters: squares are required"))
    if not faults:
        try:
            board_of_kalibr(data)
        except InvalidInput as error:
            faults.append(Fault(path, error.message))
    yield from faults


def board_of_kalibr(data: Mapping[str, Any]) -> Board:
    """Return the board of plain data that has passed `check`."""
    return _READERS[data.get(KALIBR_KEY, "aprilgrid")](data)


def kalibr_text(board: Board) -> str:
    """Return the text of the target file of a board. Raises InvalidInput for one that Kalibr does not know."""
    return emit.document(kalibr_data(board), "Target file for Kalibr")


def kalibr_data(board: Board) -> dict[str, Any]:
    """Return a board as plain data with the keys of a target file. Raises InvalidInput if Kalibr has none for it."""
    if board.square is None:
        raise InvalidInput("a Kalibr target file needs the size of the board")
    if board.type == APRILGRID and board.dictionary == TAG_FAMILY:
        side = board.marker or 0.0
        tags = {"tagCols": board.columns, "tagRows": board.rows, "tagSize": side}
        first = {"codeOffset": board.first_marker} if board.first_marker else {}
        return {KALIBR_KEY: "aprilgrid", **tags, "tagSpacing": spacing_of(board.square, side), **first}
    size = {"targetCols": board.columns, "targetRows": board.rows}
    if board.type == CHESSBOARD and not board.dots:
        return {KALIBR_KEY: "checkerboard", **size, "rowSpacingMeters": board.square, "colSpacingMeters": board.square}
    if board.type in (CIRCLES, ASYMMETRIC_CIRCLES):
        staggered = board.type == ASYMMETRIC_CIRCLES
        return {KALIBR_KEY: "circlegrid", **size, "spacingMeters": board.square, "asymmetricGrid": staggered}
    raise InvalidInput(
        f"Kalibr does not support the {board.words}, only AprilGrids of {TAG_FAMILY}, checkerboards, circle grids"
    )


def _kalibr_aprilgrid(data: Mapping[str, Any]) -> Board:
    fields = aprilgrid_fields(float(data["tagSize"]), float(data["tagSpacing"]))
    first = data.get("codeOffset", 0)
    return Board(APRILGRID, data["tagCols"], data["tagRows"], dictionary=TAG_FAMILY, first_marker=first, **fields)


def _checkerboard(data: Mapping[str, Any]) -> Board:
    return Board(CHESSBOARD, data["targetCols"], data["targetRows"], float(data["rowSpacingMeters"]))


def _circlegrid(data: Mapping[str, Any]) -> Board:
    kind = ASYMMETRIC_CIRCLES if data.get("asymmetricGrid", False) else CIRCLES
    return Board(kind, data["targetCols"], data["targetRows"], float(data["spacingMeters"]))


_READERS: Mapping[str, Callable[[Mapping[str, Any]], Board]] = {
    "aprilgrid": _kalibr_aprilgrid,
    "checkerboard": _checkerboard,
    "circlegrid": _circlegrid,
}


def read(path: Path) -> Board:
    """Return the board that a board file, a target file of Kalibr's or Basalt's, or settings of OpenCV's describe.

    Raises InvalidInput with a line for every fault, FileError if the file cannot be read.
    """
    content = files.read_text(path)
    if "Calibrate_Pattern" in content:
        return _of_opencv(content, str(path))
    data = documents.parse(content, str(path), _check_file).data
    return board_of_kalibr(data) if _TAGS & data.keys() else from_block(data)


def write(path: Path, board: Board) -> None:
    """Write a board as a YAML file."""
    files.write_text(path, emit.document(block(board), "camcal board file"))


def load_board(text: str | Path) -> Board:
    """Return the board that `text` means: the path of a YAML file, or a short form such as chessboard:9x6:25mm."""
    return read(Path(text)) if names_file(text) else parse_board(str(text))


def names_file(text: str | Path) -> bool:
    """Return whether a text means a file, not the short form of a board."""
    return Path(text).suffix.lower() in SUFFIXES or Path(text).is_file()


def _check_file(data: Any, path: str) -> Iterator[Fault]:
    if isinstance(data, dict) and "nmarkers" in data:
        yield Fault(path, "is a dictionary of markers of OpenCV's, not a board")
        return
    kalibr = isinstance(data, dict) and _TAGS & data.keys()
    yield from check_kalibr(data, path) if kalibr else check(data, path)


def _of_opencv(content: str, where: str) -> Board:
    """Return the board of the settings of OpenCV's calibration program; its lengths are taken for mm."""
    from camcal.formats.cameras import file_storage  # here, since camera files have boards, too
    from camcal.formats.cameras.values import Values

    values = Values(file_storage.parse(content, where))
    values = values.below("Settings") if "Settings" in values else values
    pattern = values.text("Calibrate_Pattern").strip('"')
    if pattern not in _PATTERNS:
        raise values.wrong("Calibrate_Pattern", f"{pattern!r} is not one of {', '.join(_PATTERNS)}")
    kind = _PATTERNS[pattern]
    columns, rows = (values.side(f"BoardSize_{side}") for side in ("Width", "Height"))
    fields: dict[str, Any] = {"square": values.number("Square_Size") * METRES["mm"]}
    if kind == CHARUCO:
        dictionary = values.text("ArUco_Dict_Name").strip('"')
        fields |= {"marker": values.number("Marker_Size") * METRES["mm"], "dictionary": dictionary}
    border = BOARD_TYPES[kind].border
    return Board(kind, columns - border, rows - border, **fields)


def _check_several(data: Any, path: str) -> Iterator[Fault]:
    """Check that plain data is several boards."""
    faults = list(mapping({_SEVERAL: mapping({}, others=check)})(data, path))
    faults += [Fault(path, "give two boards or more, each under its name")] * (not faults and len(data[_SEVERAL]) < 2)
    if not faults:
        try:
            from_block(data)
        except InvalidInput as error:
            faults.append(Fault(path, error.message))
    yield from faults


def check(data: Any, path: str) -> Iterator[Fault]:
    """Check that plain data is a board, or several."""
    if isinstance(data, dict) and _SEVERAL in data:
        yield from _check_several(data, path)
        return
    kind = data.get("type") if isinstance(data, dict) else None
    if not isinstance(kind, str) or kind not in BOARD_TYPES:
        yield from mapping({"type": one_of(tuple(BOARD_TYPES), "board type")}, others=unchecked)(data, path)
        return
    faults = list(_shape_of(kind)(data, path)) or list(_check_lengths(data, path))
    yield from faults
    if not faults:
        try:
            from_block(data)
        except InvalidInput as error:
            yield Fault(path, error.message)


@dataclass(frozen=True)
class BoardKeys:
    """What a board file of one type holds beside `type`.

    size: the key of columns and rows. scale: the length that gives the scale, its key without the unit. part: another
    length that is a field of a Board, "" if there is none. need: what to say if the part is missing, "" if it may be.
    required, optional: further keys, by the fields of a Board that they fill.
    """

    size: str
    scale: str
    part: str = ""
    need: str = ""
    required: Mapping[str, tuple[str, Check]] = field(default_factory=dict)
    optional: Mapping[str, tuple[str, Check]] = field(default_factory=dict)


BOARD_KEYS: Mapping[str, BoardKeys] = {
    CHESSBOARD: BoardKeys("inner_corners", "square", optional={"dots": ("dots", flag)}),
    CHARUCO: BoardKeys(
        "squares",
        "square",
        "marker",
        "a ChArUco board needs its marker's size",
        {"dictionary": ("dictionary", text)},
        {"first_marker": ("first_marker_id", integer(0)), "legacy": ("legacy", flag)},
    ),
    APRILGRID: BoardKeys(
        "tags",
        "tag",
        optional={"dictionary": ("family", text), "first_marker": ("first_tag_id", integer(0))},
    ),
    CIRCLES: BoardKeys("circles", "pitch", "diameter"),
    ASYMMETRIC_CIRCLES: BoardKeys("circles", "pitch", "diameter"),
}


def lengths(name: str) -> tuple[str, ...]:
    """Return the keys under which a length may be given, one for each unit."""
    return tuple(f"{name}_{unit}" for unit in METRES) if name else ()


def _shape_of(kind: str) -> Check:
    """Return the check that a board file of one type has its keys and no others."""
    keys = BOARD_KEYS[kind]
    fewest = BOARD_TYPES[kind].least + BOARD_TYPES[kind].border
    required = {"type": text, keys.size: items(integer(fewest), 2), **dict(keys.required.values())}
    if kind == APRILGRID:
        required[SPACING] = number(positive=True)
    positive = dict.fromkeys((*lengths(keys.scale), *_parts(keys)), number(positive=True))
    return mapping(required, positive | dict(keys.optional.values()))


def _check_lengths(data: Data, path: str) -> Iterator[Fault]:
    """Check that every length of a board is given once, and in proportion to another only if that one is given."""
    keys = BOARD_KEYS[data["type"]]
    scales = [key for key in lengths(keys.scale) if key in data]
    parts = [key for key in _parts(keys) if key in data]
    ratio = f"{keys.part}_ratio"
    if len(scales) > 1 or len(parts) > 1:
        yield Fault(path, f"{' and '.join(scales if len(scales) > 1 else parts)}: give one of them")
    elif keys.need and not parts:
        yield Fault(path, f"{keys.need}: {keys.part}_mm, or {ratio} as a share of the {keys.scale}")
    elif parts and not scales and parts != [ratio]:
        yield Fault(path, f"{parts[0]} without the length of a {keys.scale}: add {keys.scale}_mm, or give {ratio}")


def _parts(keys: BoardKeys) -> tuple[str, ...]:
    return (*lengths(keys.part), f"{keys.part}_ratio") if keys.part else ()


def from_block(data: Data) -> Board:
    """Return the board of plain data that has passed the checks; several as one."""
    if _SEVERAL in data:
        return board_set({name: from_block(own) for name, own in data[_SEVERAL].items()})
    keys, border = BOARD_KEYS[data["type"]], BOARD_TYPES[data["type"]].border
    columns, rows = data[keys.size]
    fields = {name: data[key] for name, (key, _) in {**keys.required, **keys.optional}.items() if key in data}
    if data["type"] == APRILGRID:
        fields = {"dictionary": TAG_FAMILY, **fields, **aprilgrid_fields(_length(data, keys.scale), data[SPACING])}
    else:
        fields["square"] = _length(data, keys.scale)
    if keys.part:
        scale = fields["square"]
        ratio = data.get(f"{keys.part}_ratio")
        fields[keys.part] = _length(data, keys.part) if ratio is None else float(ratio) * (scale or 1.0)
    return Board(data["type"], columns - border, rows - border, **fields)


def _length(data: Data, name: str) -> float | None:
    return next((float(data[key]) * METRES[key.removeprefix(f"{name}_")] for key in lengths(name) if key in data), None)


def block(board: Board) -> dict[str, Any]:
    """Return a board as plain data with the keys of a board file; several under their names."""
    if isinstance(board, BoardSet):
        return {_SEVERAL: {name: block(member) for name, member in board.members.items()}}
    keys, border = BOARD_KEYS[board.type], BOARD_TYPES[board.type].border
    data: dict[str, Any] = {"type": board.type, keys.size: [board.columns + border, board.rows + border]}
    if board.square is not None:
        data |= _length_key(keys.scale, board.marker if board.type == APRILGRID else board.square)
    if board.type == APRILGRID:
        data[SPACING] = spacing_of(board.square, board.marker or 0.0)
    if keys.part:
        part = getattr(board, keys.part)
        data |= {f"{keys.part}_ratio": part} if board.square is None and part else _length_key(keys.part, part)
    data |= {key: getattr(board, name) for name, (key, _) in keys.required.items()}
    optional = {key: getattr(board, name) for name, (key, _) in keys.optional.items()}
    return data | {key: value for key, value in optional.items() if value or (key == "legacy" and value is not None)}


def _length_key(name: str, metres: float | None) -> dict[str, float]:
    if metres is None:
        return {}
    length, unit = in_unit(metres)
    return {f"{name}_{unit}": length}


def in_unit(metres: float) -> tuple[float, str]:
    """Return a length in the unit in which it is a short number and comes back exactly: mm, else m."""
    length = float(f"{metres / METRES['mm']:.9g}")
    return (length, "mm") if length * METRES["mm"] == metres else (metres, "m")


def short_form(board: Board) -> str:
    """Return the short form of a board, which `parse_board` reads back exactly (an AprilGrid's pitch to the last bit).

    Raises InvalidInput if the first marker's id is not 0, which only a board file can say.
    """
    if board.first_marker:
        raise InvalidInput(f"a board whose first marker has id {board.first_marker} has no short form")
    border = BOARD_TYPES[board.type].border
    parts = [board.type, f"{board.columns + border}x{board.rows + border}"]
    parts += _aprilgrid(board) if board.type == APRILGRID else _lengths(board)
    if board.dictionary is not None and (board.type, board.dictionary) != (APRILGRID, TAG_FAMILY):
        parts.append(board.dictionary)
    if board.legacy is not None:
        parts.append("legacy" if board.legacy else "current")
    return ":".join(parts + ["dots"] * board.dots)


def _lengths(board: Board) -> list[str]:
    """Return the side of a square and what is printed in proportion to it, as far as they are known."""
    part = board.marker if board.diameter is None else board.diameter
    square = [] if board.square is None else [_length_text(board.square)]
    if part is None:
        return square
    return [*square, _length_text(part) if square else repr(float(part))]


def _aprilgrid(board: Board) -> list[str]:
    side = board.marker or 0.0
    return [*([] if board.square is None else [_length_text(side)]), repr(spacing_of(board.square, side))]


def _length_text(metres: float) -> str:
    length, unit = in_unit(metres)
    return np.format_float_positional(length, trim="-") + unit
