"""Pictures of disparity maps and of their errors, each above a legend of what its colours mean."""

from dataclasses import dataclass
from io import BytesIO
from typing import Literal

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from camcal.arrays import Array
from camcal.report.colour_scale import turbo_table
from camcal.stereo.geometry import StereoGeometry

ERROR_EDGES = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)  # pixels: up to 2 blue, above yellow to red

# KITTI's colours, which double from one to the next as well: Menze & Geiger, CVPR 2015, fig. 6. Red, green, blue.
_ERROR_COLOURS = (
    (49, 54, 149), (69, 117, 180), (116, 173, 209), (171, 217, 233),
    (254, 224, 144), (253, 174, 97), (244, 109, 67), (215, 48, 39), (165, 0, 38),
)  # fmt: skip
_NO_DISPARITY = (128, 128, 128)
_UNKNOWN = (0, 0, 0)
_DARKEST = 16  # of the turbo colours; those below are too much like black
_OCCLUDED = 0.45  # of the brightness

_TAIL = 0.005
_SAMPLES = 1 << 18
_NARROWEST = 420  # pixels: what the legend takes
_FONT = 1 / 64  # of the width
_SMALLEST_FONT = 11.0  # pixels
_DPI = 100
_STRIP = 4.4  # height of the legend, in heights of its letters like what follows
_ABOVE, _BELOW = 3.5, 1.0
_BOX = 0.9


