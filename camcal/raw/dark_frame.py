"""Dark frames: many exposures of no light become the one that is subtracted, and the noise of every pixel.

Frames are added up as they come, so memory does not grow with their number. Of three and more, every pixel leaves out
its highest and its lowest frame: a cosmic ray or one flash of an unstable pixel then changes nothing. A median would
do the same, but needs all frames at once and has more noise: 20 % over the plain mean of 16 frames, this has 1.5 %.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array, readonly, require_shape
from camcal.errors import InsufficientData, InvalidInput

_LEAST_TRIMMED = 3
_BRIGHTEST = 0.5  # of saturation


@dataclass(frozen=True, eq=False)
class Stack:
    """What a number of equal exposures say about every pixel, in the unit of the frames.

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


def average(frames: Iterable[Array], white: float) -> Array:
    """Return the dark frame (H, W), float32 in counts, of one or more exposures without light.

    white: counts at saturation. Raises InsufficientData without a frame, InvalidInput if frames differ in size, are
    not finite, or are too bright to be dark.
    """
    dark = stack(frames).mean
    level = float(np.median(dark))
    if level > _BRIGHTEST * white:
        share = f"{level:.0f} of {white:.0f} counts"
        raise InvalidInput(f"half of the pixels have {share} or more; is this a dark frame? cover the lens")
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
