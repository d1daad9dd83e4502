"""The edges that cross at the points of a board, as printed, and as a calibrated camera sees them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from camcal.arrays import Array, readonly
from camcal.errors import InvalidInput
from camcal.targets.board import APRILGRID, Board
from camcal.targets.boards import layouts
from camcal.targets.boards.types import TAG_BORDER
from camcal.targets.corners.cells import CROWDED, Beside, Cells
from camcal.targets.markers.families import family_named
from camcal.targets.pattern import DOT

_HALF = 0.5  # of a step on either side of a corner, whose edges are seen as far as that


@dataclass(frozen=True, eq=False)
class BoardEdges:
    """The two edges at each of a board's C points, along x and along y of the board.

    length: in the board's unit, of the steps in which reach (C, 2, 2) and depth (C, 2, 2) count, see Cells.
    """

    length: float
    reach: Array
    depth: Array

    def __post_init__(self) -> None:
        for name in ("reach", "depth"):
            object.__setattr__(self, name, readonly(getattr(self, name), (len(self.reach), 2, 2), name))

    @classmethod
    def of(cls, board: Board, first: int | None = None) -> "BoardEdges":
        """Return the edges of a board; first: see `first_sign`, None for as drawn.

        Raises InvalidInput for a board of circles.
        """
        if board.type == APRILGRID:
            return _of_tags(board)
        if not board.crossed:
            raise InvalidInput(f"no edges cross at the points of a {board.words}")
        sign = first_sign(board) if first is None else first
        depth = bright_depths((board.rows, board.columns), sign, margin(board))
        for row, column in layouts.dotted_squares(board.columns, board.rows) if board.dots else ():
            for after_row, after_column in product((0, 1), repeat=2):
                depth[row - after_row, column - after_column, after_column, after_row] = 1 / 2 - DOT
        return cls(board.pitch, np.ones((board.count, 2, 2)), depth.reshape(-1, 2, 2))


def margin(board: Board) -> float:
    """Return how far from its edges a bright square shows nothing, in squares: 1 unless a ChArUco marker is in it."""
    return 1.0 if board.marker is None or not board.checker else (1 - board.marker / board.pitch) / 2


def first_sign(board: Board) -> int:
    """Return 1 if the square before a board's first corner is dark, -1 if it is bright as on a legacy ChArUco board of
    an even number of rows of squares; a board that does not say is of the current kind.
    """
    return -1 if board.legacy and (board.rows + 1) % 2 == 0 else 1


def signs(board: Board) -> Array:
    """Return 1 or -1 for every point (C,) of a board: where it is the same, the quadrants between the edges have the
    same colours. What stands before the first point may be either dark or bright.
    """
    if board.type == APRILGRID:
        return np.tile([1.0, -1.0], board.count // 2)
    row, column = np.divmod(np.arange(board.count), board.columns)
    return np.where((row + column) % 2, -1.0, 1.0)


def bright_depths(shape: tuple[int, int], sign: int, margin: float) -> Array:
    """Return the depths (rows, columns, 2, 2) of a checker pattern with something printed within its bright squares.

    shape: rows and columns of corners. sign: 1 if the square before the first corner is dark, else -1. margin: from the
    edge of a bright square to the print, in squares.
    """
    row, column = np.indices(shape)
    dark_before = np.where((row + column) % 2, -sign, sign) > 0
    same = np.eye(2, dtype=bool)  # before both edges, or after both
    return np.where(same == dark_before[..., None, None], 1.0, margin)


def _of_tags(board: Board) -> BoardEdges:
    side = float(board.marker or 0.0)
    gap = (board.pitch - side) / side
    after = np.tile(np.array([(1, 1), (0, 1), (0, 0), (1, 0)]), (board.columns * board.rows, 1))  # where the tag lies
    reach, in_tag = tag_reach(after, gap)
    cells = family_named(str(board.dictionary)).bits + 2 * TAG_BORDER
    return BoardEdges(side, reach, np.where(in_tag, TAG_BORDER / cells, gap))


def tag_reach(after: Array, gap: float) -> tuple[Array, Array]:
    """Return the reach (N, 2, 2) of the edges at corners of tags, see Cells, and which quadrant (N, 2, 2) a tag is in.

    after: (N, 2) 1 where the tag lies behind the corner along an edge, 0 where before it. gap: between tags, in sides.
    """
    toward = np.arange(2) == after[..., None]
    return np.where(toward, 1.0, gap), toward[:, 0, :, None] & toward[:, 1, None]


def seen_cells(
    board: Board,
    ids: Array,
    points: Array,
    project: Callable[[Array], Array],
    blur_px: float,
    first: int | None = None,
) -> tuple[Array, Cells]:
    """Return the pixels (N, 2) of some of a board's points, ids (N,), and their cells as a camera sees them.

    points: (N, 3) where they are on the board as it is, in its unit. project: takes points (N, 3) of the board to
    pixels (N, 2), NaN where the camera does not see them. Pixels and cells are NaN there. blur_px: of the edges; the
    next ones are looked for only where it may bring them into the picture. first: see BoardEdges.of.
    """
    edges = BoardEdges.of(board, first)
    look = _Look(points, edges.length, project)
    middle, *ends = look.at([(0, 0), (-_HALF, 0), (_HALF, 0), (0, -_HALF), (0, _HALF)])
    steps, bends = np.empty((len(points), 2, 2)), np.empty((len(points), 2))
    for edge in (0, 1):
        before, after = ends[2 * edge : 2 * edge + 2]
        step, second = after - before, (after - 2 * middle + before) / _HALF**2
        steps[:, :, edge] = step
        bends[:, edge] = (step[:, 0] * second[:, 1] - step[:, 1] * second[:, 0]) / np.linalg.norm(step, axis=1) ** 3
    cells = Cells(steps, bends, edges.reach[ids], edges.depth[ids])
    if board.checker and cells.narrowest() < CROWDED * blur_px:
        cells = replace(cells, beside=_seen_beside(board, ids, middle, look))
    return middle, cells


@dataclass(frozen=True, eq=False)
class _Look:
    """Points (N, 3) of a board, the length of steps from them, and what takes points of the board to pixels."""

    points: Array
    length: float
    project: Callable[[Array], Array]

    def at(self, steps: Sequence[tuple[float, float]]) -> Array:
        """Return the pixels (S, N, 2) of what is S steps along x and y from the points."""
        shifts = self.length * np.column_stack([np.array(steps), np.zeros(len(steps))])
        places = self.points + shifts[:, None]
        return self.project(places.reshape(-1, 3)).reshape(len(steps), -1, 2)


def _seen_beside(board: Board, ids: Array, middle: Array, look: _Look) -> Beside:
    """Return the edges beside those of a checker pattern's corners at pixels `middle` (N, 2)."""
    row, column = np.divmod(ids, board.columns)
    ends = ((row, board.rows - 1), (column, board.columns - 1))
    lines, border = np.empty((len(ids), 2, 2, 3)), np.empty((len(ids), 2, 2), np.bool_)
    for edge, (place, last) in enumerate(ends):
        for index, sign in enumerate((-1, 1)):
            shifts = [(share, sign) if edge == 0 else (sign, share) for share in (0, -_HALF, _HALF)]
            there, before, after = look.at(shifts)
            lines[:, edge, index] = Beside.line(there - middle, after - before)
            border[:, edge, index] = place == (0 if sign < 0 else last)
    return Beside.sorted(lines, border)
