"""Figures over the image of a camera: projection uncertainty, residual vectors, coverage."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import FigureBase
from matplotlib.patches import Circle

from camcal.arrays import Array
from camcal.calibrate.intrinsics import Calibration
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle, rim
from camcal.messages import counted
from camcal.quality.projection_uncertainty import ProjectionUncertainty
from camcal.report.figures.figure import COLOUR_MAP, Plot, Theme, panel_height

_RATIO = 8.0  # of the ends of a map; above it equal ratios take equal shares of the colours
_TAIL = 0.01
_LONG, _SHARE = 0.95, 0.05  # the quantile of residuals that is drawn this share of the image's width long
_CELLS = 12  # across the longer side of the image
_LEAST_MEAN = 4  # corners in a cell whose mean is drawn
_LEVELS = 6


def projection_uncertainty(
    uncertainty: ProjectionUncertainty, image_size: tuple[int, int], circle: ImageCircle | None = None
) -> Plot:
    """Return the map of the projection uncertainty over the image."""
    figures = uncertainty.figures()
    over = f"{figures['rms_px']:.2g} px RMS over the image, at most {figures['worst_px']:.2g} px in any direction"
    where, within = "", ""
    if "inside_rms_px" in figures:
        where = f"{figures['inside_rms_px']:.2g} px RMS where corners are (inside the dashed line), "
        within = " The dashed line surrounds the corners: beyond it the lens is extrapolated."

    def draw(figure: FigureBase, theme: Theme) -> None:
        axes = image_axes(figure, image_size)
        _draw_uncertainty(axes, uncertainty, theme)
        _draw_circle(axes, circle, theme)

    return Plot(
        "projection_uncertainty",
        "Projection uncertainty",
        "Standard deviation (1 σ, RMS of the image directions) of the projection of a direction (a point at infinity): "
        f"{where}{over}.{within}",
        f"Map of the image coloured by projection uncertainty, {where}{over}.",
        draw,
        panel_height(image_size),
        dense=True,
    )


def _draw_uncertainty(axes: Axes, uncertainty: ProjectionUncertainty, theme: Theme) -> None:
    shape = (len(uncertainty.v), len(uncertainty.u))
    values = np.ma.masked_invalid(uncertainty.std_rms.reshape(shape))
    scale = scale_of(values.compressed())
    mesh = axes.pcolormesh(
        uncertainty.u, uncertainty.v, values, norm=scale, cmap=COLOUR_MAP, shading="gouraud", rasterized=True
    )
    colour_bar(axes, mesh, "1 σ, px")
    if uncertainty.inside is not None and uncertainty.inside.any():
        inside = uncertainty.inside.reshape(shape).astype(float)
        axes.contour(
            uncertainty.u, uncertainty.v, inside, levels=[0.5], colors="white", linestyles="--", linewidths=1.4
        )
    axes.set_facecolor(theme.faint)


def residual_vectors(calibration: Calibration) -> Plot:
    """Return the residuals as magnified vectors at the corners, with the means of cells of the image."""
    size = calibration.camera.image_size
    lengths = np.linalg.norm(calibration.residuals, axis=1)
    factor = magnification(lengths, size[0])
    means = cell_means(calibration.pixels, calibration.residuals, size)
    largest = float(np.linalg.norm(means[1], axis=1).max(initial=0.0))
    left = len(calibration.rejected)
    crosses = f" Crosses: {counted(left, 'rejected corner')}." if left else ""

    def draw(figure: FigureBase, theme: Theme) -> None:
        axes = image_axes(figure, size)
        draw_vectors(axes, calibration.pixels, factor * calibration.residuals, theme.series[0], 0.6)
        draw_vectors(axes, means[0], factor * means[1], theme.series[1], 1.8)
        if left:
            at = np.array([corner.pixel for corner in calibration.rejected])
            axes.plot(at[:, 0], at[:, 1], "x", color=theme.ink, ms=5, label="rejected")
        axes.set_title(f"magnified {factor:g} x", loc="right")

    return Plot(
        "residual_vectors",
        "Residual vectors",
        f"Projected minus observed corner, magnified {factor:g} x (thin), and the mean of each cell of the image "
        f"(thick, at most {largest:.2g} px): means much shorter than single residuals, without a pattern, show that "
        f"the lens model fits. RMS {calibration.rms_px:.3g} px over {counted(len(lengths), 'corner')}.{crosses}",
        f"Residuals of {counted(len(lengths), 'corner')} as vectors over the image, magnified {factor:g} times; "
        f"means of cells are at most {largest:.2g} px long.",
        draw,
        panel_height(size),
        dense=True,
    )


def magnification(lengths: Array, width: float) -> float:
    """Return by how much residuals of these lengths are drawn larger than they are: 1, 2 or 5 times a power of ten."""
    long = max(float(np.quantile(lengths, _LONG)), 1e-9) if len(lengths) else 1.0
    return round_down(_SHARE * width / long)


def round_down(value: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not above a value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step for step in (1.0, 2.0, 5.0) if step <= value / power * (1 + 1e-9)) * power)


def cell_means(pixels: Array, values: Array, size: tuple[int, int]) -> tuple[Array, Array]:
    """Return mean pixels and mean values (M, 2) of the cells of the image that have enough of them."""
    columns, rows = cells_of(size)
    cell = _cell_numbers(pixels, size)
    count = np.bincount(cell, minlength=columns * rows)
    kept = count >= _LEAST_MEAN
    means = [
        np.stack([np.bincount(cell, each, minlength=columns * rows)[kept] / count[kept] for each in both.T], axis=1)
        for both in (pixels, values)
    ]
    return means[0], means[1]


def cells_of(size: tuple[int, int]) -> tuple[int, int]:
    """Return how many columns and rows of nearly square cells an image of a size is divided into."""
    longest = max(size)
    columns, rows = (max(1, round(_CELLS * side / longest)) for side in size)
    return columns, rows


def _cell_numbers(pixels: Array, size: tuple[int, int]) -> Array:
    counts = np.array(cells_of(size))
    column, row = np.clip(((pixels + 0.5) / size * counts).astype(np.intp), 0, counts - 1).T
    return np.asarray(row * counts[0] + column)


def _cell_middles(size: tuple[int, int]) -> Array:
    """Return the pixels (rows, columns, 2) in the middle of the cells."""
    columns, rows = cells_of(size)
    u, v = (np.arange(columns) + 0.5) * size[0] / columns - 0.5, (np.arange(rows) + 0.5) * size[1] / rows - 0.5
    return np.stack(np.meshgrid(u, v), axis=-1)


def coverage(
    pixels: Array,
    size: tuple[int, int],
    views: int,
    rejected: Array | None = None,
    camera: Camera | None = None,
    circle: ImageCircle | None = None,
) -> Plot:
    """Return where in the image corners were seen, by their number in cells.

    pixels, rejected: (N, 2) px. size: (width, height). camera: shows what its lens model is valid for.
    """
    columns, rows = cells_of(size)
    counts = np.bincount(_cell_numbers(pixels, size), minlength=columns * rows).reshape(rows, columns)
    lit = np.ones(counts.shape, bool) if circle is None else circle.contains(_cell_middles(size))
    share = 100 * float((counts[lit] > 0).mean())
    folded, border = "", np.zeros((0, 2))
    if camera is not None:
        found, fold = rim(camera, circle=circle)
        if fold.folds:
            folded = f" The lens model holds up to {fold.radius_px:.0f} px from the principal point (line)."
            border = np.vstack([found, found[:1]])

    def draw(figure: FigureBase, theme: Theme) -> None:
        axes = image_axes(figure, size)
        u, v = np.linspace(-0.5, size[0] - 0.5, columns + 1), np.linspace(-0.5, size[1] - 0.5, rows + 1)
        mesh = axes.pcolormesh(u, v, np.ma.masked_equal(counts, 0), cmap=COLOUR_MAP, vmin=0, rasterized=True)
        colour_bar(axes, mesh, "corners per cell")
        axes.plot(pixels[:, 0], pixels[:, 1], ".", color=theme.series[1], ms=2.2, rasterized=True)
        if rejected is not None:
            axes.plot(rejected[:, 0], rejected[:, 1], "x", color=theme.series[3], ms=6, mew=1.8)
        axes.plot(border[:, 0], border[:, 1], color=theme.bad, lw=1.5)
        _draw_circle(axes, circle, theme)

    return Plot(
        "coverage",
        "Coverage of the image",
        f"{counted(len(pixels), 'corner')} of {counted(views, 'view')} (dots) and their number per cell: {share:.0f} % "
        f"of the cells have corners; in those without colour the lens is extrapolated.{folded}",
        f"Corners of {counted(views, 'view')} over the image; {share:.0f} % of its cells have at least one.",
        draw,
        panel_height(size),
        dense=True,
    )


def field_angle(camera: Camera, circle: ImageCircle | None = None) -> Plot:
    """Return the angle from the optical axis that every place of the image sees."""
    width, height = camera.image_size
    u, v = np.linspace(0, width - 1, 81), np.linspace(0, height - 1, 61)
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    rays = camera.unproject(pixels)
    valid = rays.valid if circle is None else rays.valid & circle.contains(pixels)
    angle = np.degrees(np.arctan2(np.hypot(rays.directions[:, 0], rays.directions[:, 1]), rays.directions[:, 2]))
    angles = np.ma.masked_array(angle, ~valid).reshape(61, 81)
    most = float(angles.max()) if valid.any() else 0.0
    focal = ", ".join(f"{name} {camera.value(name):.5g} px" for name in ("fx", "fy"))

    def draw(figure: FigureBase, theme: Theme) -> None:
        axes = image_axes(figure, camera.image_size)
        mesh = axes.pcolormesh(u, v, angles, cmap=COLOUR_MAP, shading="gouraud", vmin=0, rasterized=True)
        colour_bar(axes, mesh, "angle, deg")
        axes.contour(u, v, angles, levels=_LEVELS + 2, colors="white", linewidths=0.8)
        axes.plot(camera.value("cx"), camera.value("cy"), "+", color=theme.series[1], ms=9, mew=1.5)
        axes.set_facecolor(theme.faint)
        _draw_circle(axes, circle, theme)

    return Plot(
        "field_angle",
        "Angle from the optical axis",
        f"Angle between the ray of a pixel and the optical axis, up to {most:.1f}° in this image; lens model "
        f"{camera.model.name}, {focal}. Cross: principal point; gray: no ray.",
        f"Map of the angle from the optical axis, up to {most:.1f}°.",
        draw,
        panel_height(camera.image_size),
        dense=True,
    )


def image_axes(figure: FigureBase, size: tuple[int, int]) -> Axes:
    """Return axes over an image of a size (width, height), y down."""
    axes: Axes = figure.subplots()
    axes.set_xlim(-0.5, size[0] - 0.5)
    axes.set_ylim(size[1] - 0.5, -0.5)
    axes.set_aspect("equal")
    axes.locator_params(nbins=_LEVELS)
    axes.set_xlabel("u, px")
    axes.set_ylabel("v, px")
    return axes


def _draw_circle(axes: Axes, circle: ImageCircle | None, theme: Theme) -> None:
    if circle is not None:
        axes.add_patch(Circle(circle.centre, circle.radius, fill=False, ec=theme.ink, ls=":", lw=1.2))


def draw_vectors(axes: Axes, start: Array, vectors: Array, colour: str, width: float) -> None:
    axes.quiver(
        *start.T,
        *vectors.T,
        color=colour,
        angles="xy",
        scale_units="xy",
        scale=1,
        units="dots",
        width=2 * width,
        headwidth=3,
        headlength=4,
        headaxislength=3.5,
        rasterized=True,
    )


def scale_of(values: Array) -> Normalize:
    """Return the scale of colours of values (N,), nearly all of which it spans."""
    if not len(values):
        return Normalize(0, 1)
    low, high = np.quantile(values, [_TAIL, 1 - _TAIL]).tolist()
    if low > 0 and high > _RATIO * low:
        return LogNorm(low, high, clip=True)
    return Normalize(low, high if high > low else low + (abs(low) or 1.0), clip=True)


def colour_bar(axes: Any, mapped: Any, label: str, shrink: float = 0.9, pad: float = 0.02) -> None:
    """Draw the scale of what is mapped beside axes; numbers are written out."""
    bar = axes.figure.colorbar(mapped, ax=axes, label=label, shrink=shrink, pad=pad)
    if isinstance(bar.norm, LogNorm):
        low, high = bar.norm.vmin or 1.0, bar.norm.vmax or 1.0
        ticks = _round_ticks(low, high)
        bar.set_ticks(ticks, labels=[f"{tick:g}" for tick in ticks])
        bar.minorticks_off()


def _round_ticks(low: float, high: float) -> list[float]:
    """Return the numbers 1, 2 and 5 times powers of ten between two numbers, fewer where they are many."""
    powers = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    for steps in ((1, 2, 5), (1, 3), (1,)):
        ticks = [float(f"{step}e{power}") for power in powers for step in steps]
        ticks = [tick for tick in ticks if low <= tick <= high]
        if len(ticks) <= _LEVELS:
            return ticks
    return ticks[:: len(ticks) // _LEVELS + 1]
