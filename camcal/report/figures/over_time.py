"""Plots of series and tracks over time, with uncertainty and consistency."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from camcal.arrays import Array
from camcal.estimate.tracking.track import MEASURED, PREDICTED, REJECTED, Track
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.report.figures.sensor import STYLE, encoded

_SMOOTHED, _POINTS, _OUTLIERS = "tab:blue", "0.45", "tab:red"

# tracks
_RAW, _LINE, _OUT, _SPAN = "0.65", "tab:blue", "tab:red", "0.93"
_AXES = "xyz"
_ROWS = 7
_HEADROOM = 30  # times the largest NIS: room for the legend


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
            _draw_panel(axes, panel)
        figure.legend(*rows[0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
        rows[-1].set_xlabel("time from the first measurement, s")
        return encoded(figure, suffix)


def _draw_panel(axes: Axes, panel: Panel) -> None:
    stamps, values, std = panel.smoothed
    when, measured = panel.measured
    start, good = when[0], ~panel.outliers
    axes.plot(when[good] - start, measured[good], ".", color=_POINTS, ms=3, label="measured")
    axes.plot(when[~good] - start, measured[~good], "x", color=_OUTLIERS, ms=5, label="outliers")
    axes.fill_between(stamps - start, values - 2 * std, values + 2 * std, color=_SMOOTHED, alpha=0.25, lw=0)
    axes.plot(stamps - start, values, color=_SMOOTHED, lw=1, label="smoothed ± 2 σ")
    axes.set_ylabel(panel.name)
    axes.grid(visible=True, alpha=0.3)


def track_figure(track: Track, single: Sequence[Pose | None], title: str, gate: float, suffix: str) -> bytes:
    """Return a figure of a track as a file of the type of `suffix`.

    single: the pose that each frame gave by itself, in the track's direction. gate: of the NIS. Gray bands are the
    pieces of the track; a cross is a detection that was left out.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10, 13))
        figure.subplots_adjust(left=0.085, right=0.985, bottom=0.045, top=0.96, hspace=0.12)
        FigureCanvasAgg(figure)
        axes: Any = figure.subplots(_ROWS, 1, sharex=True)
        seen = np.array([index for index, pose in enumerate(single) if pose is not None])
        raw = [pose for pose in single if pose is not None]
        places = np.array([pose.translation for pose in raw])
        middle = _middle(track)
        turns = np.degrees(so3.log(np.array([pose.rotation for pose in raw]) @ middle.T))
        smooth_turns = np.full_like(track.translations, np.nan)
        smooth_turns[track.posed] = np.degrees(so3.log(track.rotations[track.posed] @ middle.T))
        for axis in range(3):
            _draw_coordinate(axes[axis], track, seen, places[:, axis] * 1e3, track.translations[:, axis] * 1e3)
            axes[axis].set_ylabel(f"{_AXES[axis]}, mm")
            _draw_coordinate(axes[axis + 3], track, seen, turns[:, axis], smooth_turns[:, axis])
            axes[axis + 3].set_ylabel(f"turn about {_AXES[axis]}, deg")
        _draw_nis(axes[-1], track, gate)
        axes[0].set_title(title)
        axes[0].legend(loc="upper right", ncols=3, framealpha=0.9)
        axes[-1].set_xlabel("time, s")
        figure.align_ylabels()
        return encoded(figure, suffix)


def _middle(track: Track) -> Array:
    """Return the mean rotation (3, 3), from which the turns are counted."""
    return so3.nearest(track.rotations[track.posed].mean(axis=0))


def _draw_coordinate(axes: Axes, track: Track, seen: Array, raw: Array, smooth: Array) -> None:
    """Draw one coordinate: of the single poses at the frames `seen`, and of the track."""
    states = np.array(track.states)[seen]
    used, refused = states == MEASURED, states == REJECTED
    stamps = track.stamps[seen]
    _draw_pieces(axes, track)
    axes.plot(stamps[used], raw[used], "o", color=_RAW, ms=4, label="single frames")
    axes.plot(stamps[refused], raw[refused], "x", color=_OUT, ms=5, label="left out")
    for piece in range(track.segments.max() + 1):
        inside = (track.segments == piece) & track.posed
        label = "track" if piece == 0 else None
        axes.plot(track.stamps[inside], smooth[inside], color=_LINE, lw=1, label=label)
    predicted = np.array(track.states) == PREDICTED
    axes.plot(track.stamps[predicted], smooth[predicted], "o", color=_LINE, mfc="white", ms=3)
    _limit_axis(axes, np.concatenate([smooth[np.isfinite(smooth)], raw[used]]))


def _limit_axis(axes: Axes, values: Array) -> None:
    """Show what belongs to the track; an outlier far off shall not flatten it."""
    low, high = np.min(values), np.max(values)
    margin = 0.15 * (high - low) or 1e-3
    axes.set_ylim(low - margin, high + margin)
    axes.grid(visible=True, lw=0.4, alpha=0.6)


def _draw_pieces(axes: Axes, track: Track) -> None:
    for piece in range(track.segments.max() + 1):
        inside = track.stamps[track.segments == piece]
        axes.axvspan(inside[0], inside[-1], color=_SPAN, lw=0)


def _draw_nis(axes: Axes, track: Track, gate: float) -> None:
    states = np.array(track.states)
    known = np.isfinite(track.nis)
    _draw_pieces(axes, track)
    for state, colour, mark in ((MEASURED, _LINE, "."), (REJECTED, _OUT, "x")):
        chosen = known & (states == state)
        axes.plot(track.stamps[chosen], track.nis[chosen], mark, color=colour, ms=5)
    axes.axhline(gate, color=_OUT, lw=0.8, ls="--", label=f"gate {gate:.4g}")
    axes.axhline(6, color="0.25", lw=0.8, ls=":", label="expected mean 6")
    axes.set_yscale("log")
    axes.set_ylim(top=_HEADROOM * max(gate, float(np.nanmax(track.nis, initial=gate))))
    axes.set_ylabel("NIS")
    axes.grid(visible=True, lw=0.4, alpha=0.6)
    axes.legend(loc="upper right", ncols=2, framealpha=0.9)
