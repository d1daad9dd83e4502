"""Corners of a checker pattern to a hundredth of a pixel: the picture of two crossing edges fitted to the image.

Around a corner the image is modelled as  level + slope · (x, y) + contrast · erf(t₁ / √2 σ) · erf(t₂ / √2 σ)  with
t₁, t₂ the distances from two straight edges through the corner and σ the blur. All corners are fitted at once by
Levenberg-Marquardt. On real sets this leaves a smaller reprojection error than cv2.cornerSubPix or
findChessboardCornersSB (benchmarks/detection.py): it uses only the edges, so that print within the squares does not
draw it, and it does not mind where the window was centred.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import erf

from camcal.arrays import Array

SHARE = 0.4  # of a step: the window's radius, so that it ends before the next edge
REACH_PX = 12.0  # its largest radius; more edge adds little, and lens distortion bends longer edges
REACH_SHARE = 1 / 8  # … or this share of the spacing, for images whose blur grew with their pixels
CORE_PX = 2.5  # its smallest radius: fewer pixels than parameters determine nothing
BAND_PX = 6.0  # samples lie at most this far from one of the edges; further away there is nothing to be learnt
BAND_SHARE = 1 / 4  # … or this share of the radius
_COARSE = 2  # pixels between samples of a quick fit; sharp edges sampled so are good to two tenths of a pixel
_LEAST_BLUR_PX = 0.3  # of a pixel's own square, √(1/12)
_LARGEST_BLUR_PX = 4.0
_ROUNDS = 15
_SETTLED_PX = 1e-3  # the step after such a step is of the order of 1e-5 px
_ROOT_HALF = np.sqrt(0.5)
_SHARP = -4.0  # a logarithm of blur that adds nothing to the least
_X, _Y, _ANGLE_1, _ANGLE_2, _LOG_BLUR, _LEVEL, _CONTRAST = range(7)
_COUNT = 9


@dataclass(frozen=True, eq=False)
class CornerFits:
    """What was fitted at N corners.

    pixels: (N, 2). contrast: (N,) gray levels, half of bright minus dark; positive where the square before both steps
    is dark. agreement: (N,) share of the window's variance about a plane that the model explains, 1 is perfect.
    """

    pixels: Array
    contrast: Array
    agreement: Array


@dataclass(frozen=True, eq=False)
class _Windows:
    """Samples (N, K): offsets from the start in pixels, gray values, and 1 or 0 for those beyond the window."""

    x: Array
    y: Array
    values: Array
    weights: Array

    def take(self, rows: Array) -> "_Windows":
        return _Windows(self.x[rows], self.y[rows], self.values[rows], self.weights[rows])


def fit_corners(
    gray: Array, pixels: Array, steps: Array, clearance: float = np.inf, *, quick: bool = False
) -> CornerFits:
    """Return the corners fitted from starts pixels (N, 2).

    gray: (H, W). steps: (N, 2, 2), columns are the vectors to the next corner along the row and down the column.
    clearance: how far from the nearer edge, in steps, samples may lie: less than the margin around a marker.
    quick: with a quarter of the samples, to some tenths of a pixel.
    """
    windows, reach = _windows(gray, pixels, steps, clearance, _COARSE if quick else 1)
    parameters = _start(windows, steps)
    parameters, cost = _minimise(windows, parameters, max(_LARGEST_BLUR_PX, reach / 3), 0.02 if quick else _SETTLED_PX)
    moved = parameters[:, [_X, _Y]]
    agreement = 1 - cost / np.maximum(_variation(windows), 1e-9)
    return CornerFits(pixels + moved, parameters[:, _CONTRAST], agreement)


def _windows(gray: Array, pixels: Array, steps: Array, clearance: float, stride: int) -> tuple[_Windows, float]:
    """Return the samples around every start and the largest radius in pixels."""
    lengths = np.linalg.norm(steps, axis=1)
    limit = np.maximum(REACH_PX, REACH_SHARE * lengths.min(axis=1))
    reach = float(max(CORE_PX, np.minimum(SHARE * lengths.max(axis=1), limit).max()))
    side = np.arange(-int(reach / stride) - 1, int(reach / stride) + 2) * stride
    offsets = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    places = np.rint(pixels).astype(np.intp)[:, None] + offsets
    used = _in_window(places - pixels[:, None], steps, limit[:, None], clearance)
    used &= ((places >= 0) & (places < (gray.shape[1], gray.shape[0]))).all(axis=-1)
    order = np.argsort(~used, axis=1, kind="stable")[:, : int(used.sum(axis=1).max())]
    places = np.take_along_axis(places, order[..., None], axis=1)
    away = places - pixels[:, None]
    column, row = np.moveaxis(places, -1, 0)
    values = gray[np.clip(row, 0, gray.shape[0] - 1), np.clip(column, 0, gray.shape[1] - 1)]
    weights = np.take_along_axis(used, order, axis=1)
    return _Windows(away[..., 0], away[..., 1], values.astype(np.float64), weights.astype(np.float64)), reach


def _in_window(away: Array, steps: Array, limit: Array, clearance: float) -> Array:
    """Return which samples (N, K), offsets (N, K, 2) in pixels, belong to the windows: a disc in the board's plane,
    of which what is far from both edges is left out.
    """
    in_steps = np.abs(away @ _inverse(steps).swapaxes(1, 2))
    radius = np.hypot(away[..., 0], away[..., 1])
    disc = (np.hypot(in_steps[..., 0], in_steps[..., 1]) < SHARE) & (radius <= limit)
    edge_distance = (in_steps * _heights(steps)[:, None]).min(axis=-1)
    near = (edge_distance < np.maximum(BAND_PX, BAND_SHARE * limit)) & (in_steps.min(axis=-1) < clearance)
    return np.asarray((disc & near) | (radius <= CORE_PX))


def _heights(steps: Array) -> Array:
    """Return how far from an edge (N, 2) one step leads: along the row from the column's edge, and the reverse."""
    return np.abs(np.linalg.det(steps))[:, None] / np.linalg.norm(steps, axis=1)[:, ::-1]


