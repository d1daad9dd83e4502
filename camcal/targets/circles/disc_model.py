"""The picture of a dot with eleven unknowns, and their estimate, for all dots of an image at once.

Around a rim the image is modelled as
    (1 + g · (x, y)) · (level + contrast · (f + tone · f (1 - f))),   f the picture of disc_edge.py,
with the ellipse's centre and axes, its blur, the gradient g of the light, and a tone for what gamma does to what is
blurred already.
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.solve.descent import Stopping
from camcal.solve.independent import Models, Tried, minimise_each
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
_POSSIBLE = np.array([0, 0, 1, 0, 1, 0, 0, 1, 0, 0, 0], dtype=float)  # a state inside the domain
# Costs are summed in single precision.
_STOPPING = Stopping(iterations=25, damping=1e-3, least=0.2, rise=8.0, by_gain=False, restart=0.0)


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
    """Return parameters (N, 11), sums of squares (N,) and normal matrices (N, 11, 11).

    tone_spread: the standard deviation of the tone beforehand; the normal matrices count it and the gradient's.
    settled: what a last step may promise to take off the sum, in variances of the noise.
    """
    precision = np.zeros(COUNT)
    precision[TONE], precision[GRADIENT] = tone_spread**-2, _GRADIENT**-2
    discs = _Discs(samples, precision, np.maximum(samples.used.sum(axis=1) - COUNT, 1))

    def enough(tried: Tried) -> Array:
        return np.asarray(2 * tried.promised <= settled)

    found = minimise_each(discs, parameters, np.arange(len(parameters)), _STOPPING, enough=enough)
    squares = discs.squares(found.states, found.cost)
    return found.states, squares, found.models.normal * discs.variance(squares)[:, None, None]


@dataclass(frozen=True, eq=False)
class _Discs:
    """The fits of N dots, for the solver: minus the logarithms of the posterior probabilities of states (N, 11), whose
    noise is what the residuals say.

    precision: (11,) of the priors, about zero. freedom: (N,) degrees of freedom of the residuals.
    """

    samples: RimSamples
    precision: Array
    freedom: Array

    def linearise(self, states: Array, which: Array) -> Models:
        """Return the models at states (W, 11) of the dots `which` (W,); ellipses that are too thin are outside."""
        possible = np.linalg.eigvalsh(axes_of(states))[:, 0] > _THINNEST
        states = np.where(possible[:, None], states, _POSSIBLE)
        residuals, jacobian = _evaluate(states, self.samples.take(which))
        freedom = self.freedom[which]
        variance = (residuals**2).sum(axis=1, dtype=np.float64) / freedom + ROUNDING
        cost = 0.5 * (freedom * (1 + np.log(variance / ROUNDING)) + states**2 @ self.precision)
        normal = (jacobian @ jacobian.swapaxes(1, 2)).astype(np.float64) / variance[:, None, None]
        slopes = (jacobian @ residuals[..., None])[..., 0].astype(np.float64) / variance[:, None]
        gradient = states * self.precision - slopes
        return Models(np.where(possible, cost, np.inf), gradient, normal + np.diag(self.precision))

    def retract(self, states: Array, steps: Array) -> Array:
        """Return the states after steps, the blur within what it may be."""
        moved = states + steps
        moved[:, BLUR] = np.clip(moved[:, BLUR], *_LOG_BLUR)
        return moved

    def squares(self, states: Array, cost: Array) -> Array:
        """Return the sums of squared residuals (N,) of states with these costs."""
        logarithms = (2 * cost - states**2 @ self.precision) / self.freedom - 1
        return np.asarray(ROUNDING * self.freedom * np.expm1(logarithms))

    def variance(self, squares: Array) -> Array:
        """Return the variance (N,) of the noise of one pixel."""
        return np.asarray(squares / self.freedom + ROUNDING)


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
