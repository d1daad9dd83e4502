"""Pictures of disparity maps and their errors with legends; of a pair and its row offsets."""

from io import BytesIO
from typing import Any, Literal

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PatchCollection
from matplotlib.colors import ListedColormap, TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.report.colour_scale import turbo_table
from camcal.report.figures.figure import free_drawn
from camcal.report.stereo_words import headline, line_of, verdict
from camcal.stereo.alignment import Residual
from camcal.stereo.disparity import StereoGeometry
from camcal.stereo.pair_check import PairCheck
from camcal.stereo.rectify.record import LATLON, PINHOLE

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

# the picture of a check
SUFFIXES = (".png",)
_CHECK_DPI = 110
_WIDTH, _IMAGE_SHARE = 12.0, 0.62  # inches, and how much of them is the image
_HEIGHTS = (4.6, 9.0)  # inches
_WIDEST = 1200  # px of the image behind; the figure shows no more
_CELLS = 14  # across the image
_FEWEST = 3  # features whose median stands for a cell
_LEAST_SCALE = 0.5  # px that full colour stands for, at least: what does no harm is to look harmless
_LEAST_SLOPE = 0.05  # px across the image that are worth lines
_ROOM = 1.25  # above a histogram, for the legend
_GAP = 0.12  # inches between the headline and the panels, and between these
_STYLE: dict[Any, Any] = {"font.size": 9, "axes.titlesize": 9, "figure.constrained_layout.h_pad": _GAP}


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
        free_drawn()
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
    """Draw the colours from low to high, pixels above them and metres below, if one disparity is one distance."""
    if geometry is not None and geometry.projection == LATLON:
        geometry = None
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
            depth = geometry.scale / (tick + geometry.doffs)
            strip.write(place, _BELOW, f"{depth:.3g}", "center")
    if geometry is not None:
        strip.write(0.6, _BELOW, "depth, m" if geometry.projection == PINHOLE else "distance, m")
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


def picture_of(check: PairCheck, left: Array) -> bytes:
    """Return a PNG file: the left image (H, W) uint8, its features and what their rows are off, and two histograms.

    Images of cameras above each other are drawn on their side.

    Arrows show, enlarged, where the right image has what the cell under them shows; the lines show the trend.
    """
    left = left.T if check.upright else left
    height = _WIDTH * _IMAGE_SHARE * left.shape[0] / left.shape[1] + 1.0
    free_drawn()
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(_WIDTH, float(np.clip(height, *_HEIGHTS))), layout="constrained")
        FigureCanvasAgg(figure)
        areas = figure.add_gridspec(2, 2, width_ratios=(2.4, 1))
        _draw_rows(figure.add_subplot(areas[:, 0]), check, left)
        _draw_residuals(figure.add_subplot(areas[0, 1]), check)
        _draw_disparities(figure.add_subplot(areas[1, 1]), check)
        figure.suptitle(f"{headline(check)}\n{verdict(check)}", fontsize=10)
        stream = BytesIO()
        figure.savefig(stream, format="png", dpi=_CHECK_DPI, metadata={"Software": None})
    return stream.getvalue()


def _offset(check: PairCheck) -> str:
    line = line_of(check)
    return f"{line} in the right image minus {line} in the left, px"


