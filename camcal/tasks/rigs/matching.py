"""Which images, or frames of videos, of several cameras were taken together: by name, by index or by time."""

from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.frames import BLURRED, MOVING
from camcal.calibrate.rigs.record import Captures
from camcal.dataclass import dataclass, replace
from camcal.errors import FileError, InvalidInput
from camcal.files import natural_key
from camcal.images import video
from camcal.messages import counted
from camcal.progress import Progress
from camcal.run.paths import NAME_READINGS
from camcal.targets.board import Board
from camcal.targets.detection import BoardDetection
from camcal.tasks.calibration.mixed_sizes import usual_size
from camcal.tasks.calibration.options import FrameOptions
from camcal.tasks.calibration.video_frames import (
    SEARCHED_PER_CHOSEN,
    FrameRecord,
    SurveyedVideo,
    Video,
    require_names,
    settled,
    sharpest,
    survey,
    surveyed,
)
from camcal.tasks.poses.frame_times import frame_times
from camcal.tasks.rigs.camera_inputs import CameraInputs, varying
from camcal.tasks.rigs.options import AUTO, INDEX, NAME, TIME
from camcal.tasks.timing import Timing

Views = Mapping[str, Sequence[BoardDetection]]  # of every camera, in the order of its images
Paths = Mapping[str, Sequence[Path]]
Keys = Mapping[str, Sequence[Hashable]]

_ENOUGH = 0.5  # of the images of the camera with fewest: so many names agree, or they are no common names
_NAMED = 3  # images in a message


@dataclass(frozen=True, eq=False)
class Matched:
    """Captures, how their images were found to belong together, and the images without a partner.

    largest: the largest time difference within a capture, s, None where times do not count.
    """

    captures: Captures
    by: str
    unmatched: tuple[str, ...] = ()
    largest: float | None = None

    @property
    def line(self) -> str:
        """The line of the report."""
        several = sum(sum(view is not None for view in row) > 1 for row in self.captures.views)
        apart = "" if self.largest is None else f", largest time difference {1e3 * self.largest:.3g} ms"
        alone = f"; {counted(len(self.unmatched), 'image')} unmatched" if self.unmatched else ""
        return (
            f"{counted(several, 'capture')} of {len(self.captures.cameras)} cameras, matched by {self.by}{apart}{alone}"
        )


def matched(views: Views, match: str = AUTO, tolerance: float | None = None) -> Matched:
    """Return the captures that images of two or more cameras make.

    match: by name, index or time, or whichever of them tells. tolerance: s, None for half of the shortest interval.
    Raises InvalidInput where nothing tells which images belong together.
    """
    timed = all(view.time is not None for own in views.values() for view in own)
    if match == TIME and not timed:
        image = next(view.image for own in views.values() for view in own if view.time is None)
        raise InvalidInput("has no time: set --timestamps, or --match name or index", where=image)
    if match == TIME or (match == AUTO and timed):
        return _by_time(views, tolerance)
    if match in (AUTO, NAME):
        found = _by_name(views)
        least = 1 if match == NAME else _ENOUGH * min(map(len, views.values()))
        if found is not None and len(found.captures) and _shared(found) >= least:
            return found
        if match == NAME:
            raise InvalidInput(f"no two cameras have images of one name: {_counts(views)}; use --match index or time")
    if match == AUTO and len(set(map(len, views.values()))) > 1:
        raise InvalidInput(
            f"the names of the images have too little in common, and their counts differ: {_counts(views)}; rename "
            "them, or use --match index or time"
        )
    keys = {name: range(1, len(own) + 1) for name, own in views.items()}
    return _collect(views, keys, INDEX, str)


def _counts(views: Views) -> str:
    return ", ".join(f"{name} {len(own)} ({own[0].image} …)" if own else f"{name} 0" for name, own in views.items())


def _shared(found: Matched) -> int:
    """Return the number of captures of two cameras or more."""
    return sum(sum(view is not None for view in row) > 1 for row in found.captures.views)


