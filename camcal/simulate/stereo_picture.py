"""The picture of a world, free of noise: what every pixel gathers under a point spread.

The spread is the pixel's own square blurred by a Gaussian. The image plane is cut into cells, several to a pixel. A
cell on one surface has the brightness of its middle, for paint is smooth; one that an edge goes through is looked at in
many places. Every cell counts with the share of the spread that lies on it: that is exact for edges of even surfaces.
"""

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from camcal.arrays import Array
from camcal.simulate.coverage import REACH, spread
from camcal.simulate.stereo_eyes import Eye, seen, strips
from camcal.simulate.stereo_surfaces import Surface, colours

CELLS = 2  # along a pixel
SHARPEST = 0.3  # px of blur; with less the finest paint would alias between cells
FINE = 8  # an edge cell is looked at in 64 places, 8 by 8, but shifted: they lie in 64 different columns and rows

_FINE_LENGTH = 1 / (CELLS * FINE)


def picture(surfaces: Sequence[Surface], eye: Eye, blur: float) -> Array:
    """Return the picture (H, W, 3), BGR, 0 … 1, that an eye sees; blur: of the Gaussian, pixels."""
    width, height = eye.size
    margin = math.ceil(REACH * blur)  # pixels beside a pixel that its spread reaches into
    weights = _shares(_centres(0, 1, margin), 1 / CELLS, blur)
    columns = _centres(0, width, margin)
    result = np.empty((height, width, 3))
    for first, last in strips(height, CELLS**2 * width):
        rows = _centres(first, last, margin)
        across, down = np.meshgrid(columns, rows)
        surface, points = seen(surfaces, eye, across.ravel(), down.ravel())
        cells = colours(surfaces, surface, points).reshape(*across.shape, 3)
        edge = _edges(surface.reshape(across.shape))
        cells[edge] = 0
        part = _gathered(_gathered(cells, weights, 0), weights, 1)
        _add_edges(part, surfaces, eye, (across, down), edge, blur)
        result[first:last] = part
    return result


def _centres(first: int, last: int, margin: int) -> Array:
    """Return the middles of the cells of pixels first … last - 1 and of a margin around them along one axis."""
    return np.asarray((np.arange(CELLS * (first - margin), CELLS * (last + margin)) + 0.5) / CELLS - 0.5)


def _shares(middles: Array, length: float, blur: float) -> Array:
    """Return the shares of the spread on stretches of a length around their middles, pixels, along one axis."""
    return np.asarray(spread(middles + length / 2, blur) - spread(middles - length / 2, blur))


def _gathered(cells: Array, weights: Array, axis: int) -> Array:
    """Return cells summed up to pixels along an axis; the margin goes."""
    cells = np.moveaxis(cells, axis, 0)
    span = len(cells) - len(weights) + 1
    total = sum(weight * cells[start : start + span : CELLS] for start, weight in enumerate(weights))
    return np.moveaxis(np.asarray(total), 0, axis)


def _edges(surface: Array) -> Array:
    """Return the cells (R, C) that have another surface above, below, to the left or to the right of them."""
    found = np.zeros(surface.shape, bool)
    across, down = surface[:, 1:] != surface[:, :-1], surface[1:] != surface[:-1]
    found[:, 1:] |= across
    found[:, :-1] |= across
    found[1:] |= down
    found[:-1] |= down
    return found


def _add_edges(
    image: Array, surfaces: Sequence[Surface], eye: Eye, grid: tuple[Array, Array], edge: Array, blur: float
) -> None:
    """Add to an image (H, W, 3) what its pixels gather of the edge cells (R, C); grid: the middles of all cells."""
    x, y = _places()
    margin = math.ceil(REACH * blur)
    frame = np.zeros((image.shape[0] + 4 * margin, image.shape[1] + 4 * margin, 3))
    for row in range(CELLS):
        for column in range(CELLS):
            alike = edge[row::CELLS, column::CELLS]
            if not alike.any():
                continue
            columns, rows = (axis[row::CELLS, column::CELLS][alike][:, None] for axis in grid)
            surface, points = seen(surfaces, eye, (columns + x).ravel(), (rows + y).ravel())
            values = colours(surfaces, surface, points).reshape(-1, len(x), 3)
            weights = _edge_weights(row, column, margin, blur)
            spots = np.einsum("cnb,nrs->crsb", values, weights, optimize=True)
            down, across = (places[:, None] + np.arange(2 * margin + 1) for places in np.nonzero(alike))
            np.add.at(frame, (down[:, :, None], across[:, None, :]), spots)
    image += frame[2 * margin : -2 * margin, 2 * margin : -2 * margin]


def _places() -> tuple[Array, Array]:
    """Return the x and y (64,) of the places in an edge cell, pixels from its middle."""
    column, row = np.divmod(np.arange(FINE**2), FINE)
    turned = (column, row), (row, FINE - 1 - column)  # a lattice that is no lattice of rows, columns or diagonals
    x, y = ((coarse + (fine + 0.5) / FINE) / FINE - 0.5 for coarse, fine in turned)
    return x / CELLS, y / CELLS


@lru_cache(maxsize=16)
def _edge_weights(row: int, column: int, margin: int, blur: float) -> Array:
    """Return with what weights (64, R, R) the places in a cell count for the pixels that it reaches, row by row.

    row, column: which of the cells of its pixel it is. The weights of all places add up to the share of the whole cell.
    """
    pixels = np.arange(-margin, margin + 1)
    down, across = ((cell + 0.5) / CELLS - 0.5 - pixels for cell in (row, column))
    x, y = (place[:, None] for place in _places())
    weights = _product(_shares(down + y, _FINE_LENGTH, blur), _shares(across + x, _FINE_LENGTH, blur))
    whole, total = _product(_shares(down, 1 / CELLS, blur), _shares(across, 1 / CELLS, blur)), weights.sum(axis=0)
    return np.asarray(weights * np.divide(whole, total, out=np.zeros_like(total), where=total > 0))


def _product(rows: Array, columns: Array) -> Array:
    """Return the products (..., R, R) of what counts along rows (..., R) and along columns (..., R)."""
    return np.asarray(rows[..., :, None] * columns[..., None, :])
