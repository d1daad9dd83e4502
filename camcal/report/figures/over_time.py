"""Figures over the time, of series and tracks, and over the distance, of the blur of a lens."""

from collections.abc import Callable, Sequence
from math import inf

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.estimate.tracking.track import MEASURED, PREDICTED, REJECTED, Track
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.optics import blur_disc
from camcal.report.figures.figure import WIDTH, Plot, Theme, beside, logarithmic_labels

_AXES = "xyz"
_HEADROOM = 30  # times the largest NIS: room for the legend
_LEAST_NIS = 0.05  # that is shown: one in a million is less
_ROW = 1.3  # inches

_DECADE = 10  # a longer range of distances is drawn with a logarithmic axis


@dataclass(frozen=True, eq=False)
class Panel:
    """One number over time.

    smoothed: times (K,), values (K,), standard deviations (K,). measured: times (M,), values (M,). outliers: (M,) bool.
    """

    name: str
    smoothed: tuple[Array, Array, Array]
    measured: tuple[Array, Array]
    outliers: Array


def over_time(panels: Sequence[Panel]) -> Plot:
    """Return a panel for every number over time: bands are two σ wide."""
    outliers = sum(int(panel.outliers.sum()) for panel in panels)
    names = ", ".join(panel.name for panel in panels)
    span = float(np.ptp(panels[0].smoothed[0]))

    def draw(figure: FigureBase, theme: Theme) -> None:
        rows = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for axes, panel in zip(rows, panels, strict=True):
            _draw_panel(axes, panel, theme)
        figure.legend(*rows[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
        rows[-1].set_xlabel("time from the first measurement, s")

    return Plot(
        "over_time",
        "Measured and smoothed",
        f"Measured (dots), outliers (crosses, {outliers}) and smoothed values with a band of two standard deviations "
        f"to either side, over {span:.4g} s: {names}.",
        f"Measured and smoothed values over {span:.4g} s: {names}.",
        draw,
        (WIDTH, 1.1 + _ROW * len(panels)),
    )


def _draw_panel(axes: Axes, panel: Panel, theme: Theme) -> None:
    stamps, values, std = panel.smoothed
    when, measured = panel.measured
    start, good = min(when[:1].min(initial=np.inf), stamps[0]), ~panel.outliers
    if len(when):
        axes.plot(when[good] - start, measured[good], ".", color=theme.ink, ms=3, label="measured")
        axes.plot(when[~good] - start, measured[~good], "x", color=theme.bad, ms=5, label="outliers")
    axes.fill_between(stamps - start, values - 2 * std, values + 2 * std, color=theme.series[0], alpha=0.3, lw=0)
    axes.plot(stamps - start, values, color=theme.series[0], lw=1, label="smoothed ± 2 σ")
    axes.set_ylabel(panel.name)
    axes.grid(visible=True)


def track_over_time(track: Track, single: Sequence[Pose | None], title: str, gate: float) -> Plot:
    """Return position, rotation and innovations of a track over time as one figure; see `track_plots`."""
    return beside("track", title, track_plots(track, single, gate), below=True)


def track_plots(track: Track, single: Sequence[Pose | None], gate: float) -> tuple[Plot, Plot, Plot]:
    """Return position, rotation and innovations of a track over time.

    single: the pose that each frame gave by itself, in the track's direction. gate: of the NIS. Gray bands are the
    segments of the track; a cross is a detection that was rejected.
    """
    seen = np.array([index for index, pose in enumerate(single) if pose is not None], dtype=np.intp)
    raw = [pose for pose in single if pose is not None]
    places = 1e3 * np.array([pose.translation for pose in raw]).reshape(-1, 3)
    middle = so3.nearest(track.rotations[track.posed].mean(axis=0))
    turns = np.degrees(so3.log(np.array([pose.rotation for pose in raw]).reshape(-1, 3, 3) @ middle.T))
    smooth_turns = np.full_like(track.translations, np.nan)
    smooth_turns[track.posed] = np.degrees(so3.log(track.rotations[track.posed] @ middle.T))
    number = int(track.segments.max()) + 1
    segments = f"{number} track segment{'s' * (number != 1)} (gray bands)"
    counts = (
        f"{track.count(MEASURED)} frames measured, {track.count(PREDICTED)} predicted, "
        f"{track.count(REJECTED)} rejected (crosses), {segments}"
    )

    def coordinates(raw: Array, smooth: Array, label: str) -> Callable[[FigureBase, Theme], None]:
        def draw(figure: FigureBase, theme: Theme) -> None:
            rows = figure.subplots(3, 1, sharex=True)
            for axis, axes in enumerate(rows):
                _draw_coordinate(axes, track, seen, raw[:, axis], smooth[:, axis], theme)
                axes.set_ylabel(label.format(_AXES[axis]))
            figure.legend(*rows[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
            rows[-1].set_xlabel("time, s")

        return draw

    size = (WIDTH, 1.1 + 3 * _ROW)
    return (
        Plot(
            "position",
            "Position",
            f"Translation of {track.frames} over time, mm, of single frames and of the track: {counts}.",
            f"Three coordinates in mm over time: {counts}.",
            coordinates(places, 1e3 * track.translations, "{}, mm"),
            size,
        ),
        Plot(
            "rotation",
            "Rotation",
            f"Rotation of {track.frames} from its mean over time, degrees about three axes: {counts}.",
            f"Three angles in degrees over time: {counts}.",
            coordinates(turns, smooth_turns, "about {}, deg"),
            size,
        ),
        innovations(track, gate),
    )


def innovations(track: Track, gate: float) -> Plot:
    """Return the normalised innovations squared of a track over time."""
    known = np.isfinite(track.nis)
    mean = float(np.mean(track.nis[known])) if known.any() else float("nan")

    def draw(figure: FigureBase, theme: Theme) -> None:
        axes = figure.subplots()
        states = np.array(track.states)
        _draw_segments(axes, track, theme)
        for state, colour, mark in ((MEASURED, theme.series[0], "."), (REJECTED, theme.bad, "x")):
            chosen = known & (states == state)
            axes.plot(track.stamps[chosen], track.nis[chosen], mark, color=colour, ms=5, label=state)
        axes.axhline(gate, color=theme.bad, lw=1, ls="--", label=f"gate {gate:.4g}")
        axes.axhline(6, color=theme.ink, lw=1, ls=":", label="expected mean 6")
        axes.set_yscale("log")
        axes.set_ylim(
            bottom=max(axes.get_ylim()[0], _LEAST_NIS),
            top=_HEADROOM * max(gate, float(np.nanmax(track.nis, initial=gate))),
        )
        logarithmic_labels(axes.yaxis)
        axes.set_ylabel("NIS, 1")
        axes.set_xlabel("time, s")
        axes.grid(visible=True)
        axes.legend(loc="upper left", ncols=2)

    return Plot(
        "innovations",
        "Innovations",
        f"Normalised innovation squared (NIS, no unit) of the detections: mean {mean:.3g}, expected 6; one above the "
        f"gate of {gate:.4g} is rejected unless the next agrees with it (a jerk).",
        f"NIS over time, mean {mean:.3g}, gate {gate:.4g}.",
        draw,
        (WIDTH, 3.2),
    )


def _draw_coordinate(axes: Axes, track: Track, seen: Array, raw: Array, smooth: Array, theme: Theme) -> None:
    """Draw one coordinate: of the single poses at the frames `seen`, and of the track."""
    states = np.array(track.states)[seen]
    used, refused = states == MEASURED, states == REJECTED
    stamps = track.stamps[seen]
    _draw_segments(axes, track, theme)
    axes.plot(stamps[used], raw[used], "o", color=theme.ink, alpha=0.5, ms=3, label="single frames")
    axes.plot(stamps[refused], raw[refused], "x", color=theme.bad, ms=5, label="rejected")
    for segment in range(track.segments.max() + 1):
        inside = (track.segments == segment) & track.posed
        label = "track" if segment == 0 else None
        axes.plot(track.stamps[inside], smooth[inside], color=theme.series[0], lw=1.2, label=label)
    predicted = np.array(track.states) == PREDICTED
    axes.plot(track.stamps[predicted], smooth[predicted], "o", color=theme.series[0], mfc=theme.paper, ms=3)
    shown = np.concatenate([smooth[np.isfinite(smooth)], raw[used]])  # an outlier far off shall not flatten the track
    low, high = shown.min(), shown.max()
    margin = 0.15 * (high - low) or 1e-3
    axes.set_ylim(low - margin, high + margin)
    axes.grid(visible=True)


def _draw_segments(axes: Axes, track: Track, theme: Theme) -> None:
    for segment in range(track.segments.max() + 1):
        inside = track.stamps[track.segments == segment]
        axes.axvspan(inside[0], inside[-1], color=theme.faint, alpha=0.25, lw=0)


@dataclass(frozen=True)
class BlurCurve:
    """A lens whose blur over distance is drawn; lengths in metres, pitch and Airy disc None where unknown.

    near, far: the ends of the depth of field.
    """

    focal: float
    f_number: float
    focus: float
    circle: float
    near: float
    far: float
    pitch: float | None = None
    airy_diameter: float | None = None


def blur_over_distance(curve: BlurCurve) -> Plot:
    """Return the blur disc over distance with the depth of field."""
    focus = f"{curve.focus:g} m" if curve.focus < inf else "infinity"
    lens = f"{1e3 * curve.focal:.4g} mm, f/{curve.f_number:g}, focused at {focus}"
    ends = f"{curve.near:.4g} m to {curve.far:.4g} m" if curve.far < inf else f"from {curve.near:.4g} m on"

    def draw(figure: FigureBase, theme: Theme) -> None:
        _draw_blur(figure.subplots(), curve, ends, theme)

    return Plot(
        "blur_over_distance",
        "Blur over distance",
        f"Diameter of the blur disc of a lens of {lens}, over the distance of what it shows; in focus {ends}.",
        f"Blur disc over distance; in focus {ends}.",
        draw,
        (WIDTH, 4.0),
    )


def _draw_blur(axes: Axes, curve: BlurCurve, ends: str, theme: Theme) -> None:
    unit, scale = ("pixels", curve.pitch) if curve.pitch else ("um", 1e-6)
    # up to well beyond the depth of field to both sides, the focus among them
    far = curve.far if curve.far < inf else 10 * curve.near
    margin = min(max(far / curve.near, 1.05) ** 2, 4.0)
    low = max(curve.near / margin, 1.05 * curve.focal)
    distance = np.unique([*np.geomspace(low, far * margin, 400), min(curve.focus, far * margin)])
    disc = blur_disc(curve.focal, curve.f_number, curve.focus, distance) / scale
    axes.axvspan(curve.near, min(curve.far, distance[-1]), color=theme.good, alpha=0.15, label=f"in focus, {ends}")
    axes.plot(distance, disc, color=theme.series[0], label="blur disc")
    axes.axhline(curve.circle / scale, color=theme.ink, lw=0.8, ls="--", label="circle of confusion")
    if curve.airy_diameter is not None:
        axes.axhline(curve.airy_diameter / scale, color=theme.series[1], lw=0.8, ls=":", label="Airy disc")
    if distance[-1] > _DECADE * distance[0]:
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.set_xlim(distance[0], distance[-1])
    largest = max(curve.circle, curve.airy_diameter or 0) / scale
    axes.set_ylim(0, 1.35 * min(max(float(disc.max()), largest), 6 * largest))  # room for the legend
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel("distance from the front principal plane, m")
    axes.set_ylabel(f"diameter on the sensor, {unit}")
    axes.grid(visible=True, which="major")
    axes.legend(loc="upper right", framealpha=0.9)


def broken_at_half_turns(vectors: Array) -> Array:
    """Return rotation vectors (K, 3) to draw a line through: NaN where they jump to the other way round."""
    jumps = np.linalg.norm(np.diff(vectors, axis=0), axis=1) > np.pi
    return np.where(np.append(False, jumps)[:, None], np.nan, vectors)
