"""Figures of a rig: its cameras, where they are, how well they agree; and of files of cameras, detections, poses."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain

import numpy as np
from matplotlib.figure import FigureBase
from matplotlib.patches import Patch
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from camcal.arrays import Array
from camcal.calibrate.intrinsics import CandidateModel
from camcal.calibrate.rigs.record import RigCalibration
from camcal.cameras.model import Camera, Rig
from camcal.cameras.validity import ImageCircle
from camcal.errors import InsufficientData
from camcal.files import stem_of
from camcal.formats.camera_file import STEP, CameraEntry, CameraFile
from camcal.formats.poses.record import Poses
from camcal.geometry.pose import Pose
from camcal.messages import counted
from camcal.quality.projection_uncertainty import ProjectionUncertainty, projection_uncertainty
from camcal.quality.rig_geometry import baseline
from camcal.report.figures.board import (
    board_height,
    board_shape,
    camera_lines,
    equal_aspect,
    label_space,
    space_axes,
    upright,
)
from camcal.report.figures.calibration import (
    NAMED,
    calibration_plots,
    correlation_matrix,
    correlations,
    draw_ranked,
    ranked_size,
    ranked_views,
    residuals_by_view,
)
from camcal.report.figures.figure import DIVERGING_MAP, WIDTH, Plot, Theme, of_part
from camcal.report.figures.image_plane import colour_bar, coverage, field_angle
from camcal.report.figures.image_plane import projection_uncertainty as uncertainty_map
from camcal.report.figures.trajectories import DrawnPath, in_planes, in_space
from camcal.report.rig_scene import board_outline, frustum_length
from camcal.report.table import value_and_std
from camcal.targets.board import Board
from camcal.targets.detection import Detections


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


def camera_file_plots(
    file: CameraFile, rig: Rig | None = None, boards: Sequence[Pose] = (), board: Board | None = None
) -> tuple[Plot, ...]:
    """Return the figures of a camera file: of the rig, if it is one, of each camera, and of the board's shape.

    rig: its cameras where transforms join them. boards: rig_T_board of the views that say it. board: its size.
    """
    parts: list[Plot] = []
    if rig is not None:
        parts.append(rig_in_space(rig.cameras, rig.rig_T_camera, boards, board))
    for name, entry in file.cameras.items():
        own = tuple(_of_camera(file, name, entry))
        parts += own if len(file.cameras) == 1 else of_part(own, name)
    if file.board_shape is not None:
        parts += [plot for plot in (board_shape(file.board_shape), board_height(file.board_shape)) if plot is not None]
    return tuple(parts)


def _of_camera(file: CameraFile, name: str, entry: CameraEntry) -> Iterator[Plot]:
    camera, circle = entry.camera, entry.image_circle
    if camera.model.is_central:
        yield field_angle(camera, circle)
    if camera.covariance is not None and camera.covariance.any():
        known = projection_uncertainty(camera, circle=circle)
        if known.figures():  # else no pixel is in the domain of the lens
            yield uncertainty_map(known, camera.image_size, circle)
        matrix = correlations(camera)
        if matrix is not None:
            yield matrix
    images = file.provenance.get("images")
    listed = [image for image in images if isinstance(image, Mapping)] if isinstance(images, list) else []
    own = [image for image in listed if image.get("camera", name) == name]
    rows = [
        (str(image.get("file", "")), float(image["rms_px"]), bool(image.get("used", True)))
        for image in own
        if isinstance(image.get("rms_px"), (int, float))
    ]
    if any(used for *_, used in rows):
        yield residuals_by_view(rows, len(own))


def detection_plots(detections: Detections) -> tuple[Plot, ...]:
    """Return where in the images corners were found, and how many in each view, of every camera.

    Raises InsufficientData where none were found at all.
    """
    cameras = list(dict.fromkeys(view.camera for view in detections.views if view.found))
    if not cameras:
        raise InsufficientData("no corners to draw: none of the images shows the board")
    plots: list[Plot] = []
    for camera in cameras:
        of_camera = [view for view in detections.views if view.camera == camera]
        views = [view for view in of_camera if view.found]
        sizes = [view.size for view in views]
        size = max(sizes, key=sizes.count)
        pixels = np.concatenate([view.pixels for view in views if view.size == size])
        circle = detections.circles.get(camera)
        own = (
            coverage(pixels, size, len(views), circle=circle),
            ranked_views([(view.image, len(view.ids)) for view in of_camera]),
        )
        plots += own if len(cameras) == 1 else of_part(own, camera)
    return tuple(plots)


def pose_plots(poses: Poses) -> tuple[Plot, ...]:
    """Return the translations of every object's poses in planes and in space, coloured by the residuals of the poses.

    Raises InsufficientData where there are none.
    """
    if not poses.estimates:
        raise InsufficientData("no poses to draw")
    objects = list(dict.fromkeys(key.object for key in poses.estimates))
    plots: list[Plot] = []
    for name in objects:
        records = [record for key, record in poses.estimates.items() if key.object == name]
        rms = np.array([record.rms_px for record in records])
        path = DrawnPath(
            poses.frames,
            np.array([record.transform.translation for record in records]),
            rms,
            "RMS of residuals, px",
            np.ones(len(records), bool),
            np.array([record.transform.rotation for record in records]),
            np.arange(len(records), dtype=float),
            words=f"coloured by the RMS of the residuals, {rms.min():.3g} to {rms.max():.3g} px",
            unit=poses.unit,
        )
        own = (in_planes(path), in_space(path))
        plots += of_part(own, name) if name else own
    return tuple(plots)
