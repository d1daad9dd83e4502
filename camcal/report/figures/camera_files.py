"""Figures of what camera files, detections and pose files hold."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from camcal.cameras.model import Rig
from camcal.errors import InsufficientData
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.formats.poses.record import Poses
from camcal.geometry.pose import Pose
from camcal.quality.projection_uncertainty import projection_uncertainty
from camcal.report.figures.board import board_height, board_shape
from camcal.report.figures.calibration import correlations, ranked_views, residuals_by_view
from camcal.report.figures.figure import Plot, of_part
from camcal.report.figures.image_plane import coverage, field_angle
from camcal.report.figures.image_plane import projection_uncertainty as uncertainty_map
from camcal.report.figures.rig import rig_in_space
from camcal.report.figures.trajectories import DrawnPath, in_planes, in_space
from camcal.targets.board import Board
from camcal.targets.detection import Detections


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
    yield field_angle(camera, circle)
    if camera.covariance is not None and camera.covariance.any():
        yield uncertainty_map(projection_uncertainty(camera, circle=circle), camera.image_size, circle)
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