def _by_name(views: Views) -> Matched | None:
    """Return the captures by the reading of the names under which most images have a partner, None if none has."""
    best: tuple[int, Keys] | None = None
    stems = {name: [Path(view.image) for view in own] for name, own in views.items()}
    for reading in (_each(NAME_READINGS[0]), _without_camera, _varying, *map(_each, NAME_READINGS[1:])):
        keys = reading(stems)
        if any(len(set(own)) < len(own) for own in keys.values()):
            continue
        counts = Counter(key for own in keys.values() for key in own)
        count = sum(counts[key] > 1 for own in keys.values() for key in own)
        if count > (best[0] if best else 0):
            best = count, keys
    if best is None:
        return None
    return _collect(views, best[1], NAME, _words)


def _each(reading: Callable[[Path], str]) -> Callable[[Paths], Keys]:
    return lambda paths: {name: [reading(path) for path in own] for name, own in paths.items()}


def _without_camera(paths: Paths) -> Keys:
    """Return the names of images without that of the camera: left01 of left, cam0_01 of cam0."""
    return {name: [path.stem.replace(name, "", 1).strip("_-. ") for path in own] for name, own in paths.items()}


def _varying(paths: Paths) -> Keys:
    """Return what differs between the names of any camera's images."""
    found = varying([[path.stem for path in own] for own in paths.values()])
    return {name: list(own) for name, own in zip(paths, found, strict=True)}


def _words(key: Hashable) -> str:
    return "_".join(map(str, key)) if isinstance(key, tuple) else str(key)


def _by_time(views: Views, tolerance: float | None) -> Matched:
    """Return the captures of images that were taken within the tolerance, each of another camera.

    In the order of time, an image belongs to the capture before it if it is of a camera that this lacks and within the
    tolerance of its first image; with less than half of an interval, that is the nearest one.
    """
    times = {name: np.array([float(view.time or 0.0) for view in own]) for name, own in views.items()}
    limit = _usual_tolerance(times) if tolerance is None else tolerance
    events = sorted((time, name, place) for name, own in times.items() for place, time in enumerate(own.tolist()))
    keys: dict[str, list[Hashable]] = {name: [None] * len(own) for name, own in views.items()}
    start, members = -np.inf, set(views)
    largest = 0.0
    for time, name, place in events:
        if name in members or time - start > limit:
            start, members = time, set()
        members.add(name)
        largest = max(largest, time - start)
        keys[name][place] = start
    found = _collect(views, keys, TIME, lambda key: f"{key:.6f}".rstrip("0").rstrip("."))
    if not _shared(found):
        raise InvalidInput(
            f"no two cameras have images within {1e3 * limit:.3g} ms: their clocks differ, or --time-tolerance is too "
            "small"
        )
    return replace(found, largest=largest)


def _usual_tolerance(times: Mapping[str, np.ndarray]) -> float:
    """Return half of the shortest of the cameras' usual intervals, s."""
    steps = [float(np.median(np.diff(np.sort(own)))) for own in times.values() if len(own) > 1]
    return 0.5 * min(steps, default=0.0)


def _collect(views: Views, keys: Keys, by: str, words: Callable[..., str]) -> Matched:
    """Return the captures of views by their keys, in the natural order of these."""
    cameras = tuple(views)
    rows: dict[Hashable, dict[str, BoardDetection]] = {}
    for name in cameras:
        for key, view in zip(keys[name], views[name], strict=True):
            rows.setdefault(key, {})[name] = view
    rows = dict(sorted(rows.items(), key=lambda row: natural_key(words(row[0]))))
    alone = [row for row in rows.values() if len(row) == 1]
    captures = Captures(
        cameras,
        _distinct(words(key) or next(iter(row.values())).image for key, row in rows.items()),
        tuple(tuple(row.get(name) for name in cameras) for row in rows.values()),
    )
    return Matched(captures, by, tuple(view.image for row in alone for view in row.values()))


def _distinct(names: Iterable[str]) -> tuple[str, ...]:
    """Return names, a number behind those that another one has already."""
    taken: Counter[str] = Counter()
    result = []
    for name in names:
        taken[name] += 1
        result.append(name if taken[name] == 1 else f"{name} ({taken[name]})")
    return tuple(result)


