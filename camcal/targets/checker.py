"""From the corners a detector proposes to the corners of a checker pattern that the image bears out.

A corner is kept if two crossing edges are seen there, dark and bright as a checker pattern demands, where its
neighbours put it. One that fails is looked for again where its neighbours put it, and left out if that fails too.
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.targets import grid as grids
from camcal.targets.subpixel import fit_corners

MIN_AGREEMENT = 0.75  # of a window with two crossing edges; an outer corner of a board reaches 0.65
MIN_CONTRAST = 0.25  # of the median over the board
MAX_START = 0.5  # steps from a detector's corner to the fitted one
STRAY = 0.2  # steps from where the neighbours put a corner that make it worth a second look
MAX_STRAY = 0.5  # steps from where the neighbours put a corner
MIN_SIDE = 0.5  # of a row or column beyond the board


@dataclass(frozen=True, eq=False)
class Checker:
    """Verified corners: pixels (rows, columns, 2), NaN where none.

    sign: 1 if the square before node (0, 0) is dark, else -1. contrast: median over the corners, gray levels.
    """

    grid: Array
    sign: int
    contrast: float

    @property
    def count(self) -> int:
        """The number of corners."""
        return int((~np.isnan(self.grid[..., 0])).sum())


def settle(gray: Array, start: Array, clearance: float = np.inf) -> Checker:
    """Return the verified corners near the starts (rows, columns, 2), NaN where a detector proposes none.

    gray: (H, W). clearance: see fit_corners.
    """
    known = ~np.isnan(start[..., 0])
    grid, look = _fit(gray, start, known, MAX_START, clearance)
    sign = 1 if np.nansum(look) >= 0 else -1
    contrast = float(np.median(np.abs(look[known]))) if known.any() else 0.0
    least = MIN_CONTRAST * contrast
    grid[~(sign * look > least)] = np.nan
    grid[grids.stray(grid) > STRAY] = np.nan
    for _ in range(sum(grid.shape[:2])):
        grown = _grow(gray, grid, sign, least, clearance)
        if np.array_equal(np.isnan(grown), np.isnan(grid)):
            break
        grid = grown
    return Checker(_polish(gray, grid, clearance), sign, contrast)


def _polish(gray: Array, grid: Array, clearance: float) -> Array:
    """Return the grid fitted once more with all samples, which leaves no trace of where a detector put the corners."""
    known = ~np.isnan(grid[..., 0])
    result = grid.copy()
    if known.any():
        result[known] = fit_corners(gray, grid[known], grids.steps(grid)[known], clearance).pixels
    return result


def continues(gray: Array, checker: Checker) -> bool:
    """Return whether the checker pattern goes on beyond the grid, so that the board is larger than thought."""
    wide = np.pad(checker.grid, ((1, 1), (1, 1), (0, 0)), constant_values=np.nan)
    beyond = np.isnan(wide[..., 0])
    wide[beyond] = grids.predict(wide)[beyond]
    look, agreement = _look(gray, wide, beyond & ~np.isnan(wide[..., 0]))
    alike = (agreement > SURE_AGREEMENT) & (np.abs(checker.sign * look / checker.contrast - 1) < ALIKE)
    return any(side.mean() > MIN_SIDE for side in (alike[0], alike[-1], alike[:, 0], alike[:, -1]))


def _grow(gray: Array, grid: Array, sign: int, least: float, clearance: float) -> Array:
    """Return the grid with missing corners that are seen where their neighbours put them."""
    missing = np.isnan(grid[..., 0])
    places = np.where(missing[..., None], grids.predict(grid), grid)
    found, look = _fit(gray, places, missing & ~np.isnan(places[..., 0]), MAX_STRAY, clearance)
    return np.where((missing & (sign * look > least))[..., None], found, grid)


def _fit(gray: Array, grid: Array, where: Array, limit: float, clearance: float) -> tuple[Array, Array]:
    """Return the grid fitted at the nodes `where`, and their look (rows, columns).

    The look is the contrast, its sign changed on every other node, so that a checker pattern has one sign; 0 where no
    two edges cross within `limit` steps of the start.
    """
    look = np.zeros(grid.shape[:2])
    if not where.any():
        return grid.copy(), look
    steps = grids.steps(grid)
    fits = fit_corners(gray, grid[where], steps[where], clearance, quick=True)
    near = np.linalg.norm(fits.pixels - grid[where], axis=1) < limit * grids.spacing(steps[where])
    inside = ((fits.pixels > -0.5) & (fits.pixels < np.array(gray.shape[::-1]) - 0.5)).all(axis=1)
    seen = near & inside & (fits.agreement > MIN_AGREEMENT)
    row, column = np.nonzero(where)
    look[where] = np.where(seen, fits.contrast, 0.0) * np.where((row + column) % 2, -1, 1)
    result = grid.copy()
    result[where] = fits.pixels
    return result, look