def _inverse(steps: Array) -> Array:
    """Return the inverses of (N, 2, 2), of the unit matrix where two steps are parallel: those fits fail by agreement."""
    flat = np.abs(np.linalg.det(steps)) < 1e-3
    return np.asarray(np.linalg.inv(np.where(flat[:, None, None], np.eye(2), steps)))


def _variation(windows: _Windows) -> Array:
    """Return the sum of squares (N,) about the plane through every window.

    A board's outer corner, dark on one side of three, is half a plane: against the mean it would look like a crossing.
    """
    plane = np.stack([np.ones_like(windows.x), windows.x, windows.y], axis=1) * windows.weights[:, None]
    values = windows.values * windows.weights
    normal = plane @ plane.swapaxes(1, 2) + 1e-9 * np.eye(3)
    fitted = np.linalg.solve(normal, plane @ values[..., None])
    return np.asarray(((values - (plane.swapaxes(1, 2) @ fitted)[..., 0]) ** 2).sum(axis=1))


def _start(windows: _Windows, steps: Array) -> Array:
    """Return the parameters (N, 9) at the start: edges along the steps, gray levels by linear least squares."""
    parameters = np.zeros((len(steps), _COUNT))
    parameters[:, _ANGLE_1] = np.arctan2(steps[:, 1, 0], steps[:, 0, 0])
    parameters[:, _ANGLE_2] = np.arctan2(steps[:, 1, 1], steps[:, 0, 1])
    residuals, jacobian = _evaluate(parameters, windows)
    linear = jacobian[:, _LEVEL:]
    normal = linear @ linear.swapaxes(1, 2) + 1e-9 * np.eye(_COUNT - _LEVEL)
    parameters[:, _LEVEL:] = np.linalg.solve(normal, linear @ residuals[..., None])[..., 0]
    return parameters


