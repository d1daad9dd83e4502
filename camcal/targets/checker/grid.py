"""Grids of board corners in an image: prediction of nodes, local steps, orientation.

A grid is an array (rows, columns, 2) of pixels, NaN where a corner is missing.
"""

from collections.abc import Callable

import numpy as np

from camcal.arrays import Array

_REACH = 3  # nodes away that take part in a prediction
_UPRIGHT = np.array([np.cos(np.radians(20)), np.sin(np.radians(20))])


def predict(grid: Array) -> Array:
    """Return where its neighbours put every node (rows, columns, 2), pixels; NaN where they are too few.

    The median of the estimates along rows and columns, exact for quadratic spacing, so that perspective and strong
    distortion pass and a wrong neighbour or two is outvoted; where there are none, of linear ones.
    """
    quadratic, linear = _estimates(grid)
    best = _median(quadratic)
    return np.where(np.isnan(best), _median(linear), best)


def padded(grid: Array) -> Array:
    """Return the grid with a row or a column more on each of its sides, NaN there."""
    return np.pad(grid, ((1, 1), (1, 1), (0, 0)), constant_values=np.nan)


def outer(values: Array) -> tuple[Array, Array, Array, Array]:
    """Return what stands along the top, bottom, left and right of a padded grid's values (rows, columns, ...).

    The corners, of which nobody knows to which side they belong, are left out.
    """
    return values[0, 1:-1], values[-1, 1:-1], values[1:-1, 0], values[1:-1, -1]


def stray(grid: Array) -> Array:
    """Return how far every node (rows, columns) is from the nearest estimate of its neighbours, in steps.

    The nearest one, because on the rim of a fisheye image the estimates scatter. NaN where there is none.
    """
    away = np.linalg.norm(np.concatenate(_estimates(grid)) - grid, axis=-1)
    nearest = np.where(np.isnan(away), np.inf, away).min(axis=0)
    return np.where(np.isfinite(nearest), nearest / np.maximum(spacing(steps(grid)), 1e-9), np.nan)


def _estimates(grid: Array) -> tuple[Array, Array]:
    """Return estimates (K, rows, columns, 2) of every node from its neighbours: quadratic ones and linear ones."""
    near = _neighbours(grid)
    quadratic, linear = [], []
    for along in (np.array([0, 1]), np.array([1, 0])):
        across = along[::-1]
        for sign in (-1, 1):
            one, two, three = (near(sign * k * along) for k in (1, 2, 3))
            quadratic.append(3 * one - 3 * two + three)
            linear.append(2 * one - two)
            linear.append(one + near(sign * across) - near(sign * (along + across)))
        before, after = near(-along), near(along)
        quadratic.append((4 * (before + after) - near(-2 * along) - near(2 * along)) / 6)
        linear.append((before + after) / 2)
    return np.array(quadratic), np.array(linear)


def steps(grid: Array) -> Array:
    """Return the vectors to the next column and the next row at every node (rows, columns, 2, 2), pixels.

    The last axis is (along the row, down the column). A node without neighbours takes the steps of an affine map.
    """
    near = _neighbours(grid)
    row, column = np.nonzero(~np.isnan(grid[..., 0]))
    design = np.column_stack([column, row, np.ones(len(row))])
    affine = np.linalg.lstsq(design, grid[row, column], rcond=None)[0]
    pairs = []
    for along, everywhere in zip((np.array([0, 1]), np.array([1, 0])), affine[:2], strict=True):
        step = _mean(np.array([near(along) - grid, grid - near(-along)]))
        pairs.append(np.where(np.isnan(step), everywhere, step))
    return np.stack(pairs, axis=-1)


def spacing(steps_at_nodes: Array) -> Array:
    """Return the shorter of the two steps (..., 2, 2) at every node, pixels."""
    return np.asarray(np.linalg.norm(steps_at_nodes, axis=-2).min(axis=-1))


def area(grid: Array) -> float:
    """Return the area that the nodes of a grid stand for, pixels: their number times that of the usual cell."""
    found = ~np.isnan(grid[..., 0])
    cells = np.abs(np.linalg.det(steps(grid)[found])) if found.any() else np.zeros(1)
    return float(np.median(cells)) * int(found.sum())


def uprightness(grid: Array) -> float:
    """Return how nearly the rows of a grid run to the right: the cosine of the angle to 20° below the image's x axis.

    Boards are held upright or on their side, so that the rows of two views of one stand seldom run just opposite ways
    on this scale, as they would against the x axis: a board on its side leans a little to the left or to the right.
    """
    along = np.nansum(grid[:, 1:] - grid[:, :-1], axis=(0, 1))
    return float(along @ _UPRIGHT / max(np.hypot(*along), 1e-9))


def _neighbours(grid: Array) -> Callable[[Array], Array]:
    """Return what gives the grid moved by an offset (rows, columns), NaN from outside."""
    rows, columns = grid.shape[:2]
    wide = np.pad(grid, ((_REACH, _REACH), (_REACH, _REACH), (0, 0)), constant_values=np.nan)

    def moved(offset: Array) -> Array:
        row, column = offset + _REACH
        return np.asarray(wide[row : row + rows, column : column + columns])

    return moved


def _median(values: Array) -> Array:
    """Return the median over the first axis without NaN, NaN where there is nothing else."""
    ordered = np.sort(values, axis=0)  # NaN last
    count = (~np.isnan(values)).sum(axis=0)
    low, high = (np.take_along_axis(ordered, k[None], axis=0)[0] for k in (np.maximum(count - 1, 0) // 2, count // 2))
    return np.where(count > 0, (low + np.where(count % 2 == 0, high, low)) / 2, np.nan)


def _mean(values: Array) -> Array:
    present = ~np.isnan(values)
    count = present.sum(axis=0)
    return np.where(count > 0, np.where(present, values, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)
