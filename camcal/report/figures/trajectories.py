"""Figures of trajectories: their projections onto three planes, their path in space, errors over time.

As evo draws them: equal lengths along all axes, start and end marked, coloured by time, or by error with a reference.
Source: Grupp, evo: Python package for the evaluation of odometry and SLAM, 2017.
"""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import FigureBase
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Line3DCollection

from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.estimate.trajectory_error import ErrorOptions, aligned
from camcal.geometry.pose import Trajectory
from camcal.report.figures.board import equal_aspect, space_axes
from camcal.report.figures.figure import WIDTH, Plot, Theme, line_colours

_AXES = "xyz"
_MOST_FRAMES = 12  # axes of poses along a path in space
_FRAME = 0.06  # of the largest extent: their length
_NARROWEST = 0.5  # of the largest side: of a panel
_FLAT = 1e-3  # of the largest extent: what is drawn of one that is smaller


@dataclass(frozen=True, eq=False)
class DrawnPath:
    """The places (N, 3) of a trajectory in metres, what colours them (N,), where a line between two is left out.

    label: of the colours, with their unit. broken: (N,) whether no line leads from a place to the next. rotations:
    (N, 3, 3). stamps: (N,) s. reference: (M, 3) places of a reference, None without one. words: what the colours say,
    for captions. unit: of the places.
    """

    frames: str
    places: Array
    colours: Array
    label: str
    broken: Array
    rotations: Array
    stamps: Array
    reference: Array | None = None
    words: str = ""
    unit: str = "m"


def path_of(
    trajectory: Trajectory, reference: Trajectory | None = None, options: ErrorOptions | None = None
) -> DrawnPath:
    """Return the path of a trajectory, coloured by time, or by its distance from a reference after alignment.

    Raises InsufficientData where the two have no times in common.
    """
    if reference is None:
        broken = np.zeros(len(trajectory), bool)
        if trajectory.segments is not None and len(trajectory) > 1:
            broken[:-1] = np.diff(trajectory.segments) != 0
        time = trajectory.stamps - trajectory.stamps[0]
        span = f"coloured by time over {time[-1]:.4g} s"
        return DrawnPath(
            trajectory.frames, trajectory.translations, time, "time, s", broken, trajectory.rotations,
            trajectory.stamps, words=span,
        )  # fmt: skip
    own, truth, _ = aligned(trajectory, reference, options or ErrorOptions())
    errors = np.linalg.norm(own.translations - truth.translations, axis=1)
    factor, unit = small_unit(float(errors.max()))
    rms = float(np.sqrt(np.mean(errors**2)))
    words = f"coloured by the distance from the reference (dashed) after alignment, {factor * rms:.3g} {unit} RMS"
    return DrawnPath(
        trajectory.frames, own.translations, factor * errors, f"error, {unit}", np.zeros(len(own), bool),
        own.rotations, own.stamps, truth.translations, words,
    )  # fmt: skip


def small_unit(largest: float) -> tuple[float, str]:
    """Return the factor that takes lengths in metres to the unit that they are said in, and that unit."""
    return (1e3, "mm") if largest < 1 else (1.0, "m")


def trajectory_plots(path: DrawnPath) -> tuple[Plot, ...]:
    """Return a path in three planes and in space, and its errors over time where there is a reference."""
    over = (errors_over_time(path),) if path.reference is not None else ()
    return (in_planes(path), in_space(path), *over)


def _extent(path: DrawnPath) -> tuple[float, str, str]:
    """Return factor and unit of the places, and the extents of the path in words."""
    size = np.ptp(path.places, axis=0)
    factor, unit = small_unit(float(size.max())) if path.unit == "m" else (1.0, path.unit)
    length = float(np.linalg.norm(np.diff(path.places, axis=0), axis=1)[~path.broken[:-1]].sum())
    extents = " x ".join(f"{factor * side:.3g}" for side in size)
    return factor, unit, f"{len(path.places)} poses, {factor * length:.4g} {unit} long, extent {extents} {unit}"


def in_planes(path: DrawnPath) -> Plot:
    """Return the projections of a path onto the planes xy, zy and xz."""
    factor, unit, words = _extent(path)

    def draw(figure: FigureBase, theme: Theme) -> None:
        places = factor * path.places
        reference = None if path.reference is None else factor * path.reference
        size = np.maximum(np.ptp(places, axis=0), _FLAT * float(np.ptp(places, axis=0).max()) or 1.0)
        size = np.maximum(size, _NARROWEST * size.max())
        parts = figure.subplot_mosaic(
            [["xy", "zy"], ["xz", "words"]],
            width_ratios=(size[0], size[2]),
            height_ratios=(size[1], size[2]),
        )
        for plane in ("xy", "zy", "xz"):
            axes, columns = parts[plane], [_AXES.index(name) for name in plane]
            _draw_line(axes, places[:, columns], path, theme)
            if reference is not None:
                axes.plot(*reference[:, columns].T, color=theme.ink, lw=1, ls="--", label="reference", zorder=0)
            axes.set_aspect("equal", adjustable="datalim")
            axes.set_xlabel(f"{plane[0]}, {unit}")
            axes.set_ylabel(f"{plane[1]}, {unit}")
            axes.xaxis.set_major_locator(MaxNLocator(2, steps=[1, 2, 5, 10], min_n_ticks=1))
            axes.locator_params(axis="y", nbins=4)
            axes.grid(visible=True)
        parts["words"].set_axis_off()
        parts["words"].legend(*parts["xy"].get_legend_handles_labels(), loc="center")
        figure.colorbar(_mappable(path, theme), ax=list(parts.values()), label=path.label, shrink=0.8, pad=0.02)

    return Plot(
        "trajectory_planes",
        f"Trajectory of {path.frames}",
        f"Translation of {path.frames} in three planes, equal lengths along all axes, {path.words}: {words}.",
        f"Three projections of a path: {words}.",
        draw,
        (WIDTH, 4.8),
        dense=True,
    )


