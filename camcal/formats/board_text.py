"""The short form of a board as text, which `parse_board` reads back."""

import numpy as np

from camcal.errors import InvalidInput
from camcal.formats.board_keys import in_unit
from camcal.targets.board import APRILGRID, Board
from camcal.targets.boards.short_forms import spacing_of
from camcal.targets.boards.types import BOARD_TYPES, TAG_FAMILY


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
    square = [] if board.square is None else [_length(board.square)]
    if part is None:
        return square
    return [*square, _length(part) if square else repr(float(part))]


def _aprilgrid(board: Board) -> list[str]:
    side = board.marker or 0.0
    return [*([] if board.square is None else [_length(side)]), repr(spacing_of(board.square, side))]


def _length(metres: float) -> str:
    length, unit = in_unit(metres)
    return np.format_float_positional(length, trim="-") + unit
