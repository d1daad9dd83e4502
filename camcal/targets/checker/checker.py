"""Verification of proposed corners of a checker pattern.

A corner is kept if two crossing edges are seen there, dark and bright as a checker pattern demands, where its
neighbours put it. One that fails is searched for again where its neighbours put it, and left out if that fails too.

A look tells whether a corner is there, and where to a part of a pixel. Around it the image is sampled along its two
edges in the board's own directions, so that every corner looks the same however it is tilted, and fitted linearly with
the picture of a corner, its derivatives by both directions and a plane. A few rounds of this lead to the corner (Baker
and Matthews 2004, inverse compositional alignment).
"""

import math
from functools import cache

import numpy as np

from camcal import opencv
from camcal.arrays import Array
from camcal.dataclass import dataclass, replace
from camcal.targets.board_map import map_of
from camcal.targets.checker import proposals as grids

AGREEMENT = 0.75  # of a window with two crossing edges at least; an outer corner of a board reaches 0.65
# Largest share of a corner's window that is unlike the picture of a corner, beside what is usual on the board.
DISTURBED = 0.04
TIMES_USUAL = 4.0
CONTRAST = 0.05  # at least, of the median over the board: a corner of it may lie in deep shade
START = 0.5  # steps from a proposed corner to the fitted one at most
STRAY = 0.3  # steps from where the neighbours put a corner that cost it a second look
REPAIR = 0.5  # steps from where the neighbours put a missing corner to the fitted one at most
# A pattern that goes on beyond its stated size resembles the rest of it in most places of a side; a board's margin
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
    def inverted(self) -> "Checker":
        """The same corners in the negative of the image."""
        return replace(self, sign=-self.sign)

    @property
    def area(self) -> float:
        """The area in the image that the corners stand for, pixels."""
        return grids.area(self.grid)


@dataclass(frozen=True, eq=False)
class NodeMeasurements:
    """What is seen at the nodes of a grid (rows, columns), NaN where not examined.

    contrast: gray levels, its sign changed on every other node so that a checker pattern has one sign.
    moved: steps, or sides of a tag, from the start.
    """

    grid: Array
    contrast: Array
    agreement: Array
    moved: Array

    def crossing(self, limit: float) -> Array:
        """Return where two edges cross within `limit` steps of the start."""
        return np.asarray((self.agreement > AGREEMENT) & (self.moved < limit))


def verified_corners(gray: Array, start: Array, clearance: float = CLEARANCE) -> Checker:
    """Return the verified corners near the starts (rows, columns, 2), NaN where a detector proposes none.

    gray: (H, W) uint8. clearance: how far from an edge, in steps, an image shows nothing but squares. The corners are
    good to some tenths of a pixel.
    """
    nodes = _measure_nodes(gray, start, ~np.isnan(start[..., 0]), clearance)
    crossing = nodes.crossing(START)
    if not crossing.any():
        return Checker(np.full_like(start, np.nan), 1, 0.0)
    sign = 1 if nodes.contrast[crossing].sum() >= 0 else -1
    contrast = float(np.median(np.abs(nodes.contrast[crossing])))
    grid = np.where((crossing & (sign * nodes.contrast > CONTRAST * contrast))[..., None], nodes.grid, np.nan)
    grid[grids.stray(grid) > STRAY] = np.nan
    checker = Checker(grid, sign, contrast)
    for _ in range(0 if checker.found.all() else sum(start.shape[:2])):
        grown = _fill(gray, checker, grids.predict(checker.grid), clearance)
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
        wide = grids.widen(checker.grid)
        beyond = np.ones(wide.shape[:2], dtype=bool)
        beyond[1:-1, 1:-1] = False
        places = np.where(beyond[..., None], grids.predict(wide), wide)
        if not any(_sides(_find_hints(gray, places, beyond, checker))):
            break
        nodes = _measure_nodes(gray, places, beyond & ~np.isnan(places[..., 0]), CLEARANCE, far=True)
        likeness = np.abs(checker.sign * nodes.contrast / checker.contrast - 1)
        same = nodes.crossing(REPAIR) & (nodes.agreement > SAME_AGREEMENT) & (likeness < SAME_CONTRAST)
        top, bottom, left, right = _sides(same)
        if not (top or bottom or left or right):
            break
        grid = np.where(same[..., None], nodes.grid, wide)
        grid = grid[(not top) : len(grid) - (not bottom), (not left) : grid.shape[1] - (not right)]
        checker = Checker(grid, checker.sign * (-1) ** (top + left), checker.contrast)
    return checker


