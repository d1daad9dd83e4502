"""Refinement of circles: blurred ellipses fitted around their rims, and the projected centres.

First roughly to some samples, then to all that the rims' blur reaches. Where dots stand so close that the blur of one
reaches the next, what the others put into a window is counted in.

Perspective moves the centre of the ellipse away from the projected centre of the disc. Where the board is seen as
x → p + J x / (1 + l · x) around a disc of radius r the offset is -r² J l / (1 - r² l · l): the centre of the dual conic
H diag(r², r², -1) Hᵀ (Heikkilä 2000, Geometric camera calibration using circular control points). Lens distortion moves
it too. Both follow from how the grid as a whole is seen (board_map.py): every disc's rim is taken into the image, an
ellipse is fitted to it as one was to the image, and its distance from the image of the centre is taken off.
"""

from dataclasses import dataclass, replace

import numpy as np

from camcal.arrays import Array
from camcal.targets.board_map import BoardMap, map_of
from camcal.targets.circles.blobs import Ellipses, neighbours, square_roots
from camcal.targets.circles.disc_model import (
    BLUR,
    CENTRE,
    CONTRAST,
    COUNT,
    GRADIENT,
    LEVEL,
    ROUNDING,
    RimSamples,
    axes_of,
    blur_of,
    minimise,
    picture,
    rim,
    sample,
    start_of,
)

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
class _Surroundings:
    """The nearest other ellipses (N, M) of every one, and how far their centres are in its own axes."""

    near: Array
    distance: Array

    @property
    def spacing(self) -> Array:
        """Return how far (N,) the nearest one is."""
        return np.asarray(self.distance.min(axis=1))


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
        return float(np.median(blur_of(self.parameters)))


def fit_discs(gray: Array, start: Ellipses) -> DiscFits:
    """Return the dots fitted from starts good to half a pixel or so.

    gray: (H, W). start: all the dots there are, for some may stand close to others.
    """
    around = _surroundings(start)
    coarse = sample(gray, start, _COARSE_BAND, np.maximum(_LEAST_ROOM, around.spacing / 2), _COARSE_SAMPLES)
    fit = _Round(coarse, start, *minimise(coarse, start_of(coarse, start.axes), _NO_TONE, _ROUGHLY))
    fit = _refined(gray, fit, start, around)
    if _touching(fit, around).any():
        fit = _refined(gray, fit, start, around)
    return _result(fit, start)


def _surroundings(ellipses: Ellipses) -> _Surroundings:
    near = neighbours(ellipses.centres, _NEIGHBOURS)
    away = (ellipses.centres[near] - ellipses.centres[:, None]) @ np.linalg.inv(ellipses.axes)
    return _Surroundings(near, np.linalg.norm(away, axis=2))


def _refined(gray: Array, last: _Round, start: Ellipses, around: _Surroundings) -> _Round:
    """Return the fit to all samples that the blur of the last one asks for; where that failed, from its start."""
    good = _accepted(last.ellipses, start)
    middle = Ellipses(
        np.where(good[:, None], last.ellipses.centres, start.centres),
        np.where(good[:, None, None], last.ellipses.axes, start.axes),
    )
    touching = _touching(last, around)
    room = np.maximum(_LEAST_ROOM, np.where(touching.any(axis=1), around.spacing - 1, around.spacing / 2))
    samples = sample(gray, middle, max(_LEAST_BAND, _BAND * last.blur), room)
    samples = _among_others(samples, middle, around, touching, last.blur)
    begin = start_of(samples, middle.axes)
    begin[good, BLUR : GRADIENT.start] = last.parameters[good, BLUR : GRADIENT.start]
    return _Round(samples, middle, *minimise(samples, begin, _TONE, _SETTLED))


def _accepted(ellipses: Ellipses, start: Ellipses) -> Array:
    """Return which fits (N,) are of the ellipses they started from."""
    short = np.linalg.eigvalsh(start.axes)[:, 0]
    moved = np.linalg.norm(ellipses.centres - start.centres, axis=1)
    growth = np.abs(np.log(ellipses.areas / start.areas))
    return np.asarray((moved < np.maximum(_FURTHEST * short, 1.0)) & (growth < np.log(_GROWTH)))


