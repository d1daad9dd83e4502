"""The image model of a circle with eleven parameters, fitted to all circles of an image at once.

Around a rim the image is modelled as
    (1 + g · (x, y)) · (level + contrast · (f + tone · f (1 - f))),
with the ellipse's centre and axes, its blur, the gradient g of the light, and a tone for what gamma does to what is
blurred already. f is the picture of a disc under a blur, seen as an ellipse. With d the signed distance to the rim,
positive outside, κ the rim's curvature and s the blur it is
    E[Φ(-d / s - b(ε))],   b(ε) = (1 - √(1 - κ² s² ε²)) / (κ s) = ½ κ s ε² + ⅛ κ³ s³ ε⁴ + …,
Φ the normal distribution and ε a normal number, the blur along the rim, which carries a sample of a round disc out of
it. The mean is taken at ε = 0 and ± √3 (the Gauss-Hermite rule of three points). The picture is the same on opposite
sides of the centre, so that what it leaves out, the rim's change of curvature, does not move that.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from camcal.arrays import Array
from camcal.solve.descent import Stopping
from camcal.solve.independent import Models, Trial, minimise_each
from camcal.targets.circles.blobs import Ellipses


@dataclass(frozen=True, eq=False)
class RimSamples:
    """Samples (N, K) around N ellipses: offsets from the starts (pixels), gray values, 1 for those that count or 0.

    reach: (N, 1) pixels, the largest offset of each. whole: (N,) share of each window that is within the image.
    others: (N, K) how much of a sample other ellipses cover.
    """

    x: Array
    y: Array
    values: Array
    used: Array
    reach: Array
    whole: Array
    others: Array

    def take(self, rows: Array) -> "RimSamples":
        """Return the samples of some of the windows."""
        return RimSamples(
            self.x[rows],
            self.y[rows],
            values=self.values[rows],
            used=self.used[rows],
            reach=self.reach[rows],
            whole=self.whole[rows],
            others=self.others[rows],
        )


def sample(gray: Array, start: Ellipses, band: float, room: Array, most: float = np.inf) -> RimSamples:
    """Return the samples not farther than `band` (px) from the rims, `most` an ellipse or a few more.

    room: (N,) the multiple of an ellipse's axes that samples may reach outwards, short of the next ellipse.
    """
    height, width = gray.shape
    half = np.linalg.norm(start.axes, axis=2).max() + band  # rows' lengths are half the sides of the bounding box
    side = np.arange(-int(half) - 1, int(half) + 2)
    offsets = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    whole = np.rint(start.centres).astype(np.intp)
    shift = whole - start.centres
    owner, place = np.nonzero(_near_rim(offsets + shift[:, None], start.axes, band, room))
    count = np.bincount(owner, minlength=len(whole))
    every = np.maximum(1, (count / most).astype(np.intp))[owner]
    kept = (np.arange(len(owner)) - (np.cumsum(count) - count)[owner]) % every == 0
    owner, offset = owner[kept], offsets[place[kept]]
    column, row = (whole[owner] + offset).T
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    wanted = np.bincount(owner, minlength=len(whole))
    owner, offset, column, row = owner[inside], offset[inside], column[inside], row[inside]
    count = np.bincount(owner, minlength=len(whole))
    slot = np.arange(len(owner)) - (np.cumsum(count) - count)[owner]
    x, y, values, used = np.zeros((4, len(whole), max(1, int(count.max()))), np.float32)
    x[owner, slot], y[owner, slot] = (offset + shift[owner]).T
    values[owner, slot], used[owner, slot] = gray[row, column], 1
    reach = np.maximum(np.abs(x), np.abs(y)).max(axis=1, keepdims=True) + 1
    return RimSamples(
        x, y, values=values, used=used, reach=reach, whole=count / np.maximum(wanted, 1), others=np.zeros_like(x)
    )


def _near_rim(away: Array, axes: Array, band: float, room: Array) -> Array:
    """Return which offsets (N, K, 2) lie within the band, to first order, and within the room."""
    x, y = np.moveaxis(away.astype(np.float32), -1, 0)
    inverse = np.linalg.inv(axes).astype(np.float32)
    a, b, c = (inverse[:, i, j, None] for i, j in ((0, 0), (0, 1), (1, 1)))
    across, down = a * x + b * y, b * x + c * y
    square = across * across + down * down
    slope = np.sqrt((a * across + b * down) ** 2 + (b * across + c * down) ** 2)
    near = np.abs(square - np.sqrt(square)) < band * slope
    return np.asarray(
        (near | (square < 0.25) & (np.linalg.det(axes)[:, None] < band**2)) & (square < room[:, None] ** 2)
    )


PIXEL_VARIANCE = 1 / 12  # of a pixel's own square, which blurs every picture
ROUNDING = 1 / 12  # gray levels squared
COUNT = 11
CENTRE, AXES, BLUR, LEVEL, CONTRAST, TONE, GRADIENT = (
    slice(0, 2), slice(2, 5), 5, 6, 7, 8, slice(9, 11),
)  # fmt: skip

_START_BLUR = 1.0  # px
_GRADIENT = 0.02  # spread of the light's change from a window's middle to its rim; a wide blur resembles one
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

    def enough(tried: Trial) -> Array:
        return np.asarray(2 * tried.promised <= settled)

    found = minimise_each(discs, parameters, np.arange(len(parameters)), _STOPPING, enough=enough)
    squares = discs.squares(found.states, found.cost)
    return found.states, squares, found.models.normal * discs.variance(squares)[:, None, None]


@dataclass(frozen=True, eq=False)
class _Discs:
    """The fits of N dots, for the solver: minus the logarithms of the posterior probabilities of states (N, 11), whose
    noise is what the residuals say.

    precision: (11,) of the priors, about zero. dof: (N,) degrees of freedom of the residuals.
    """

    samples: RimSamples
    precision: Array
    dof: Array

    def linearise(self, states: Array, which: Array) -> Models:
        """Return the models at states (W, 11) of the dots `which` (W,); ellipses that are too thin are outside."""
        possible = np.linalg.eigvalsh(axes_of(states))[:, 0] > _THINNEST
        states = np.where(possible[:, None], states, _POSSIBLE)
        residuals, jacobian = _evaluate(states, self.samples.take(which))
        dof = self.dof[which]
        variance = (residuals**2).sum(axis=1, dtype=np.float64) / dof + ROUNDING
        cost = 0.5 * (dof * (1 + np.log(variance / ROUNDING)) + states**2 @ self.precision)
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
        logarithms = (2 * cost - states**2 @ self.precision) / self.dof - 1
        return np.asarray(ROUNDING * self.dof * np.expm1(logarithms))

    def variance(self, squares: Array) -> Array:
        """Return the variance (N,) of the noise of one pixel."""
        return np.asarray(squares / self.dof + ROUNDING)


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


_DENSITY = np.float32(1 / np.sqrt(2 * np.pi))
_TINY = np.float32(1e-6)  # so that the centre itself has a direction
_STEPS = 3  # good to 1e-5 of the long axis where the short one is half as long, to 5e-5 at a seventh
_NEAR, _FAR = np.float32(2 / 3), np.float32(1 / 3)  # weights of ε = 0 and of ε² = 3
_FIRST, _THIRD = np.float32(3 / 2), np.float32(9 / 8)  # the terms of b for ε² = 3


@dataclass(frozen=True, eq=False)
class Rim:
    """Where samples (N, K) lie to the rims of N ellipses, pixels.

    distance: positive outside. curvature: 1 / px, of the rim nearby. outward: (N, 2, K) unit normals. unit: (N, 2, K)
    the points of the unit circle that the axes take to the rim nearby.
    """

    distance: Array
    curvature: Array
    outward: Array
    unit: Array


@dataclass(frozen=True, eq=False)
class Picture:
    """The picture (N, K), 1 inside and 0 outside, and its derivatives by the distance and by the blur, per pixel."""

    value: Array
    by_distance: Array
    by_blur: Array


def rim(x: Array, y: Array, axes: Array) -> Rim:
    """Return where samples lie, x, y (N, K) from the ellipses' centres; axes (N, 2, 2) symmetric."""
    lengths, frames = (part.astype(x.dtype) for part in np.linalg.eigh(axes))
    long, short = lengths[:, [1]], lengths[:, [0]]
    (long_x, long_y), (short_x, short_y) = (frames[:, :, k].T[..., None] for k in (1, 0))
    along, across = x * long_x + y * long_y, x * short_x + y * short_y
    cosine, sine = _nearest(np.abs(along), np.abs(across), long, short)
    cosine, sine = np.copysign(cosine, along), np.copysign(sine, across)
    steepness = _length(cosine / long, sine / short)
    normal_along, normal_across = cosine / (long * steepness), sine / (short * steepness)
    distance = (along - long * cosine) * normal_along + (across - short * sine) * normal_across
    return Rim(
        distance,
        1 / ((long * short) ** 2 * (steepness * steepness * steepness)),
        np.stack([normal_along * long_x + normal_across * short_x, normal_along * long_y + normal_across * short_y], 1),
        np.stack([cosine * long_x + sine * short_x, cosine * long_y + sine * short_y], axis=1),
    )


