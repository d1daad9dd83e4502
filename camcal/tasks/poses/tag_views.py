"""Detections of tags in images and videos, and of boards in videos."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass, field, replace
from camcal.errors import CamcalError, FileError
from camcal.estimate.poses.records import Correspondences
from camcal.images.files import gray_8bit
from camcal.images.image import Image
from camcal.images.video import frame_name, frames
from camcal.messages import Message
from camcal.progress import SILENT, Outcome, Progress, warn_of
from camcal.raw.reading import read_detection_image
from camcal.run import fingerprint
from camcal.run.fanout import fan_out
from camcal.run.journal import journaled
from camcal.run.options import DEFAULT_BATCH, BatchOptions
from camcal.run.paths import find_media
from camcal.run.resume import Items
from camcal.targets.board import CHARUCO, Board
from camcal.targets.checker.charuco import arrangements
from camcal.targets.detect import detect, require_findable
from camcal.targets.detection import BoardDetection, Detections
from camcal.targets.markers import Markers, TagObjects, detect_markers
from camcal.tasks.calibration.board_views import BoardViews
from camcal.tasks.calibration.which_board import board_warnings, pattern_lines, symmetry_warnings

_TIMEOUT_S = 600.0  # for one image; the slowest take seconds
_LISTED = 8  # ids in a reason
_SAMPLE = 6  # frames of a video on which the arrangement of a ChArUco board is found out
_STRIDE = 10


@dataclass(frozen=True, eq=False)
class TagViews:
    """What was seen: views by image and object, in the order of the images, and reasons of images without any.

    failed: a line for every file that could not be read. images: all that could be read, in order; frames of a video
    are named by `frame_name`.
    """

    views: tuple[Correspondences, ...]
    nothing: Mapping[str, str] = field(default_factory=dict)
    failed: tuple[str, ...] = ()
    warnings: tuple[Message, ...] = ()
    images: tuple[str, ...] = ()


class _Frame(NamedTuple):
    """An image to search under its name: None of a file, the gray frame of a video, or the error that ended one."""

    name: str
    image: Image | CamcalError | None = None


class _ImageMarkers(NamedTuple):
    """The markers of an image and its width and height."""

    markers: Markers
    size: tuple[int, int]


def tag_views(
    inputs: Sequence[Path | str],
    tags: TagObjects,
    recursive: bool = False,
    jobs: int | None = None,
    progress: Progress = SILENT,
    image_size: tuple[int, int] | None = None,
    *,
    keep_repeated: bool = False,
    batch: BatchOptions = DEFAULT_BATCH,
) -> TagViews:
    """Return what images, folders, globs and videos show of tags: one view for every image and object.

    A view holds all corners of its object, of every visible tag; see targets.tags for their order and frames.
    image_size: (width, height) of the camera; an image of another size has that for its reason. None: any.
    keep_repeated: single tags that an image shows several times are all there, as tag_5, tag_5_2, … from top to bottom.
    Raises InvalidInput, FileError for inputs that are not there, or if none can be read.
    """
    media = find_media(inputs, recursive)
    search = partial(_search, tags=tags, keep_repeated=keep_repeated, jobs=jobs, batch=batch, progress=progress)
    outcomes = search([_Frame(path.as_posix()) for path in media.images], "images")
    for video in media.videos:
        batch.raise_first(_errors(outcomes))
        outcomes += search(_frames([video]), video.name)
    errors = _errors(outcomes)
    batch.raise_first(errors)
    seen = {outcome.item.name: outcome.value for outcome in outcomes if outcome.value is not None}
    if not seen:
        raise errors[0] if len(errors) == 1 else FileError(f"none of {len(errors)} images can be read; {errors[0]}")
    views: list[Correspondences] = []
    nothing: dict[str, str] = {}
    for name, item in seen.items():
        found = _objects(name, item.markers, tags)
        reason = _why_not(item, found, tags, image_size)
        views += [] if reason else found
        nothing |= {name: reason} if reason else {}
    warnings = tuple(each.at(name) for name, item in seen.items() for each in item.markers.warnings)
    warn_of(warnings, progress)
    return TagViews(tuple(views), nothing, tuple(map(str, errors)), warnings, tuple(seen))


def _errors(outcomes: Iterable[Outcome[_Frame, _ImageMarkers]]) -> list[CamcalError]:
    return [outcome.error for outcome in outcomes if outcome.error is not None]


def _frames(videos: Iterable[Path]) -> Iterator[_Frame]:
    for video in videos:
        try:
            for number, image in enumerate(frames(video)):
                yield _Frame(frame_name(video, number), Image(gray_8bit(image.pixels), image.orientation))
        except CamcalError as error:
            yield _Frame(video.as_posix(), error)


def _search(
    looks: Iterable[_Frame],
    what: str,
    tags: TagObjects,
    keep_repeated: bool,
    jobs: int | None,
    batch: BatchOptions,
    progress: Progress,
) -> list[Outcome[_Frame, _ImageMarkers]]:
    """Return what became of every image, its pixels dropped."""
    timeout = None if jobs == 1 else _TIMEOUT_S
    work = partial(_look_at, family=tags.family, keep_repeated=keep_repeated)
    settings = fingerprint.of_data([fingerprint.versions(), tags.family, keep_repeated])
    kept: Items[_Frame, _ImageMarkers] = Items(settings, _looked_at, result=_ImageMarkers)
    found = journaled(work, looks, kept, jobs=jobs, batch=batch, what=what, progress=progress, timeout=timeout)
    return [outcome.of(_Frame(outcome.item.name)) for outcome in found]


def _looked_at(look: _Frame) -> list[Path | str]:
    if look.image is None:
        return [Path(look.name)]
    return [str(look.image) if isinstance(look.image, CamcalError) else fingerprint.of_array(look.image.pixels)]


def _look_at(look: _Frame, family: str, keep_repeated: bool) -> _ImageMarkers:
    if isinstance(look.image, CamcalError):
        raise look.image
    gray = read_detection_image(Path(look.name)).gray if look.image is None else look.image.pixels
    return _ImageMarkers(detect_markers(gray, family, keep_repeated=keep_repeated), (gray.shape[1], gray.shape[0]))


def _objects(image: str, markers: Markers, tags: TagObjects) -> list[Correspondences]:
    """Return the view of every object that has a tag in an image, in the order of their first ids."""
    parts: dict[str, list[tuple[Array, Array, Array]]] = {}
    times: Counter[int] = Counter()
    often = Counter(markers.ids.tolist())
    for tag, corners, covariance in zip(markers.ids.tolist(), markers.corners, markers.covariance, strict=True):
        if (found := tags.find(tag)) is None:
            continue
        name = found[0]
        if often[tag] > 1 and name in tags.bundles:
            continue  # which of them is the one of the bundle nobody knows
        times[tag] += 1
        name += f"_{times[tag]}" if times[tag] > 1 else ""
        parts.setdefault(name, []).append((found[1], corners, covariance))
    views = []
    for name, rows in parts.items():
        points, pixels, covariance = (np.concatenate(column) for column in zip(*rows, strict=True))
        views.append(Correspondences(image, points, pixels, covariance, object=name))
    return views


def _why_not(
    seen: _ImageMarkers, found: Sequence[Correspondences], tags: TagObjects, image_size: tuple[int, int] | None
) -> str | None:
    """Return why an image has no view, None if it has."""
    if image_size not in (None, seen.size):
        has, known = ("{} x {}".format(*size) for size in (seen.size, image_size or seen.size))
        return f"the image has {has} pixels, the camera file is for {known}"
    if found:
        return None
    if len(seen.markers.ids):
        ids = ", ".join(map(str, seen.markers.ids[:_LISTED])) + (" …" if len(seen.markers.ids) > _LISTED else "")
        return f"ids {ids} of {tags.family} detected, none of a known object"
    return seen.markers.warnings[0].text if seen.markers.warnings else f"no tag of {tags.family} found"


def board_frames(
    videos: Sequence[Path],
    board: Board,
    jobs: int | None = None,
    progress: Progress = SILENT,
    *,
    batch: BatchOptions = DEFAULT_BATCH,
) -> BoardViews:
    """Return what every frame of videos shows of a board, frames named as `frame_name` does.

    A ChArUco board is taken in the arrangement that fits the first video. A video that ends early is one of those
    that failed; its frames are there. Raises FileError if no frame can be read, InvalidInput for such a board.
    """
    require_findable(board)
    known = _arranged(videos[0], board) if board.type == CHARUCO else board
    work = partial(_detect, board=known)
    views: list[BoardDetection] = []
    errors: list[CamcalError] = []
    tasks, what = _frames(videos), "detecting"
    for outcome in fan_out(work, tasks, jobs=jobs, batch=batch, processes=True, what=what, progress=progress):
        # one outcome after another: each holds its frame
        views += [outcome.value] if outcome.value else []
        errors += [outcome.error] if outcome.error else []
    batch.raise_first(errors)
    if not views:
        raise errors[0] if errors else FileError("holds no frame", where=str(videos[0]))
    warnings = (*board_warnings(views, known, board), *symmetry_warnings(known))
    warn_of(warnings, progress)
    return BoardViews(
        known,
        Detections(known, tuple(views)),
        warnings,
        lines=pattern_lines(known, board, views),
        failed=tuple(map(str, errors)),
    )


def _detect(frame: _Frame, board: Board) -> BoardDetection:
    if isinstance(frame.image, CamcalError):
        raise frame.image
    assert frame.image is not None
    return replace(detect(frame.image.pixels, board), image=frame.name, orientation=frame.image.orientation)


def _arranged(video: Path, board: Board) -> Board:
    """Return the arrangement of a ChArUco board with which most corners are found on a few frames."""
    candidates = arrangements(board)
    if len(candidates) == 1:
        return candidates[0]
    sample: list[Image] = []
    for number, image in enumerate(frames(video)):
        if number % _STRIDE == 0:
            sample.append(image)
        if len(sample) == _SAMPLE:
            break
    grays = [gray_8bit(image.pixels) for image in sample]
    return max(candidates, key=lambda candidate: sum(len(detect(gray, candidate).ids) for gray in grays))
