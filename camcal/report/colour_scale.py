"""Numbers as colours: a range that a few outliers do not stretch, and the turbo colours."""

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.report.cloud_scene import evenly

_TAIL = 0.02
_RATIO = 5.0  # of the ends of a range; above it the steps are of equal ratio
_SAMPLE = 100_000


@dataclass(frozen=True)
class ColourScale:
    """A range of numbers; logarithmic: equal ratios, not equal differences, take equal shares of it."""

    low: float
    high: float
    logarithmic: bool = False

    def fraction(self, values: Array) -> Array:
        """Return where values stand in the range, 0 … 1; what is outside stands at its ends, NaN stays."""
        low, high = (np.log(end) if self.logarithmic else end for end in (self.low, self.high))
        with np.errstate(invalid="ignore", divide="ignore"):
            placed = np.log(values) if self.logarithmic else values
            fraction: Array = np.clip((placed - low) / (high - low), 0.0, 1.0)
        return fraction


def scale_of(values: Array) -> ColourScale:
    """Return the scale of nearly all of some values (N,); those that are not finite do not count."""
    known = values[np.isfinite(values)]
    if not known.size:
        return ColourScale(0.0, 1.0)
    low, high = np.quantile(known[evenly(len(known), _SAMPLE)].astype(np.float64), [_TAIL, 1 - _TAIL]).tolist()
    if high - low <= 1e-9 * max(abs(low), abs(high)):
        return ColourScale(low - 0.5 * (abs(low) or 1.0), high + 0.5 * (abs(high) or 1.0))
    return ColourScale(low, high, logarithmic=low > 0 and high > _RATIO * low)


@cache
def turbo_table() -> Array:
    """Return the 256 colours (256, 3), red, green, blue, uint8, from blue to red.

    Source: Mikhailov, Turbo, an improved rainbow colormap for visualization, 2019.
    """
    steps = np.arange(256, dtype=np.uint8)[None]
    table: Array = np.ascontiguousarray(cv2.applyColorMap(steps, cv2.COLORMAP_TURBO).reshape(256, 3)[:, ::-1])
    table.setflags(write=False)
    return table


def turbo(fraction: Array) -> Array:
    """Return colours (N, 3), red, green, blue, uint8, of numbers 0 … 1 (N,); gray where they are NaN."""
    known = np.isfinite(fraction)
    colours: Array = turbo_table()[np.rint(np.where(known, fraction, 0) * 255).astype(np.intp)]
    colours[~known] = 128
    return colours
