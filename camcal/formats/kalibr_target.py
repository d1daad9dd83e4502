"""The target file of Kalibr: the board of its calibrations, as YAML.

target_type: aprilgrid       # or checkerboard, circlegrid
tagCols: 6
tagRows: 6
tagSize: 0.088               # side of a tag over its black border, metres
tagSpacing: 0.3              # the gap between two tags as a share of that
codeOffset: 0                # optional: the id of the first tag

An AprilGrid keeps Kalibr's numbers and frame. The points of the others are numbered as all of camcal's grids are, row
by row; Kalibr's own frame of them has x along the columns of a checkerboard and of a plain circle grid.
"""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from camcal.errors import InvalidInput
from camcal.formats import emit
from camcal.formats.documents import Fault
from camcal.formats.schema import flag, integer, mapping, number, one_of, text
from camcal.targets.board import Board
from camcal.targets.board_types import (
    APRILGRID,
    ASYMMETRIC_CIRCLES,
    CHESSBOARD,
    CIRCLES,
    TAG_FAMILY,
    aprilgrid_fields,
    spacing_of,
)

KEY = "target_type"

_LENGTH = number(positive=True)
_GRID = {KEY: text, "targetCols": integer(2), "targetRows": integer(2)}
_CHECKS = {
    "aprilgrid": mapping(
        {KEY: text, "tagCols": integer(1), "tagRows": integer(1), "tagSize": _LENGTH, "tagSpacing": _LENGTH},
        {"codeOffset": integer(0)},
    ),
    "checkerboard": mapping({**_GRID, "rowSpacingMeters": _LENGTH, "colSpacingMeters": _LENGTH}),
    "circlegrid": mapping({**_GRID, "spacingMeters": _LENGTH}, {"asymmetricGrid": flag}),
}


def check(data: Any, path: str) -> Iterator[Fault]:
    """Check that plain data is a target of Kalibr's."""
    kind = data[KEY]
    if kind not in tuple(_CHECKS):
        yield from one_of(tuple(_CHECKS), "target type")(kind, KEY)
        return
    faults = list(_CHECKS[kind](data, path))
    if not faults and kind == "checkerboard" and data["rowSpacingMeters"] != data["colSpacingMeters"]:
        faults.append(Fault("colSpacingMeters", "differs from rowSpacingMeters: squares are required"))
    if not faults:
        try:
            board_of(data)
        except InvalidInput as error:
            faults.append(Fault(path, error.message))
    yield from faults


def board_of(data: Mapping[str, Any]) -> Board:
    """Return the board of plain data that has passed `check`."""
    return _READERS[data[KEY]](data)


def text_of(board: Board) -> str:
    """Return the text of the target file of a board. Raises InvalidInput for one that Kalibr does not know."""
    return emit.document(data_of(board), "Target file for Kalibr")


def data_of(board: Board) -> dict[str, Any]:
    """Return a board as plain data with the keys of a target file. Raises InvalidInput if Kalibr has none for it."""
    if board.square is None:
        raise InvalidInput("a Kalibr target file needs the size of the board")
    if board.type == APRILGRID and board.dictionary == TAG_FAMILY:
        side = board.marker or 0.0
        tags = {"tagCols": board.columns, "tagRows": board.rows, "tagSize": side}
        first = {"codeOffset": board.first_marker} if board.first_marker else {}
        return {KEY: "aprilgrid", **tags, "tagSpacing": spacing_of(board.square, side), **first}
    size = {"targetCols": board.columns, "targetRows": board.rows}
    if board.type == CHESSBOARD and not board.dots:
        return {KEY: "checkerboard", **size, "rowSpacingMeters": board.square, "colSpacingMeters": board.square}
    if board.type in (CIRCLES, ASYMMETRIC_CIRCLES):
        staggered = board.type == ASYMMETRIC_CIRCLES
        return {KEY: "circlegrid", **size, "spacingMeters": board.square, "asymmetricGrid": staggered}
    raise InvalidInput(
        f"Kalibr does not support the {board.words}, only AprilGrids of {TAG_FAMILY}, checkerboards, circle grids"
    )


def _aprilgrid(data: Mapping[str, Any]) -> Board:
    fields = aprilgrid_fields(float(data["tagSize"]), float(data["tagSpacing"]))
    first = data.get("codeOffset", 0)
    return Board(APRILGRID, data["tagCols"], data["tagRows"], dictionary=TAG_FAMILY, first_marker=first, **fields)


def _checkerboard(data: Mapping[str, Any]) -> Board:
    return Board(CHESSBOARD, data["targetCols"], data["targetRows"], float(data["rowSpacingMeters"]))


def _circlegrid(data: Mapping[str, Any]) -> Board:
    kind = ASYMMETRIC_CIRCLES if data.get("asymmetricGrid", False) else CIRCLES
    return Board(kind, data["targetCols"], data["targetRows"], float(data["spacingMeters"]))


_READERS: Mapping[str, Callable[[Mapping[str, Any]], Board]] = {
    "aprilgrid": _aprilgrid,
    "checkerboard": _checkerboard,
    "circlegrid": _circlegrid,
}
