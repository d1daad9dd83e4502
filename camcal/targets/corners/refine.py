"""Corners as exactly as an image allows: a picture of two crossing edges fitted to every corner's own cell.

Around a corner the image is modelled as
    (1 + g · (x, y)) · (level + contrast · T(f)),   f the crossing of crossing.py, T the curve of tone.py,
with both edges' places, directions and blurs, and the gradient g of the light: eleven unknowns a corner. The edges may
bend as a lens bends them, by a curvature that is given. Only pixels by the edges are looked at, each counted with the
nearer one, and none that the next edges reach. All corners are fitted at once by Levenberg-Marquardt steps in offsets
and angles of the edges, in which the unknowns hardly depend on each other.
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array, readonly
from camcal.targets.corners.cell_window import LONGEST_PX, CellWindow, look
from camcal.targets.corners.cells import Beside, Cells
from camcal.targets.corners.checker_picture import CheckerPicture, alone, crowded
from camcal.targets.corners.crossing import PIXEL_VARIANCE
from camcal.targets.corners.tone import STRONGEST, toned

ROUNDING = 1 / 12  # gray levels² of whole numbers
_BLUR_PX = (0.29, 6.3)  # a pixel's own square is the least; without it an edge between two rows could be anywhere there
_ROUNDS = 24  # that few corners need
_SETTLED_PX = 1e-3  # the step after such a step is of the order of 1e-5 px
_SETTLED = 0.05  # of a standard deviation
_STUCK = 1e3  # a damping under which no step leads down
_LEVEL = 0.01  # of the sum of squares: what falls by more is on its way, even where the corner does not move
_RESTING_PX = 0.02  # where pictures are not like the model, steps go to and fro and lessen slowly
_FURTHEST = 0.35  # steps from the start; a fit that goes further has found something else
_COUNT = 11
_OFFSETS, _ANGLES, _BLURS, _LIGHT = slice(0, 2), slice(2, 4), slice(4, 6), slice(6, 11)


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
    window = look(gray, pixels, cells, blur_px, sites, longest_px)
    scene = _Scene.of(cells, pixels, blur_px)
    fit = _minimise(window, scene, _State.start(window, scene, pixels, cells, blur_px))
    return _result(fit, window, pixels, cells, ROUNDING if gray.dtype == np.uint8 else 0.0)


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

    def picture(self, window: CellWindow, state: "_State", along: Array, away: Array) -> CheckerPicture:
        """Return the picture (N, K) of edges; along, away: (2, N, K) px along each edge and from it, to its left."""
        single = np.float32
        inverse = np.exp(-state.log_blur).astype(single).T[..., None]
        correlation = np.cos(state.angles[:, [0]] - state.angles[:, [1]]).astype(single)
        if self.beside is None:
            return alone(away[0] * inverse[0], away[1] * inverse[1], correlation)
        x, y = window.offsets(self.start)
        scaled = []
        for edge in (0, 1):
            bend = (self.bends[:, [edge]] / 2).astype(single) * along[edge] ** 2
            lines = self.beside.lines[:, edge].astype(single)[..., None]
            right, left = (lines[:, k, 0] * x + lines[:, k, 1] * y + lines[:, k, 2] - bend for k in (0, 1))
            scaled.append(np.stack([right, away[edge], left]) * inverse[edge])
        return crowded(scaled[0], scaled[1], correlation, self.beside.border, np.sign(state.light[:, [1]]))


@dataclass(frozen=True, eq=False)
class _State:
    """Corners (N, 2), angles (N, 2) of the edges, logarithms (N, 2) of their blurs, and the light (N, 5): level,
    contrast, tone, and the gradient over the window's reach.
    """

    pixels: Array
    angles: Array
    log_blur: Array
    light: Array

    @classmethod
    def start(cls, window: CellWindow, scene: _Scene, pixels: Array, cells: Cells, blur_px: float) -> "_State":
        """Return edges along the steps, and the light by linear least squares."""
        angles = np.arctan2(cells.steps[:, 1], cells.steps[:, 0])
        blur = np.full((len(pixels), 2), np.log(np.clip(blur_px, *_BLUR_PX)))
        state = cls(pixels.astype(np.float64), angles, blur, np.zeros((len(pixels), 5)))
        state.light[:, 1] = 1.0
        linear = _evaluate(window, scene, state).jacobian[:, 6:8]
        normal = (linear @ linear.swapaxes(1, 2)).astype(np.float64) + 1e-6 * np.eye(2)
        weighted = (linear @ (window.values * window.used)[..., None]).astype(np.float64)
        state.light[:, :2] = np.linalg.solve(normal, weighted)[..., 0]
        return state

    def take(self, rows: Array) -> "_State":
        """Return the state of some of the corners."""
        return _State(self.pixels[rows], self.angles[rows], self.log_blur[rows], self.light[rows])

    def put(self, rows: Array, other: "_State") -> None:
        """Take over the state of some of the corners."""
        for mine, new in zip(vars(self).values(), vars(other).values(), strict=True):
            mine[rows] = new

    def moved(self, step: Array) -> "_State":
        """Return the state after a step (N, 11)."""
        across = np.linalg.solve(self.normals, step[:, _OFFSETS, None])[..., 0]
        blur = np.clip(self.log_blur + step[:, _BLURS], *np.log(_BLUR_PX))
        light = self.light + step[:, _LIGHT]
        light[:, 2] = np.clip(light[:, 2], -STRONGEST, STRONGEST)
        return _State(self.pixels + across, self.angles + step[:, _ANGLES], blur, light)

    @property
    def normals(self) -> Array:
        """The left normals (N, 2, 2) of both edges, one a row."""
        return np.stack([-np.sin(self.angles), np.cos(self.angles)], axis=-1)


@dataclass(frozen=True, eq=False)
class _Linear:
    """Residuals (N, K), and derivatives (N, 11, K) of the model: offsets, angles, logarithms of the blurs, light."""

    residuals: Array
    jacobian: Array

    @property
    def cost(self) -> Array:
        """The sums of squares (N,)."""
        return np.asarray(np.einsum("nk,nk->n", self.residuals, self.residuals), np.float64)

    @property
    def normal(self) -> Array:
        """The normal matrices (N, 11, 11)."""
        return np.asarray(self.jacobian @ self.jacobian.swapaxes(1, 2), np.float64)

    @property
    def gradient(self) -> Array:
        """The right-hand sides (N, 11)."""
        return np.asarray((self.jacobian @ self.residuals[..., None])[..., 0], np.float64)


@dataclass(frozen=True, eq=False)
class _Fit:
    """The state at the end, sums of squares (N,), normal matrices (N, 11, 11), and whether it has come to rest (N,)."""

    state: _State
    cost: Array
    normal: Array
    settled: Array


def _minimise(window: CellWindow, scene: _Scene, state: _State) -> _Fit:
    linear = _evaluate(window, scene, state)
    cost, normal, gradient = linear.cost, linear.normal, linear.gradient
    damping, (settled, resting) = np.full(len(cost), 1e-4), np.zeros((2, len(cost)), np.bool_)
    count = window.used.sum(axis=1) + 1e-9
    for _ in range(_ROUNDS):
        rows = np.flatnonzero(~settled)
        if not len(rows):
            break
        step = _step(normal[rows], gradient[rows], damping[rows])
        trial = state.take(rows).moved(step)
        spread = np.sqrt(cost[rows] / count[rows] / (normal[rows][:, [0, 1], [0, 1]].min(axis=1) + 1e-9))
        length = np.abs(step[:, _OFFSETS]).max(axis=1)
        resting[rows] = length < np.maximum(_RESTING_PX, spread)
        linear = _evaluate(window.take(rows), scene.take(rows), trial)
        better = linear.cost <= cost[rows] * (1 + 1e-6)
        falling = linear.cost < (1 - _LEVEL) * cost[rows]
        kept = rows[better]
        state.put(kept, trial.take(better))
        cost[kept], normal[kept], gradient[kept] = linear.cost[better], linear.normal[better], linear.gradient[better]
        damping[rows] *= np.where(better, 0.1, 30.0)
        arrived = (better & ~falling) | (damping[rows] > _STUCK)
        settled[rows] = (length < np.maximum(_SETTLED_PX, _SETTLED * spread)) & arrived
    return _Fit(state, cost, normal, resting)


def _step(normal: Array, gradient: Array, damping: Array) -> Array:
    """Return damped steps (N, 11)."""
    damped = normal.copy()
    diagonal = np.arange(_COUNT)
    damped[:, diagonal, diagonal] *= 1 + damping[:, None]
    damped[:, diagonal, diagonal] += 1e-6  # cells with fewer pixels than unknowns
    return np.asarray(np.linalg.solve(damped, gradient[..., None])[..., 0])


def _evaluate(window: CellWindow, scene: _Scene, state: _State) -> _Linear:
    """Return values minus model and the model's derivatives, in single precision: sums of a thousand small numbers."""
    single = np.float32
    x, y = window.offsets(state.pixels)
    cos, sin = (part.astype(single).T[..., None] for part in (np.cos(state.angles), np.sin(state.angles)))
    along = cos * x + sin * y
    away = cos * y - sin * x - (scene.bends / 2).astype(single).T[..., None] * along**2
    seen = scene.picture(window, state, along, away)
    level, contrast, tone, slope_x, slope_y = state.light.astype(single).T[..., None]
    over_x, over_y = x * window.scale, y * window.scale
    gain = (1 + slope_x * over_x + slope_y * over_y) * window.used
    curve = toned(seen.value, tone)
    shape = level + contrast * curve.value
    slope = -gain * contrast * curve.by_picture
    inverse = np.exp(-state.log_blur).astype(single).T[..., None]
    jacobian = np.empty((len(x), _COUNT, x.shape[1]), single)
    for edge, by_distance in enumerate((seen.by_first, seen.by_second)):
        jacobian[:, edge] = slope * by_distance * inverse[edge]
        jacobian[:, 2 + edge] = jacobian[:, edge] * along[edge]
    for edge, by_blur in enumerate((seen.by_blur_1, seen.by_blur_2)):
        jacobian[:, 4 + edge] = slope * by_blur
    jacobian[:, 6], jacobian[:, 7], jacobian[:, 8] = gain, gain * curve.value, gain * contrast * curve.by_tone
    lit = window.used * shape
    jacobian[:, 9], jacobian[:, 10] = over_x * lit, over_y * lit
    return _Linear(window.values * window.used - gain * shape, jacobian)


