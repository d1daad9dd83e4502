"""`camcal handeye`: where a camera stands on a robot's hand, or beside it, with the noise of the robot itself."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.known_cameras import KnownBoard, KnownCamera, estimate_known, prior_of, wide_prior_of
from camcal.calibrate.robot.estimator import RobotEstimate, estimate_robot
from camcal.calibrate.robot.problem import RobotPoses
from camcal.calibrate.robot.reading import (
    LEAST_POSES,
    Reading,
    duplicates,
    fits_better,
    moved_from,
    read_robot,
    shift_of,
    undetermined_axis,
)
from camcal.calibrate.robot.start import Poses
from camcal.cameras.observations import Observations
from camcal.errors import InsufficientData, InvalidInput, NotConverged
from camcal.formats import cameras, native, provenance, robot_poses
from camcal.formats.camera_file import CameraEntry, CameraFile, JointCovariance, Transform
from camcal.formats.pose_text import Form, form_named
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.messages import Message, counted
from camcal.options import command_line
from camcal.progress import SILENT, Progress, stage, warn_of
from camcal.quality.camera_check import usable
from camcal.report.table import Column
from camcal.run.outputs import claim, writes
from camcal.run.paths import split_address
from camcal.targets.board import Surface
from camcal.targets.detection import BoardDetection
from camcal.tasks.calibration.board_views import board_views, view_settings
from camcal.tasks.calibration.handeye_options import BASE_T_HAND, HAND_T_BASE, UNITS, HandEyeOptions
from camcal.tasks.given_camera import require_no_image

COLUMNS = (
    Column("transform"),
    Column("x", "mm"),
    Column("y", "mm"),
    Column("z", "mm"),
    Column("± std", "mm"),
    Column("rotation vector", "deg"),
    Column("± std", "deg"),
)
_MILLI = 1e3
_FOREIGN_PX = 3.0  # of corners, with a lens that is not theirs
_LARGE = (5e-3, np.radians(0.5))  # m and rad: noise of no robot that is sound
_DOUBTFUL = 0.3  # the weight below which a pose of the robot is named
_SYSTEMATIC = 0.3  # of the variance of its position errors, linear in position


@dataclass(frozen=True, eq=False)
class HandEyeReport:
    """Hand and eye. transforms: by their names, with covariances. noise: of the robot, σ with its 95 % interval, m and
    rad. doubtful: images whose pose of the robot hardly counts. words: how the poses were read.
    """

    transforms: Mapping[str, Transform]
    estimate: RobotEstimate
    noise: tuple[tuple[float, float, float], tuple[float, float, float]]
    images: tuple[str, ...]
    doubtful: tuple[str, ...]
    systematic: float
    words: str
    output: Path | None
    warnings: tuple[Message, ...]


@writes
def handeye(options: HandEyeOptions, progress: Progress = SILENT) -> HandEyeReport:
    """Return where the camera and the board stand, after writing the camera file with these transforms.

    Raises InvalidInput for poses that cannot be of these images, with what is wrong with them where that is known,
    InsufficientData for too few poses or too little rotation, NotConverged, FileError.
    """
    path, name = split_address(options.camera)
    require_no_image(path)
    file = cameras.read(path, progress)
    name = name or next(iter(file.cameras))
    entry = cameras.select(file, name if len(file.cameras) > 1 else None, str(path))
    if options.robot is None or options.output is None:
        raise InvalidInput("--robot and --output are needed")
    claim([options.output])
    board = options.board
    if board is None and file.board_shape is not None:
        board = file.board_shape.board
    seen = board_views(options.inputs, board, progress=progress, **view_settings(options))
    if seen.board.unit != "m":
        raise InvalidInput(
            "hand and eye are in metres: give the size of the board's squares, as in chessboard:9x6:25mm"
        )
    rows = robot_poses.read(options.robot)
    views, places = _matched(seen.detections.views, rows, str(options.robot))
    same = file.board_shape is not None and file.board_shape.board == seen.board
    used = float(entry.quality.get("images_used") or provenance.image_counts(file.provenance)[0] or inf)
    shape = KnownBoard(file.board_shape, used) if same and file.board_shape else KnownBoard(Surface.flat(seen.board))
    sigma = 0.0 if entry.noise is None else entry.noise.sigma_px
    known = KnownCamera(entry.camera, sigma, Observations.of(views), np.arange(len(views)))
    warnings: tuple[Message, ...] = ()
    if again := _used_before(file, views):
        text = (
            f"{counted(again, 'image')} of the calibration used again: the lens is estimated from them, not known twice"
        )
        warnings = (Message("images_used_again", text, {"images": again}),)
    with stage(progress, "estimating"):
        prior = wide_prior_of(known) if options.free_lens or again else prior_of(known)
        estimated = estimate_known([known], [Pose.identity()], shape, {0: prior})
        if estimated is None:
            raise InvalidInput(
                "its lens has no image of the corners: the images are of another camera", where=str(path)
            )
        found = estimated[0]
        if (off := found.parts[0].noise.sigma) > _FOREIGN_PX:
            text = (
                f"the corners are off by {off:.1f} px with this lens: the images are of another camera, focus or size"
            )
            raise InvalidInput(text, where=str(path))
        camera_T_board = Poses(found.state.rotations, found.state.translations)
        reading, remarks = _read(options, rows, places, camera_T_board)
        robot = RobotPoses(
            reading.poses, np.arange(len(views)), not options.eye_to_hand, (1.0, 1.0), np.ones(len(views))
        )
        estimate = estimate_robot(found, robot, reading.fit)
    if not estimate.converged:
        raise NotConverged(f"hand and eye not converged after {estimate.passes} passes")
    images = tuple(view.image for view in views)
    doubtful = tuple(image for image, weight in zip(images, estimate.weights, strict=True) if weight < _DOUBTFUL)
    systematic = _linear_share(estimate)
    warnings += remarks + _remarks(doubtful, systematic, estimate.sigmas)
    warn_of(warnings, progress)
    transforms, joint = _transforms(estimate, name, options.eye_to_hand)
    report = HandEyeReport(
        transforms,
        estimate,
        (_interval(estimate.sigmas[0], estimate.dof[0]), _interval(estimate.sigmas[1], estimate.dof[1])),
        images,
        doubtful,
        systematic,
        f"{reading.words}, {HAND_T_BASE if reading.inverted else BASE_T_HAND}, {_unit_of(reading.scale)}",
        options.output,
        warnings,
    )
    written = CameraFile(
        {name: _with_lens(entry, estimate, known.free) if options.free_lens else entry},
        transforms,
        joint,
        provenance=provenance.build(
            command_line("handeye", options), seen.board, [{"file": image} for image in images]
        ),
    )
    native.write(options.output, written)
    return report


def _with_lens(entry: CameraEntry, estimate: RobotEstimate, free: Array) -> CameraEntry:
    """Return a camera with the lens as it was estimated with the robot, without what was known of the one before."""
    before = entry.camera
    covariance = np.zeros((len(before.parameters),) * 2)
    covariance[np.ix_(free, free)] = estimate.lens_covariance
    camera = replace(before, parameters=estimate.state.rig.lenses[0], covariance=covariance)
    return CameraEntry(camera, entry.valid, noise=entry.noise, sensor=entry.sensor, extra=entry.extra)


def _used_before(file: CameraFile, views: Sequence[BoardDetection]) -> int:
    """Return how many of these images the camera has been calibrated from, by their hashes."""
    listed = file.provenance.get("images")
    known = {image.get("sha256") for image in listed if isinstance(image, dict)} if isinstance(listed, list) else set()
    return sum(view.sha256 is not None and view.sha256 in known for view in views)


def _matched(
    views: Sequence[BoardDetection], rows: robot_poses.RobotRows, where: str
) -> tuple[list[BoardDetection], Array]:
    """Return the views that have a pose of the board and one of the robot, and the places of the latter."""
    shown = usable(views)
    if rows.names is None:
        if len(rows.numbers) != len(views):
            raise InvalidInput(
                f"{counted(len(rows.numbers), 'pose')} for {counted(len(views), 'image')}: poses without names "
                "of images go with them one by one",
                where=where,
            )
        order = {id(view): place for place, view in enumerate(views)}
        places = [order[id(view)] for view in shown]
    else:
        known = {Path(name).name: place for place, name in enumerate(rows.names)}
        stems = {Path(name).stem: place for place, name in enumerate(rows.names)}
        found = [known.get(Path(view.image).name, stems.get(Path(view.image).stem)) for view in shown]
        shown = [view for view, place in zip(shown, found, strict=True) if place is not None]
        places = [place for place in found if place is not None]
    if len(shown) < LEAST_POSES:
        raise InsufficientData(
            f"{counted(len(shown), 'image')} with the board and a pose of the robot; {LEAST_POSES} or more are needed"
        )
    return shown, np.array(places)


def _read(
    options: HandEyeOptions, rows: robot_poses.RobotRows, places: Array, camera: Poses
) -> tuple[Reading, tuple[Message, ...]]:
    """Return the robot's poses as the images say they are to be read.

    Raises InvalidInput for a mistake that can be named, InsufficientData for a hand that hardly turned.
    """
    numbers, in_hand = rows.numbers[places], not options.eye_to_hand
    forms = rows.forms() if options.robot_form is None else (form_named(options.robot_form),)
    scales = tuple(UNITS.values()) if options.robot_unit is None else (UNITS[options.robot_unit],)
    directions = (False, True) if options.robot_frames is None else (options.robot_frames == HAND_T_BASE,)
    candidates = candidates_of(forms, numbers)
    if not candidates:
        named = options.robot_form or f"of {numbers.shape[1]} numbers"
        raise InvalidInput(f"its rows are no poses {named}", where=str(options.robot))
    readings = read_robot(candidates, camera, scales, directions, in_hand)
    best = readings[0]
    if (axis := undetermined_axis(best.poses)) is not None:
        raise InsufficientData(_little_rotation(axis))
    everything = candidates_of(rows.forms(), numbers)
    others = read_robot(everything, camera, tuple(UNITS.values()), (False, True), in_hand) if everything else ()
    for said, names in _mistakes(options, best, others):
        raise InvalidInput(f"{said}: {names}", where=str(options.robot))
    shift = shift_of(everything, camera) if rows.names is None else 0
    if shift:
        pair = f"image 1 belongs to pose {1 + shift}" if shift > 0 else f"image {1 - shift} belongs to pose 1"
        raise InvalidInput(
            f"the poses fit the images once they are shifted by {abs(shift)}: {pair}; one of them is missing",
            where=str(options.robot),
        )
    warnings: tuple[Message, ...] = ()
    if (first := moved_from(best.fit)) is not None:
        what = "the camera" if options.eye_to_hand else "the board"
        text = f"from pose {first + 1} on all are off: {what} has been moved, or has slipped in its mount"
        raise InvalidInput(f"{text}; leave these images out", where=str(options.robot))
    if count := duplicates(best.poses):
        text = f"{counted(count, 'pose')} of the robot repeated: the hand did not move, which shows nothing new"
        warnings += (Message("repeated_robot_pose", text, {"poses": count}, str(options.robot)),)
    return best, warnings


def _mistakes(options: HandEyeOptions, best: Reading, others: Sequence[Reading]) -> list[tuple[str, str]]:
    """Return what was said of the poses, and what they rather are."""
    if not others or not fits_better(best.fit, others[0].fit):
        return []
    other, told = others[0], []
    if options.robot_form is not None and other.words != best.words:
        told.append(f"--robot-form {other.words}")
    if options.robot_frames is not None and other.inverted != best.inverted:
        told.append(f"--robot-frames {HAND_T_BASE if other.inverted else BASE_T_HAND}")
    if options.robot_unit is not None and other.scale != best.scale:
        told.append(f"--robot-unit {_unit_of(other.scale)}")
    return [("the poses fit the images as something else", f"give {' '.join(told)}")] if told else []


def candidates_of(forms: Sequence[Form], numbers: Array) -> list[tuple[str, Poses]]:
    """Return the poses (N,) that rows of numbers are in each form, without those in which they are none."""
    found = []
    for form in forms:
        try:
            poses = [form.parse(row).pose() for row in numbers]
        except InvalidInput:
            continue
        rotations, translations = (
            np.stack([getattr(pose, name) for pose in poses]) for name in ("rotation", "translation")
        )
        found.append((str(form), Poses(rotations, translations)))
    return found


def _little_rotation(axis: Array) -> str:
    """Return what to do about a hand that turned about this axis (3,) only, zeros for none."""
    if not axis.any():
        return "the hand hardly turned between the images: turn it about two axes, by 30° and more"
    shown = ", ".join(f"{value:.2f}" for value in axis)
    return (
        f"the hand turned about one axis only, ({shown}) in its frame: where the camera stands along it is not "
        "determined; turn it about another one too, by 30° and more"
    )


def _unit_of(scale: float) -> str:
    return next(name for name, own in UNITS.items() if own == scale)


def _interval(sigma: float, dof: float) -> tuple[float, float, float]:
    """Return a standard deviation with its 95 % interval, given its degrees of freedom."""
    from scipy.stats import chi2

    low, high = (sigma * float(np.sqrt(dof / chi2.ppf(share, dof))) for share in (0.975, 0.025))
    return sigma, low, high


def _linear_share(estimate: RobotEstimate) -> float:
    """Return the share of the variance of the robot's position errors that is linear in position, beyond chance."""
    robot = estimate.problem.robot
    places = robot.base_T_hand.translations
    terms = np.column_stack([np.ones(len(places)), places - places.mean(axis=0)])
    count, used = len(places), terms.shape[1]
    if count <= 2 * used:
        return 0.0
    errors = estimate.residuals[:, :3]
    left = errors - terms @ np.linalg.lstsq(terms, errors, rcond=None)[0]
    whole = np.sum((errors - errors.mean(axis=0)) ** 2) / (count - 1)
    return float(max(0.0, 1.0 - np.sum(left**2) / (count - used) / whole)) if whole > 0 else 0.0


