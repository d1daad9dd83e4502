"""Several frames of one scene under one light: the mean of each colour's samples, how they vary in time and in space.

Frames are read one after the other; only their sum is kept.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from math import hypot, sqrt

import numpy as np
from scipy.ndimage import uniform_filter

from camcal.arrays import Array, readonly
from camcal.errors import InsufficientData, InvalidInput
from camcal.raw.counting import Counted
from camcal.raw.mosaic import Mosaic, by_place, channel_names
from camcal.raw.options import MONO, PATTERNS

_BOX = 9  # samples a side that the pattern is compared with, so that slow shading is not taken for it
_FEWEST = 2 * _BOX  # samples of a phase along a side


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
    def degrees(self) -> int:
        """Degrees of freedom of each temporal variance."""
        return (self.frames - 1) * (self.samples - 1)


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
        raise InsufficientData("a single frame at one level of light; noise takes at least two")
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