def unmatched_words(images: Sequence[str]) -> str:
    """Return which images have no partner, the first of them by name."""
    named = ", ".join(Path(image).name for image in images[:_NAMED])
    more = f" and {len(images) - _NAMED} more" if len(images) > _NAMED else ""
    return f"{counted(len(images), 'image')} without a partner of another camera: {named}{more}"


@dataclass(frozen=True, eq=False)
class RigVideos:
    """The videos of cameras by their names; instants: (I, C) numbers of the frames to be searched, -1 for none.

    times: (N,) s of all frames of each video; their numbers for all videos if one of them has no times. tolerance: the
    largest difference of times within an instant.
    """

    videos: Mapping[str, Video]
    instants: Array
    times: Mapping[str, Array]
    tolerance: float

    def time_of(self, camera: str, image: str) -> float:
        """Return the time of a frame by its name, s."""
        return float(self.times[camera][frame_number(image)])

    def instant_of(self, camera: str, image: str) -> int:
        """Return the instant of a frame by its name."""
        column = list(self.videos).index(camera)
        return int(np.flatnonzero(self.instants[:, column] == frame_number(image))[0])


def frame_number(image: str) -> int:
    """Return the number of a frame by its name, as `video.frame_name` has it."""
    return int(Path(image).name.rpartition("_")[2])


def survey_rig(
    cameras: Sequence[CameraInputs], options: FrameOptions, tolerance: float | None, progress: Progress
) -> RigVideos:
    """Return the videos of cameras, one each, and the instants to be searched in all of them.

    tolerance: s, None for half of the shortest frame interval. Raises InvalidInput for several videos of a camera, or
    images beside them; FileError where no frames belong together.
    """
    require_names([videos_alone(camera) for camera in cameras])
    every = replace(options, every=1)
    found = {camera.name: surveyed(camera.videos[0], every, progress) for camera in cameras}
    times = _times(found)
    steps = [float(np.median(np.diff(own))) for own in times.values() if len(own) > 1]
    limit = 0.5 * min(steps, default=0.0) if tolerance is None else tolerance
    instants = _instants(times, limit, options.every)
    if not options.whole:
        value = _sharpness(found, instants)
        rows = sharpest(range(len(instants)), value.tolist(), SEARCHED_PER_CHOSEN * options.most)
        instants = instants[rows]
    videos = {
        name: each.video([number for number in instants[:, column].tolist() if number >= 0])
        for column, (name, each) in enumerate(found.items())
    }
    return RigVideos(videos, instants, times, limit)


def videos_alone(camera: CameraInputs) -> Path:
    """Return the video of a camera; raises InvalidInput unless it has one and nothing else."""
    if camera.images or camera.tables or len(camera.videos) != 1:
        raise InvalidInput(f"camera {camera.name!r}: with videos, each camera has one and nothing else")
    return camera.videos[0]


def every_frame(cameras: Sequence[CameraInputs], options: FrameOptions, progress: Progress) -> dict[str, Video]:
    """Return the videos of cameras, one each, with all of their frames to be searched."""
    paths = {camera.name: videos_alone(camera) for camera in cameras if camera.videos}
    require_names(list(paths.values()))
    return {name: survey(path, replace(options, whole=True), progress) for name, path in paths.items()}


def each_alone(views: Views) -> Matched:
    """Return every view as a capture, until the times of the cameras are known."""
    names = tuple(views)
    own = [(name, view) for name in names for view in views[name]]
    rows = tuple(tuple(view if name == each else None for each in names) for name, view in own)
    return Matched(Captures(names, tuple(f"{name}/{place}" for place, (name, _) in enumerate(own)), rows), TIME)


def with_own_times(
    views: Sequence[BoardDetection], videos: Sequence[Path], timing: Timing, progress: Progress
) -> list[BoardDetection]:
    """Return views with their times; raises InvalidInput where nothing tells them."""
    times = frame_times([view.image for view in views], videos, timing, progress)
    return [replace(view, time=time) for view, time in zip(views, times.tolist(), strict=True)]