def robust_range(values: Array) -> tuple[float, float]:
    """Return the range of nearly all values (H, W) that are finite: for a sequence, take that of one frame for all."""
    sample = values.ravel()[:: max(1, values.size // _SAMPLES)]
    known = sample[np.isfinite(sample)]
    if not known.size:
        return 0.0, 1.0
    low, high = np.quantile(known.astype(np.float64), [_TAIL, 1 - _TAIL]).tolist()
    return (low, high) if high - low > 1e-3 else (low - 0.5, high + 0.5)


def disparity_picture(
    values: Array, limits: tuple[float, float] | None = None, geometry: StereoGeometry | None = None
) -> Array:
    """Return a disparity map as a picture (H + legend, W or more, 3), blue, green, red, uint8; black where unknown.

    values: (H, W) pixels, NaN where there is none. limits: the disparities of the first and the last colour, by default
    `robust_range`. geometry: adds metres to the legend.
    """
    low, high = limits or robust_range(values)
    table = turbo_table()[:, ::-1].copy()
    table[0] = _UNKNOWN
    steps_per_pixel = np.float32((255 - _DARKEST) / (high - low))
    place = np.clip((values - np.float32(low)) * steps_per_pixel + np.float32(_DARKEST), _DARKEST, 255)
    steps = np.nan_to_num(place, copy=False, nan=0.0).astype(np.uint8)
    coloured = np.asarray(cv2.applyColorMap(steps, np.ascontiguousarray(table[:, None])))
    strip = _Strip.below(coloured)
    _draw_scale(strip, (low, high), geometry)
    return strip.under(coloured)


def error_picture(error: Array, truth_known: Array, visible: Array | None = None) -> Array:
    """Return the errors of a disparity map as a picture (H + legend, W or more, 3), blue, green, red, uint8.

    error: (H, W) pixels, NaN without a disparity. truth_known: (H, W) bool. visible: (H, W) bool, what both cameras
    see; the rest is darker.
    """
    size = np.where(np.isfinite(error), np.abs(error), np.inf).astype(np.float32)
    kind = np.searchsorted(np.array(ERROR_EDGES, np.float32), size).astype(np.uint8)
    kind[~np.isfinite(error)] = len(_ERROR_COLOURS)
    kind[~truth_known] = len(_ERROR_COLOURS) + 1
    bright = np.array([*_ERROR_COLOURS, _NO_DISPARITY, _UNKNOWN])[:, ::-1]
    table = np.zeros((256, 1, 3), np.uint8)
    table[: len(bright), 0] = bright
    table[128 : 128 + len(bright), 0] = np.rint(bright * _OCCLUDED)
    if visible is not None:
        kind[~visible] += 128
    coloured = np.asarray(cv2.applyColorMap(kind, table))
    strip = _Strip.below(coloured)
    _draw_error_colours(strip, occluded=visible is not None)
    return strip.under(coloured)


@dataclass(frozen=True, eq=False)
class _Strip:
    """The legend below a picture: axes whose unit is the height of a letter, from the left and from the bottom.

    size: its width and height in pixels. width: in letters. points: the height of a letter as matplotlib counts it.
    """

    figure: Figure
    axes: Axes
    size: tuple[int, int]
    width: float
    points: float

    @staticmethod
    def below(picture: Array) -> "_Strip":
        """Return an empty legend for a picture."""
        width = max(picture.shape[1], _NARROWEST)
        font = max(_SMALLEST_FONT, _FONT * width)
        size = (width, round(_STRIP * font))
        inches = ((size[0] + 0.5) / _DPI, (size[1] + 0.5) / _DPI)  # matplotlib cuts off what is no whole pixel
        figure = Figure(figsize=inches, dpi=_DPI, facecolor="white")
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set_xlim(0, width / font)
        axes.set_ylim(0, _STRIP)
        axes.set_axis_off()
        return _Strip(figure, axes, size, width / font, font * 72 / _DPI)

    def write(self, x: float, y: float, text: str, align: Literal["left", "center", "right"] = "left") -> None:
        self.axes.text(x, y, text, ha=align, va="center", fontsize=self.points)

    def box(self, x: float, y: float, width: float, colour: tuple[int, int, int]) -> None:
        self.axes.add_patch(Rectangle((x, y), width, _BOX, facecolor=[part / 255 for part in colour], edgecolor="none"))

    def under(self, picture: Array) -> Array:
        """Return the picture with the legend below; a picture narrower than that stands on white."""
        stream = BytesIO()
        self.figure.savefig(stream, format="rgba", dpi=_DPI)
        legend = np.frombuffer(stream.getbuffer(), np.uint8).reshape(self.size[1], self.size[0], 4)
        height, width = picture.shape[:2]
        whole = np.full((height + self.size[1], self.size[0], 3), 255, np.uint8)
        whole[:height, :width] = picture
        whole[height:] = legend[:, :, 2::-1]
        return whole


def _draw_scale(strip: _Strip, limits: tuple[float, float], geometry: StereoGeometry | None) -> None:
    """Draw the colours from low to high, pixels above them and metres below."""
    low, high = limits
    left, right, bottom = 8.6, strip.width - 8.2, 1.9
    colours = ListedColormap(turbo_table()[_DARKEST:] / 255)
    steps = np.arange(256 - _DARKEST)[None]
    strip.axes.imshow(
        steps, colours, aspect="auto", extent=(left, right, bottom, bottom + _BOX), interpolation="nearest"
    )
    strip.write(0.6, _ABOVE, "disparity, px")
    ticks = np.array(MaxNLocator(max(2, int((right - left) / 5)), steps=[1, 2, 5, 10]).tick_values(low, high))
    for tick in ticks[(ticks >= low) & (ticks <= high)]:
        place = left + (right - left) * (tick - low) / (high - low)
        strip.axes.plot([place, place], [bottom + _BOX, bottom + _BOX + 0.25], color="black", lw=strip.points / 12)
        strip.write(place, _ABOVE, f"{tick:.6g}", "center")
        if geometry is not None and tick + geometry.doffs > 0:
            depth = geometry.fx * geometry.baseline / (tick + geometry.doffs)
            strip.write(place, _BELOW, f"{depth:.3g}", "center")
    if geometry is not None:
        strip.write(0.6, _BELOW, "depth, m")
    strip.box(strip.width - 6.9, bottom, 1.0, _UNKNOWN)
    strip.write(strip.width - 5.5, bottom + _BOX / 2, "no match")


def _draw_error_colours(strip: _Strip, occluded: bool) -> None:
    """Draw a box for each colour, with the errors between them."""
    left, bottom = 0.6, 1.9
    wide = (strip.width - 2 * left) / len(_ERROR_COLOURS)
    for index, colour in enumerate(_ERROR_COLOURS):
        strip.box(left + index * wide, bottom, wide, colour)
    for index, edge in enumerate(ERROR_EDGES, 1):
        strip.write(left + index * wide, _ABOVE, f"{edge:g}", "center")
    strip.write(left, _ABOVE, "error")
    strip.write(strip.width - left, _ABOVE, "px", "right")
    strip.box(left, _BELOW - _BOX / 2, 1.0, _NO_DISPARITY)
    strip.write(left + 1.4, _BELOW, "no disparity")
    strip.box(left + 9, _BELOW - _BOX / 2, 1.0, _UNKNOWN)
    strip.write(left + 10.4, _BELOW, "no truth")
    if occluded:
        strip.write(left + 16.5, _BELOW, "dark: occluded")
