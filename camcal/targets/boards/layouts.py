"""Where the points of a board lie and which turns of it look alike, for every type; lengths in pitches."""

from collections.abc import Sequence

import numpy as np

from camcal.arrays import Array, readonly

# Kalibr's order of a tag's corners: lower left, lower right, upper right, upper left; x right, y up
_CORNERS = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])


def grid(columns: int, rows: int) -> Array:
    """Return the points (rows · columns, 2) of a plain grid, row by row."""
    row, column = np.divmod(np.arange(columns * rows), columns)
    return np.column_stack([column, row]).astype(float)


def staggered(columns: int, rows: int) -> Array:
    """Return the points (rows · columns, 2) of OpenCV's asymmetric grid: two apart in a row, odd rows one further."""
    row, column = np.divmod(np.arange(columns * rows), columns)
    return np.column_stack([2 * column + row % 2, row]).astype(float)


def tag_corners(columns: int, rows: int, side: float) -> Array:
    """Return the corners (4 · rows · columns, 2) of tags, one apart, in Kalibr's order: y points up."""
    return np.asarray((grid(columns, rows)[:, None] + side * _CORNERS).reshape(-1, 2))


def grid_turns(columns: int, rows: int, *, half: bool) -> tuple[Array, ...]:
    """Return the permutations of a grid's ids under the turns that map it to itself, the identity first.

    half: whether it looks the same after half a turn; one of as many columns as rows then does after a quarter too.
    """
    ids = np.arange(columns * rows).reshape(rows, columns)
    if not half:
        return _permutations([ids])
    if columns == rows:
        return _permutations([np.rot90(ids, turns) for turns in range(4)])
    return half_turns(columns * rows)


def half_turns(count: int) -> tuple[Array, ...]:
    """Return the identity and half a turn of points that are numbered row by row."""
    return _permutations([np.arange(count), np.arange(count)[::-1]])


def unchanged(count: int) -> tuple[Array, ...]:
    """Return the identity alone."""
    return _permutations([np.arange(count)])


def _permutations(turns: Sequence[Array]) -> tuple[Array, ...]:
    return tuple(readonly(turn.ravel(), (turn.size,), "permutation", np.intp) for turn in turns)


def dotted_squares(columns: int, rows: int) -> tuple[tuple[int, int], ...]:
    """Return row and column of the three squares of a chessboard that carry a dot, counted with its outer squares.

    The first is a white one near the middle, the origin that OpenCV looks for (findChessboardCornersSBWithMeta); the
    others are the black ones to its right and below. None lies at the rim. A board without room for them has none.
    """
    rim = [(row, column) for row in range(1, rows - 1) for column in range(1, columns - 1) if (row + column) % 2]
    if not rim:
        return ()
    row, column = min(rim, key=lambda place: (2 * place[0] - rows + 1) ** 2 + (2 * place[1] - columns + 1) ** 2)
    return (row, column), (row, column + 1), (row + 1, column)
