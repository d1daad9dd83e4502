"""`camcal pnp`: correspondences, or images of a board, and a camera to poses."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from camcal.cameras.model import Camera
from camcal.errors import CamcalError, InsufficientData, InvalidInput
from camcal.estimate.pnp import Correspondences, PoseEstimate, estimate_poses
from camcal.formats import correspondences, native, poses
from camcal.formats.poses import Poses
from camcal.progress import SILENT, Progress
from camcal.run.inputs import split_address
from camcal.run.outputs import refuse_overwriting
from camcal.targets.board import Board, Detection
from camcal.tasks.board_views import board_views

_LIKELY_DISTANCE_M = (0.05, 100.0)  # outside, the points are likely not in metres


@dataclass(frozen=True)
class PnpOptions:
    """A camera file (FILE or FILE#NAME) and what it saw: `points`, or `inputs` of a board.

    points: a CSV of correspondences. board: a board file or short form, None where a detections file names it.
    inputs: images, folders and globs, or one detections file. inverse: object_T_camera in place of camera_T_object.
    noise_px: standard deviation of a pixel coordinate, None to estimate it. name: of the camera in its file.
    """

    camera: str
    points: Path | None = None
    board: str | None = None
    inputs: tuple[str, ...] = ()
    output: Path | None = None
    inverse: bool = False
    noise_px: float | None = None
    name: str | None = None
    recursive: bool = False
    jobs: int | None = None


@dataclass(frozen=True, eq=False)
class PnpReport:
    """The poses, remarks of the detection, and the images that failed: unreadable, or seen but without a pose."""

    poses: Poses
    notes: tuple[str, ...]
    failed: tuple[str, ...]

    @property
    def unsettled(self) -> tuple[str, ...]:
        """The images whose pose did not converge."""
        return tuple(image for image, estimate in self.poses.estimates.items() if not estimate.converged)


@dataclass(frozen=True, eq=False)
class _Seen:
    """The views to work on, the unit of their points, images without a board, and what is wrong with others."""

    views: Sequence[Correspondences]
    unit: str = "m"
    nothing: Mapping[str, str] = field(default_factory=dict)
    refused: Mapping[str, CamcalError] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    failed: tuple[str, ...] = ()


def pnp(options: PnpOptions, progress: Progress = SILENT) -> PnpReport:
    """Return the pose of every image, after writing them to options.output if that is given.

    Raises InvalidInput, FileError, or what kept the first image from a pose if none has one; nothing is written then.
    """
    _check(options)
    camera = _camera(options, progress)
    if options.points is not None:
        seen = _Seen(correspondences.read(options.points, camera.image_size))
    else:
        seen = _seen_boards(options, camera, progress)
    outcomes = estimate_poses(camera, seen.views, options.noise_px)
    found = {outcome.item.image: outcome.value for outcome in outcomes if outcome.value is not None}
    refused = {**seen.refused, **{outcome.item.image: outcome.error for outcome in outcomes if outcome.error}}
    if not found:
        raise _why_no_pose(seen, refused)
    if seen.unit == "m":
        _warn_of_units(found, progress)
    if options.inverse:
        found = {image: estimate.inverse() for image, estimate in found.items()}
    missing = {**seen.nothing, **{image: error.message for image, error in refused.items()}}
    result = Poses(next(iter(found.values())).frames, seen.unit, found, missing)
    if options.output:
        poses.write(options.output, result)
    return PnpReport(result, seen.notes, (*seen.failed, *refused))


def _check(options: PnpOptions) -> None:
    if options.points is None and not options.inputs:
        raise InvalidInput("nothing to work on: give --points CSV, or --board BOARD and images of it")
    if options.points is not None and (options.inputs or options.board):
        raise InvalidInput("--points has its own points; leave --board and the images out")
    if options.output is None:
        return
    poses.require_suffix(options.output)
    inputs = [split_address(options.camera)[0], *map(Path, options.inputs)]
    inputs += [options.points] if options.points else []
    refuse_overwriting([options.output], inputs)


def _camera(options: PnpOptions, progress: Progress) -> Camera:
    path, name = split_address(options.camera)
    file = native.read(path)
    for warning in file.warnings:
        progress.warn(warning)
    return native.select(file, name or options.name, str(path)).camera


def _seen_boards(options: PnpOptions, camera: Camera, progress: Progress) -> _Seen:
    """Return what images or a detections file show of the board."""
    found = board_views(options.inputs, options.board, options.recursive, options.jobs, progress)
    views = _of_one_camera(found.detections.views, split_address(options.camera)[1] or options.name)
    shown = [view for view in views if view.found]
    return _Seen(
        [_on_board(view, found.board) for view in shown if view.size == camera.image_size],
        found.board.unit,
        {view.image: view.reason or "nothing found" for view in views if not view.found},
        {view.image: _other_size(view, camera) for view in shown if view.size != camera.image_size},
        found.notes,
        found.failed,
    )


def _on_board(view: Detection, board: Board) -> Correspondences:
    return Correspondences(view.image, board.points()[view.ids], view.pixels, view.covariance)


def _of_one_camera(views: Sequence[Detection], name: str | None) -> list[Detection]:
    """Return the views of the named camera where a detections file holds those of several."""
    names = sorted({view.camera for view in views})
    if len(names) < 2:
        return list(views)
    if name not in names:
        raise InvalidInput(f"the detections are of the cameras {', '.join(names)}; say which with --camera")
    return [view for view in views if view.camera == name]


def _other_size(view: Detection, camera: Camera) -> InvalidInput:
    found, known = (f"{width} x {height}" for width, height in (view.size, camera.image_size))
    return InvalidInput(f"the image has {found} pixels, the camera file is for {known}", where=view.image)


def _why_no_pose(seen: _Seen, refused: Mapping[str, CamcalError]) -> CamcalError:
    if refused:
        return next(iter(refused.values()))
    image, reason = next(iter(seen.nothing.items()), ("", "no image could be read"))
    return InsufficientData(f"no pose from {len(seen.nothing)} images; {reason}", where=image or None)


def _warn_of_units(found: Mapping[str, PoseEstimate], progress: Progress) -> None:
    distance = float(np.median([np.linalg.norm(estimate.transform.translation) for estimate in found.values()]))
    nearest, farthest = _LIKELY_DISTANCE_M
    if not nearest <= distance <= farthest:
        progress.warn(f"the object is {distance:.3g} m away from the camera; are the points in metres?")


def document(report: PnpReport) -> dict[str, Any]:
    """Return the report as plain data for --json."""
    return {**poses.document(report.poses), "notes": list(report.notes), "failed": list(report.failed)}
