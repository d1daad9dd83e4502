"""Circles fitted to an image: blurred ellipses around their rims, eleven parameters each, all of them at once.

First roughly to some samples, then to all that the rims' blur reaches. Where dots stand so close that the blur of one
reaches the next, what the others put into a window is counted in. Around a rim the image is modelled as
    (1 + g · (x, y)) · (level + contrast · (f + tone · f (1 - f))),
with the ellipse's centre and axes, its blur, the gradient g of the light, and a tone for what gamma does to what is
blurred already. f is the picture of a disc under a blur, seen as an ellipse. With d the signed distance to the rim,
positive outside, κ the rim's curvature and s the blur it is
    E[Φ(-d / s - b(ε))],   b(ε) = (1 - √(1 - κ² s² ε²)) / (κ s) = ½ κ s ε² + ⅛ κ³ s³ ε⁴ + …,
Φ the normal distribution and ε a normal number, the blur along the rim, which carries a sample of a round disc out of
it. The mean is taken at ε = 0 and ± √3 (the Gauss-Hermite rule of three points). The picture is the same on opposite
sides of the centre, so that what it leaves out, the rim's change of curvature, does not move that.
"""

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass, replace
from camcal.solve.descent import Stopping
from camcal.solve.independent import Models, Trial, minimise_each
from camcal.targets.ellipses import Ellipses, neighbours, picture, rim


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
        return RimSamples(*(part[rows] for part in vars(self).values()))


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

    minima = minimise_each(discs, parameters, np.arange(len(parameters)), _STOPPING, enough=enough)
    squares = discs.squares(minima.states, minima.cost)
    return minima.states, squares, minima.models.normal * discs.variance(squares)[:, None, None]


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
    variance = np.exp(2 * parameters[:, [BLUR]])
    blur = np.sqrt(np.float32(PIXEL_VARIANCE) + variance)
    seen, by_distance, by_blur = picture(near.distance, near.curvature, blur)
    value = seen + samples.others
    level, contrast, tone = (parameters[:, [k]] for k in (LEVEL, CONTRAST, TONE))
    x, y = samples.x / samples.reach, samples.y / samples.reach
    light = (1 + parameters[:, [9]] * x + parameters[:, [10]] * y) * used
    bow = value * (1 - value)
    shown = value + tone * bow
    even = level + contrast * shown
    gain = light * contrast * (1 + tone * (1 - 2 * value))
    jacobian = np.empty((len(parameters), COUNT, used.shape[1]), np.float32)
    along = (-gain * by_distance)[:, None] * near.outward
    jacobian[:, CENTRE] = along
    jacobian[:, 2] = along[:, 0] * near.unit[:, 0]
    jacobian[:, 3] = along[:, 0] * near.unit[:, 1] + along[:, 1] * near.unit[:, 0]
    jacobian[:, 4] = along[:, 1] * near.unit[:, 1]
    jacobian[:, BLUR] = gain * by_blur * variance / blur
    jacobian[:, LEVEL] = light
    jacobian[:, CONTRAST] = light * shown
    jacobian[:, TONE] = light * contrast * bow
    jacobian[:, 9], jacobian[:, 10] = even * x * used, even * y * used
    return samples.values * used - even * light, jacobian


_COARSE_BAND = 5.0  # px, where the blur is not known and a start may be half a pixel off
_COARSE_SAMPLES = 150  # of a dot
_BAND = 3.2  # standard deviations of the blur
_LEAST_BAND = 2.2  # px
_NO_TONE = 1e-3  # at first: a radius that is off by half a pixel resembles a tone
_TONE = 0.5  # dots of few pixels do not tell it from the blur
_ROUGHLY, _SETTLED = 1.0, 1e-2  # squares of the standard deviations by which a last step moves
_WHOLE = 0.8  # of a window that must lie within the image
_FURTHEST = 0.5  # short axes from the start; a fit that goes further has found something else
_GROWTH = 2.5  # of an ellipse's area from the start, or its inverse
_NEIGHBOURS = 8
_TOUCHING = 6.0  # standard deviations of the blur between two rims that must be fitted together
_LEAST_ROOM = 1.2  # in an ellipse's axes


@dataclass(frozen=True, eq=False)
class DiscFits:
    """What was fitted at N dots.

    ellipses: their centres and axes. covariance: (N, 2, 2) px² of the centres. blur: (N,) px, the pixel's own square
    not counted. level, contrast: (N,) gray levels, of the ground and of the dot less the ground. agreement: (N,) share
    of the window's variance that the model explains, 1 is perfect; 0 where the fit failed. noise: (N,) gray levels.
    """

    ellipses: Ellipses
    covariance: Array
    blur: Array
    level: Array
    contrast: Array
    agreement: Array
    noise: Array