def _times(found: Mapping[str, SurveyedVideo]) -> dict[str, Array]:
    """Return the times (N,) s of the frames of all videos, their numbers if one has no times."""
    stamps = {name: video.stamps(each.path) for name, each in found.items()}
    known = {name: own[: found[name].count] for name, own in stamps.items() if own is not None}
    if len(known) == len(found):
        return known
    return {name: np.arange(each.count, dtype=float) for name, each in found.items()}


def _instants(times: Mapping[str, Array], limit: float, every: int) -> Array:
    """Return the numbers (I, C) of frames within the limit of every frame of the video with fewest, -1 for none."""
    if not all(len(own) for own in times.values()):
        empty = next(name for name, own in times.items() if not len(own))
        raise FileError(f"the video of camera {empty!r} has no frames that can be read")
    start, end = max(own[0] for own in times.values()), min(own[-1] for own in times.values())
    within = {name: np.count_nonzero((own >= start) & (own <= end)) for name, own in times.items()}
    reference = times[min(within, key=lambda name: within[name])][::every]
    columns = []
    for own in times.values():
        after = np.clip(np.searchsorted(own, reference), 1, max(len(own) - 1, 1))
        before = after - 1
        after = np.minimum(after, len(own) - 1)
        nearest = np.where(reference - own[before] <= own[after] - reference, before, after)
        columns.append(np.where(np.abs(own[nearest] - reference) <= limit, nearest, -1))
    instants = np.stack(columns, axis=1)
    together = (instants >= 0).sum(axis=1) > 1
    if not together.any():
        raise InvalidInput(f"no frames of two videos are within {1e3 * limit:.3g} ms; use --time-tolerance")
    return np.asarray(instants[together])


def _sharpness(found: Mapping[str, SurveyedVideo], instants: Array) -> Array:
    """Return how sharp instants (I,) are: the mean logarithm of what their frames have over their video's median."""
    logs = np.full(instants.shape, np.nan)
    for column, each in enumerate(found.values()):
        values = np.log(np.maximum(each.sharpness, 1e-12))
        there = instants[:, column] >= 0
        logs[there, column] = (values - np.median(values))[instants[there, column]]
    return np.asarray(np.nanmean(logs, axis=1))


def settled_together(
    rig: RigVideos, views: Mapping[str, Sequence[BoardDetection]], board: Board, options: FrameOptions
) -> dict[str, tuple[FrameRecord, ...]]:
    """Return what becomes of the frames of every camera that were searched: an instant is used in all or in none.

    The instants that two cameras or more show come first, by the best rank that one of its frames has for its lens.
    """
    records = {name: settled(own, board, usual_size(own), options) for name, own in views.items()}
    if options.whole:
        return records
    ranks: dict[int, list[float]] = {}
    refused: dict[int, str] = {}
    for name, own in records.items():
        for record in own:
            instant = rig.instant_of(name, record.view.image)
            if record.choice is None:
                continue
            if record.choice.why in (BLURRED, MOVING):
                refused[instant] = f"camera {name}: {record.reason}"
            rank = record.choice.rank
            ranks.setdefault(instant, []).append(np.inf if rank is None else rank)
    usable = [instant for instant in ranks if instant not in refused]
    order = sorted(usable, key=lambda instant: (len(ranks[instant]) < 2, min(ranks[instant]), instant))
    used = {instant for instant in order[: options.most] if np.isfinite(min(ranks[instant]))}
    return {
        name: tuple(_decide(record, rig.instant_of(name, record.view.image), used, refused) for record in own)
        for name, own in records.items()
    }


def _decide(record: FrameRecord, instant: int, used: set[int], refused: Mapping[int, str]) -> FrameRecord:
    """Return the record of a frame with whether its instant is used."""
    taken = instant in used and record.view.found
    if taken == record.taken:
        return record
    return replace(record, taken=taken, reason="of a used instant" if taken else refused.get(instant, "adds less"))
