"""Statistics of several frames of one exposure level: mean, temporal and spatial variance per colour.

Frames are read one after the other; only their sum is kept. Rounding to whole counts, and ending at 0, did something to
the noise of dark frames, which is undone.
"""

from collections.abc import Iterable, Iterator, Sequence
from math import hypot, sqrt

import numpy as np
from scipy.ndimage import uniform_filter
from scipy.optimize import least_squares
from scipy.special import ndtr

from camcal.arrays import Array, readonly
from camcal.dataclass import dataclass
from camcal.errors import InsufficientData, InvalidInput
from camcal.raw import MONO, PATTERNS
from camcal.raw.mosaic import Mosaic, by_place, channel_names

ROUNDING = 1 / 12  # counts²: variance of an error that is uniform over one count
LIMIT = 0.24  # counts²: below this EMVA 1288 takes the noise for that of rounding
HIDDEN = sqrt(LIMIT - ROUNDING)  # counts: the noise that is then its upper limit, 0.40 in the standard
SIGNIFICANT = 5.0  # standard deviations at which a difference is no chance

_COARSE = 3.0  # counts: noise above that is rounded evenly, as long as it stays away from 0
_REACH = 6.0  # standard deviations
_SMALLEST = 0.02  # counts: noise that is not searched for below, and spread that is too small to matter
_SILENT = 1e-4  # counts²: a variance that only rare outliers bring about
_VAGUE = 0.1  # of the noise: an uncertainty that only rounding brings about
_SINGULAR = 1e-6  # of the determinant: the counts do not tell the noise any more
_NODES = np.linspace(-4, 4, 49)  # standard deviations, fine enough for a spread of six times the noise
_WEIGHTS = np.exp(-(_NODES**2) / 2) / np.exp(-(_NODES**2) / 2).sum()

_BOX = 9  # samples a side that the pattern is compared with, so that slow shading is not taken for it
_FEWEST = 2 * _BOX  # samples of a phase along a side


@dataclass(frozen=True)
class DarkSignal:
    """A dark signal before it was counted, in counts: mean, standard deviation in time, and of the pixels' own means.

    limited: the noise is too small against a count to be measured well.
    """

    mean: float
    std: float
    std_uncertainty: float
    spread: float
    spread_uncertainty: float
    limited: bool


@dataclass(frozen=True)
class Counted:
    """Counts as they are measured: mean, variance in time, variance of the pixels' means, and their uncertainties."""

    mean: float
    temporal: float
    temporal_std: float
    spatial: float
    spatial_std: float


def before_counting(measured: Counted) -> DarkSignal:
    """Return the Gaussian signals whose counts, rounded and cut off at 0, have these variances.

    Below the limit of EMVA 1288 rounding is undone as well, and the uncertainty grows as that fails; where all counts
    are the same the noise is its upper limit, 0.4 counts. Raises InsufficientData if all counts are 0.
    Source: EMVA 1288 Release 4.0 Linear (photon transfer method: 0.24 counts², 0.40 counts).
    """
    spread, spread_uncertainty = root(measured.spatial, measured.spatial_std)
    if measured.temporal < _SILENT:
        if measured.mean < _SILENT:
            raise InsufficientData("all dark counts are 0: noise clipped; increase the black level of the camera")
        return DarkSignal(measured.mean, HIDDEN, HIDDEN, spread, spread_uncertainty, limited=True)
    std, std_uncertainty = root(max(measured.temporal - ROUNDING, ROUNDING), measured.temporal_std)
    if std > _COARSE and measured.mean > _REACH * hypot(std, spread):
        return DarkSignal(measured.mean, std, std_uncertainty, spread, spread_uncertainty, limited=False)
    return _undone(measured, (measured.mean, std, max(spread, _SMALLEST)))


def root(variance: float, std: float) -> tuple[float, float]:
    """Return the square root of a variance and its uncertainty; a negative one is no deviation, but for chance.

    Near zero the uncertainty is the deviation that the variance might be. `squared` undoes it.
    """
    value = sqrt(max(variance, 0.0))
    return value, std / 2 / value if value > sqrt(std) / 2 else sqrt(std)


def squared(value: float, std: float) -> tuple[float, float]:
    """Return the variance that has this root, and its uncertainty."""
    return value**2, max(2 * value * std, std**2)


