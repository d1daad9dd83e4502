"""Selection of video frames for several cameras: the same instants in all of them.

Frames of one instant belong together by the times in the videos, or by their numbers where a video has none. The
sharpest instant of each interval is searched in all videos. Of those with the board, the instants are used that tell
most about one of the lenses; where a camera sees the board blurred or moving fast, the instant is left out.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.frames import BLURRED, MOVING
from camcal.errors import FileError, InvalidInput
from camcal.images import video
from camcal.progress import Progress
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
    surveyed,
)
from camcal.tasks.rigs.camera_inputs import CameraInputs


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
    for camera in cameras:
        if camera.images or camera.tables or len(camera.videos) != 1:
            raise InvalidInput(f"camera {camera.name!r}: with videos, each camera has one and nothing else")
    require_names([camera.videos[0] for camera in cameras])
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
