"""Figures of the board: its shape, where it stood in front of the camera, and the views of it worth taking."""

import re
from collections.abc import Sequence
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from camcal.arrays import Array
from camcal.calibrate.intrinsics import Calibration
from camcal.cameras.model import Camera
from camcal.messages import counted
from camcal.quality.view_advice import Known, SuggestedView, ViewAdvice, rim
from camcal.report.figures.figure import COLOUR_MAP, DIVERGING_MAP, WIDTH, Plot, Theme, panel_height
from camcal.report.figures.image_plane import colour_bar, round_down, scale_of
from camcal.report.rig_scene import board_outline, frustum
from camcal.report.table import length_unit
from camcal.targets.board import Surface

_RELIEF = 0.25  # of the board's longer side: how high its largest deviation is drawn
_MOST_RELIEF = 1000.0  # times: what is flatter is drawn flat
_LEAST_EXTENT = 0.35  # of the longest axis in space: what a short one is drawn long
_ZOOM, _LABEL_PAD = 0.9, 7.0  # of what stands in axes in space; points: labels stay inside, and off the numbers
_PER_EDGE = 8  # rays of each edge of an image
_LEAST = 1e-9  # of the board's longer side: a flat board

_ACROSS = 3  # pictures in a row
_LETTERS = 36  # of a line below a picture
_MOST_DOTS = 4000


def board_height(surface: Surface) -> Plot | None:
    """Return the deviation of the board from a plane as contours, None for a board that is taken to be flat."""
    points, height, unit = _relief(surface)
    if height is None:
        return None
    across = float(np.ptp(height))
    most = _full_colour(surface, height)

    def draw(figure: FigureBase, _: Theme) -> None:
        axes = figure.subplots()
        levels = MaxNLocator(10, symmetric=True).tick_values(-most, most)
        filled = axes.tricontourf(points[:, 0], points[:, 1], height, levels=levels, cmap=DIVERGING_MAP)
        axes.plot(*points[:, :2].T, ".", color="#1a1a1a", ms=2)
        axes.set_aspect("equal")
        axes.invert_yaxis()
        axes.set_xlabel(f"x, {unit}")
        axes.set_ylabel(f"y, {unit}")
        colour_bar(axes, filled, f"out of plane, {unit}")

    return Plot(
        "board_height",
        "Board out of plane",
        f"Height of the board's points (dots) over their plane, positive along the board's z axis: {across:.2g} {unit} "
        f"from the lowest to the highest{_significance(surface)}.",
        f"Contours of the board's height; it spans {across:.2g} {unit}.",
        draw,
        panel_height(surface.board.extent),
    )


def board_shape(surface: Surface) -> Plot | None:
    """Return the board as an exaggerated surface in space, None for a board that is taken to be flat."""
    points, height, unit = _relief(surface)
    if height is None:
        return None
    side = float(np.ptp(points[:, :2], axis=0).max())
    most = _full_colour(surface, height)
    factor = round_down(min(_RELIEF * side / float(np.ptp(height)), _MOST_RELIEF))

    def draw(figure: FigureBase, theme: Theme) -> None:
        axes = space_axes(figure, theme)
        # z of a board points away from its printed side: up is towards the camera
        axes.plot_trisurf(
            *points[:, :2].T,
            factor * height,
            cmap=DIVERGING_MAP,
            vmin=-factor * most,
            vmax=factor * most,
            lw=0.2,
            edgecolor=theme.ink,
            alpha=0.9,
        )
        axes.set_xlabel(f"x, {unit}")
        axes.set_ylabel(f"y, {unit}")
        axes.set_zlabel(f"z x {factor:g}, {unit}")
        equal_aspect(axes, np.column_stack([points[:, :2], factor * height]))
        axes.invert_yaxis()

    return Plot(
        "board_shape",
        "Board shape",
        f"The board as estimated, its height exaggerated {factor:g} x: {float(np.ptp(height)):.2g} {unit} from the "
        f"lowest to the highest point{_significance(surface)}.",
        f"Surface of the board with heights exaggerated {factor:g} times.",
        draw,
        (WIDTH, 3.8),
    )


