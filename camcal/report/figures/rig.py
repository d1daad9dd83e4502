"""Figures of the calibration of a rig: its cameras, where they are, how well they agree."""

from collections.abc import Mapping, Sequence
from itertools import chain

import numpy as np
from matplotlib.figure import FigureBase
from matplotlib.patches import Patch
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from camcal.arrays import Array
from camcal.calibrate.intrinsics import CandidateModel
from camcal.calibrate.rigs.record import RigCalibration
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle
from camcal.files import stem_of
from camcal.formats.camera_file import STEP
from camcal.geometry.pose import Pose
from camcal.messages import counted
from camcal.quality.projection_uncertainty import ProjectionUncertainty
from camcal.quality.rig_geometry import baseline
from camcal.report.figures.board import camera_lines, equal_aspect, label_space, space_axes, upright
from camcal.report.figures.calibration import (
    NAMED,
    calibration_plots,
    correlation_matrix,
    draw_ranked,
    ranked_size,
)
from camcal.report.figures.figure import DIVERGING_MAP, WIDTH, Plot, Theme, of_part
from camcal.report.figures.image_plane import colour_bar
from camcal.report.rig_scene import board_outline, frustum_length
from camcal.report.uncertain import value_and_std
from camcal.targets.board import Board


def rig_plots(
    calibration: RigCalibration,
    uncertainties: Mapping[str, ProjectionUncertainty],
    circles: Mapping[str, ImageCircle],
    candidates: Mapping[tuple[str, ...], tuple[CandidateModel, ...]] | None = None,
) -> tuple[Plot, ...]:
    """Return the figures of a rig, and then those of each camera under its name; the board is that of the first one.

    candidates: lens models that were compared, by the cameras of a kind.
    """
    compared = {name: found for names, found in (candidates or {}).items() for name in names}
    of_cameras = (
        of_part(calibration_plots(own, uncertainties[name], compared.get(name, ()), circles.get(name)), name)
        for name, own in calibration.calibrations.items()
    )
    return (*joint_plots(calibration), *chain.from_iterable(of_cameras))


def joint_plots(calibration: RigCalibration) -> tuple[Plot, ...]:
    """Return the figures of a rig that are of no single camera."""
    first = calibration.calibrations[calibration.first]
    rig_T_board = [
        calibration.poses[name].inverse() @ view.camera_T_board
        for name, own in calibration.calibrations.items()
        if name in calibration.poses
        for view in own.views
        if view.camera_T_board is not None
    ]
    cameras = {name: calibration.calibrations[name].camera for name in calibration.poses}
    rig_T_camera = {name: pose.inverse() for name, pose in calibration.poses.items()}
    of_rig = (
        rig_in_space(cameras, rig_T_camera, rig_T_board, first.board),
        epipolar_errors(calibration),
        exposure_motion(calibration),
        *(baseline_covariance(calibration, name) for name in calibration.poses if name != calibration.first),
    )
    return tuple(plot for plot in of_rig if plot is not None)


def rig_in_space(
    cameras: Mapping[str, Camera],
    rig_T_camera: Mapping[str, Pose],
    rig_T_board: Sequence[Pose] = (),
    board: Board | None = None,
) -> Plot:
    """Return the cameras of a rig as frusta in its frame, with the boards that they saw; metres."""
    places = np.array([rig_T_camera[name].translation for name in cameras])
    apart = np.linalg.norm(places[:, None] - places, axis=2)
    length = frustum_length([rig_T_camera[name] for name in cameras], rig_T_board)
    boards = [] if board is None else [pose.apply(board_outline(board)) for pose in rig_T_board]
    lines = {
        name: [rig_T_camera[name].apply(line) for line in camera_lines(own, length)] for name, own in cameras.items()
    }
    words = f"{counted(len(cameras), 'camera')}, at most {apart.max():.4g} m apart"
    seen = f", and the board in {counted(len(boards), 'view')}" if boards else ""

    def draw(figure: FigureBase, theme: Theme) -> None:
        axes = space_axes(figure, theme)
        if boards:
            faces = Poly3DCollection([upright(each) for each in boards], alpha=0.15, facecolor=theme.faint)
            faces.set_edgecolor(theme.ink)
            faces.set_linewidth(0.4)
            axes.add_collection3d(faces)
        colours = {name: theme.series[index % len(theme.series)] for index, name in enumerate(cameras)}
        for name, own in lines.items():
            for line in own:
                axes.plot(*upright(line).T, color=colours[name], lw=1.4)
        everything = [*boards, *chain.from_iterable(lines.values())]
        equal_aspect(axes, upright(np.concatenate(everything)))
        label_space(axes, "m")
        handles = [Patch(color=colour, label=name) for name, colour in colours.items()]
        figure.legend(handles=handles, loc="outside lower center", ncols=4)

    return Plot(
        "rig",
        "Rig",
        f"The cameras as frusta in the frame of the first one: {words}{seen}. x right, y down, z forward.",
        f"Frusta of {words}{seen}.",
        draw,
        (WIDTH, 4.4),
        dense=True,
    )


