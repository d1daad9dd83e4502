"""The poses of `camcal handeye`: which of the robot's belong to what a camera saw, and how they are to be read."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.calibrate.robot.problem import Poses, SeenPoses
from camcal.calibrate.robot.reading import (
    LEAST_POSES,
    Motion,
    Reading,
    duplicates,
    fits_better,
    moved_from,
    read_robot,
    seen_form,
    shift_of,
    undetermined_axis,
)
from camcal.dataclass import dataclass, replace
from camcal.errors import InsufficientData, InvalidInput
from camcal.formats import poses as pose_files
from camcal.formats import robot_poses
from camcal.formats.pose_text import Form, form_named
from camcal.formats.poses.record import FORMAT
from camcal.messages import Message, counted
from camcal.parsing import is_number
from camcal.targets.detection import BoardDetection
from camcal.tasks.calibration.check_options import BASE_T_HAND, HAND_T_BASE, UNITS, HandEyeOptions

_LATEST_STAMP = 1e11  # s: a larger number is in ns
_NS = 1e-9
_INSIDE = 0.5  # of the images' times, within those of the poses
_HEAD = 1000  # letters, in which a file of camcal says what it is


@dataclass(frozen=True, eq=False)
class SeenBoard:
    """What a camera or a rig saw of the board: a RigProblem or SeenPoses, and its state.

    images: (N,) names of captures; times: (N,) s, None where they are not known. places: (N,) of the robot's poses.
    words: how poses of the board were read.
    """

    problem: Any
    state: Any
    images: tuple[str, ...]
    places: Array
    times: Array | None = None
    words: str = ""

    @property
    def camera_T_board(self) -> Poses:  # noqa: N802 - a_T_b
        """The poses of the board in the frame of the camera or rig."""
        return Poses(self.state.rotations, self.state.translations)


@dataclass(frozen=True, eq=False)
class ReadPoses:
    """The robot's poses of images, as they are read. motion: where they are matched by time, all of them, with the
    times (N,) of the images and by how many s they are late, roughly.
    """

    reading: Reading
    motion: Motion | None
    times: Array
    delay: float
    warnings: tuple[Message, ...]

    @property
    def words(self) -> str:
        """How they were read."""
        frames = HAND_T_BASE if self.reading.inverted else BASE_T_HAND
        return f"{self.reading.words}, {frames}, {_unit_of(self.reading.scale)}"


def time_of(view: BoardDetection) -> float | None:
    """Return when an image was taken, by its record or by its name, s."""
    stem = Path(view.image).stem
    if view.time is not None or not is_number(stem):
        return view.time
    value = float(stem)
    return value * _NS if value > _LATEST_STAMP else value


def by_time(rows: robot_poses.RobotRows, times: Sequence[float | None]) -> bool:
    """Return whether poses go with images by their times: both have them, and they are of the same hours."""
    known = np.array([time for time in times if time is not None])
    if rows.names is not None or rows.times is None or len(known) < len(times):
        return False
    inside = (known >= rows.times[0]) & (known <= rows.times[-1])
    return bool(len(known) and inside.mean() > _INSIDE)


def places_of(names: Sequence[str], listed: int, shown: Array, rows: robot_poses.RobotRows, where: str) -> Array:
    """Return the places (N,) of the robot's poses of those images that show the board, -1 for none.

    names: of all `listed` images; shown: (M,) the places among them of those with the board.
    """
    if rows.names is None:
        if len(rows.numbers) != listed:
            raise InvalidInput(
                f"{counted(len(rows.numbers), 'pose')} for {counted(listed, 'image')}: poses without names "
                "of images go with them one by one",
                where=where,
            )
        return shown
    known = {Path(name).name: place for place, name in enumerate(rows.names)}
    stems = {Path(name).stem: place for place, name in enumerate(rows.names)}
    images = [Path(names[place]) for place in shown]
    return np.array([known.get(image.name, stems.get(image.stem, -1)) for image in images], np.intp)


def require_enough(count: int) -> None:
    """Raise InsufficientData for too few poses."""
    if count < LEAST_POSES:
        raise InsufficientData(
            f"{counted(count, 'image')} with the board and a pose of the robot; {LEAST_POSES} or more are needed"
        )


def seen_poses(path: Path, rows: robot_poses.RobotRows, options: HandEyeOptions) -> SeenBoard:
    """Return the poses of the board that a file has in place of images; raises InvalidInput, FileError."""
    given: robot_poses.RobotRows | None = None
    images: tuple[str, ...] | None
    if (own := _of_camcal(path)) is not None:
        images, times, listed = own[0], None, len(own[0])
    else:
        given = robot_poses.read(path)
        images, times, listed = given.names, given.times, len(given.numbers)
    names = images or tuple(f"pose {place + 1}" for place in range(listed))
    where = str(options.robot)
    if times is not None and by_time(rows, list(times)):
        places = np.arange(listed)
    elif images is None and rows.names is not None:
        raise InvalidInput("has no names of images, and the robot's poses do: give both, or neither", where=str(path))
    else:
        times = None
        places = places_of(names, listed, np.arange(listed), rows, where)
    kept = np.flatnonzero(places >= 0)
    require_enough(len(kept))
    times = None if times is None else times[kept]
    chosen = tuple(names[place] for place in kept)
    if own is not None:
        problem = SeenPoses(own[1].take(kept), own[2][kept])
        return SeenBoard(problem, problem.measured, chosen, places[kept], times)
    assert given is not None
    candidates = candidates_of(given.forms(), given.numbers[kept])
    robot = candidates if times is not None else candidates_of(_forms(options, rows), rows.numbers[places[kept]])
    if not candidates or not robot:
        raise InvalidInput("its rows are no poses", where=where if candidates else str(path))
    words, poses = seen_form(robot, candidates, tuple(UNITS.values()), not options.eye_to_hand)
    return SeenBoard(SeenPoses(poses, None), poses, chosen, places[kept], times, words)


def _of_camcal(path: Path) -> tuple[tuple[str, ...], Poses, Array] | None:
    """Return images, poses and covariances of a pose file of camcal, None for another file."""
    if path.suffix.lower() == ".mat" or FORMAT not in files.read_text(path)[:_HEAD]:
        return None
    found = pose_files.read(path)
    if found.unit != "m" or len({key.object for key in found.estimates}) > 1:
        raise InvalidInput("hand and eye need poses of one object, in metres", where=str(path))
    records = [each if found.of_object else each.inverse() for each in found.estimates.values()]
    rotations = np.stack([each.transform.rotation for each in records])
    poses = Poses(rotations, np.stack([each.transform.translation for each in records]))
    return tuple(key.image for key in found.estimates), poses, np.stack([each.covariance for each in records])


def _forms(options: HandEyeOptions, rows: robot_poses.RobotRows) -> tuple[Form, ...]:
    return rows.forms() if options.robot_form is None else (form_named(options.robot_form),)


def read_poses(options: HandEyeOptions, rows: robot_poses.RobotRows, seen: SeenBoard) -> ReadPoses:
    """Return the robot's poses as the camera says they are to be read.

    Raises InvalidInput for a mistake that can be named, InsufficientData for a hand that hardly turned.
    """
    camera, in_hand, where = seen.camera_T_board, not options.eye_to_hand, str(options.robot)
    numbers, delay, motion = rows.numbers, 0.0, None
    if seen.times is not None and rows.times is not None:
        everything = candidates_of((form_named("tum"),), numbers)
        if everything:
            motion = Motion(rows.times, everything[0][1])
            delay = motion.delay(seen.times, camera)
            everything = [("tum", motion.at(seen.times + delay))]
        candidates = everything
    else:
        candidates = candidates_of(_forms(options, rows), numbers[seen.places])
        everything = candidates_of(rows.forms(), numbers[seen.places])
    if not candidates:
        named = options.robot_form or f"of {numbers.shape[1]} numbers"
        raise InvalidInput(f"its rows are no poses {named}", where=where)
    scales = tuple(UNITS.values()) if options.robot_unit is None else (UNITS[options.robot_unit],)
    directions = (False, True) if options.robot_frames is None else (options.robot_frames == HAND_T_BASE,)
    best = read_robot(candidates, camera, scales, directions, in_hand)[0]
    if (axis := undetermined_axis(best.poses)) is not None:
        raise InsufficientData(_little_rotation(axis))
    others = read_robot(everything, camera, tuple(UNITS.values()), (False, True), in_hand) if everything else ()
    for said, names in _mistakes(options, best, others):
        raise InvalidInput(f"{said}: {names}", where=where)
    if motion is None and (shift := shift_of(everything, camera)):
        raise InvalidInput(_shift_words(shift, named=rows.names is not None), where=where)
    if (first := moved_from(best.fit)) is not None:
        what = "the camera" if options.eye_to_hand else "the board"
        text = f"from pose {first + 1} on all are off: {what} has been moved, or has slipped in its mount"
        raise InvalidInput(f"{text}; leave these images out", where=where)
    warnings: tuple[Message, ...] = ()
    if count := duplicates(best.poses):
        text = f"{counted(count, 'pose')} of the robot repeated: the hand did not move, which shows nothing new"
        warnings += (Message("repeated_robot_pose", text, {"poses": count}, where),)
    if motion is None:
        return ReadPoses(best, None, np.zeros(0), 0.0, warnings)
    known = replace(motion.poses, translations=motion.poses.translations * best.scale)
    motion = replace(motion, poses=known.inverse() if best.inverted else known)
    return ReadPoses(best, motion, np.asarray(seen.times), delay, warnings)


def _shift_words(shift: int, *, named: bool) -> str:
    """Return by how much poses are shifted against the images, or their names are."""
    image, pose = (1, 1 + shift) if shift > 0 else (1 - shift, 1)
    if named:
        return f"the poses have the names of other images: that of image {pose} belongs to image {image}"
    pair = f"image {image} belongs to pose {pose}; one of them is missing"
    return f"the poses fit the images once they are shifted by {abs(shift)}: {pair}"


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