def _undone(measured: Counted, guess: tuple[float, float, float]) -> DarkSignal:
    """Return the mean, noise and spread whose counts are as measured, by least squares from a guess."""
    target = np.array([measured.mean, measured.temporal, measured.spatial])

    def residuals(unknown: Array) -> Array:
        return np.asarray(counted(*unknown) - target)

    bounds = ([-np.inf, _SMALLEST, 0.0], [np.inf, np.inf, np.inf])
    fit = least_squares(
        residuals, guess, bounds=bounds, x_scale=(1.0, guess[1], guess[1]), xtol=1e-12, ftol=1e-12, gtol=1e-15
    )
    mean, std, spread = fit.x.tolist()
    jacobian: Array = np.asarray(fit.jac)
    if spread < _SMALLEST:  # then it has no slope, and no part in the other two
        inverse = np.zeros((3, 3))
        inverse[:2, :2] = _inverse(jacobian[:2, :2])
        spread_uncertainty = sqrt(measured.spatial_std)
    else:
        inverse = _inverse(jacobian)
        spread_uncertainty = hypot(inverse[2, 1] * measured.temporal_std, inverse[2, 2] * measured.spatial_std)
    uncertainty = hypot(inverse[1, 1] * measured.temporal_std, inverse[1, 2] * measured.spatial_std)
    uncertainty = min(float(uncertainty), HIDDEN)  # where rounding hides the noise, it is below that at least
    limited = std < HIDDEN or uncertainty > _VAGUE * std or measured.temporal < LIMIT
    return DarkSignal(mean, std, uncertainty, spread, spread_uncertainty, limited)


def _inverse(jacobian: Array) -> Array:
    if abs(np.linalg.det(jacobian)) < _SINGULAR:
        return np.full_like(jacobian, np.inf)
    return np.asarray(np.linalg.inv(jacobian))


def counted(mean: float, std: float, spread: float) -> Array:
    """Return mean, temporal and spatial variance (3,) of the rounded, non-negative counts of Gaussian signals.

    std: of a signal in time; spread: standard deviation of the signals' means. Sums over all counts, not a series.
    """
    means = mean + spread * _NODES
    first_count = max(0.0, np.floor(means[0] - _REACH * std))
    counts = np.arange(first_count, max(first_count, np.ceil(means[-1] + _REACH * std)) + 2)
    below = ndtr((counts[:-1] + 0.5 - means[:, None]) / std)
    shares = np.diff(below, axis=1, prepend=0.0, append=1.0)
    centres = shares @ counts
    temporal = _WEIGHTS @ (shares * (counts - centres[:, None]) ** 2).sum(axis=1)
    middle = _WEIGHTS @ centres
    return np.array([middle, temporal, _WEIGHTS @ (centres - middle) ** 2])


@dataclass(frozen=True, eq=False)
class Level:
    """Frames of one light and exposure; every array has an entry for each of P phases, in the order of `names`.

    mean_dn: (P,) counts. temporal: (P,) variance of a pixel from frame to frame, counts². spatial: (P,) variance of
    the pixels' true means against their surroundings, counts²; it may fall below 0 by chance. measured_spatial: (P,)
    the same with the noise that is left in the mean of the frames. clipped: (P,) share of samples at 0 or at white.
    frame_means: (F, P) of every frame, counts. samples: of one phase in one frame. peak: the largest count;
    white: where counts end.
    """

    names: tuple[str, ...]
    size: tuple[int, int]
    exposure_s: float | None
    mean_dn: Array
    temporal: Array
    spatial: Array
    measured_spatial: Array
    clipped: Array
    frame_means: Array
    samples: int
    peak: float
    white: float

    def __post_init__(self) -> None:
        count = len(self.names)
        for name in ("mean_dn", "temporal", "spatial", "measured_spatial", "clipped"):
            object.__setattr__(self, name, readonly(getattr(self, name), (count,), name))
        object.__setattr__(self, "frame_means", readonly(self.frame_means, (None, count), "frame_means"))

    @property
    def frames(self) -> int:
        return len(self.frame_means)

    def counted(self, phase: int) -> Counted:
        """Return the counts of one phase with the uncertainty of their variances."""
        return Counted(
            float(self.mean_dn[phase]),
            float(self.temporal[phase]),
            float(self.temporal[phase]) * sqrt(2 / self.degrees),
            float(self.spatial[phase]),
            self.spatial_std(phase),
        )

    def spatial_std(self, phase: int) -> float:
        """Return the standard deviation of a spatial variance, counts²."""
        noise = float(self.temporal[phase]) / self.frames
        return hypot(self.measured_spatial[phase] * sqrt(2 / self.samples), noise * sqrt(2 / self.degrees))

    @property
    def words(self) -> str:
        """The level as people know it: exposure, number of frames, and mean."""
        exposure = "" if self.exposure_s is None else f"{1e3 * self.exposure_s:g} ms, "
        return f"{exposure}{self.frames} frames, mean {self.mean_dn.mean():.4g}"

    @property
    def degrees(self) -> int:
        """Degrees of freedom of each temporal variance."""
        return (self.frames - 1) * (self.samples - 1)


