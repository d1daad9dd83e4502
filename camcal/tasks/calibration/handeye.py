"""`camcal handeye`: where a camera stands on a robot's hand, or beside it, with the noise of the robot itself."""

from collections.abc import Mapping, Sequence
from math import inf
from typing import Any

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.calibrate.known_cameras import KnownBoard, KnownCamera, estimate_known, freed, prior_of, wide_prior_of
from camcal.calibrate.robot.estimator import RobotEstimate, estimate_robot
from camcal.calibrate.robot.problem import RobotPoses, closed_form
from camcal.cameras.observations import Observations
from camcal.dataclass import dataclass, replace
from camcal.errors import InvalidInput, NotConverged
from camcal.formats import cameras, frames, native, provenance, robot_poses, split_address
from camcal.formats.camera_file import (
    STEP,
    CameraEntry,
    CameraFile,
    JointCovariance,
    Transform,
    ValidRegion,
    rig_of,
)
from camcal.geometry.pose import NamedTransform, Pose, frames_of
from camcal.messages import Message, counted
from camcal.options import command_line
from camcal.progress import SILENT, Progress, stage, warn_of
from camcal.quality.camera_check import usable
from camcal.report.handeye import SIGNIFICANT, HandEyeReport, report_of
from camcal.run.outputs import claim, writes
from camcal.targets.board import Board, Surface
from camcal.targets.detection import BoardDetection
from camcal.tasks.calibration.board_views import board_views, view_settings
from camcal.tasks.calibration.check_options import HandEyeOptions
from camcal.tasks.calibration.handeye_poses import (
    ReadPoses,
    SeenBoard,
    by_time,
    places_of,
    read_poses,
    require_enough,
    seen_poses,
    time_of,
)
from camcal.tasks.given_camera import read_part, require_no_image
from camcal.tasks.rigs.options import RigSettings
from camcal.tasks.rigs.rig_views import rig_views

CAMERA = "camera"  # the name of one that no file names
_FOREIGN_PX = 3.0  # of corners, with a lens that is not theirs
_LATER = 0.1  # of its standard deviation, by which a delay may change at last
_ROUNDS = 6


@dataclass(frozen=True, eq=False)
class GivenCameras:
    """The cameras that a robot carries or faces: one of a file or a rig, or none where poses of the board are given.

    frame: the name of the frame that their poses camera_T_rig are in. known: what is known of those that took images.
    """

    file: CameraFile | None
    cameras: Mapping[str, CameraEntry]
    frame: str = CAMERA
    poses: Mapping[str, Pose] | None = None


@writes
def handeye(options: HandEyeOptions, progress: Progress = SILENT) -> HandEyeReport:
    """Return where the camera and the board stand, after writing the camera file with these transforms.

    Without a camera file, of poses of the board, that is a file of transforms alone.
    Raises InvalidInput for poses that cannot be of these images, with what is wrong with them where that is known,
    InsufficientData for too few poses or too little rotation, NotConverged, FileError.
    """
    if options.output is None:
        raise InvalidInput("--output is needed")
    outputs = tuple(each for each in (options.output, options.report) if each is not None)
    claim(outputs)
    given, _, board, report = solve_handeye(options, progress)
    images = [{"file": image} for image in report.images]
    if given.file is None:
        named = [
            NamedTransform(*frames_of(name), each.pose, each.covariance) for name, each in report.transforms.items()
        ]
        frames.write(options.output, named)
    else:
        entries = dict(given.cameras)
        if options.free_lens and board is not None:
            lenses = report.estimate.state.rig.lenses
            entries = {
                name: _with_lens(entry, report.estimate, place, lenses[place])
                for place, (name, entry) in enumerate(entries.items())
            }
        kept = given.file.transforms if given.poses is not None else {}
        covariance = report.estimate.covariance
        names = [f"{name}.{step}" for name in report.transforms for step in STEP]
        written = CameraFile(
            entries,
            {**kept, **report.transforms},
            JointCovariance(tuple(names), covariance),
            provenance=provenance.build(command_line("handeye", options), board, images),
        )
        native.write(options.output, written)
    if options.report is not None:
        from camcal.report.page.checks import handeye_page
        from camcal.report.page.record import rendered
        from camcal.tasks.reports.closing import made

        files.write_text(options.report, rendered(handeye_page(report, str(options.robot), made())))
    return replace(report, outputs=outputs)


