"""The figure of numbers over time: what was measured, and what is known of it."""

from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from camcal.arrays import Array
from camcal.report.figures import STYLE, encoded

_LINE, _POINTS, _OUTLIERS = "tab:blue", "0.45", "tab:red"


@dataclass(frozen=True, eq=False)
class Panel:
    """One number over time.

    smoothed: times (K,), values (K,), standard deviations (K,). measured: times (M,), values (M,). outliers: (M,) bool.
    """

    name: str
    smoothed: tuple[Array, Array, Array]
    measured: tuple[Array, Array]
    outliers: Array


def over_time(panels: Sequence[Panel], suffix: str) -> bytes:
    """Return a figure with a panel for every number, as a file of the type of `suffix`: bands are two σ wide."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 1.2 + 1.7 * len(panels)), layout="constrained")
        FigureCanvasAgg(figure)
        rows = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for axes, panel in zip(rows, panels, strict=True):
            _draw(axes, panel)
        figure.legend(*rows[0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
        rows[-1].set_xlabel("time from the first measurement, s")
        return encoded(figure, suffix)


def _draw(axes: Axes, panel: Panel) -> None:
    stamps, values, std = panel.smoothed
    when, measured = panel.measured
    start, good = when[0], ~panel.outliers
    axes.plot(when[good] - start, measured[good], ".", color=_POINTS, ms=3, label="measured")
    axes.plot(when[~good] - start, measured[~good], "x", color=_OUTLIERS, ms=5, label="outliers")
    axes.fill_between(stamps - start, values - 2 * std, values + 2 * std, color=_LINE, alpha=0.25, lw=0)
    axes.plot(stamps - start, values, color=_LINE, lw=1, label="smoothed ± 2 σ")
    axes.set_ylabel(panel.name)
    axes.grid(visible=True, alpha=0.3)
