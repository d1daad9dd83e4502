"""Board files: the YAML form of a Board, or a target file of Kalibr's.

type: charuco
squares: [9, 7]              # chessboard: inner_corners: [9, 6]; aprilgrid: tags: [6, 6]; circles: [10, 8]
square_mm: 30.0              # or square_cm, square_m, square_in; left out when unknown; tag_mm, pitch_mm
marker_mm: 22.0              # or marker_ratio: 0.73, the marker's share of the square; spacing_ratio, diameter_mm
dictionary: DICT_5X5_100     # aprilgrid: family: tag36h11
first_marker_id: 0           # optional; aprilgrid: first_tag_id
legacy: false                # optional: the pattern of OpenCV before 4.6; left out, it is found out
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from camcal import files
from camcal.errors import InvalidInput
from camcal.formats import board_keys, emit, kalibr_target, strict_yaml
from camcal.formats.schema import mapping, one_of
from camcal.formats.strict_yaml import Fault
from camcal.targets.board import Board, parse_board
from camcal.targets.boards.types import BOARD_TYPES

SUFFIXES = (".yaml", ".yml")


def read(path: Path) -> Board:
    """Return the board that a board file or a target file of Kalibr's describes.

    Raises InvalidInput with a line for every fault, FileError if the file cannot be read.
    """
    data = strict_yaml.load(path, _check_file).data
    return kalibr_target.board_of(data) if kalibr_target.KEY in data else from_block(data)


def write(path: Path, board: Board) -> None:
    """Write a board as a YAML file."""
    files.write_text(path, emit.document(block(board), "camcal board file"))


def load_board(text: str) -> Board:
    """Return the board that `text` means: the path of a YAML file, or a short form such as chessboard:9x6:25mm."""
    path = Path(text)
    if path.suffix.lower() in SUFFIXES or path.is_file():
        return read(path)
    return parse_board(text)


def _check_file(data: Any, path: str) -> Iterator[Fault]:
    kalibr = isinstance(data, dict) and kalibr_target.KEY in data
    yield from kalibr_target.check(data, path) if kalibr else check(data, path)


def check(data: Any, path: str) -> Iterator[Fault]:
    """Check that plain data is a board."""
    kind = data.get("type") if isinstance(data, dict) else None
    if not isinstance(kind, str) or kind not in BOARD_TYPES:
        yield from mapping({"type": one_of(tuple(BOARD_TYPES), "board type")}, others=lambda _value, _path: ())(
            data, path
        )
        return
    faults = list(board_keys.shape_of(kind)(data, path)) or list(board_keys.check_lengths(data, path))
    yield from faults
    if not faults:
        try:
            from_block(data)
        except InvalidInput as error:
            yield Fault(path, error.message)


def from_block(data: Mapping[str, Any]) -> Board:
    """Return the board of plain data that has passed `check`."""
    return board_keys.board_of(data)


def block(board: Board) -> dict[str, Any]:
    """Return a board as plain data with the keys of a board file."""
    return board_keys.data_of(board)