@dataclass(frozen=True, eq=False)
class _Round:
    """A fit to samples around `middle`: parameters (N, 11), costs (N,), normal matrices (N, 11, 11)."""

    samples: RimSamples
    middle: Ellipses
    parameters: Array
    cost: Array
    normal: Array

    @property
    def ellipses(self) -> Ellipses:
        """Return what was fitted."""
        return Ellipses(self.middle.centres + self.parameters[:, CENTRE], axes_of(self.parameters))

    @property
    def blur(self) -> float:
        """Return the median blur, the pixel's own square included, px."""
        return float(np.median(np.sqrt(PIXEL_VARIANCE + np.exp(2 * self.parameters[:, BLUR]))))


def fit_discs(gray: Array, start: Ellipses) -> DiscFits:
    """Return the dots fitted from starts good to half a pixel or so.

    gray: (H, W). start: all the dots there are, for some may stand close to others.
    """
    near = neighbours(start.centres, _NEIGHBOURS)
    away = (start.centres[near] - start.centres[:, None]) @ np.linalg.inv(start.axes)
    distance = np.linalg.norm(away, axis=2)
    room = np.maximum(_LEAST_ROOM, distance.min(axis=1) / 2)
    coarse = sample(gray, start, _COARSE_BAND, room, _COARSE_SAMPLES)
    fit = _Round(coarse, start, *minimise(coarse, start_of(coarse, start.axes), _NO_TONE, _ROUGHLY))
    fit = _refine(gray, fit, start, near, distance)
    if _touching(fit, distance).any():
        fit = _refine(gray, fit, start, near, distance)
    return _result(fit, start)


def _refine(gray: Array, last: _Round, start: Ellipses, near: Array, distance: Array) -> _Round:
    """Return the fit to all samples that the blur of the last one asks for; where that failed, from its start.

    near, distance: (N, M) the nearest other ellipses of every one, and how far their centres are in its own axes.
    """
    good = _accept(last.ellipses, start)
    middle = Ellipses(
        np.where(good[:, None], last.ellipses.centres, start.centres),
        np.where(good[:, None, None], last.ellipses.axes, start.axes),
    )
    touching, spacing = _touching(last, distance), distance.min(axis=1)
    room = np.maximum(_LEAST_ROOM, np.where(touching.any(axis=1), spacing - 1, spacing / 2))
    samples = sample(gray, middle, max(_LEAST_BAND, _BAND * last.blur), room)
    samples = _add_others(samples, middle, near, touching, last.blur)
    begin = start_of(samples, middle.axes)
    begin[good, BLUR : GRADIENT.start] = last.parameters[good, BLUR : GRADIENT.start]
    return _Round(samples, middle, *minimise(samples, begin, _TONE, _SETTLED))


def _accept(ellipses: Ellipses, start: Ellipses) -> Array:
    """Return which fits (N,) are of the ellipses they started from."""
    short = np.linalg.eigvalsh(start.axes)[:, 0]
    moved = np.linalg.norm(ellipses.centres - start.centres, axis=1)
    growth = np.abs(np.log(ellipses.areas / start.areas))
    return np.asarray((moved < np.maximum(_FURTHEST * short, 1.0)) & (growth < np.log(_GROWTH)))


def _touching(fit: _Round, distance: Array) -> Array:
    """Return which dots are reached by the blur of which of those around them at distances (N, M)."""
    short = np.linalg.eigvalsh(fit.ellipses.axes)[:, :1]
    return np.asarray((distance - 2) * short < _TOUCHING * fit.blur)


def _add_others(samples: RimSamples, ellipses: Ellipses, near: Array, touching: Array, blur: float) -> RimSamples:
    """Return the samples with what the pictures of other ellipses put into the windows of those they touch."""
    others = samples.others.copy()
    for which, touched in zip(near.T, touching.T, strict=True):
        rows, other = np.flatnonzero(touched), which[touched]
        if not len(rows):
            continue
        x, y = (ellipses.centres[rows] - ellipses.centres[other]).astype(np.float32).T[..., None]
        away = rim(samples.x[rows] + x, samples.y[rows] + y, ellipses.axes[other])
        others[rows] += picture(away.distance, away.curvature, np.full((len(rows), 1), blur, np.float32))[0]
    return replace(samples, others=others)


def _result(fit: _Round, start: Ellipses) -> DiscFits:
    samples, parameters = fit.samples, fit.parameters
    count = samples.used.sum(axis=1)
    variance = fit.cost / np.maximum(count - COUNT, 1)
    covariance = np.linalg.pinv(fit.normal)[:, :2, :2] * np.maximum(variance, ROUNDING)[:, None, None]
    good = _accept(fit.ellipses, start) & (samples.whole > _WHOLE) & (count > 2 * COUNT)
    mean = samples.values.sum(axis=1) / np.maximum(count, 1)
    variation = (samples.used * (samples.values - mean[:, None]) ** 2).sum(axis=1)
    rounding = ROUNDING * np.maximum(count, 1)
    agreement = np.where(good, 1 - (fit.cost + rounding) / (variation + rounding), 0.0)
    return DiscFits(
        fit.ellipses,
        covariance,
        blur=np.exp(parameters[:, BLUR]),
        level=parameters[:, LEVEL],
        contrast=parameters[:, CONTRAST],
        agreement=agreement,
        noise=np.sqrt(variance),
    )