def solve_handeye(
    options: HandEyeOptions, progress: Progress = SILENT
) -> tuple[GivenCameras, SeenBoard, Board | None, HandEyeReport]:
    """Return the cameras, what they saw and of which board, and hand and eye, without writing them; see `handeye`."""
    if options.robot is None:
        raise InvalidInput("--robot is needed")
    if (options.camera_poses is None) == (not options.camera or not options.inputs):
        raise InvalidInput("CAMERA and IMAGES are needed, or --camera-poses in the place of images")
    given = _given_cameras(options, progress)
    rows = robot_poses.read(options.robot)
    warnings: tuple[Message, ...] = ()
    board: Board | None = None
    with stage(progress, "estimating"):
        if options.camera_poses is not None:
            seen = seen_poses(options.camera_poses, rows, options)
        else:
            seen, board, warnings = _seen_in_images(options, given, rows, progress)
        known = read_poses(options, rows, seen)
        estimate, delay = _estimate(seen, known, options)
    if not estimate.converged:
        raise NotConverged(f"hand and eye not converged after {estimate.passes} passes")
    transforms = _transforms(estimate, given.frame, options.eye_to_hand)
    words = f"{known.words}; of the board as {seen.words}" if seen.words else known.words
    report = report_of(estimate, transforms, delay, seen.images, words, warnings + known.warnings)
    warn_of(report.warnings, progress)
    return given, seen, board, report


def _given_cameras(options: HandEyeOptions, progress: Progress) -> GivenCameras:
    """Return the cameras of the file that was given, the one that was named, or those of a rig."""
    if not options.camera:
        return GivenCameras(None, {})
    path, name = split_address(options.camera)
    require_no_image(path)
    file = read_part(path, options.part, progress)
    if name is None and len(file.cameras) > 1:
        rig, frame = rig_of(file, str(path))
        poses = {each: own.inverse() for each, own in rig.rig_T_camera.items()}
        return GivenCameras(file, file.cameras, frame, poses)
    name = name or next(iter(file.cameras))
    return GivenCameras(file, {name: cameras.select(file, name, str(path))}, name)


def _seen_in_images(
    options: HandEyeOptions, given: GivenCameras, rows: robot_poses.RobotRows, progress: Progress
) -> tuple[SeenBoard, Board, tuple[Message, ...]]:
    """Return what images show of the board, by the lenses as they are known."""
    file = given.file
    assert file is not None
    captures, board = _captures(options, given, file, progress)
    if board.unit != "m":
        raise InvalidInput(
            "hand and eye are in metres: give the size of the board's squares, as in chessboard:9x6:25mm"
        )
    shown = np.array([place for place, views in enumerate(captures) if usable(list(views.values()))], np.intp)
    first = [next(iter(views.values())) for views in captures]
    moments = [time_of(first[place]) for place in shown]
    timed = by_time(rows, moments)
    names = [view.image for view in first]
    places = shown if timed else places_of(names, len(captures), shown, rows, str(options.robot))
    kept = shown[places >= 0]
    require_enough(len(kept))
    chosen = [captures[place] for place in kept]
    used = [view for views in chosen for view in usable(list(views.values()))]
    warnings: tuple[Message, ...] = ()
    if again := _used_before(file, used):
        text = (
            f"{counted(again, 'image')} of the calibration used again: the lens is estimated from them, not known twice"
        )
        warnings = (Message("images_used_again", text, {"images": again}),)
    problem, state = _known(given, file, board, chosen, free=options.free_lens or bool(again), where=options.camera)
    times = np.array(moments, float) if timed else None
    images = tuple(names[place] for place in kept)
    return SeenBoard(problem, state, images, places[places >= 0], times), board, warnings


def _captures(
    options: HandEyeOptions, given: GivenCameras, file: CameraFile, progress: Progress
) -> tuple[list[Mapping[str, BoardDetection]], Board]:
    """Return the views of every capture by cameras, also those without the board, and the board."""
    board = options.board
    if board is None and file.board_shape is not None:
        board = file.board_shape.board
    if given.poses is None:
        (name,) = given.cameras
        one = board_views(options.inputs, board, progress=progress, **view_settings(options))
        return [{name: view} for view in one.detections.views], one.board
    settings = RigSettings(board=board, refine=False, **view_settings(options))
    rig = rig_views(options.inputs, settings, progress)
    if unknown := [each for each in rig.captures.cameras if each not in given.cameras]:
        raise InvalidInput(f"no camera {unknown[0]!r}; it has {', '.join(given.cameras)}", where=options.camera)
    return [
        {name: view for name, view in zip(rig.captures.cameras, row, strict=True) if view is not None}
        for row in rig.captures.views
    ], rig.board


