"""From the corners a detector proposes to the corners of a checker pattern that the image bears out.

A corner is kept if two crossing edges are seen there, dark and bright as a checker pattern demands, where its
neighbours put it. One that fails is looked for again where its neighbours put it, and left out if that fails too.
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.targets import grid as grids
from camcal.targets.subpixel import fit_corners
from camcal.targets.windows import FINE, QUICK, WIDE

AGREEMENT = 0.75  # of a window with two crossing edges at least; an outer corner of a board reaches 0.65
CONTRAST = 0.05  # at least, of the median over the board: a corner of it may lie in deep shade
START = 0.5  # steps from a proposed corner to the fitted one at most
STRAY = 0.3  # steps from where the neighbours put a corner that cost it a second look
REPAIR = 0.5  # steps from where the neighbours put a missing corner to the fitted one at most
# A pattern that goes on beyond its stated size looks like the rest of it in most places of a side; a board's margin
# and what lies behind it reach neither.
SAME_AGREEMENT = 0.9
SAME_CONTRAST = 0.3  # largest relative difference
SIDE = 0.5
MAX_EXTENSION = 100


@dataclass(frozen=True, eq=False)
class Checker:
    """Verified corners: pixels (rows, columns, 2), NaN where none.

    sign: 1 if the square before node (0, 0) is dark, else -1. contrast: median over the corners, gray levels.
    """

    grid: Array
    sign: int
    contrast: float

    @property
    def found(self) -> Array:
        """Which corners were found, (rows, columns)."""
        return ~np.isnan(self.grid[..., 0])


@dataclass(frozen=True, eq=False)
class _Look:
    """What is seen at the nodes of a grid (rows, columns), NaN where nobody looked.

    contrast: gray levels, its sign changed on every other node so that a checker pattern has one sign.
    moved: steps from the start.
    """

    grid: Array
    contrast: Array
    agreement: Array
    moved: Array

    def crossing(self, limit: float) -> Array:
        """Return where two edges cross within `limit` steps of the start."""
        return np.asarray((self.agreement > AGREEMENT) & (self.moved < limit))


def settle(gray: Array, start: Array, clearance: float = np.inf) -> Checker:
    """Return the verified corners near the starts (rows, columns, 2), NaN where a detector proposes none.

    gray: (H, W). clearance: see fit_corners.
    """
    look = _look(gray, start, ~np.isnan(start[..., 0]), clearance)
    crossing = look.crossing(START)
    if not crossing.any():
        return Checker(np.full_like(start, np.nan), 1, 0.0)
    sign = 1 if look.contrast[crossing].sum() >= 0 else -1
    contrast = float(np.median(np.abs(look.contrast[crossing])))
    grid = np.where((crossing & (sign * look.contrast > CONTRAST * contrast))[..., None], look.grid, np.nan)
    grid[grids.stray(grid) > STRAY] = np.nan
    checker = Checker(grid, sign, contrast)
    for _ in range(sum(start.shape[:2])):
        grown = _grown(gray, checker, clearance)
        if (grown.found == checker.found).all():
            break
        checker = grown
    return Checker(_polished(gray, checker.grid, clearance), sign, contrast)


def trimmed(checker: Checker) -> Checker:
    """Return the checker without outer rows and columns of which most corners were not found.

    A detector may take the rim of a board for a row of corners when the true one at the other end is out of sight.
    """
    while checker.found.any():
        found = checker.found
        top, bottom, left, right = (side.mean() <= SIDE for side in (found[0], found[-1], found[:, 0], found[:, -1]))
        if not (top or bottom or left or right):
            break
        rows, columns = found.shape
        grid = checker.grid[int(top) : rows - int(bottom), int(left) : columns - int(right)]
        checker = Checker(grid, checker.sign * (-1) ** (int(top) + int(left)), checker.contrast)
    return checker


def extended(gray: Array, checker: Checker) -> Checker:
    """Return the checker with rows and columns added as long as the pattern goes on beyond a side.

    A board of the stated size comes back as it is.
    """
    for _ in range(MAX_EXTENSION):
        wide = np.pad(checker.grid, ((1, 1), (1, 1), (0, 0)), constant_values=np.nan)
        beyond = np.pad(np.zeros_like(checker.found), 1, constant_values=True)
        places = np.where(beyond[..., None], grids.predict(wide), wide)
        look = _look(gray, places, beyond & ~np.isnan(places[..., 0]), np.inf, far=True)
        likeness = np.abs(checker.sign * look.contrast / checker.contrast - 1)
        same = look.crossing(REPAIR) & (look.agreement > SAME_AGREEMENT) & (likeness < SAME_CONTRAST)
        sides = (same[0, 1:-1], same[-1, 1:-1], same[1:-1, 0], same[1:-1, -1])
        top, bottom, left, right = (bool(side.mean() > SIDE) for side in sides)
        if not (top or bottom or left or right):
            break
        grid = np.where(same[..., None], look.grid, wide)
        grid = grid[(not top) : len(grid) - (not bottom), (not left) : grid.shape[1] - (not right)]
        checker = Checker(grid, checker.sign * (-1) ** (top + left), checker.contrast)
    return checker


def _grown(gray: Array, checker: Checker, clearance: float) -> Checker:
    """Return the checker with missing corners that are seen where their neighbours put them."""
    places = np.where(checker.found[..., None], checker.grid, grids.predict(checker.grid))
    look = _look(gray, places, ~checker.found & ~np.isnan(places[..., 0]), clearance, far=True)
    seen = look.crossing(REPAIR) & (checker.sign * look.contrast > CONTRAST * checker.contrast)
    return Checker(np.where(seen[..., None], look.grid, checker.grid), checker.sign, checker.contrast)


def _polished(gray: Array, grid: Array, clearance: float) -> Array:
    """Return the grid fitted once more with all samples, which leaves no trace of where a detector put the corners."""
    known = ~np.isnan(grid[..., 0])
    result = grid.copy()
    if known.any():
        result[known] = fit_corners(gray, grid[known], grids.steps(grid)[known], FINE, clearance).pixels
    return result


def _look(gray: Array, grid: Array, where: Array, clearance: float, *, far: bool = False) -> _Look:
    """Return what is seen near the nodes `where` (rows, columns) of a grid; far: the corners may be steps/2 away."""
    shape = grid.shape[:2]
    result = _Look(grid.copy(), np.full(shape, np.nan), np.full(shape, np.nan), np.full(shape, np.nan))
    if not where.any():
        return result
    steps, pixels = grids.steps(grid)[where], grid[where]
    if far:
        pixels = fit_corners(gray, pixels, steps, WIDE, clearance).pixels
    fits = fit_corners(gray, pixels, steps, QUICK, clearance)
    inside = ((fits.pixels > -0.5) & (fits.pixels < np.array(gray.shape[::-1]) - 0.5)).all(axis=1)
    row, column = np.nonzero(where)
    result.grid[where] = fits.pixels
    result.contrast[where] = fits.contrast * np.where((row + column) % 2, -1, 1)
    result.agreement[where] = np.where(inside, fits.agreement, 0.0)
    result.moved[where] = np.linalg.norm(fits.pixels - grid[where], axis=1) / grids.spacing(steps)
    return result