def _remarks(doubtful: Sequence[str], systematic: float, sigmas: tuple[float, float]) -> tuple[Message, ...]:
    """Return what is to be said of the robot's poses."""
    found = []
    if sigmas[0] > _LARGE[0] or sigmas[1] > _LARGE[1]:
        size = f"{_MILLI * sigmas[0]:.2g} mm and {np.degrees(sigmas[1]):.2g}°"
        text = f"noise of the robot {size}, more than any robot has: are poses and images of the same moments?"
        found.append(Message("large_robot_noise", text, {"position_m": sigmas[0], "rotation_rad": sigmas[1]}))
    if doubtful:
        text = f"poses of the robot that fit no other: {', '.join(doubtful[:5])}{' …' * (len(doubtful) > 5)}"
        found.append(Message("doubtful_robot_pose", text, {"poses": len(doubtful)}))
    if systematic > _SYSTEMATIC:
        share = f"{100 * systematic:.0f} % of the variance of the robot's position errors"
        text = f"{share} is linear in position: systematic, not noise"
        found.append(Message("systematic_robot", text, {"share": systematic}))
    return tuple(found)


def _transforms(
    estimate: RobotEstimate, camera: str, eye_to_hand: bool
) -> tuple[dict[str, Transform], JointCovariance]:
    """Return hand_T_camera and base_T_board, or base_T_camera and hand_T_board, and their joint covariance."""
    names = (f"base_T_{camera}", "hand_T_board") if eye_to_hand else (f"hand_T_{camera}", "base_T_board")
    poses, covariance = (estimate.carrier_T_rig, estimate.world_T_board), estimate.covariance
    transforms = {
        name: Transform(pose, covariance[part, part])
        for name, pose, part in zip(names, poses, (slice(0, 6), slice(6, 12)), strict=True)
    }
    steps = [f"{name}.{step}" for name in names for step in ("tx", "ty", "tz", "rx", "ry", "rz")]
    return transforms, JointCovariance(tuple(steps), covariance)


