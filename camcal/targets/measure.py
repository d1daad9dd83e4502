"""The corners of a board measured where they have been found, as exactly as an image allows, with their covariance."""

import numpy as np

from camcal.arrays import Array
from camcal.targets import grid as grids
from camcal.targets.cells import Cells
from camcal.targets.edge_blur import edge_blur
from camcal.targets.refine import RefinedCorners, refine

LARGEST_NOISE = 0.4  # of the contrast; what is left over of a corner that is none is more
_BLUR_PX = 1.0  # where no edge says otherwise
_NEAR_PX = 8.0  # along the edges for a first look: from starts some tenths of a pixel off one cannot tell how they bend
_ROUNDS = 3  # where corners are so close that each is seen in its neighbours' pictures


def measure_grid(
    values: Array, grid: Array, depth: Array | None = None, sites: Array | None = None
) -> tuple[Array, Array]:
    """Return the corners (rows, columns, 2) px of a checker pattern and their covariance (rows, columns, 2, 2) px².

    values: (H, W), uint8 or any other kind of number. grid: (rows, columns, 2), good to half a pixel or so, NaN where
    no corner is known. depth: see Cells, (rows, columns, 2, 2). sites: (H, W) mask of the pixels that count. NaN where
    the image does not bear a corner out.
    """
    measured, covariance = np.full_like(grid, np.nan), np.full((*grid.shape, 2), np.nan)
    known = ~np.isnan(grid[..., 0])
    if not known.any():
        return measured, covariance
    blur = blur_of(values, grid[known])
    near = refine(values, grid[known], Cells.plain(grids.steps(grid)[known]), blur, sites, _NEAR_PX)
    for _ in range(_ROUNDS):
        grid = np.full_like(grid, np.nan)
        grid[known] = near.pixels
        cells = Cells.of_grid(grid, depth)
        near = refine(values, near.pixels, cells, blur, sites)
        if not cells.crowded(blur):
            break
    good = clear(near)
    measured[known] = np.where(good[:, None], near.pixels, np.nan)
    covariance[known] = np.where(good[:, None, None], near.covariance, np.nan)
    return measured, covariance


def clear(corners: RefinedCorners) -> Array:
    """Return which corners (N,) are borne out by the image."""
    return np.asarray(corners.settled & (corners.noise < LARGEST_NOISE * np.abs(corners.contrast)))


def blur_of(values: Array, pixels: Array) -> float:
    """Return the blur of the edges (px, the pixel's own square included) around points (N, 2)."""
    blur = edge_blur(values, pixels) if len(pixels) > 2 else np.nan
    return float(blur) if np.isfinite(blur) else _BLUR_PX
