"""A lattice of ellipses as a board of circles: turned and numbered as the board's points are.

A grid of ellipses has centres (rows, columns, 2) and axes (rows, columns, 2, 2), NaN where there is none. An asymmetric
board's grid has a column for every half of its spacing, so that every other node is none of its circles.
"""

import numpy as np

from camcal.arrays import Array
from camcal.targets.board import ASYMMETRIC_CIRCLES, LARGEST, Board
from camcal.targets.boards import layouts
from camcal.targets.circles.blobs import Ellipses

_SIDE = 0.5  # of an outer row's nodes that must be seen for it to belong to the board


def as_drawn(lattice: Array, board: Board) -> Array:
    """Return a lattice of indices, -1 where none, with the board's rows and columns parallel to its own.

    The lattice of nearest neighbours of an asymmetric board stands at 45° to it.
    """
    if board.type != ASYMMETRIC_CIRCLES:
        return _trimmed(lattice, 1)
    row, column = np.nonzero(lattice >= 0)
    x, y = column - row, column + row
    turned = np.full((np.ptp(y) + 1, np.ptp(x) + 1), -1)
    turned[y - y.min(), x - x.min()] = lattice[row, column]
    return _trimmed(turned, 2)


def _trimmed(lattice: Array, every: int) -> Array:
    """Return the lattice without outer rows and columns of which too little was found."""
    while lattice.size:
        found = lattice >= 0
        sides = (found[0], found[-1], found[:, 0], found[:, -1])
        top, bottom, left, right = (int(every * side.mean() < _SIDE) for side in sides)
        if not (top or bottom or left or right):
            break
        rows, columns = lattice.shape
        lattice = lattice[top : rows - bottom, left : columns - right]
    return lattice


def size_of(board: Board) -> tuple[int, int]:
    """Return rows and columns of the board's grid of ellipses."""
    return board.rows, board.columns * (2 if board.type == ASYMMETRIC_CIRCLES else 1)


def numbered(lattice: Array, ellipses: Ellipses, board: Board) -> Array | None:
    """Return the lattice turned so that node (0, 0) is point 0, None if it is not the board's.

    Of the turns that look the same, the one whose rows run most to the right.
    """
    turns = [np.rot90(lattice, turn) for turn in range(4)]
    fitting = [turn for turn in turns if turn.shape == size_of(board) and _staggered(turn, board)]
    return max(fitting, key=lambda turn: _rightness(turn, ellipses), default=None)


def board_of(lattice: Array, like: Board) -> Board | None:
    """Return the board whose rows and columns a lattice of indices, turned as one like it is drawn, has; None if none.

    Lengths are those of `like`.
    """
    for turn in range(4):
        turned = np.rot90(lattice, turn)
        rows, columns = turned.shape
        if like.type == ASYMMETRIC_CIRCLES:
            columns, half = divmod(columns, 2)
            if half:
                continue
        if min(rows, columns) < 2 or max(rows, columns) > LARGEST:
            return None
        board = like.of_size(columns, rows)
        if turned.shape == size_of(board) and _staggered(turned, board):
            return board
    return None


def nodes(board: Board) -> Array:
    """Return row and column (count, 2) of every point of the board in its grid of ellipses, in the order of ids."""
    layout = layouts.staggered if board.type == ASYMMETRIC_CIRCLES else layouts.grid
    return layout(board.columns, board.rows)[:, ::-1].astype(np.intp)


def _staggered(lattice: Array, board: Board) -> bool:
    """Return whether the nodes with an ellipse are those of the board."""
    wanted = np.zeros(lattice.shape, dtype=bool)
    wanted[tuple(nodes(board).T)] = True
    return not ((lattice >= 0) & ~wanted).any()


def _rightness(lattice: Array, ellipses: Ellipses) -> float:
    """Return the cosine of the angle from the image's x axis to the rows of a lattice."""
    row, column = np.nonzero(lattice >= 0)
    design = np.column_stack([column, row, np.ones(len(row))])
    along = np.linalg.lstsq(design, ellipses.centres[lattice[row, column]], rcond=None)[0][0]
    return float(along[0] / np.hypot(*along))