def _minimise(windows: _Windows, parameters: Array, largest_blur: float, settled: float) -> tuple[Array, Array]:
    """Return parameters (N, 9) and costs (N,), by Levenberg-Marquardt on every window alone."""
    cost, normal, gradient = _linearise(parameters, windows)
    damping = np.full(len(parameters), 1e-3)
    active = np.ones(len(parameters), dtype=bool)
    for _ in range(_ROUNDS):
        rows = np.flatnonzero(active)
        if not len(rows):
            break
        step = _damped_step(normal[rows], gradient[rows], damping[rows])
        trial = parameters[rows] + step
        trial[:, _LOG_BLUR] = np.clip(trial[:, _LOG_BLUR], _SHARP, np.log(largest_blur))
        trial_cost, trial_normal, trial_gradient = _linearise(trial, windows.take(rows))
        better = trial_cost <= cost[rows]
        kept = rows[better]
        parameters[kept], cost[kept] = trial[better], trial_cost[better]
        normal[kept], gradient[kept] = trial_normal[better], trial_gradient[better]
        damping[rows] *= np.where(better, 0.2, 8.0)
        active[rows] = np.abs(step[:, [_X, _Y]]).max(axis=1) > settled
    return parameters, cost


def _damped_step(normal: Array, gradient: Array, damping: Array) -> Array:
    damped = normal.copy()
    diagonal = np.arange(_COUNT)
    damped[:, diagonal, diagonal] *= 1 + damping[:, None]
    damped[:, diagonal, diagonal] += 1e-9  # windows with less than nine samples
    return np.asarray(np.linalg.solve(damped, gradient[..., None])[..., 0])


def _linearise(parameters: Array, windows: _Windows) -> tuple[Array, Array, Array]:
    residuals, jacobian = _evaluate(parameters, windows)
    return (
        (residuals**2).sum(axis=1),
        jacobian @ jacobian.swapaxes(1, 2),
        (jacobian @ residuals[..., None])[..., 0],
    )


def _evaluate(parameters: Array, windows: _Windows) -> tuple[Array, Array]:
    """Return values minus model (N, K) and the model's derivatives (N, 9, K), both times the weights."""
    weights = windows.weights
    dx, dy = windows.x - parameters[:, [_X]], windows.y - parameters[:, [_Y]]
    cos_1, sin_1 = np.cos(parameters[:, [_ANGLE_1]]), np.sin(parameters[:, [_ANGLE_1]])
    cos_2, sin_2 = np.cos(parameters[:, [_ANGLE_2]]), np.sin(parameters[:, [_ANGLE_2]])
    distance_1, distance_2 = cos_1 * dy - sin_1 * dx, cos_2 * dy - sin_2 * dx
    own_blur = np.exp(2 * parameters[:, [_LOG_BLUR]])
    scale = _ROOT_HALF / np.sqrt(_LEAST_BLUR_PX**2 + own_blur)
    side_1, side_2 = erf(scale * distance_1), erf(scale * distance_2)
    contrast = parameters[:, [_CONTRAST]]
    slope_x, slope_y = parameters[:, [7]], parameters[:, [8]]
    model = parameters[:, [_LEVEL]] + contrast * side_1 * side_2 + slope_x * windows.x + slope_y * windows.y
    peak = contrast * weights * scale * (2 / np.sqrt(np.pi))
    by_1 = peak * np.exp(-((scale * distance_1) ** 2)) * side_2
    by_2 = peak * np.exp(-((scale * distance_2) ** 2)) * side_1
    jacobian = np.stack(
        [
            by_1 * sin_1 + by_2 * sin_2,
            -by_1 * cos_1 - by_2 * cos_2,
            -by_1 * (cos_1 * dx + sin_1 * dy),
            -by_2 * (cos_2 * dx + sin_2 * dy),
            -(by_1 * distance_1 + by_2 * distance_2) * (own_blur / (_LEAST_BLUR_PX**2 + own_blur)),
            weights,
            side_1 * side_2 * weights,
            windows.x * weights,
            windows.y * weights,
        ],
        axis=1,
    )
    return (windows.values - model) * weights, jacobian