def _find_hints(gray: Array, places: Array, where: Array, checker: Checker) -> Array:
    """Return where (rows, columns), by contrast, there may be one more corner just at its place beyond a pattern."""
    where = where & ~np.isnan(places[..., 0])
    row, column = np.nonzero(where)
    _, contrast, agreement = measure_saddles_at(gray, places[where], grids.steps(places)[where], CLEARANCE)
    contrast = contrast * np.where((row + column) % 2, -1, 1)
    result = np.zeros(where.shape, dtype=bool)
    result[where] = (checker.sign * contrast > HINT * checker.contrast) & (agreement > HINT)
    return result


def _sides(there: Array) -> tuple[bool, bool, bool, bool]:
    """Return for the top, bottom, left and right side of a grid (rows, columns) whether most of it is there."""
    top, bottom, left, right = (bool(side.mean() > SIDE) for side in grids.outer(there))
    return top, bottom, left, right


def with_hidden_corners(gray: Array, checker: Checker, clearance: float) -> Checker:
    """Return the checker with missing corners that are seen where all the others put them, as behind a hand."""
    found = checker.found
    if found.sum() < MAPPED or found.all():
        return checker
    row, column = np.indices(found.shape)
    nodes = np.stack([column, row], axis=-1).astype(np.float64)
    board_map = map_of(nodes[found], checker.grid[found], (gray.shape[1], gray.shape[0]))
    return _fill(gray, checker, board_map.pixels(nodes.reshape(-1, 2)).reshape(nodes.shape), clearance)


def _fill(gray: Array, checker: Checker, predicted: Array, clearance: float) -> Checker:
    """Return the checker with missing corners that are seen near where they are predicted (rows, columns, 2)."""
    places = np.where(checker.found[..., None], checker.grid, predicted)
    nodes = _measure_nodes(gray, places, ~checker.found & ~np.isnan(places[..., 0]), clearance, far=True)
    seen = nodes.crossing(REPAIR) & (checker.sign * nodes.contrast > CONTRAST * checker.contrast)
    return Checker(np.where(seen[..., None], nodes.grid, checker.grid), checker.sign, checker.contrast)


def clear_corners(gray: Array, checker: Checker, clearance: float = CLEARANCE) -> Array:
    """Return the corners (rows, columns, 2) that look as clear as the others, good to some tenths of a pixel.

    One that a finger touches, or a shadow's edge, would be drawn towards it.
    """
    found, grid = checker.found, checker.grid.copy()
    if found.any():
        _, _, agreement = measure_saddles_at(gray, grid[found], grids.steps(grid)[found], clearance)
        unlike = 1 - agreement
        clear = (agreement > AGREEMENT) & (unlike < DISTURBED + TIMES_USUAL * np.median(unlike))
        grid[found] = np.where(clear[:, None], grid[found], np.nan)
    return grid


def _measure_nodes(gray: Array, grid: Array, where: Array, clearance: float, *, far: bool = False) -> NodeMeasurements:
    """Return what is seen near the nodes `where` (rows, columns) of a grid; far: the corners may be steps/2 away."""
    shape = grid.shape[:2]
    result = NodeMeasurements(grid.copy(), np.full(shape, np.nan), np.full(shape, np.nan), np.full(shape, np.nan))
    if not where.any():
        return result
    steps = grids.steps(grid)[where]
    pixels, contrast, agreement = measure_saddles(gray, grid[where], steps, clearance, far=far)
    row, column = np.nonzero(where)
    result.grid[where], result.agreement[where] = pixels, agreement
    result.contrast[where] = contrast * np.where((row + column) % 2, -1, 1)
    result.moved[where] = np.linalg.norm(pixels - grid[where], axis=1) / np.maximum(grids.spacing(steps), 1e-9)
    return result


# How far along the edges to look, as a share of the steps and in pixels at most: the last one samples every pixel or
# two, which it takes to tell where a sharp edge lies.
FAR = ((0.55, 200.0), (0.4, 50.0))
NEAR = ((0.3, 15.0), (0.2, 6.0))
VERDICT = (0.3, 40.0)
LEAST_PX = 2.0  # a reach that pixels can show
BESIDE_LEAST = 0.25  # of the reach, how far from an edge samples lie at least, however narrow the clearance
BLURS = (0.12, 0.4)  # of the reach: pictures of a sharp corner and of a blurred one
SAMPLES = 5  # on each side of the corner
SAMPLES_BESIDE = 3  # on each side of an edge
ROUNDS = 2
LARGEST_STEP = 0.5  # of the reach in a round


@dataclass(frozen=True, eq=False)
class _Stencil:
    """Places (2, K) in reaches, and what to multiply the samples there with.

    solve: (3, K), gives the contrast and minus the contrast times the shift. plane: (K, K) takes the plane out.
    pictures: (B, K) corners of different blur without their planes, of length 1. peak: (B,) their contrast.
    """

    places: Array
    solve: Array
    plane: Array
    pictures: Array
    peak: Array