def _draw_rows(axes: Axes, check: PairCheck, left: Array) -> None:
    residual = check.residual
    width, height = residual.size
    step = -(-width // _WIDEST)
    axes.imshow(left[::step, ::step], cmap="gray", vmin=-150, vmax=330, extent=(-0.5, width - 0.5, height - 0.5, -0.5))
    full = max(residual.p95, _LEAST_SCALE)
    colours: dict[str, Any] = {"cmap": "coolwarm", "norm": TwoSlopeNorm(0, -full, full)}
    x, y = residual.pixels.T
    dots = axes.scatter(x, y, c=residual.dy, s=5, linewidths=0, **colours)
    cell = width / _CELLS
    middles, medians = _cells(residual, cell)
    squares = [Rectangle((x - cell / 2, y - cell / 2), cell, cell) for x, y in middles]
    axes.add_collection(PatchCollection(squares, array=medians, alpha=0.35, linewidths=0, **colours))
    lengths = np.clip(medians, -full, full) / full * cell * 0.9
    arrows: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1, "pivot": "mid", "width": 0.004}
    axes.quiver(*middles.T, np.zeros_like(lengths), lengths, medians, ec="black", lw=0.4, **arrows, **colours)
    axes.figure.colorbar(dots, ax=axes, shrink=0.8, pad=0.01, label=_offset(check))
    _draw_trend(axes, residual)
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), xticks=[], yticks=[])
    turned = " (images on their side)" if check.upright else ""
    axes.set_title(f"{line_of(check)} offset of the right image, arrows × {0.9 * cell / full:.0f}{turned}")
    _explain(axes)


def _explain(axes: Axes) -> None:
    """Say below the image what its marks are."""
    arrow = Line2D([], [], ls="", marker=r"$\downarrow$", color="tab:red", markersize=9)
    dot, bare = (
        Line2D([], [], ls="", marker=mark, color="gray", markersize=size) for mark, size in (("o", 3), ("s", 9))
    )
    words = ("feature", f"median of a cell with {_FEWEST} or more", "no arrow: fewer features, or none")
    axes.legend((dot, arrow, bare), words, loc="upper center", bbox_to_anchor=(0.5, 0), ncols=3, frameon=False)


def _cells(residual: Residual, cell: float) -> tuple[Array, Array]:
    """Return the middles (N, 2) of the square cells that features lie in, pixels, and the medians (N,) of their dy."""
    places, members = np.unique(residual.pixels // cell, axis=0, return_inverse=True)
    held = [residual.dy[members.ravel() == index] for index in range(len(places))]
    shown = np.array([len(values) >= _FEWEST for values in held])
    medians = np.array([np.median(values) for values in held])
    return (places[shown] + 0.5) * cell, medians[shown]


def _draw_trend(axes: Axes, residual: Residual) -> None:
    """Draw the lines along which the trend is the same."""
    width, height = residual.size
    trend = residual.trend
    across, down = np.meshgrid(np.linspace(-0.5, 0.5, 50), np.linspace(-0.5, 0.5, 50))
    off = trend.centre.value + trend.tilt.value * across + trend.scale.value * down
    if np.ptp(off) < _LEAST_SLOPE:
        return
    lines = axes.contour((across + 0.5) * width, (down + 0.5) * height, off, 5, colors="black", linewidths=0.8)
    axes.clabel(lines, fmt="%+.2f", fontsize=8)


def _draw_residuals(axes: Axes, check: PairCheck) -> None:
    residual = check.residual
    limit = max(float(np.quantile(np.abs(residual.dy), 0.99)), _LEAST_SCALE)
    axes.hist(np.clip(residual.dy, -limit, limit), bins=np.linspace(-limit, limit, 41).tolist(), color="tab:gray")
    axes.axvline(0, color="black", lw=0.8)
    axes.axvline(residual.median.value, color="tab:red", lw=1.2, label=f"median {residual.median.value:+.3f} px")
    axes.set_xlabel(_offset(check))
    axes.set_ylabel("features")
    axes.set_ylim(top=_ROOM * axes.get_ylim()[1])
    axes.legend(loc="upper left", fontsize=8)


def _draw_disparities(axes: Axes, check: PairCheck) -> None:
    values = check.disparities if check.disparities.size else check.residual.disparity
    axes.hist(values, bins=80, color="tab:blue", weights=np.full(len(values), 100 / len(values)))
    if check.searched is not None:
        for end, label in zip(check.searched, ("range to search", None), strict=True):
            axes.axvline(end, color="tab:red", lw=1.2, ls="--", label=label)
        axes.legend(loc="upper left", fontsize=8)
    axes.set_xlabel("disparity, px (right: nearer)")
    axes.set_ylabel("% of what is matched")
    axes.set_ylim(top=_ROOM * axes.get_ylim()[1])