def _nearest(along: Array, across: Array, long: Array, short: Array) -> tuple[Array, Array]:
    """Return cosine and sine (N, K) of the points of ellipses nearest to samples in their first quadrant.

    By steps on the circle that osculates the ellipse at the last point, from the middle of its quadrant.
    """
    cosine = sine = np.full_like(along, np.sqrt(0.5))
    middle_along, middle_across = (long**2 - short**2) / long, (short**2 - long**2) / short
    for _ in range(_STEPS):
        cube_along, cube_across = middle_along * (cosine * cosine * cosine), middle_across * (sine * sine * sine)
        radius = _length(long * cosine - cube_along, short * sine - cube_across)
        off_along, off_across = along - cube_along, across - cube_across
        scale = radius / (_length(off_along, off_across) + _TINY)
        cosine = np.maximum(off_along * scale + cube_along, 0) / long
        sine = np.maximum(off_across * scale + cube_across, 0) / short
        cosine, sine = _normalised(cosine, sine)
    return cosine, sine


def _normalised(x: Array, y: Array) -> tuple[Array, Array]:
    x = x + _TINY
    length = _length(x, y)
    return x / length, y / length


def _length(x: Array, y: Array) -> Array:
    return np.asarray(np.sqrt(x * x + y * y))


def picture(distance: Array, curvature: Array, blur: Array) -> Picture:
    """Return the picture at distances (N, K) from rims of curvature (N, K) under blurs (N, 1)."""
    scaled, bend = distance / blur, curvature * blur
    square = bend * bend
    beyond = scaled + bend * (_FIRST + _THIRD * square)
    density, density_beyond = (
        _DENSITY * weight * np.exp(-0.5 * z * z) for weight, z in ((_NEAR, scaled), (_FAR, beyond))
    )
    both = density + density_beyond
    return Picture(
        _NEAR * ndtr(-scaled) + _FAR * ndtr(-beyond),
        -both / blur,
        (scaled * both - density_beyond * bend * (_FIRST + 3 * _THIRD * square)) / blur,
    )
