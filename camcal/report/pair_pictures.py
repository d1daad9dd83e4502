"""A picture of a check: which rows are off and where, over the left image, and how far things are apart."""

from io import BytesIO
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PatchCollection
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from camcal.arrays import Array
from camcal.report.pair_check import headline, verdict
from camcal.stereo.pair.alignment import Residual
from camcal.stereo.pair.pair_check import PairCheck

SUFFIXES = (".png",)

_ROWS = "row in the right image minus row in the left, px"
_DPI = 110
_WIDTH, _IMAGE_SHARE = 12.0, 0.62  # inches, and how much of them is the image
_HEIGHTS = (4.6, 9.0)  # inches
_WIDEST = 1200  # px of the image behind; the figure shows no more
_CELLS = 14  # across the image
_FEWEST = 3  # features whose median stands for a cell
_LEAST_SCALE = 0.5  # px that full colour stands for, at least: what does no harm is to look harmless
_LEAST_SLOPE = 0.05  # px across the image that are worth lines
_ROOM = 1.25  # above a histogram, for the legend
_STYLE: dict[Any, Any] = {"font.size": 9}


def picture_of(check: PairCheck, left: Array) -> bytes:
    """Return a PNG file: the left image (H, W) uint8, its features and what their rows are off, and two histograms.

    Arrows show, enlarged, where the right image has what the cell under them shows; the lines show the trend.
    """
    height = _WIDTH * _IMAGE_SHARE * left.shape[0] / left.shape[1] + 1.0
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(_WIDTH, float(np.clip(height, *_HEIGHTS))), layout="constrained")
        FigureCanvasAgg(figure)
        areas = figure.add_gridspec(2, 2, width_ratios=(2.4, 1))
        _draw_rows(figure.add_subplot(areas[:, 0]), check.residual, left)
        _draw_residuals(figure.add_subplot(areas[0, 1]), check.residual)
        _draw_disparities(figure.add_subplot(areas[1, 1]), check)
        figure.suptitle(f"{headline(check.residual)}\n{verdict(check)}", fontsize=10)
        stream = BytesIO()
        figure.savefig(stream, format="png", dpi=_DPI, metadata={"Software": None})
    return stream.getvalue()


def _draw_rows(axes: Axes, residual: Residual, left: Array) -> None:
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
    axes.figure.colorbar(dots, ax=axes, shrink=0.8, pad=0.01, label=_ROWS)
    _draw_trend(axes, residual)
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), xticks=[], yticks=[])
    axes.set_title(f"row offset of the right image, arrows × {0.9 * cell / full:.0f}")
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


def _draw_residuals(axes: Axes, residual: Residual) -> None:
    limit = max(float(np.quantile(np.abs(residual.dy), 0.99)), _LEAST_SCALE)
    axes.hist(np.clip(residual.dy, -limit, limit), bins=np.linspace(-limit, limit, 41).tolist(), color="tab:gray")
    axes.axvline(0, color="black", lw=0.8)
    axes.axvline(residual.median.value, color="tab:red", lw=1.2, label=f"median {residual.median.value:+.3f} px")
    axes.set_xlabel(_ROWS)
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