def _scale(path: DrawnPath) -> Normalize:
    low, high = float(np.min(path.colours)), float(np.max(path.colours))
    return Normalize(low, high if high > low else low + 1)


def _mappable(path: DrawnPath, theme: Theme) -> ScalarMappable:
    return ScalarMappable(_scale(path), line_colours(theme))


def _segments(places: Array, path: DrawnPath) -> tuple[Array, Array]:
    """Return the lines (M, 2, D) from place to place, and what colours them (M,)."""
    lines = np.stack([places[:-1], places[1:]], axis=1)[~path.broken[:-1]]
    return lines, ((path.colours[:-1] + path.colours[1:]) / 2)[~path.broken[:-1]]


def _draw_line(axes: Axes, places: Array, path: DrawnPath, theme: Theme) -> None:
    lines, values = _segments(places, path)
    if len(lines):
        drawn = LineCollection(list(lines), cmap=line_colours(theme), norm=_scale(path), lw=1.8, rasterized=True)
        drawn.set_array(values)
        axes.add_collection(drawn)
    axes.scatter(
        places[:, 0], places[:, 1], 4, path.colours, cmap=line_colours(theme), norm=_scale(path), rasterized=True
    )
    axes.plot(*places[0], "o", color=theme.good, ms=6, label="start")
    axes.plot(*places[-1], "s", color=theme.bad, ms=6, label="end")
    axes.update_datalim(places)
    axes.autoscale_view()


def in_space(path: DrawnPath) -> Plot:
    """Return a path in space with the axes of some of its poses."""
    factor, unit, words = _extent(path)

    def draw(figure: FigureBase, theme: Theme) -> None:
        places = factor * path.places
        axes = space_axes(figure, theme)
        lines, values = _segments(places, path)
        if len(lines):
            drawn = Line3DCollection(list(lines), cmap=line_colours(theme), norm=_scale(path), lw=1.8)
            drawn.set_array(values)
            axes.add_collection3d(drawn)
        axes.scatter(*places.T, c=path.colours, cmap=line_colours(theme), norm=_scale(path), s=4, depthshade=False)
        axes.plot(*places[0], "o", color=theme.good, ms=6, label="start")
        axes.plot(*places[-1], "s", color=theme.bad, ms=6, label="end")
        everything = places
        if path.reference is not None:
            axes.plot(*(factor * path.reference).T, color=theme.ink, lw=1, ls="--", label="reference")
            everything = np.concatenate([places, factor * path.reference])
        length = _FRAME * float(np.ptp(places, axis=0).max())
        chosen = np.unique(np.linspace(0, len(places) - 1, min(len(places), _MOST_FRAMES)).astype(np.intp))
        for axis, colour in enumerate((theme.series[1], theme.series[2], theme.series[0])):
            ends = np.stack([places[chosen], places[chosen] + length * path.rotations[chosen, :, axis]], axis=1)
            axes.add_collection3d(Line3DCollection(list(ends), colors=colour, lw=1))
        equal_aspect(axes, everything)
        for name in _AXES:
            getattr(axes, f"set_{name}label")(f"{name}, {unit}")
        axes.legend(loc="upper left")
        figure.colorbar(_mappable(path, theme), ax=axes, label=path.label, shrink=0.6, pad=0.14)

    return Plot(
        "trajectory_space",
        f"Path of {path.frames}",
        f"Translation of {path.frames} in space, {path.words}; short lines: x (first colour), y and z axes of some "
        f"poses. {words}.",
        f"A path in space: {words}.",
        draw,
        (WIDTH, 4.4),
        dense=True,
    )


def errors_over_time(path: DrawnPath) -> Plot:
    """Return the distances of a path from its reference over time."""
    rms = float(np.sqrt(np.mean(path.colours**2)))
    unit = path.label.rpartition(" ")[2]
    largest = float(path.colours.max())

    def draw(figure: FigureBase, theme: Theme) -> None:
        axes = figure.subplots()
        axes.plot(path.stamps - path.stamps[0], path.colours, color=theme.series[0], lw=1.2)
        axes.axhline(rms, color=theme.ink, lw=1, ls="--", label=f"RMS {rms:.3g} {unit}")
        axes.set_ylim(0, 1.3 * largest or 1.0)
        axes.set_xlabel("time from the first pose, s")
        axes.set_ylabel(f"absolute error, {unit}")
        axes.grid(visible=True)
        axes.legend(loc="upper right")

    return Plot(
        "trajectory_error",
        "Error over time",
        f"Distance from the reference after alignment (absolute trajectory error): {rms:.3g} {unit} RMS, at most "
        f"{largest:.3g} {unit}.",
        f"Error over time, {rms:.3g} {unit} RMS.",
        draw,
        (WIDTH, 3.0),
    )