def _result(fit: _Fit, window: CellWindow, start: Array, cells: Cells, rounding: float) -> RefinedCorners:
    state = fit.state
    freedom = window.used.sum(axis=1) - _COUNT
    variance = np.maximum(fit.cost / np.maximum(freedom, 1), rounding)
    step = np.linalg.norm(cells.steps, axis=1).min(axis=1)
    near = np.linalg.norm(state.pixels - start, axis=1) < _FURTHEST * step
    settled = fit.settled & near & (freedom > _COUNT)
    inverse = np.linalg.inv(fit.normal + 1e-9 * np.eye(_COUNT))[:, _OFFSETS, _OFFSETS]
    to_pixels = np.linalg.inv(state.normals)
    covariance = to_pixels @ inverse @ to_pixels.swapaxes(1, 2) * variance[:, None, None]
    covariance = (covariance + covariance.swapaxes(1, 2)) / 2  # symmetric to the last digit, as files have it
    settled &= (np.linalg.det(covariance) > 0) & (np.trace(covariance, axis1=1, axis2=2) > 0)  # else ill-conditioned
    kept = np.where(settled, 1.0, np.nan)
    return RefinedCorners(
        np.where(settled[:, None], state.pixels, start),
        covariance * kept[:, None, None],
        np.sqrt(np.maximum(np.exp(2 * state.log_blur) - PIXEL_VARIANCE, 0.0)) * kept[:, None],
        state.light[:, 1] * kept,
        np.sqrt(variance) * kept,
        settled,
    )
