"""The cells of an AprilGrid's corners: a tag's border on one side, a small square on the other, and gaps between them.

Along each edge a corner has the side of the tag before it or behind it, and the gap's width on the other side. Nothing
but edges is seen as deep as the border of a tag, behind which its bits begin, and as deep as the gap elsewhere.
"""

from dataclasses import replace

import numpy as np

from camcal.arrays import Array
from camcal.targets.aprilgrid.tag_lattice import Predicted, TagLattice
from camcal.targets.boards.types import TAG_BORDER
from camcal.targets.corners.board_edges import tag_reach
from camcal.targets.corners.cells import Beside, Cells

_AROUND = 20  # corners that say how lines bend at one of them
_SPARE = 2  # corners to a term of the polynomial


def tag_cells(lattice: TagLattice, grid: Array, predicted: Predicted, side: int) -> Cells:
    """Return the cells of the corners that a grid (2 rows, 2 columns, 2) px has, NaN where none, row by row.

    predicted: where the neighbours put all corners. side: cells across a tag, its border included.
    """
    known = ~np.isnan(grid[..., 0])
    row, column = np.nonzero(known)
    after = 1 - np.stack([column, row], axis=1) % 2  # 1 where the tag lies behind the corner along an edge
    reach, in_tag = tag_reach(after, lattice.gap)
    beside = _beside(lattice, np.where(known[..., None], grid, predicted.places), predicted.steps)
    depth = np.where(in_tag, TAG_BORDER / side, 1.0)
    return Cells(predicted.steps[known], _bends(lattice, grid), reach, depth, beside.take(np.flatnonzero(known)))


def uncrowded(cells: Cells) -> Cells:
    """Return the same cells without the edges beside them: as deep as they go in an image that is sharp enough."""
    depth = np.minimum(cells.depth, cells.reach.min(axis=(1, 2))[:, None, None])
    return replace(cells, depth=depth, beside=None)


def _bends(lattice: TagLattice, grid: Array) -> Array:
    """Return the curvatures (N, 2) 1/px of the lines through a grid's corners, see Cells.bends.

    What bends lines is smooth and corners are not exact: a polynomial in x and y says where those around a corner are.
    """
    known = ~np.isnan(grid[..., 0])
    nodes, pixels = lattice.nodes[known], grid[known]
    powers = _powers(len(nodes))
    if not len(powers):
        return np.zeros_like(pixels)
    away = nodes - nodes[:, None]
    nearest = np.argsort((away**2).sum(axis=2), axis=1, kind="stable")[:, :_AROUND]
    away = np.take_along_axis(away, nearest[..., None], axis=1)
    terms = (away[:, :, None] ** powers).prod(axis=-1)
    fitted = np.linalg.pinv(terms) @ pixels[nearest]
    bends = []
    for one, two in (((1, 0), (2, 0)), ((0, 1), (0, 2))):
        slope, bend = (fitted[:, (powers == power).all(axis=1).argmax()] for power in (one, two))
        across = slope[:, 0] * bend[:, 1] - slope[:, 1] * bend[:, 0]
        bends.append(2 * across / np.maximum(np.hypot(*slope.T), 1e-9) ** 3)
    return np.stack(bends, axis=1)


def _powers(count: int) -> Array:
    """Return the powers (K, 2) of x and y in the polynomial through so many corners, none if they are too few."""
    degree = next((degree for degree in (3, 2) if _SPARE * (degree + 1) * (degree + 2) / 2 <= count), -1)
    return np.array([(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)])


def _beside(lattice: TagLattice, places: Array, steps: Array) -> Beside:
    """Return the edges next to those of all corners at places (2 rows, 2 columns, 2) px, NaN where unknown."""
    rows, columns = places.shape[:2]
    wide = np.pad(places, ((1, 1), (1, 1), (0, 0)), constant_values=np.nan)
    tangents = np.pad(steps, ((1, 1), (1, 1), (0, 0), (0, 0)), constant_values=np.nan)
    lines, border = np.empty((rows, columns, 2, 2, 3)), np.zeros((rows, columns, 2, 2), np.bool_)
    row, column = np.indices((rows, columns))
    for edge, line, count in ((0, row, rows), (1, column, columns)):
        for index, sign in enumerate((-1, 1)):
            down, right = (1 + sign, 1) if edge == 0 else (1, 1 + sign)
            part = np.s_[down : down + rows, right : right + columns]
            width = np.where(line % 2 == (sign + 1) // 2, lattice.gap, 1.0)[..., None]
            unknown = np.isnan(wide[part][..., :1])
            toward = np.where(unknown, sign * width * steps[..., 1 - edge], wide[part] - places)
            lines[:, :, edge, index] = Beside.line(
                toward, np.where(unknown[..., None], steps, tangents[part])[..., edge]
            )
            border[:, :, edge, index] = line == (0 if sign < 0 else count - 1)
    return Beside.sorted(lines.reshape(-1, 2, 2, 3), border.reshape(-1, 2, 2))
