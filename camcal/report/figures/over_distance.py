"""Figures over the distance: the blur of a lens, and the projection uncertainty."""

from dataclasses import dataclass
from math import inf

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from camcal.arrays import Array
from camcal.optics.lens import blur_disc
from camcal.quality.range_uncertainty import RangeUncertainty
from camcal.report.figures.figure import WIDTH, Plot, Theme, logarithmic_labels

_ROOM = 3.0  # times the largest uncertainty: for the legend
_DECADE = 10  # a longer range of distances is drawn with a logarithmic axis


def uncertainty_over_distance(found: RangeUncertainty, infinity_px: float, unit: str) -> Plot:
    """Return the projection uncertainty over the distance; infinity_px: of directions. unit: of the distances."""
    distance, least = found.best
    boards = f"{found.near:.2g} to {found.far:.2g} {unit}"
    words = f"least {least:.2g} px at {distance:.2g} {unit}, {infinity_px:.2g} px at infinity"

    def draw(figure: FigureBase, theme: Theme) -> None:
        axes = figure.subplots()
        axes.axvspan(found.near, found.far, color=theme.faint, alpha=0.35, lw=0, label="boards")
        axes.loglog(found.distances, found.std, color=theme.series[0], lw=1.8, label="1 σ, RMS")
        axes.axhline(infinity_px, color=theme.ink, lw=1, ls="--", label="at infinity")
        axes.set_xlim(found.distances[0], found.distances[-1])
        axes.set_ylim(least / 2, _ROOM * float(found.std.max()))
        for axis in (axes.xaxis, axes.yaxis):
            logarithmic_labels(axis)
        axes.set_xlabel(f"distance, {unit}")
        axes.set_ylabel("projection uncertainty, px")
        axes.grid(visible=True)
        axes.legend(loc="upper right", ncols=3, columnspacing=0.8)

    return Plot(
        "uncertainty_over_distance",
        "Projection uncertainty over distance",
        "Standard deviation (1 σ, RMS where corners are) of the projection of points over their distance from the "
        f"camera: {words}. The boards were at {boards} (gray); nearer points depend on where the camera's centre is, "
        "farther ones on the focal length.",
        f"Curve of the projection uncertainty over distance: {words}; boards at {boards}.",
        draw,
        (WIDTH, 3.2),
    )


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
    distance = _distances(curve)
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


def _distances(curve: BlurCurve) -> Array:
    """Return distances (N,) in m, up to well beyond the depth of field to both sides, the focus among them."""
    far = curve.far if curve.far < inf else 10 * curve.near
    margin = min(max(far / curve.near, 1.05) ** 2, 4.0)
    low = max(curve.near / margin, 1.05 * curve.focal)
    return np.unique([*np.geomspace(low, far * margin, 400), min(curve.focus, far * margin)])
