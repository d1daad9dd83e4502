"""Colour maps: a range robust to outliers, the turbo map, and colours of points."""

from functools import cache

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.report.cloud_scene import CloudScene, evenly

_TAIL = 0.02
_RATIO = 5.0  # of the ends of a range; above it the steps are of equal ratio
_SAMPLE = 100_000
COLOURS = ("image", "depth", "sigma", "gray")
_PLAIN = 150  # gray level of points that have no colour
_LUMA = np.array([0.299, 0.587, 0.114], np.float32)  # Rec. ITU-R BT.601


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


@dataclass(frozen=True, eq=False)
class Paint:
    """The colour of every point (N, 3), red, green, blue, uint8, and the scale it stands for, if it stands for one."""

    colours: Array
    name: str
    scale: ColourScale | None = None


def paint_of(scene: CloudScene, colour: str | None = None) -> Paint:
    """Return the colours of the points by image, depth, sigma or gray; by default by image, or depth without one.

    Raises InvalidInput if the cloud does not have what it is to be coloured by.
    """
    colour = colour or ("depth" if scene.colours is None else "image")
    if colour not in COLOURS:
        raise InvalidInput(f"colour {colour!r} is unknown; use one of {', '.join(COLOURS)}")
    if colour == "depth":
        return _scale(scene.depth, colour)
    if colour == "sigma":
        if scene.sigma is None:
            raise InvalidInput("the cloud has no sigma to be coloured by; 'camcal stereo cloud --sigma' writes it")
        return _scale(scene.sigma, colour)
    if colour == "image":
        if scene.colours is None:
            raise InvalidInput("the cloud has no colours; use depth or gray")
        return Paint(scene.colours, colour)
    if scene.colours is None:
        return Paint(np.full(scene.points.shape, _PLAIN, np.uint8), colour)
    light = np.rint(scene.colours @ _LUMA).astype(np.uint8)
    return Paint(np.repeat(light[:, None], 3, axis=1), colour)


def _scale(values: Array, name: str) -> Paint:
    scale = scale_of(values)
    return Paint(turbo(scale.fraction(values)), name, scale)