def rows(report: HandEyeReport) -> list[list[object]]:
    """Return the rows of the table."""
    table: list[list[object]] = []
    for name, transform in report.transforms.items():
        covariance = np.asarray(transform.covariance)
        std = np.sqrt(np.diag(covariance))
        vector = np.degrees(so3.log(transform.pose.rotation))
        table.append(
            [
                name,
                *(f"{_MILLI * value:.3f}" for value in transform.pose.translation),
                f"{_MILLI * np.sqrt(np.mean(std[:3] ** 2)):.2g}",
                " ".join(f"{value:.4f}" for value in vector),
                f"{np.degrees(np.sqrt(np.mean(std[3:] ** 2))):.2g}",
            ]
        )
    return table


def noise_words(report: HandEyeReport) -> str:
    """Return the robot's noise in a line."""
    (shift, low, high), (turn, least, most) = report.noise
    place = f"position {_MILLI * shift:.3g} mm ({_MILLI * low:.2g} to {_MILLI * high:.2g})"
    turned = np.degrees([turn, least, most])
    return (
        f"Noise of the robot: {place}, rotation {turned[0]:.3g}° ({turned[1]:.2g} to {turned[2]:.2g}), 95 % intervals"
    )


def document(report: HandEyeReport) -> dict[str, Any]:
    """Return the report as plain data for --json."""
    (shift, low, high), (turn, least, most) = report.noise
    return {
        "output": report.output,
        "read_as": report.words,
        "transforms": {
            name: {
                "R": item.pose.rotation.tolist(),
                "t_m": item.pose.translation.tolist(),
                "covariance": np.asarray(item.covariance).tolist(),
            }
            for name, item in report.transforms.items()
        },
        "robot_noise": {
            "position_m": {"value": shift, "low": low, "high": high},
            "rotation_rad": {"value": turn, "low": least, "high": most},
            "systematic_share": report.systematic,
        },
        "poses": [
            {"image": image, "shift_m": shift.tolist(), "rotation_vector": turned.tolist(), "weight": float(weight)}
            for image, shift, turned, weight in zip(
                report.images,
                report.estimate.residuals[:, :3],
                report.estimate.residuals[:, 3:],
                report.estimate.weights,
                strict=True,
            )
        ],
        "passes": report.estimate.passes,
    }
