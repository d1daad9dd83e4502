"""What is printed of a board, in millimetres on paper."""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array, readonly
from camcal.errors import InvalidInput
from camcal.targets.board import Board
from camcal.targets.boards.short_forms import FORMS
from camcal.targets.pattern import BLACK, Pattern, ink_reach, pattern_of
from camcal.targets.printing.outlines import outlines

MM = 1e3

_QUIET = 0.25  # width of the white around a board, of its pitch


@dataclass(frozen=True, eq=False)
class Ink:
    """The black of a board, in millimetres from its upper left corner, y down; see `Page` for outlines and discs.

    size: width and height of the board. pitch: of its squares, tags or circles. quiet: width of the white that belongs
    around it. finest: width of the smallest thing that is to be told apart.
    """

    size: tuple[float, float]
    outlines: tuple[Array, ...]
    discs: Array
    pitch: float
    quiet: float
    finest: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "discs", readonly(self.discs, (None, 4), "discs"))

    @property
    def bordered(self) -> tuple[float, float]:
        """Width and height (mm) of the board with the white around it."""
        return self.size[0] + 2 * self.quiet, self.size[1] + 2 * self.quiet


def ink_of(board: Board) -> Ink:
    """Return what is printed of a board.

    Raises InvalidInput for a board whose lengths are not known, or whose markers the dictionary does not have.
    """
    if board.square is None:
        raise InvalidInput(f"the {board.words} has no size to print it at; give it as in {FORMS[board.type]}")
    pattern, reach = pattern_of(board), ink_reach(board)
    width, height = (round((side + 2 * reach) * MM, 6) for side in board.extent)
    x, y, black = (pattern.x + reach) * MM, (pattern.y + reach) * MM, pattern.ink == BLACK
    if board.inward < 0:  # y points up
        y, black = height - y[::-1], black[::-1]
    discs = (pattern.discs + np.array([reach, reach, 0, 0])) * [MM, MM, MM, 1]
    pitch = board.pitch * MM
    return Ink((width, height), outlines(x, y, black), discs, pitch, _QUIET * pitch, _finest(pattern) * MM)


def _finest(pattern: Pattern) -> float:
    """Return the smallest of the rectangles' sides, those of the white border apart, and of the discs' diameters."""
    sides = np.diff(pattern.x)[1:-1], np.diff(pattern.y)[1:-1]
    return float(np.concatenate([*sides, 2 * pattern.discs[:, 2]]).min())