def _full_colour(surface: Surface, height: Array) -> float:
    """Return the height of full colour, mm or squares; what is within its uncertainty is pale."""
    return max(float(np.abs(height).max()), 2 * length_unit(surface.board)[0] * surface.deflection_std)


def _significance(surface: Surface) -> str:
    """Return the uncertainty of a board's bend in words, and whether it is planar within that."""
    factor, unit = length_unit(surface.board)
    std = surface.deflection_std
    planar = ", planar within that" if surface.deflection <= 2 * std else ""
    return f" (1 σ of the bend {factor * std:.2g} {unit}{planar})"


def _relief(surface: Surface) -> tuple[Array, Array | None, str]:
    """Return the points (C, 3) of a board, their heights (C,) over their plane, None where it is flat, and the unit."""
    factor, unit = length_unit(surface.board)
    points = surface.points()
    design = np.column_stack([np.ones(len(points)), points[:, :2]])
    height = points[:, 2] - design @ np.linalg.lstsq(design, points[:, 2], rcond=None)[0]
    flat = np.abs(height).max() < _LEAST * max(surface.board.extent)
    return factor * points, None if flat else factor * height, unit


def poses(calibration: Calibration) -> Plot:
    """Return the camera and the boards in front of it, coloured by the residuals of their views."""
    used = [view for view in calibration.views if view.camera_T_board is not None]
    unit = calibration.board.unit
    outline = board_outline(calibration.board)
    boards = [view.camera_T_board.apply(outline) for view in used if view.camera_T_board is not None]
    rms = np.array([view.rms_px or np.nan for view in used])
    distances = np.array([np.linalg.norm(board[:4].mean(axis=0)) for board in boards])
    near, far = distances.min(), distances.max()
    tilts = np.array([_tilt(view.camera_T_board.rotation) for view in used if view.camera_T_board is not None])
    reach = f"{near:.2g} to {far:.2g} {unit}"

    def draw(figure: FigureBase, theme: Theme) -> None:
        axes = space_axes(figure, theme)
        scale = scale_of(rms[np.isfinite(rms)])
        faces = Poly3DCollection([upright(board) for board in boards], cmap=COLOUR_MAP, norm=scale, alpha=0.55)
        faces.set_array(rms)
        faces.set_edgecolor(theme.ink)
        faces.set_linewidth(0.4)
        axes.add_collection3d(faces)
        lines = camera_lines(calibration.camera, 0.35 * float(np.median(distances)))
        for line in lines:
            axes.plot(*upright(line).T, color=theme.series[1], lw=1.2)
        equal_aspect(axes, upright(np.concatenate([*boards, *lines])))
        label_space(axes, unit)
        colour_bar(axes, faces, "RMS of the view, px", shrink=0.6, pad=0.12)

    return Plot(
        "poses",
        "Poses of the board",
        f"The camera (frustum) and the board in {counted(len(used), 'view')}, {reach} away and tilted by "
        f"{tilts.min():.0f}° to {tilts.max():.0f}°; colour: RMS of the view's residuals, px.",
        f"Camera and {counted(len(used), 'board')} in space, {reach} away.",
        draw,
        (WIDTH, 4.0),
        dense=True,
    )


def _tilt(rotation: Array) -> float:
    """Return the angle in degrees between a board's normal and the optical axis."""
    return float(np.degrees(np.arccos(min(abs(float(rotation[2, 2])), 1.0))))


def camera_lines(camera: Camera, length: float) -> Sequence[Array]:
    """Return the lines (N, 3) that show a camera, in its frame: its frustum, or its axis where the lens has no rays."""
    return frustum(camera, length, _PER_EDGE) or [np.array([[0.0, 0, 0], [0, 0, length]])]


def upright(points: Array) -> Array:
    """Return points (N, 3) of a frame x right, y down, z forward as they are drawn: x, z, -y."""
    return np.stack([points[:, 0], points[:, 2], -points[:, 1]], axis=1)


