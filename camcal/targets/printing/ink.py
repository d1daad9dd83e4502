"""What is printed of a board, in millimetres on paper.

One path goes around squares that share a side, so that no seam shows there.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array, readonly
from camcal.errors import InvalidInput
from camcal.targets.board import Board
from camcal.targets.boards.short_forms import FORMS
from camcal.targets.pattern import BLACK, Pattern, ink_reach, pattern_of

# Right, down, left, up: (column, row) of a step, in the order of turns to the right
_STEPS = ((1, 0), (0, 1), (-1, 0), (0, -1))
_TURNS = (1, 0, 3)  # to the right first: squares that only touch at a corner stay apart

Edge = tuple[int, int, int]  # where it starts (column, row of the line), and which of the steps it takes


def outlines(x: Array, y: Array, black: Array) -> tuple[Array, ...]:
    """Return the outlines (K, 2) of cells that are black, clockwise (y down) around them, holes the other way.

    x (M,), y (N,): the lines between cells, ascending. black: (N - 1, M - 1) of bool.
    """
    lattice = [np.array(corners) for corners in _loops(set(_edges(black)))]
    return tuple(np.column_stack([x[corners[:, 0]], y[corners[:, 1]]]) for corners in lattice)


def _edges(black: Array) -> Iterator[Edge]:
    """Yield the sides of black cells towards white, each with black to its right."""
    padded = np.pad(black, 1)
    inside = padded[1:-1, 1:-1]
    beside = (padded[:-2, 1:-1], padded[1:-1, 2:], padded[2:, 1:-1], padded[1:-1, :-2])  # above, right, below, left
    starts = ((0, 0), (1, 0), (1, 1), (0, 1))
    for step, (neighbour, (column, row)) in enumerate(zip(beside, starts, strict=True)):
        for place in np.argwhere(inside & ~neighbour).tolist():
            yield place[1] + column, place[0] + row, step


def _loops(edges: set[Edge]) -> Iterator[list[tuple[int, int]]]:
    """Yield the corners of every closed path along edges, and use them up; the order is that of the places."""
    for first in sorted(edges):
        if first in edges:
            yield _walk(first, edges)


def _walk(first: Edge, edges: set[Edge]) -> list[tuple[int, int]]:
    corners: list[tuple[int, int]] = []
    edge = first
    while True:
        edges.discard(edge)
        step = edge[2]
        column, row = edge[0] + _STEPS[step][0], edge[1] + _STEPS[step][1]
        onward = ((column, row, (step + turn) % 4) for turn in _TURNS)
        edge = next(way for way in onward if way == first or way in edges)
        if edge[2] != step:
            corners.append((column, row))
        if edge == first:
            return corners


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
