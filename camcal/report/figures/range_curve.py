"""The figure of the projection uncertainty over the distance of points."""

from matplotlib.figure import FigureBase

from camcal.quality.range_uncertainty import RangeUncertainty
from camcal.report.figures.figure import WIDTH, Plot, Theme, logarithmic_labels

_ROOM = 3.0  # times the largest uncertainty: for the legend


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
