"""Dark frames and flat fields, for subtraction and division.

Dark frames, many exposures of no light, become the one that is subtracted, and the noise of every pixel. They are added
up as they come, so memory does not grow with their number. Of three and more, every pixel leaves out its highest and
its lowest frame: a cosmic ray or one flash of an unstable pixel then changes nothing. A median would do the same, but
needs all frames at once and has more noise: 20 % over the plain mean of 16 frames, this has 1.5 %.

Flat fields, what every pixel makes of even light, become the divisor that undoes it. Without smoothing it corrects
everything that multiplies light: the lens's fall-off, dust, and the response of single pixels. It then brings in the
noise of the flat frame, which is worth it while that is below the 0.5 … 1 % by which pixels differ: 16 frames at half
saturation of a sensor that holds 10 000 electrons have 0.35 %, one has 1.4 %. Smoothing gives up dust and pixels and is
for few or noisy frames.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array, readonly, require_shape
from camcal.errors import InsufficientData, InvalidInput
from camcal.raw.mosaic import cell_side, phases

_LEAST_TRIMMED = 3
_BRIGHTEST = 0.5  # of saturation
_FLOOR = 1e-3
_SATURATED = 0.95  # of saturation: photon noise clips from about here on, and the mean comes out too low
_MOST_SATURATED = 1e-3  # of the samples: hot pixels are fewer
_DARKEST = 0.02  # mean light of one colour: 80 of 4095 counts, 10 % noise and the error of the black level


@dataclass(frozen=True, eq=False)
class Stack:
    """Statistics of every pixel over equal exposures, in the unit of the frames.

    mean: (H, W) float32, without the highest and the lowest frame when there are three or more.
    deviation: (H, W) float32, standard deviation of the frames that went into the mean, NaN for a single one. Without
    its extremes it is less than the noise, by the same factor for all pixels.
    """

    count: int
    mean: Array
    deviation: Array

    def __post_init__(self) -> None:
        for name in ("mean", "deviation"):
            object.__setattr__(self, name, readonly(getattr(self, name), (None, None), name, np.float32))


def stack(frames: Iterable[Array]) -> Stack:
    """Return the mean and the deviation of frames (H, W) of one size, counts or linear light.

    Raises InsufficientData without a frame, InvalidInput if a frame has another size or is not finite.
    """
    count, sums, extremes = 0, np.zeros((2, 0, 0)), np.zeros((2, 0, 0))
    for count, frame in enumerate(frames, start=1):
        if count == 1:
            sums = np.zeros((2, *require_shape(frame, (None, None), "frame 1").shape))
            extremes = np.stack([frame, frame])
        exact = _require_frame(frame, sums.shape[1:], count)
        sums[0] += exact
        sums[1] += np.square(exact, out=exact)
        np.minimum(frame, extremes[0], out=extremes[0])
        np.maximum(frame, extremes[1], out=extremes[1])
    if count == 0:
        raise InsufficientData("no frames to average; give one or more")
    kept = count
    if count >= _LEAST_TRIMMED:
        kept -= 2
        for extreme in extremes.astype(np.float64):
            sums[0] -= extreme
            sums[1] -= extreme * extreme
    return Stack(count, sums[0] / kept, _deviation(sums[0], sums[1], kept))


def dark_average(frames: Iterable[Array], white: float) -> Array:
    """Return the dark frame (H, W), float32 in counts, of one or more exposures without light.

    white: counts at saturation. Raises InsufficientData without a frame, InvalidInput if frames differ in size, are
    not finite, or are too bright to be dark.
    """
    dark = stack(frames).mean
    level = float(np.median(dark))
    if level > _BRIGHTEST * white:
        share = f"{level:.0f} of {white:.0f} counts"
        raise InvalidInput(
            f"half of the pixels have {share} or more; check that this is a dark frame with the lens covered"
        )
    return dark


def _require_frame(frame: Array, shape: tuple[int, ...], number: int) -> Array:
    if frame.shape != shape:
        found = " × ".join(map(str, frame.shape[::-1]))
        raise InvalidInput(f"frame {number} has {found} pixels, the first one {shape[1]} × {shape[0]}")
    exact = frame.astype(np.float64)
    if frame.dtype.kind == "f" and not np.isfinite(exact).all():
        raise InvalidInput(f"frame {number}: {np.count_nonzero(~np.isfinite(exact))} pixels are not finite")
    return exact


def _deviation(total: Array, squares: Array, count: int) -> Array:
    if count == 1:
        return np.full(total.shape, np.nan, np.float32)
    variance = (squares - total * total / count) / (count - 1)
    return np.asarray(np.sqrt(np.maximum(variance, 0)), np.float32)


def flat_gain(flat: Array, pattern: str, smoothing: float = 0.0) -> Array:
    """Return the divisor (H, W), float32: the flat over the mean of each place of the pattern's cell, at least 1e-3.

    flat: (H, W) linear light, dark frame subtracted, 1 at saturation; best the mean of 16 or more frames.
    smoothing: standard deviation in pixels of a Gaussian over the samples of each place; 0 is none.
    Linear light is divided by it before white balance. The mean of a place is kept, and so is the colour of light.
    Raises InvalidInput if the flat is saturated, almost dark, or not finite.
    """
    flat = require_shape(flat, (None, None), "flat frame", np.float32)
    if not np.isfinite(flat).all():
        raise InvalidInput(f"{np.count_nonzero(~np.isfinite(flat))} pixels of the flat frame are not finite")
    if not 0 <= smoothing < np.inf:
        raise InvalidInput(f"the smoothing of the flat frame is 0 or more pixels, found {smoothing:g}")
    side = cell_side(pattern)
    gain = np.empty_like(flat)
    for place, site in enumerate(phases(pattern)):
        mean = _require_exposed(flat[site], f"row {place // side}, column {place % side} of the {pattern} cell")
        gain[site] = _smooth(flat[site], smoothing / side) / np.float32(mean)
    return np.maximum(gain, _FLOOR, out=gain)


def _require_exposed(samples: Array, place: str) -> float:
    """Return the mean of the samples of one place; raises InvalidInput if they tell no relative light."""
    saturated = np.count_nonzero(samples >= _SATURATED) / samples.size
    if saturated > _MOST_SATURATED:
        where = f"at {place} above {_SATURATED:.0%} of saturation"
        raise InvalidInput(f"flat frame saturated: {saturated:.1%} of the samples {where}; reduce the exposure")
    mean = float(samples.mean(dtype=np.float64))
    if mean < _DARKEST:
        where = f"of saturation at {place}, {_DARKEST:.0%} are needed"
        raise InvalidInput(f"flat frame too dark: mean {mean:.2%} {where}; increase the exposure")
    return mean


def _smooth(samples: Array, sigma: float) -> Array:
    if sigma == 0:
        return samples
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(samples, sigma, mode="reflect"))
