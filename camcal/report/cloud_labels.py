"""What is written over a picture of a cloud: its caption, a scale bar, the legend of its colours."""

from dataclasses import dataclass
from io import BytesIO
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.colors import ListedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullLocator

from camcal.arrays import Array
from camcal.report.colour_scale import ColourScale, turbo_table

_DPI = 100
_FONT = 1 / 55  # of the smaller side of the picture
_SMALLEST_FONT = 9.0  # pixels
_INK = "0.15"
_OPACITY = 0.85
_PAPER: dict[str, Any] = {"facecolor": "white", "alpha": _OPACITY, "edgecolor": "none", "pad": 2.5}
_BAR = 0.22  # longest scale bar as a share of the width


@dataclass(frozen=True)
class Labels:
    """A caption; the unit of the cloud; pixels per unit for a scale bar, None in perspective; a scale and its name."""

    caption: str
    unit: str
    pixels_per_unit: float | None = None
    scale: ColourScale | None = None
    scale_name: str = ""


def nice_below(length: float) -> float:
    """Return the largest of 1, 2, 5, 10, 20, 50 … (or 0.5, 0.2, …) that is not above a positive length."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(power * max(step for step in (1, 2, 5) if step * power <= length * (1 + 1e-9)))


def write_labels(pixels: Array, labels: Labels) -> Array:
    """Return a picture (H, W, 3), red, green, blue, uint8, with its labels; elsewhere its pixels are untouched."""
    over = _overlay((pixels.shape[1], pixels.shape[0]), labels)
    share = over[..., 3:] / np.float32(255)
    mixed: Array = np.rint(pixels * (1 - share) + over[..., :3] * share).astype(np.uint8)
    return mixed


def _overlay(size: tuple[int, int], labels: Labels) -> Array:
    """Return the labels alone (H, W, 4), red, green, blue and opacity."""
    font = max(_SMALLEST_FONT, _FONT * min(size))
    with mpl.rc_context({"font.size": font * 72 / _DPI, "axes.linewidth": font / 16}):
        inches = ((size[0] + 0.5) / _DPI, (size[1] + 0.5) / _DPI)  # matplotlib cuts off what is no whole pixel
        figure = Figure(figsize=inches, dpi=_DPI)
        edge = (0.8 * font / size[0], 0.8 * font / size[1])
        figure.text(edge[0], 1 - edge[1], labels.caption, va="top", color=_INK, bbox=_PAPER)
        if labels.pixels_per_unit is not None:
            _draw_bar(figure, labels, size, font)
        if labels.scale is not None:
            _draw_legend(figure, labels, labels.scale, size, font)
        stream = BytesIO()
        figure.savefig(stream, format="rgba", dpi=_DPI, facecolor="none")
    return np.frombuffer(stream.getvalue(), np.uint8).reshape(size[1], size[0], 4)


def _draw_bar(figure: Figure, labels: Labels, size: tuple[int, int], font: float) -> None:
    """Draw a length and what it is, at the bottom left."""
    per_unit = labels.pixels_per_unit or 1.0
    length = nice_below(_BAR * size[0] / per_unit)
    width = length * per_unit / size[0]
    axes = figure.add_axes((font / size[0], font / size[1], width, 0.45 * font / size[1]))
    axes.set_facecolor(_INK)
    axes.set_xticks([])
    axes.set_yticks([])
    place = (1.1 * font / size[0], 1.9 * font / size[1])
    figure.text(*place, f"{length:g} {labels.unit}", va="bottom", color=_INK, bbox=_PAPER)


def _draw_legend(figure: Figure, labels: Labels, scale: ColourScale, size: tuple[int, int], font: float) -> None:
    """Draw the colours and the numbers they stand for, at the bottom right."""
    height, wide = min(0.42 * size[1], 14 * font), 5.6 * font
    left, bottom = size[0] - wide - 0.5 * font, 0.7 * font
    paper = figure.add_axes((left / size[0], bottom / size[1], wide / size[0], (height + 2.6 * font) / size[1]))
    paper.set_facecolor((1, 1, 1, _OPACITY))
    paper.set_xticks([])
    paper.set_yticks([])
    for side in paper.spines.values():
        side.set_visible(False)
    paper.text(0.5, 1 - 0.5 * font / (height + 2.6 * font), f"{labels.scale_name}, {labels.unit}", ha="center",
               va="top", color=_INK)  # fmt: skip
    bar = ((left + 0.7 * font) / size[0], (bottom + 0.6 * font) / size[1], 1.1 * font / size[0], height / size[1])
    axes = figure.add_axes(bar)
    norm = (LogNorm if scale.logarithmic else Normalize)(scale.low, scale.high)
    colours = mpl.cm.ScalarMappable(norm, ListedColormap(turbo_table() / 255))
    colour_bar = figure.colorbar(colours, cax=axes, ticks=_ticks(scale))
    colour_bar.ax.yaxis.set_minor_locator(NullLocator())
    colour_bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.4g}"))
    colour_bar.ax.tick_params(colors=_INK, width=font / 16, length=0.3 * font, pad=0.25 * font)


def _ticks(scale: ColourScale) -> list[float]:
    """Return numbers within a scale to write beside it: round ones, at most nine."""
    if not scale.logarithmic:
        inside = MaxNLocator(nbins=7, steps=[1, 2, 2.5, 5, 10]).tick_values(scale.low, scale.high)
        return [float(value) for value in inside if scale.low <= value <= scale.high]
    powers = 10.0 ** np.arange(np.floor(np.log10(scale.low)), np.ceil(np.log10(scale.high)) + 1)
    for steps in ((1, 1.5, 2, 3, 5, 7), (1, 2, 5), (1, 3), (1,)):
        ticks = [float(power * step) for power in powers for step in steps]
        inside = [value for value in ticks if scale.low <= value <= scale.high]
        if len(inside) <= 9:
            return inside
    return [scale.low, scale.high]