def measure_saddles(
    gray: Array, pixels: Array, steps: Array, clearance: float = np.inf, *, far: bool = False
) -> tuple[Array, Array, Array]:
    """Return the corners (N, 2) px that are seen near pixels (N, 2) of `gray`, (H, W) uint8, contrast and agreement.

    contrast: (N,) gray levels, half of bright minus dark, positive where the square before both steps is dark.
    agreement: (N,) share of the variance about a plane that the picture of a corner explains.
    steps: (N, 2, 2), columns are the vectors to the next corner along the row and down the column. clearance: how far
    from the nearer edge, in steps, samples may lie. far: the corner may be half a step away.
    """
    for limit in (*FAR, *NEAR) if far else NEAR:
        pixels = _refine(gray, pixels, steps, clearance, limit)
    return measure_saddles_at(gray, pixels, steps, clearance)


def measure_saddles_at(
    gray: Array, pixels: Array, steps: Array, clearance: float = np.inf
) -> tuple[Array, Array, Array]:
    """Return what is seen of corners just at pixels (N, 2), see `measure_saddles`."""
    stencil, frames = _stencil_for(steps, clearance, VERDICT)
    values = _values(gray, pixels, stencil, frames) @ stencil.plane
    total = (values**2).sum(axis=1)
    scores = values @ stencil.pictures.T
    best = np.abs(scores).argmax(axis=1)
    score = scores[np.arange(len(scores)), best]
    inside = ((pixels > -0.5) & (pixels < np.array(gray.shape[::-1]) - 0.5)).all(axis=1)
    rounding = values.shape[1] / 12  # gray levels squared
    agreement = np.where(inside, score**2 / (total + rounding), 0.0)
    return pixels, -score * stencil.peak[best], agreement


def _refine(gray: Array, pixels: Array, steps: Array, clearance: float, limit: tuple[float, float]) -> Array:
    """Return the corners nearer to where they are, by a few rounds with one reach."""
    stencil, frames = _stencil_for(steps, clearance, limit)
    for _ in range(ROUNDS):
        values = _values(gray, pixels, stencil, frames) @ stencil.solve.T
        contrast = values[:, :1]
        flat = np.abs(contrast) < 1e-3
        shift = np.where(flat, 0.0, -values[:, 1:] / np.where(flat, 1.0, contrast))
        shift = np.clip(shift, -LARGEST_STEP, LARGEST_STEP)
        pixels = pixels + (frames @ shift[..., None])[..., 0]
    return pixels


def _values(gray: Array, pixels: Array, stencil: _Stencil, frames: Array) -> Array:
    """Return the gray levels (N, K) at the stencil's places around pixels (N, 2)."""
    x, y = (pixels[:, axis, None] + frames[:, axis] @ stencil.places for axis in (0, 1))
    return opencv.sampled(gray, x, y)


def _stencil_for(steps: Array, clearance: float, limit: tuple[float, float]) -> tuple[_Stencil, Array]:
    """Return the stencil and the frames (N, 2, 2): a reach along the row and down the column, pixels."""
    share, most = limit
    lengths = np.maximum(np.linalg.norm(steps, axis=1), 1e-9)
    reach = np.clip(share * lengths, LEAST_PX, most) / lengths
    beside = float(np.clip(clearance / share, BESIDE_LEAST, 1.0))
    return _stencil(round(beside, 2)), steps * reach[:, None]


@cache
def _stencil(beside: float) -> _Stencil:
    along, aside = _both_ways(SAMPLES), beside * _both_ways(SAMPLES if beside == 1 else SAMPLES_BESIDE)
    u, v = np.stack(np.meshgrid(along, aside)).reshape(2, -1)
    if beside < 1:
        u, v = np.concatenate([u, v]), np.concatenate([v, u])
    plane = np.stack([np.ones_like(u), u, v], axis=1)
    blur = BLURS[-1]
    slope_u, slope_v = (np.sqrt(2 / np.pi) / blur * np.exp(-((w / blur) ** 2) / 2) for w in (u, v))
    erf = np.vectorize(math.erf)  # a few values once, for which SciPy's would have to be imported
    side_u, side_v = (erf(w / np.sqrt(2) / blur) for w in (u, v))
    design = np.column_stack([np.ones_like(u), side_u * side_v, slope_u * side_v, side_u * slope_v])
    without = np.eye(len(u)) - plane @ np.linalg.pinv(plane)
    pictures = np.stack([erf(u / np.sqrt(2) / blur) * erf(v / np.sqrt(2) / blur) for blur in BLURS]) @ without
    lengths = np.linalg.norm(pictures, axis=1)
    return _Stencil(
        np.stack([u, v]).astype(np.float32),
        np.linalg.pinv(design)[1:].astype(np.float32),
        without.astype(np.float32),
        (pictures / lengths[:, None]).astype(np.float32),
        1 / lengths,
    )


def _both_ways(count: int) -> Array:
    one = (np.arange(count) + 0.5) / count
    return np.concatenate([-one[::-1], one])
