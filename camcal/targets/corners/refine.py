"""Corner refinement: a model of two crossing edges fitted to the cell of every corner.

Around a corner the image is modelled as
    (1 + g · (x, y)) · (level + contrast · T(f)),   f the crossing and T the curve of checker_picture.py,
with both edges' places, directions and blurs, and the gradient g of the light: eleven unknowns a corner. The edges may
bend as a lens bends them, by a curvature that is given. Only pixels by the edges are examined, each counted with the
nearer one, and none that the next edges reach. All corners are fitted at once, by steps in offsets and angles of the
edges, in which the unknowns hardly depend on each other.
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array, readonly
from camcal.solve.descent import Stopping
from camcal.solve.independent import Minima, Models, Trial, minimise_each
from camcal.targets.corners.cells import LONGEST_PX, Beside, Cells, CellWindow, sample_cells
from camcal.targets.corners.checker_picture import PIXEL_VARIANCE, STRONGEST, CheckerPicture, alone, crowded, toned

ROUNDING = 1 / 12  # gray levels² of whole numbers
_BLUR_PX = (0.29, 6.3)  # a pixel's own square is the least; without it an edge between two rows could be anywhere there
# Costs are summed in single precision; the damping falls and rises fast, for most corners need few steps.
_STOPPING = Stopping(iterations=24, damping=1e-4, rise=30.0, by_gain=False, restart=0.0, most=30.0, slack=1e-6)
_SETTLED_PX = 1e-3  # the step after such a step is of the order of 1e-5 px
_SETTLED = 0.05  # of a standard deviation
_LEVEL = 0.01  # of the sum of squares: what falls by more is on its way, even where the corner does not move
_RESTING_PX = 0.02  # where pictures are not like the model, steps go to and fro and lessen slowly
_FURTHEST = 0.35  # steps from the start; a fit that goes further has found something else
_COUNT = 11
# The unknowns as the elements of a state: corner, angles of the edges, logarithms of their blurs, and the light: level,
# contrast, tone, and the gradient over the window's reach. A step has the offsets of both edges where a state has the
# corner.
_PIXELS, _ANGLES, _BLURS, _LIGHT = slice(0, 2), slice(2, 4), slice(4, 6), slice(6, 11)
_OFFSETS, _CONTRAST, _TONE = _PIXELS, 7, 8


@dataclass(frozen=True, eq=False)
class RefinedCorners:
    """What was fitted at N corners.

    pixels: (N, 2). covariance: (N, 2, 2) px². blur: (N, 2) px, across the first and the second edge, the pixel's own
    square not counted. contrast: (N,) gray levels, half of bright minus dark, positive where the square before both
    steps is dark. noise: (N,) standard deviation of the residuals, gray levels. settled: (N,) whether the fit came to
    rest near its start; elsewhere pixels are the start and covariance, blur, contrast and noise are NaN.
    """

    pixels: Array
    covariance: Array
    blur: Array
    contrast: Array
    noise: Array
    settled: Array

    def __post_init__(self) -> None:
        count = len(self.pixels)
        shapes = {"pixels": (2,), "covariance": (2, 2), "blur": (2,), "contrast": (), "noise": ()}
        for name, shape in shapes.items():
            object.__setattr__(self, name, readonly(getattr(self, name), (count, *shape), name))
        object.__setattr__(self, "settled", readonly(self.settled, (count,), "settled", np.bool_))


def refine(
    gray: Array,
    pixels: Array,
    cells: Cells,
    blur_px: float,
    sites: Array | None = None,
    longest_px: float = LONGEST_PX,
) -> RefinedCorners:
    """Return corners fitted from starts pixels (N, 2), good to half a pixel or so.

    gray: (H, W), uint8 or any other kind of number. blur_px: about the blur of the edges, the pixel's own square
    included, which says how far from them to look. sites: (H, W) mask of the pixels that count, such as those of one
    colour of a mosaic; None for all. longest_px: how far along an edge to look at most; the farther, the more it
    matters how the edge bends.
    """
    window = sample_cells(gray, pixels, cells, blur_px, sites, longest_px)
    corners = _Corners(window, _Scene.of(cells, pixels, blur_px))
    states, every = corners.start(pixels, cells, blur_px), np.arange(len(pixels))
    fit = minimise_each(corners, states, every, _STOPPING, enough=corners.enough)
    return _result(fit, corners, pixels, cells, ROUNDING if gray.dtype == np.uint8 else 0.0)


@dataclass(frozen=True, eq=False)
class _Scene:
    """What is known of N corners: how their edges bend (N, 2), and the edges beside them if the blur brings them in,
    as lines from `start` (N, 2).
    """

    bends: Array
    start: Array
    beside: Beside | None

    @classmethod
    def of(cls, cells: Cells, start: Array, blur_px: float) -> "_Scene":
        """Return what matters of the cells under a blur."""
        return cls(cells.bends, start, cells.beside if cells.crowded(blur_px) else None)

    def take(self, rows: Array) -> "_Scene":
        """Return what is known of some of the corners."""
        return _Scene(self.bends[rows], self.start[rows], None if self.beside is None else self.beside.take(rows))

    def picture(self, window: CellWindow, states: Array, along: Array, away: Array) -> CheckerPicture:
        """Return the picture (N, K) of edges; along, away: (2, N, K) px along each edge and from it, to its left."""
        single = np.float32
        inverse = np.exp(-states[:, _BLURS]).astype(single).T[..., None]
        correlation = np.cos(states[:, [2]] - states[:, [3]]).astype(single)
        if self.beside is None:
            return alone(away[0] * inverse[0], away[1] * inverse[1], correlation)
        x, y = window.offsets(self.start)
        scaled = []
        for edge in (0, 1):
            bend = (self.bends[:, [edge]] / 2).astype(single) * along[edge] ** 2
            lines = self.beside.lines[:, edge].astype(single)[..., None]
            right, left = (lines[:, k, 0] * x + lines[:, k, 1] * y + lines[:, k, 2] - bend for k in (0, 1))
            scaled.append(np.stack([right, away[edge], left]) * inverse[edge])
        return crowded(scaled[0], scaled[1], correlation, self.beside.border, np.sign(states[:, [_CONTRAST]]))


@dataclass(frozen=True, eq=False)
class _Corners:
    """The fits of N corners, for the solver: states (N, 11), steps (N, 11)."""

    window: CellWindow
    scene: _Scene

    def start(self, pixels: Array, cells: Cells, blur_px: float) -> Array:
        """Return edges along the steps, and the light by linear least squares."""
        states = np.zeros((len(pixels), _COUNT))
        states[:, _PIXELS] = pixels
        states[:, _ANGLES] = np.arctan2(cells.steps[:, 1], cells.steps[:, 0])
        states[:, _BLURS] = np.log(np.clip(blur_px, *_BLUR_PX))
        states[:, _CONTRAST] = 1.0
        linear = _evaluate(self.window, self.scene, states)[1][:, 6:8]
        normal = (linear @ linear.swapaxes(1, 2)).astype(np.float64) + 1e-6 * np.eye(2)
        weighted = (linear @ (self.window.values * self.window.used)[..., None]).astype(np.float64)
        states[:, 6:8] = np.linalg.solve(normal, weighted)[..., 0]
        return states

    def linearise(self, states: Array, which: Array) -> Models:
        """Return the models of half the sums of squares."""
        residuals, jacobian = _evaluate(self.window.take(which), self.scene.take(which), states)
        cost = 0.5 * np.einsum("nk,nk->n", residuals, residuals).astype(np.float64)
        normal = (jacobian @ jacobian.swapaxes(1, 2)).astype(np.float64)
        normal += 1e-6 * np.eye(_COUNT)  # cells with fewer pixels than unknowns
        return Models(cost, -(jacobian @ residuals[..., None])[..., 0].astype(np.float64), normal)

    def retract(self, states: Array, steps: Array) -> Array:
        """Return the states after steps, blurs and tone within what they may be."""
        moved = states + steps
        moved[:, _PIXELS] = states[:, _PIXELS] + np.linalg.solve(_normals(states), steps[:, _OFFSETS, None])[..., 0]
        moved[:, _BLURS] = np.clip(moved[:, _BLURS], *np.log(_BLUR_PX))
        moved[:, _TONE] = np.clip(moved[:, _TONE], -STRONGEST, STRONGEST)
        return moved

    def enough(self, tried: Trial) -> Array:
        """Return after which steps (A,) a corner stays where it is, and its picture has come to its level: a step so
        small that does not lower the cost is no reason to look for a smaller one.
        """
        level = np.abs(tried.fall) <= _LEVEL * tried.before.cost
        small = self._small(tried.before, tried.which, _SETTLED_PX, _SETTLED)
        return np.asarray(level & (_length(tried.steps) < small))

    def resting(self, fit: Minima) -> Array:
        """Return which corners (N,) have moved little in the last step."""
        return np.asarray(_length(fit.steps) < self._small(fit.models, fit.which, _RESTING_PX, 1.0))

    def _small(self, models: Models, which: Array, px: float, deviations: float) -> Array:
        """Return lengths (A,) of `px`, or so many standard deviations of a corner where that is more."""
        count = self.window.used[which].sum(axis=1) + 1e-9
        least = models.normal[:, [0, 1], [0, 1]].min(axis=1)
        return np.asarray(np.maximum(px, deviations * np.sqrt(2 * models.cost / count / least)))


def _length(steps: Array) -> Array:
    """Return how far (A,) px steps (A, 11) take corners."""
    return np.asarray(np.abs(steps[:, _OFFSETS]).max(axis=1))


def _normals(states: Array) -> Array:
    """Return the left normals (N, 2, 2) of both edges, one a row."""
    angles = states[:, _ANGLES]
    return np.stack([-np.sin(angles), np.cos(angles)], axis=-1)


def _evaluate(window: CellWindow, scene: _Scene, states: Array) -> tuple[Array, Array]:
    """Return values minus model (N, K) and the model's derivatives (N, 11, K), in single precision: sums of a thousand
    small numbers.
    """
    single = np.float32
    x, y = window.offsets(states[:, _PIXELS])
    angles = states[:, _ANGLES]
    cos, sin = (part.astype(single).T[..., None] for part in (np.cos(angles), np.sin(angles)))
    along = cos * x + sin * y
    away = cos * y - sin * x - (scene.bends / 2).astype(single).T[..., None] * along**2
    seen = scene.picture(window, states, along, away)
    level, contrast, tone, slope_x, slope_y = states[:, _LIGHT].astype(single).T[..., None]
    over_x, over_y = x * window.scale, y * window.scale
    gain = (1 + slope_x * over_x + slope_y * over_y) * window.used
    curve = toned(seen.value, tone)
    shape = level + contrast * curve.value
    slope = -gain * contrast * curve.by_picture
    inverse = np.exp(-states[:, _BLURS]).astype(single).T[..., None]
    jacobian = np.empty((len(x), _COUNT, x.shape[1]), single)
    for edge, by_distance in enumerate((seen.by_first, seen.by_second)):
        jacobian[:, edge] = slope * by_distance * inverse[edge]
        jacobian[:, 2 + edge] = jacobian[:, edge] * along[edge]
    for edge, by_blur in enumerate((seen.by_blur_1, seen.by_blur_2)):
        jacobian[:, 4 + edge] = slope * by_blur
    jacobian[:, 6], jacobian[:, 7], jacobian[:, 8] = gain, gain * curve.value, gain * contrast * curve.by_tone
    lit = window.used * shape
    jacobian[:, 9], jacobian[:, 10] = over_x * lit, over_y * lit
    return window.values * window.used - gain * shape, jacobian


def _result(fit: Minima, corners: _Corners, start: Array, cells: Cells, rounding: float) -> RefinedCorners:
    states = fit.states
    dof = corners.window.used.sum(axis=1) - _COUNT
    variance = np.maximum(2 * fit.cost / np.maximum(dof, 1), rounding)
    step = np.linalg.norm(cells.steps, axis=1).min(axis=1)
    near = np.linalg.norm(states[:, _PIXELS] - start, axis=1) < _FURTHEST * step
    settled = corners.resting(fit) & near & (dof > _COUNT)
    inverse = np.linalg.inv(fit.models.normal)[:, _OFFSETS, _OFFSETS]
    to_pixels = np.linalg.inv(_normals(states))
    covariance = to_pixels @ inverse @ to_pixels.swapaxes(1, 2) * variance[:, None, None]
    covariance = (covariance + covariance.swapaxes(1, 2)) / 2  # symmetric to the last digit, as files have it
    settled &= (np.linalg.det(covariance) > 0) & (np.trace(covariance, axis1=1, axis2=2) > 0)  # else ill-conditioned
    kept = np.where(settled, 1.0, np.nan)
    return RefinedCorners(
        np.where(settled[:, None], states[:, _PIXELS], start),
        covariance * kept[:, None, None],
        np.sqrt(np.maximum(np.exp(2 * states[:, _BLURS]) - PIXEL_VARIANCE, 0.0)) * kept[:, None],
        states[:, _CONTRAST] * kept,
        np.sqrt(variance) * kept,
        settled,
    )
