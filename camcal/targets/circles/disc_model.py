"""The picture of a dot with eleven unknowns, and their estimate, for all dots of an image at once.

Around a rim the image is modelled as
    (1 + g · (x, y)) · (level + contrast · (f + tone · f (1 - f))),   f the picture of disc_edge.py,
with the ellipse's centre and axes, its blur, the gradient g of the light, and a tone for what gamma does to what is
blurred already. Each dot has a Levenberg-Marquardt iteration of its own.
"""

import numpy as np

from camcal.arrays import Array
from camcal.targets.circles.disc_edge import picture, rim
from camcal.targets.circles.disc_window import RimSamples

PIXEL_VARIANCE = 1 / 12  # of a pixel's own square, which blurs every picture
ROUNDING = 1 / 12  # gray levels squared
COUNT = 11
CENTRE, AXES, BLUR, LEVEL, CONTRAST, TONE, GRADIENT = (
    slice(0, 2), slice(2, 5), 5, 6, 7, 8, slice(9, 11),
)  # fmt: skip

_START_BLUR = 1.0  # px
_GRADIENT = 0.02  # spread of the light's change from a window's middle to its rim; a wide blur looks like one
_LOG_BLUR = (-3.0, 2.0)
_THINNEST = 0.3  # px, a half axis
_ROUNDS = 25


def start_of(samples: RimSamples, axes: Array) -> Array:
    """Return the parameters (N, 11) of ellipses where their samples are centred, levels by linear least squares."""
    parameters = np.zeros((len(axes), COUNT))
    parameters[:, AXES] = axes[:, [0, 0, 1], [0, 1, 1]]
    parameters[:, BLUR] = np.log(_START_BLUR)
    parameters[:, CONTRAST] = 1.0
    linear = _evaluate(parameters, samples)[1][:, [LEVEL, CONTRAST]].astype(np.float64)
    normal = linear @ linear.swapaxes(1, 2) + 1e-9 * np.eye(2)
    parameters[:, [LEVEL, CONTRAST]] = np.linalg.solve(normal, linear @ samples.values[..., None])[..., 0]
    return parameters


def axes_of(parameters: Array) -> Array:
    """Return the axes (N, 2, 2) in parameters (N, 11)."""
    return np.asarray(parameters[:, [2, 3, 3, 4]].reshape(-1, 2, 2))


def blur_of(parameters: Array) -> Array:
    """Return the blur (N,) in parameters (N, 11), the pixel's own square included, px."""
    return np.asarray(np.sqrt(PIXEL_VARIANCE + np.exp(2 * parameters[:, BLUR])))


def minimise(samples: RimSamples, parameters: Array, tone_spread: float, settled: float) -> tuple[Array, Array, Array]:
    """Return parameters (N, 11), costs (N,) and normal matrices (N, 11, 11).

    tone_spread: the standard deviation of the tone beforehand; the normal matrices count it and the gradient's.
    settled: what a last step may promise to take off the cost, in variances of the noise.
    """
    expected = np.zeros(COUNT)
    expected[TONE], expected[GRADIENT] = tone_spread**-2, _GRADIENT**-2
    freedom = np.maximum(samples.used.sum(axis=1) - COUNT, 1)
    cost, normal, gradient = _linearise(parameters, samples)
    damping = np.full(len(parameters), 1e-3)
    active = np.ones(len(parameters), dtype=bool)
    for _ in range(_ROUNDS):
        rows = np.flatnonzero(active)
        if not len(rows):
            break
        variance = cost[rows] / freedom[rows] + ROUNDING
        weights = variance[:, None] * expected
        step, promise = _damped_step(normal[rows], gradient[rows], damping[rows], weights, parameters[rows])
        trial = parameters[rows] + step
        trial[:, BLUR] = np.clip(trial[:, BLUR], *_LOG_BLUR)
        possible = np.linalg.eigvalsh(axes_of(trial))[:, 0] > _THINNEST
        trial[~possible] = parameters[rows[~possible]]
        trial_cost, trial_normal, trial_gradient = _linearise(trial, samples.take(rows))
        dearer = (weights * (trial**2 - parameters[rows] ** 2)).sum(axis=1)
        better = (trial_cost + dearer <= cost[rows]) & possible
        kept = rows[better]
        parameters[kept], cost[kept] = trial[better], trial_cost[better]
        normal[kept], gradient[kept] = trial_normal[better], trial_gradient[better]
        damping[rows] *= np.where(better, 0.2, 8.0)
        active[rows] = promise > settled * variance
    normal += (cost / freedom + ROUNDING)[:, None, None] * np.diag(expected)
    return parameters, cost, normal


def _damped_step(
    normal: Array, gradient: Array, damping: Array, weights: Array, parameters: Array
) -> tuple[Array, Array]:
    """Return the steps (N, 11) and how much less the cost (N,) would be if the model were linear."""
    damped, gradient = normal.copy(), gradient - weights * parameters
    diagonal = np.arange(COUNT)
    damped[:, diagonal, diagonal] = (damped[:, diagonal, diagonal] + weights) * (1 + damping[:, None]) + 1e-9
    step = np.linalg.solve(damped, gradient[..., None])[..., 0]
    return step, np.abs((step * gradient).sum(axis=1))


def _linearise(parameters: Array, samples: RimSamples) -> tuple[Array, Array, Array]:
    """Return costs (N,), normal matrices (N, 11, 11) and gradients (N, 11)."""
    residuals, jacobian = _evaluate(parameters, samples)
    return (
        (residuals**2).sum(axis=1, dtype=np.float64),
        (jacobian @ jacobian.swapaxes(1, 2)).astype(np.float64),
        (jacobian @ residuals[..., None])[..., 0].astype(np.float64),
    )


def _evaluate(parameters: Array, samples: RimSamples) -> tuple[Array, Array]:
    """Return values minus model (N, K) and the model's derivatives (N, 11, K), zero where samples do not count."""
    used, axes = samples.used, axes_of(parameters)
    parameters = parameters.astype(np.float32)
    near = rim(samples.x - parameters[:, [0]], samples.y - parameters[:, [1]], axes)
    own = np.exp(2 * parameters[:, [BLUR]])
    blur = np.sqrt(np.float32(PIXEL_VARIANCE) + own)
    seen = picture(near.distance, near.curvature, blur)
    value = seen.value + samples.others
    level, contrast, tone = (parameters[:, [k]] for k in (LEVEL, CONTRAST, TONE))
    x, y = samples.x / samples.reach, samples.y / samples.reach
    light = (1 + parameters[:, [9]] * x + parameters[:, [10]] * y) * used
    bow = value * (1 - value)
    shown = value + tone * bow
    even = level + contrast * shown
    gain = light * contrast * (1 + tone * (1 - 2 * value))
    jacobian = np.empty((len(parameters), COUNT, used.shape[1]), np.float32)
    along = (-gain * seen.by_distance)[:, None] * near.outward
    jacobian[:, CENTRE] = along
    jacobian[:, 2] = along[:, 0] * near.unit[:, 0]
    jacobian[:, 3] = along[:, 0] * near.unit[:, 1] + along[:, 1] * near.unit[:, 0]
    jacobian[:, 4] = along[:, 1] * near.unit[:, 1]
    jacobian[:, BLUR] = gain * seen.by_blur * own / blur
    jacobian[:, LEVEL] = light
    jacobian[:, CONTRAST] = light * shown
    jacobian[:, TONE] = light * contrast * bow
    jacobian[:, 9], jacobian[:, 10] = even * x * used, even * y * used
    return samples.values * used - even * light, jacobian
