"""Corners of a checker pattern to some hundredths of a pixel, from starts that may be far away.

Around a corner the image is modelled as  level + slope · (x, y) + contrast · f,  f the crossing of two straight edges
through the corner (crossing.py). All corners are fitted at once, each by its own Levenberg-Marquardt iteration. What is
left over tells a corner from what is none; refine.py then measures those that are.
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.targets.crossing import PIXEL_VARIANCE, crossing
from camcal.targets.windows import FINE, Samples, Window, sample

_LARGEST_BLUR_PX = 4.0  # or a third of the window
_ROUNDING = 1 / 12  # gray levels squared
_ROUNDS = 15
_SETTLED_PX = 1e-3  # the step after such a step is of the order of 1e-5 px
_SETTLED_COARSE_PX = 0.02
_SHARP = -4.0  # a logarithm of blur that adds nothing to the least
_X, _Y, _ANGLE_1, _ANGLE_2, _LOG_BLUR, _LEVEL, _CONTRAST, _SLOPE_X, _SLOPE_Y = range(9)
_COUNT = 9


@dataclass(frozen=True, eq=False)
class CornerFits:
    """What was fitted at N corners.

    pixels: (N, 2). contrast: (N,) gray levels, half of bright minus dark; positive where the square before both steps
    is dark. agreement: (N,) share of the window's variance about a plane that the model explains, 1 is perfect, 0 where
    the corner has left its window.
    """

    pixels: Array
    contrast: Array
    agreement: Array


def fit_corners(
    gray: Array,
    pixels: Array,
    steps: Array,
    window: Window = FINE,
    clearance: float = np.inf,
    sites: Array | None = None,
) -> CornerFits:
    """Return the corners fitted from starts pixels (N, 2).

    gray: (H, W). steps: (N, 2, 2), columns are the vectors to the next corner along the row and down the column.
    clearance: how far from the nearer edge, in steps, samples may lie: less than the margin around a marker.
    sites: (H, W) mask of the pixels that count, as the samples of one colour do in a mosaic; None for all.
    """
    samples = sample(gray, pixels, steps, window, clearance, sites)
    settled = _SETTLED_PX if window.across == np.inf else _SETTLED_COARSE_PX
    parameters, cost = _minimise(samples, _start(samples, steps), settled)
    moved = parameters[:, [_X, _Y]]
    inside = np.hypot(*moved.T) < samples.reach
    return CornerFits(pixels + moved, parameters[:, _CONTRAST], np.where(inside, _agreement(samples, cost), 0.0))


def _agreement(samples: Samples, cost: Array) -> Array:
    """Return the share (N,) of the variation about a plane that is explained; 0 of an empty wall, or by few samples."""
    count = samples.weights.sum(axis=1)
    rounding = _ROUNDING * np.maximum(count, 1)
    explained = 1 - (cost + rounding) / (_variation(samples) + rounding)
    return np.where(count >= 2 * _COUNT, explained, 0.0)


def _variation(samples: Samples) -> Array:
    """Return the sum of squares (N,) about the plane through every window.

    A board's outer corner, dark on one side of three, is half a plane: against the mean it would look like a crossing.
    """
    plane = np.stack([np.ones_like(samples.x), samples.x, samples.y], axis=1) * samples.weights[:, None]
    values = samples.values * samples.weights
    normal = plane @ plane.swapaxes(1, 2) + 1e-9 * np.eye(3)
    fitted = np.linalg.solve(normal, plane @ values[..., None])
    return np.asarray(((values - (plane.swapaxes(1, 2) @ fitted)[..., 0]) ** 2).sum(axis=1))


def _start(samples: Samples, steps: Array) -> Array:
    """Return the parameters (N, 9) at the start: edges along the steps, gray levels by linear least squares."""
    parameters = np.zeros((len(steps), _COUNT))
    parameters[:, _LOG_BLUR] = np.log(samples.blur)
    parameters[:, _ANGLE_1] = np.arctan2(steps[:, 1, 0], steps[:, 0, 0])
    parameters[:, _ANGLE_2] = np.arctan2(steps[:, 1, 1], steps[:, 0, 1])
    residuals, jacobian = _evaluate(parameters, samples)
    linear = jacobian[:, _LEVEL:]
    normal = linear @ linear.swapaxes(1, 2) + 1e-9 * np.eye(_COUNT - _LEVEL)
    parameters[:, _LEVEL:] = np.linalg.solve(normal, linear @ residuals[..., None])[..., 0]
    return parameters


def _minimise(samples: Samples, parameters: Array, settled: float) -> tuple[Array, Array]:
    """Return parameters (N, 9) and costs (N,), by Levenberg-Marquardt on every window alone."""
    cost, normal, gradient = _linearise(parameters, samples)
    damping = np.full(len(parameters), 1e-3)
    largest_blur = np.log(max(_LARGEST_BLUR_PX, samples.reach / 3))
    active = np.ones(len(parameters), dtype=bool)
    for _ in range(_ROUNDS):
        rows = np.flatnonzero(active)
        if not len(rows):
            break
        step = _damped_step(normal[rows], gradient[rows], damping[rows])
        trial = parameters[rows] + step
        trial[:, _LOG_BLUR] = np.clip(trial[:, _LOG_BLUR], _SHARP, largest_blur)
        trial_cost, trial_normal, trial_gradient = _linearise(trial, samples.take(rows))
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
    damped[:, diagonal, diagonal] += 1e-9  # samples with less than nine samples
    return np.asarray(np.linalg.solve(damped, gradient[..., None])[..., 0])


def _linearise(parameters: Array, samples: Samples) -> tuple[Array, Array, Array]:
    residuals, jacobian = _evaluate(parameters, samples)
    return (
        (residuals**2).sum(axis=1),
        jacobian @ jacobian.swapaxes(1, 2),
        (jacobian @ residuals[..., None])[..., 0],
    )


def _evaluate(parameters: Array, samples: Samples) -> tuple[Array, Array]:
    """Return values minus model (N, K) and the model's derivatives (N, 9, K), both times the weights."""
    weights = samples.weights
    dx, dy = samples.x - parameters[:, [_X]], samples.y - parameters[:, [_Y]]
    cos_1, sin_1 = np.cos(parameters[:, [_ANGLE_1]]), np.sin(parameters[:, [_ANGLE_1]])
    cos_2, sin_2 = np.cos(parameters[:, [_ANGLE_2]]), np.sin(parameters[:, [_ANGLE_2]])
    distance_1, distance_2 = cos_1 * dy - sin_1 * dx, cos_2 * dy - sin_2 * dx
    own_blur = np.exp(2 * parameters[:, [_LOG_BLUR]])
    scale = 1 / np.sqrt(PIXEL_VARIANCE + own_blur)
    seen = crossing(scale * distance_1, scale * distance_2, cos_1 * cos_2 + sin_1 * sin_2)
    contrast, slope_x, slope_y = (parameters[:, [k]] for k in (_CONTRAST, _SLOPE_X, _SLOPE_Y))
    model = parameters[:, [_LEVEL]] + contrast * seen.value + slope_x * samples.x + slope_y * samples.y
    gain = contrast * weights * scale
    by_1, by_2 = gain * seen.by_first, gain * seen.by_second
    jacobian = np.stack(
        [
            by_1 * sin_1 + by_2 * sin_2,
            -by_1 * cos_1 - by_2 * cos_2,
            -by_1 * (cos_1 * dx + sin_1 * dy),
            -by_2 * (cos_2 * dx + sin_2 * dy),
            -(by_1 * distance_1 + by_2 * distance_2) * (own_blur * scale**2),
            weights,
            seen.value * weights,
            samples.x * weights,
            samples.y * weights,
        ],
        axis=1,
    )
    return (samples.values - model) * weights, jacobian