def _known(
    given: GivenCameras,
    file: CameraFile,
    board: Board,
    captures: Sequence[Mapping[str, BoardDetection]],
    *,
    free: bool,
    where: str,
) -> tuple[Any, Any]:
    """Return the problem of the captures and its state: lenses known by their file or free, the rig as it is."""
    same = file.board_shape is not None and file.board_shape.board == board
    known, poses = [], []
    for name, entry in given.cameras.items():
        own = [(place, view) for place, views in enumerate(captures) for view in usable([*_of(views, name)])]
        if own:
            places, views = zip(*own, strict=True)
            sigma = 0.0 if entry.noise is None else entry.noise.sigma_px
            lens = freed(entry.camera) if free else entry.camera
            known.append(KnownCamera(lens, sigma, Observations.of(views), np.array(places)))
            poses.append(Pose.identity() if given.poses is None else given.poses[name])
    entry = next(iter(given.cameras.values()))
    used = float(entry.quality.get("images_used") or provenance.image_counts(file.provenance)[0] or inf)
    shape = KnownBoard(file.board_shape, used) if same and file.board_shape else KnownBoard(Surface.flat(board))
    priors = {place: wide_prior_of(each) if free else prior_of(each) for place, each in enumerate(known)}
    estimated = estimate_known(known, poses, shape, priors, held=True)
    if estimated is None:
        raise InvalidInput("its lens has no image of the corners: the images are of another camera", where=where)
    found = estimated[0]
    if (off := max(part.noise.sigma for part in found.parts)) > _FOREIGN_PX:
        text = f"the corners are off by {off:.1f} px with this lens: the images are of another camera, focus or size"
        raise InvalidInput(text, where=where)
    return found.problem, found.state


def _of(views: Mapping[str, BoardDetection], name: str) -> Sequence[BoardDetection]:
    return [views[name]] if name in views else []


def _estimate(seen: SeenBoard, known: ReadPoses, options: HandEyeOptions) -> tuple[RobotEstimate, float]:
    """Return hand and eye, and by how many s the robot's poses have been taken to be late beforehand."""
    count, in_hand = len(seen.images), not options.eye_to_hand
    robot = RobotPoses(known.reading.poses, np.arange(count), in_hand, (1.0, 1.0), np.ones(count))
    scale = (0,) if options.robot_scale else ()
    if known.motion is None:
        return estimate_robot(seen.problem, seen.state, robot, known.reading.fit, scale), 0.0
    delay, free = known.delay, scale
    for _ in range(_ROUNDS):
        poses = known.motion.at(known.times + delay)
        robot = replace(robot, base_T_hand=poses, velocities=known.motion.velocities(known.times + delay))
        start = closed_form(robot.world_T_carrier, seen.camera_T_board)
        found = estimate_robot(seen.problem, seen.state, robot, start, free)
        value, std = found.systematic.get("delay", (0.0, inf))
        if free == scale and abs(value + delay) < SIGNIFICANT * std and abs(value) < SIGNIFICANT * std:
            break
        if free != scale and abs(value) < _LATER * std:
            break
        delay, free = delay + value, (*scale, 1)
    return found, delay


def _with_lens(entry: CameraEntry, estimate: RobotEstimate, place: int, lens: Array) -> CameraEntry:
    """Return a camera with the lens as it was estimated with the robot, without what was known of the one before."""
    before, rig = entry.camera, estimate.problem.rig
    own = slice(*rig.lens_starts[place : place + 2])  # type: ignore[attr-defined]
    free = rig.parts[place].free  # type: ignore[attr-defined]
    covariance = np.zeros((len(before.parameters),) * 2)
    covariance[np.ix_(free, free)] = estimate.joint[own, own]
    camera = replace(before, parameters=lens, covariance=covariance)
    valid = ValidRegion.of(camera, entry.image_circle)
    return CameraEntry(camera, valid, noise=entry.noise, sensor=entry.sensor, extra=entry.extra)


def _used_before(file: CameraFile, views: Sequence[BoardDetection]) -> int:
    """Return how many of these images the camera has been calibrated from, by their hashes."""
    listed = file.provenance.get("images")
    known = {image.get("sha256") for image in listed if isinstance(image, dict)} if isinstance(listed, list) else set()
    return sum(view.sha256 is not None and view.sha256 in known for view in views)


def _transforms(estimate: RobotEstimate, frame: str, eye_to_hand: bool) -> dict[str, Transform]:
    """Return hand_T_camera and base_T_board, or base_T_camera and hand_T_board."""
    names = (f"base_T_{frame}", "hand_T_board") if eye_to_hand else (f"hand_T_{frame}", "base_T_board")
    poses, covariance = (estimate.carrier_T_rig, estimate.world_T_board), estimate.covariance
    return {
        name: Transform(pose, covariance[part, part])
        for name, pose, part in zip(names, poses, (slice(0, 6), slice(6, 12)), strict=True)
    }
