"""The figure of a lens's blur over distance."""

from dataclasses import dataclass
from math import inf

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from camcal.arrays import Array
from camcal.optics.lens import blur_disc
from camcal.report.figures.figure import WIDTH, Plot, Theme

_DECADE = 10  # a longer range of distances is drawn with a logarithmic axis


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