def epipolar_errors(calibration: RigCalibration) -> Plot | None:
    """Return the epipolar error of every capture, the largest first; None where no corner was seen by two cameras."""
    errors = calibration.epipolar_by_capture
    rows = _rank(calibration.captures, errors)
    if not rows or calibration.epipolar_rms_px is None:
        return None
    total, worst = calibration.epipolar_rms_px, rows[0][1]
    return _bars(
        "epipolar_errors",
        "Epipolar error by capture",
        f"RMS of the distance of corners from the epipolar lines of what the other camera saw, px, {_captures(rows)}: "
        f"{total:.3g} px over all (dashed), at most {worst:.3g} px in a capture.",
        rows,
        total,
        "epipolar error RMS, px",
    )


def exposure_motion(calibration: RigCalibration) -> Plot | None:
    """Return how far the board moved between the exposures of each capture; None where that was not estimated."""
    motion = calibration.motion
    if motion is None or not motion.by_capture:
        return None
    rows = _rank(calibration.captures, 1e3 * np.array(motion.by_capture))
    if not rows:
        return None
    median = 1e3 * motion.median
    return _bars(
        "exposure_motion",
        "Motion between exposures",
        f"How far the board moved between the exposures of a capture, mm, {_captures(rows)}: median {median:.2g} mm "
        f"(dashed), at most {1e3 * motion.largest:.2g} mm.",
        rows,
        median,
        "motion of the board, mm",
    )


def _rank(names: Sequence[str], values: Array) -> list[tuple[str, float, bool]]:
    """Return names and values that are known, the largest first."""
    known = [(name, float(value), True) for name, value in zip(names, values, strict=True) if np.isfinite(value)]
    return sorted(known, key=lambda row: (-row[1], row[0]))


def _captures(rows: Sequence[tuple[str, float, bool]]) -> str:
    """Return which rows are drawn, in words."""
    return f"the {NAMED} largest of {len(rows)} captures" if len(rows) > NAMED else counted(len(rows), "capture")


def _bars(
    name: str, title: str, caption: str, rows: Sequence[tuple[str, float, bool]], usual: float, label: str
) -> Plot:
    shown = rows[:NAMED]

    def draw(figure: FigureBase, theme: Theme) -> None:
        axes = figure.subplots()
        draw_ranked(axes, shown, 1.1 * rows[0][1] or 1.0, theme)
        axes.axvline(usual, color=theme.ink, lw=1, ls="--")
        axes.set_xlabel(label)

    return Plot(name, title, caption, f"Bars: {caption}", draw, ranked_size(len(shown)))


def baseline_covariance(calibration: RigCalibration, camera: str) -> Plot:
    """Return the standard deviations of a camera's pose against the first one, and their correlations."""
    name = calibration.transform_name(camera)
    covariance = calibration.pose_covariance(camera)
    std = np.sqrt(np.diag(covariance))
    length = baseline(calibration.poses[camera], covariance)
    shown = " ± ".join(value_and_std(1e3 * length.value, None if length.std is None else 1e3 * length.std))
    scaled = [*(f"{1e3 * value:.2g} mm" for value in std[:3]), *(f"{np.degrees(value):.2g}°" for value in std[3:])]

    def draw(figure: FigureBase, _: Theme) -> None:
        axes = figure.subplots()
        image = axes.imshow(correlation_matrix(covariance), cmap=DIVERGING_MAP, vmin=-1, vmax=1)
        axes.set_xticks(range(6), STEP)
        axes.set_yticks(range(6), [f"{step} ± {text}" for step, text in zip(STEP, scaled, strict=True)])
        axes.set_xlabel("step of the pose (translation, rotation)")
        axes.set_ylabel("step ± 1 σ, mm and degrees")
        colour_bar(axes, image, "correlation")

    words = ", ".join(f"{step} {text}" for step, text in zip(STEP, scaled, strict=True))
    return Plot(
        f"covariance_{stem_of(name)}",
        f"Uncertainty of {name}",
        f"Baseline {shown} mm. Standard deviations of the pose and correlations of its errors: {words}.",
        f"Matrix of correlations of the six parameters of {name}: {words}.",
        draw,
        (WIDTH, 3.8),
    )