def drifts(flats: Sequence[Level], darks: Sequence[Level]) -> Iterator[tuple[Level, float]]:
    """Yield the levels whose frames differ in brightness by more than chance, and by what share of their signal."""
    black = np.mean([level.mean_dn for level in darks], axis=0)
    for level in flats:
        signal = level.mean_dn - black
        change = np.ptp(level.frame_means, axis=0)
        sure = change > SIGNIFICANT * np.sqrt(2 * level.temporal / level.samples)
        if (shares := change[sure & (signal > 0)] / signal[sure & (signal > 0)]).size:
            yield level, float(shares.max())


def phase_names(pattern: str) -> tuple[str, ...]:
    """Return a name for each place of the cell in reading order: greens are Gr in red's row and Gb in blue's."""
    if pattern == MONO:
        return ("mono",)
    if pattern not in PATTERNS:
        raise InvalidInput("photon transfer needs a Bayer pattern or a sensor without filters")
    return channel_names(pattern)


def planes(values: Array, pattern: str) -> list[Array]:
    """Return the samples of each phase as an array of their own, all of the same size."""
    return [values] if pattern == MONO else by_place(values, pattern)


def measure_level(frames: Iterable[Mosaic], exposure_s: float | None = None, white: float | None = None) -> Level:
    """Return the statistics of frames of one light; white: counts at saturation, by default what the frames say.

    The temporal variance is that of the difference of two frames, less what the light as a whole changed; of more
    frames it is pooled about each pixel's mean.
    Raises InsufficientData for less than two frames or too few pixels, InvalidInput if the frames differ in size or
    pattern. Source: EMVA 1288 Release 4.0 Linear (photon transfer method; spatial variances).
    """
    sums: _Sums | None = None
    for frame in frames:
        if sums is None:
            sums = _Sums(frame)
        sums.add(frame, frame.white if white is None else white)
    if sums is None or len(sums.means) < 2:
        raise InsufficientData("a single frame at one illumination level (minimum two)")
    return sums.level(exposure_s)


class _Sums:
    """What is kept of the frames read so far. Counts are taken from the first frame's means, to lose no digits."""

    def __init__(self, first: Mosaic) -> None:
        self.first = first
        self.names = phase_names(first.pattern)
        self.start = np.array([plane.mean() for plane in planes(first.values, first.pattern)])
        self.totals = [np.zeros(plane.shape) for plane in planes(first.values, first.pattern)]
        self.means: list[Array] = []
        self.squares = np.zeros(len(self.names))
        self.clipped = np.zeros(len(self.names))
        self.peak = 0.0
        self.white = np.inf
        if min(self.totals[0].shape) < _FEWEST:
            raise InsufficientData(
                f"frames of {first.size[0]} × {first.size[1]} are too small; use {2 * _FEWEST} a side"
            )

    def add(self, frame: Mosaic, white: float) -> None:
        if (frame.size, frame.pattern) != (self.first.size, self.first.pattern):
            one, other = (f"{mosaic.size[0]} × {mosaic.size[1]} {mosaic.pattern}" for mosaic in (self.first, frame))
            raise InvalidInput(f"frames of one level differ: {one} and {other}")
        means = np.empty(len(self.names))
        for index, plane in enumerate(planes(frame.values, frame.pattern)):
            offset = plane - self.start[index]
            self.totals[index] += offset
            self.squares[index] += np.vdot(offset, offset)
            self.clipped[index] += np.mean((plane <= 0) | (plane >= white))
            means[index] = offset.mean()
        self.means.append(self.start + means)
        self.peak = max(self.peak, float(frame.values.max()))
        self.white = min(self.white, white)

    def level(self, exposure_s: float | None) -> Level:
        count, samples = len(self.means), self.totals[0].size
        means = np.array(self.means)
        # Sums of squares: of all samples, less those of the pixels' means, less those of the frames' means.
        pixels = np.array([np.vdot(total, total) for total in self.totals]) / count
        within = self.squares - pixels - samples * np.square(means - means.mean(axis=0)).sum(axis=0)
        temporal = np.maximum(within, 0) / ((count - 1) * (samples - 1))
        measured = np.array([_unevenness(total / count) for total in self.totals])
        return Level(
            names=self.names,
            size=self.first.size,
            exposure_s=exposure_s,
            mean_dn=means.mean(axis=0),
            temporal=temporal,
            spatial=measured - temporal / count,
            measured_spatial=measured,
            clipped=self.clipped / count,
            frame_means=means,
            samples=samples,
            peak=self.peak,
            white=self.white,
        )


def _unevenness(plane: Array) -> float:
    """Return the variance of uncorrelated differences between pixels, without what changes slowly over the image."""
    inside = slice(_BOX // 2, -(_BOX // 2))
    difference = (plane - uniform_filter(plane, _BOX))[inside, inside]
    return float(np.square(difference).mean() / (1 - 1 / _BOX**2))  # the surroundings share a part of the pixel's own