def _touching(fit: _Round, around: _Surroundings) -> Array:
    """Return which dots are reached by the blur of which of those around them, (N, M)."""
    short = np.linalg.eigvalsh(fit.ellipses.axes)[:, :1]
    return np.asarray((around.distance - 2) * short < _TOUCHING * fit.blur)


def _among_others(
    samples: RimSamples, ellipses: Ellipses, around: _Surroundings, touching: Array, blur: float
) -> RimSamples:
    """Return the samples with what the pictures of other ellipses put into the windows of those they touch."""
    others = samples.others.copy()
    for which, touched in zip(around.near.T, touching.T, strict=True):
        rows, near = np.flatnonzero(touched), which[touched]
        if not len(rows):
            continue
        x, y = (ellipses.centres[rows] - ellipses.centres[near]).astype(np.float32).T[..., None]
        away = rim(samples.x[rows] + x, samples.y[rows] + y, ellipses.axes[near])
        others[rows] += picture(away.distance, away.curvature, np.full((len(rows), 1), blur, np.float32)).value
    return replace(samples, others=others)


def _result(fit: _Round, start: Ellipses) -> DiscFits:
    samples, parameters = fit.samples, fit.parameters
    count = samples.used.sum(axis=1)
    variance = fit.cost / np.maximum(count - COUNT, 1)
    covariance = np.linalg.pinv(fit.normal)[:, :2, :2] * np.maximum(variance, ROUNDING)[:, None, None]
    good = _accepted(fit.ellipses, start) & (samples.whole > _WHOLE) & (count > 2 * COUNT)
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


_RIM_POINTS = 24
_ROUNDS = 3  # the map is fitted to centres that are off at first; each round leaves a quarter or less
_TYPICAL_RADIUS = 0.3  # pitches


def projected_centres(ellipses: Ellipses, points: Array, radius: float | None, size: tuple[int, int]) -> Array:
    """Return the pixels (N, 2) of the discs' centres, from their ellipses in the image.

    points: (N, 2) of the centres on the board. radius: in the same unit, None to find it from the ellipses' areas.
    size: (width, height) of the image.
    """
    centres = ellipses.centres
    for _ in range(_ROUNDS):
        seen = map_of(points, centres, size)
        reach = radius or _radius(seen, points, ellipses)
        centres = ellipses.centres - (_rims(seen, points, reach).centres - seen.pixels(points))
    return centres


def _radius(seen: BoardMap, points: Array, ellipses: Ellipses) -> float:
    """Return the radius of the discs in the points' unit: the median over their areas."""
    trial = _TYPICAL_RADIUS * float(np.linalg.norm(points[1:] - points[:-1], axis=1).min())
    return trial * float(np.sqrt(np.median(ellipses.areas / _rims(seen, points, trial).areas)))


def _rims(seen: BoardMap, points: Array, radius: float) -> Ellipses:
    """Return the ellipses that fit the images of the discs' rims best, every piece of a rim counting by its length."""
    angles = 2 * np.pi * np.arange(_RIM_POINTS) / _RIM_POINTS
    unit = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    traced = seen.pixels(points[:, None] + radius * unit)
    lengths = np.linalg.norm(np.roll(traced, -1, axis=1) - np.roll(traced, 1, axis=1), axis=2)
    centres = traced.mean(axis=1)
    first = 2 / _RIM_POINTS * traced.swapaxes(1, 2) @ unit  # the first harmonic, an affine map of the circle
    axes = square_roots(first @ first.swapaxes(1, 2))
    x, y = np.moveaxis(traced - centres[:, None], -1, 0)
    near = rim(x, y, axes)
    (normal_x, normal_y), (across, down) = near.outward.swapaxes(0, 1), near.unit.swapaxes(0, 1)
    design = [normal_x, normal_y, normal_x * across, normal_x * down + normal_y * across, normal_y * down]
    jacobian = np.stack(design, axis=1)
    weighted = jacobian * lengths[:, None]
    normal = weighted @ jacobian.swapaxes(1, 2)
    step = np.linalg.solve(normal, weighted @ near.distance[..., None])[..., 0]
    return Ellipses(centres + step[:, :2], axes + step[:, [2, 3, 3, 4]].reshape(-1, 2, 2))