def space_axes(figure: FigureBase, theme: Theme) -> Axes3D:
    """Return axes in space without a background."""
    axes = figure.add_subplot(projection="3d")
    assert isinstance(axes, Axes3D)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color((0, 0, 0, 0))
        axis.line.set_color(theme.faint)
    axes.grid(visible=True)
    axes.locator_params(nbins=4)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.labelpad = _LABEL_PAD
    return axes


def label_space(axes: Axes3D, unit: str) -> None:
    """Label axes in which points are drawn by `upright`."""
    axes.set_xlabel(f"x, {unit}")
    axes.set_ylabel(f"z, {unit}")
    axes.set_zlabel(f"-y, {unit}")


def equal_aspect(axes: Axes3D, points: Array) -> None:
    """Give axes in space the extent of points (N, 3), equal lengths along all of them."""
    low, high = points.min(axis=0), points.max(axis=0)
    longest = float((high - low).max())
    spread = np.maximum(_LEAST_EXTENT * longest - (high - low), 0) / 2  # room for the numbers of a short axis
    low, high = low - spread, high + spread
    margin = 0.03 * longest or 0.5
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
    axes.set_zlim(low[2] - margin, high[2] + margin)
    axes.set_box_aspect(high - low + 2 * margin, zoom=_ZOOM)


def suggested_views(known: Known, advice: ViewAdvice, corners: Array, words: Sequence[str]) -> Plot:
    """Return the pictures of suggested views; corners: (N, 2) px of the views that were seen. words: of each view."""
    rows = -(-len(advice.views) // _ACROSS)
    width, height = known.camera.image_size
    size = 1.6 * WIDTH, rows * (1.6 * WIDTH / _ACROSS * height / width + 0.75) + 0.25
    now, after = advice.std_px, advice.views[-1].std_px
    dots = corners[:: max(len(corners) // _MOST_DOTS, 1)]

    def draw(figure: FigureBase, theme: Theme) -> None:
        panels = figure.subplots(rows, _ACROSS, squeeze=False).ravel()
        for number, (axes, view, text) in enumerate(zip(panels, advice.views, words, strict=False), start=1):
            _draw_view(axes, known, view, f"{number}: {text}", dots, theme)
        for axes in panels[len(advice.views) :]:
            axes.set_axis_off()

    return Plot(
        "suggested_views",
        "Views to take next",
        "The board as the camera will see it in the views that lower the projection uncertainty most, from "
        f"{now:.3g} px to {after:.3g} px (RMS over the image). The thick line is the nearer part, the square dot the "
        "first corner; gray: corners of the views that there are.",
        "; ".join(words),
        draw,
        size,
        dense=True,
    )


def _draw_view(axes: Axes, known: Known, view: SuggestedView, words: str, dots: Array, theme: Theme) -> None:
    width, height = known.camera.image_size
    placed = view.pose.apply(rim(known.surface.board))
    outline = known.camera.project(placed).pixels
    points = known.camera.project(view.pose.apply(known.surface.points())).pixels
    axes.plot(*dots.T, ".", color=theme.faint, ms=1.5, zorder=1)
    axes.fill(*outline.T, facecolor=theme.series[0], alpha=0.15, edgecolor=theme.series[0], lw=1.2, zorder=2)
    axes.plot(*points.T, ".", color=theme.series[0], ms=2.5, zorder=3)
    axes.plot(*points[0], "s", color=theme.series[0], ms=5, zorder=3)
    if view.tilt:  # as much of the outline as a side has, around the nearest corner or on the nearest side
        runs = (np.arange(len(outline))[:, None] + np.arange(len(outline) // 4 + 1)) % len(outline)
        near = runs[np.argmin(placed[runs, 2].mean(axis=1))]
        axes.plot(*outline[near].T, color=theme.series[1], lw=3, zorder=4)
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])
    label = fill(re.sub(r" (m|squares)$", "\u00a0\\1", words), _LETTERS)
    axes.set_xlabel(f"{label}\n{view.std_px:.3g} px", fontsize=7)
