"""From the corners a detector proposes to the corners of a checker pattern that the image bears out.

A corner is kept if two crossing edges are seen there, dark and bright as a checker pattern demands, where its
neighbours put it. One that fails is looked for again where its neighbours put it, and left out if that fails too.
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.targets.board_map import map_of
from camcal.targets.checker import grid as grids
from camcal.targets.checker.looks import glance, look

AGREEMENT = 0.75  # of a window with two crossing edges at least; an outer corner of a board reaches 0.65
# Largest share of a corner's window that is unlike the picture of a corner, beside what is usual on the board.
DISTURBED = 0.04
TIMES_USUAL = 4.0
CONTRAST = 0.05  # at least, of the median over the board: a corner of it may lie in deep shade
START = 0.5  # steps from a proposed corner to the fitted one at most
STRAY = 0.3  # steps from where the neighbours put a corner that cost it a second look
REPAIR = 0.5  # steps from where the neighbours put a missing corner to the fitted one at most
# A pattern that goes on beyond its stated size looks like the rest of it in most places of a side; a board's margin
# and what lies behind it reach neither.
SAME_AGREEMENT = 0.9
SAME_CONTRAST = 0.3  # largest relative difference
HINT = 0.25  # of both, just where a corner is expected
SIDE = 0.5
MAX_EXTENSION = 100
MAPPED = 8  # corners that say where the others are
CLEARANCE = 0.15  # steps from an edge; what is printed within squares stays out of the look


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

    @property
    def area(self) -> float:
        """The area in the image that the corners stand for, pixels."""
        return grids.area(self.grid)


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


def settle(gray: Array, start: Array, clearance: float = CLEARANCE) -> Checker:
    """Return the verified corners near the starts (rows, columns, 2), NaN where a detector proposes none.

    gray: (H, W) uint8. clearance: how far from an edge, in steps, an image shows nothing but squares. The corners are
    good to some tenths of a pixel.
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
    return checker


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
        wide = grids.padded(checker.grid)
        beyond = np.pad(np.zeros_like(checker.found), 1, constant_values=True)
        places = np.where(beyond[..., None], grids.predict(wide), wide)
        if not any(_sides(_hinted(gray, places, beyond, checker))):
            break
        look = _look(gray, places, beyond & ~np.isnan(places[..., 0]), CLEARANCE, far=True)
        likeness = np.abs(checker.sign * look.contrast / checker.contrast - 1)
        same = look.crossing(REPAIR) & (look.agreement > SAME_AGREEMENT) & (likeness < SAME_CONTRAST)
        top, bottom, left, right = _sides(same)
        if not (top or bottom or left or right):
            break
        grid = np.where(same[..., None], look.grid, wide)
        grid = grid[(not top) : len(grid) - (not bottom), (not left) : grid.shape[1] - (not right)]
        checker = Checker(grid, checker.sign * (-1) ** (top + left), checker.contrast)
    return checker


def _hinted(gray: Array, places: Array, where: Array, checker: Checker) -> Array:
    """Return where (rows, columns), by a glance, there may be one more corner just at its place beyond a pattern."""
    where = where & ~np.isnan(places[..., 0])
    row, column = np.nonzero(where)
    looks = glance(gray, places[where], grids.steps(places)[where], CLEARANCE)
    contrast = looks.contrast * np.where((row + column) % 2, -1, 1)
    result = np.zeros(where.shape, dtype=bool)
    result[where] = (checker.sign * contrast > HINT * checker.contrast) & (looks.agreement > HINT)
    return result


def _sides(there: Array) -> tuple[bool, bool, bool, bool]:
    """Return for the top, bottom, left and right side of a grid (rows, columns) whether most of it is there."""
    top, bottom, left, right = (bool(side.mean() > SIDE) for side in grids.outer(there))
    return top, bottom, left, right


def _grown(gray: Array, checker: Checker, clearance: float) -> Checker:
    """Return the checker with missing corners that are seen where their neighbours put them."""
    return _filled(gray, checker, grids.predict(checker.grid), clearance)


def revisited(gray: Array, checker: Checker, clearance: float) -> Checker:
    """Return the checker with missing corners that are seen where all the others put them, as behind a hand."""
    known = checker.found
    if known.sum() < MAPPED or known.all():
        return checker
    row, column = np.indices(known.shape)
    nodes = np.stack([column, row], axis=-1).astype(np.float64)
    seen = map_of(nodes[known], checker.grid[known], (gray.shape[1], gray.shape[0]))
    return _filled(gray, checker, seen.pixels(nodes.reshape(-1, 2)).reshape(nodes.shape), clearance)


def _filled(gray: Array, checker: Checker, predicted: Array, clearance: float) -> Checker:
    """Return the checker with missing corners that are seen near where they are predicted (rows, columns, 2)."""
    places = np.where(checker.found[..., None], checker.grid, predicted)
    look = _look(gray, places, ~checker.found & ~np.isnan(places[..., 0]), clearance, far=True)
    seen = look.crossing(REPAIR) & (checker.sign * look.contrast > CONTRAST * checker.contrast)
    return Checker(np.where(seen[..., None], look.grid, checker.grid), checker.sign, checker.contrast)


def undisturbed(gray: Array, checker: Checker, clearance: float = CLEARANCE) -> Array:
    """Return the corners (rows, columns, 2) that look as clear as the others, good to some tenths of a pixel.

    One that a finger touches, or a shadow's edge, would be drawn towards it.
    """
    known, grid = checker.found, checker.grid.copy()
    if known.any():
        looks = glance(gray, grid[known], grids.steps(grid)[known], clearance)
        unlike = 1 - looks.agreement
        clear = (looks.agreement > AGREEMENT) & (unlike < DISTURBED + TIMES_USUAL * np.median(unlike))
        grid[known] = np.where(clear[:, None], grid[known], np.nan)
    return grid


def _look(gray: Array, grid: Array, where: Array, clearance: float, *, far: bool = False) -> _Look:
    """Return what is seen near the nodes `where` (rows, columns) of a grid; far: the corners may be steps/2 away."""
    shape = grid.shape[:2]
    result = _Look(grid.copy(), np.full(shape, np.nan), np.full(shape, np.nan), np.full(shape, np.nan))
    if not where.any():
        return result
    steps = grids.steps(grid)[where]
    looks = look(gray, grid[where], steps, clearance, far=far)
    row, column = np.nonzero(where)
    result.grid[where] = looks.pixels
    result.contrast[where] = looks.contrast * np.where((row + column) % 2, -1, 1)
    result.agreement[where] = looks.agreement
    result.moved[where] = np.linalg.norm(looks.pixels - grid[where], axis=1) / np.maximum(grids.spacing(steps), 1e-9)
    return result
