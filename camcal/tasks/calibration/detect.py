"""`camcal detect`: the points of a board in images and frames of videos, as many at a time as there are cores."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from camcal.errors import CamcalError, FileError, InvalidInput
from camcal.formats import boards, detections
from camcal.progress import SILENT, Outcome, Progress
from camcal.run.fanout import fan_out
from camcal.run.inputs import Media, find_images, find_media
from camcal.run.outputs import refuse_overwriting, require_folder
from camcal.targets.board import CHARUCO, Board, Detection, Detections
from camcal.targets.checker.charuco import arrangements
from camcal.targets.detect import detect, require_findable
from camcal.tasks.calibration.board_remarks import nothing_found, remarks
from camcal.tasks.calibration.corner_drawing import draw, pictures
from camcal.tasks.calibration.photographs import (
    AS_IMAGES,
    Reading,
    in_colours,
    read_photograph,
    require_colours,
)
from camcal.tasks.calibration.video_frames import (
    BEST_FRAMES,
    Film,
    FrameLook,
    FrameOptions,
    FrameRecord,
    as_data,
    look_at,
    require_names,
    settled,
    summary,
    survey,
)

SUFFIXES = (".csv", ".vnl")
SAMPLE = 6  # images on which the arrangement of a ChArUco board is found out
TRYING = "trying patterns"
TIMEOUT_S = 600.0  # for one image; the slowest take some seconds
MIXED = (
    "red and blue come from demosaiced images, which mix them with green: the aberration may be wrong by tenths of a "
    "pixel; use raw frames"
)

Source = TypeVar("Source")
Shown = TypeVar("Shown")


@dataclass(frozen=True)
class DetectOptions:
    """Images and videos (files, folders, globs), the board that is looked for, and the detections file, None for none.

    reading: what is made of camera raw files and bare mosaics. frames: which ones of videos are taken. draw: a folder
    for pictures of what was found. parts: whether parts of a chessboard will do that show which part they are.
    """

    inputs: Sequence[Path | str]
    board: Board
    output: Path | None = None
    recursive: bool = False
    jobs: int | None = None
    reading: Reading = AS_IMAGES
    frames: FrameOptions = BEST_FRAMES
    draw: Path | None = None
    parts: bool = False


@dataclass(frozen=True, eq=False)
class DetectReport:
    """The detections with the board as it turned out to be, remarks, and the images that could not be read.

    colours: the same views by the samples of red and of blue, if the reading asked for them. frames: what became of the
    frames of videos that were searched; those that are taken are among the detections. films: where they come from.
    pictures: those drawn.
    """

    detections: Detections
    notes: tuple[str, ...]
    failed: tuple[str, ...]
    colours: Mapping[str, tuple[Detection, ...]] = field(default_factory=dict)
    frames: tuple[FrameRecord, ...] = ()
    films: tuple[Film, ...] = ()
    pictures: tuple[Path, ...] = ()

    @property
    def used(self) -> int:
        """The number of images with corners."""
        return sum(view.found for view in self.detections.views)


@dataclass(frozen=True)
class Seen:
    """What one image shows, and its colours if asked for; pattern: the size of a checker pattern that is not the board.

    demosaiced: whether the colours had been mixed.
    """

    view: Detection
    pattern: tuple[int, int] | None
    colours: Mapping[str, Detection] = field(default_factory=dict)
    demosaiced: bool = False


def detect_images(options: DetectOptions, progress: Progress = SILENT) -> DetectReport:
    """Return what images and chosen frames of videos show of a board, written to options.output if that is given.

    Images come in their order, then frames in theirs. A ChArUco board is taken in the arrangement that fits. Images of
    another size than most are left out.
    Raises InvalidInput, FileError if nothing can be read, InsufficientData if the board is nowhere; only pictures are
    drawn then.
    """
    require_findable(options.board, partial=options.parts)
    require_colours(options.board, options.reading)
    media = _media(options)
    _require_outputs(options, media)
    films = [survey(video, options.frames, progress) for video in media.videos]
    board = _arranged(options, media.images, films, progress) if options.board.type == CHARUCO else options.board
    seen, errors = _seen(media.images, board, options, progress)
    looks, lost = _looks(films, board, options, progress)
    errors += [*(film.error for film in films if film.error is not None), *lost]
    found = [item.view for item in seen] + [look.view for look in looks]
    patterns = [item.pattern for item in seen] + [look.pattern for look in looks]
    _require_readable(found, errors)
    if error := nothing_found(found, patterns, board, parts=options.parts):
        _drawn([item.view for item in seen], films, options, progress)  # here the reasons are wanted most
        raise error
    size = _usual_size(found)
    records = settled(looks, board, size, options.frames)
    kept = [record.look.view for record in records if record.taken or options.frames.whole]
    views = [_of_size(view, size) for view in (*(item.view for item in seen), *kept)]
    mixed = (MIXED,) if any(item.demosaiced for item in seen) else ()
    if options.output is not None:
        detections.write(options.output, Detections(board, tuple(views)))
    return DetectReport(
        Detections(board, tuple(views)),
        remarks(views, board, options.board) + mixed + tuple(summary(film, records) for film in films),
        tuple(map(str, errors)),
        {colour: tuple(item.colours[colour] for item in seen) for colour in (seen[0].colours if seen else ())},
        records,
        tuple(films),
        _drawn(views, films, options, progress),
    )


def _drawn(
    views: Sequence[Detection], films: Sequence[Film], options: DetectOptions, progress: Progress
) -> tuple[Path, ...]:
    if options.draw is None:
        return ()
    outputs = pictures([view.image for view in views], [film.path for film in films], options.draw)
    return draw(views, outputs, films, options.reading, options.jobs, progress)


def _media(options: DetectOptions) -> Media:
    """Return what there is to look at; videos are no raw frames and are left out where these are asked for."""
    if options.reading != AS_IMAGES:
        return Media(tuple(find_images(options.inputs, options.recursive, options.reading.suffixes)), ())
    media = find_media(options.inputs, options.recursive)
    require_names(media.videos)
    return media


def _require_outputs(options: DetectOptions, media: Media) -> None:
    """Raise InvalidInput if results have no place, or that of an input."""
    inputs = (*media.images, *media.videos)
    if options.output is not None:
        if options.output.suffix.lower() not in SUFFIXES:
            raise InvalidInput(f"detections are written as {' or '.join(SUFFIXES)}", where=str(options.output))
        refuse_overwriting([options.output], inputs)
    if options.draw is not None:
        require_folder(options.draw, "--draw")
        pictures([path.as_posix() for path in media.images], inputs, options.draw)


def _require_readable(views: Sequence[Detection], errors: Sequence[CamcalError]) -> None:
    """Raise what kept everything from being read, if something did."""
    if not views:
        raise errors[0] if len(errors) == 1 else FileError(f"none of {len(errors)} images can be read; {errors[0]}")


def _seen(
    images: Sequence[Path], board: Board, options: DetectOptions, progress: Progress
) -> tuple[list[Seen], list[CamcalError]]:
    """Return what images show, and why others could not be read."""
    work = partial(_detect_file, reading=options.reading, parts=options.parts)
    tasks = [(path, board) for path in images]
    outcomes = list(_search(work, tasks, options, "detecting", progress)) if images else []
    errors = [outcome.error for outcome in outcomes if outcome.error is not None]
    return [outcome.value for outcome in outcomes if outcome.value is not None], errors


def _looks(
    films: Sequence[Film], board: Board, options: DetectOptions, progress: Progress
) -> tuple[list[FrameLook], list[CamcalError]]:
    """Return what the frames of films show that are searched, and why others could not be."""
    looks: list[FrameLook] = []
    errors: list[CamcalError] = []
    for film in films:
        # one outcome after another: each holds its frame
        work = partial(look_at, parts=options.parts)
        for outcome in _search(work, film.tasks([board]), options, f"detecting in {film.path.name}", progress):
            looks += [outcome.value] if outcome.value else []
            errors += [outcome.error] if outcome.error else []
    return looks, errors


def _search(
    work: Callable[[Source], Shown], tasks: Iterable[Source], options: DetectOptions, what: str, progress: Progress
) -> Iterator[Outcome[Source, Shown]]:
    timeout = None if options.jobs == 1 else TIMEOUT_S
    return fan_out(work, tasks, jobs=options.jobs, processes=True, what=what, progress=progress, timeout=timeout)


def _detect_file(task: tuple[Path, Board], reading: Reading, parts: bool = False) -> Seen:
    path, board = task
    photograph = read_photograph(path, reading)
    sighting = detect(photograph.gray, board, partial=parts, samples=photograph.samples)
    height, width = photograph.gray.shape
    found = sighting.in_image(path.as_posix(), (width, height), photograph.orientation)
    return Seen(found, sighting.pattern, in_colours(photograph, found, board), photograph.demosaiced)


def _arranged(options: DetectOptions, images: Sequence[Path], films: Sequence[Film], progress: Progress) -> Board:
    """Return the arrangement of a ChArUco board with which most corners are found on a sample, else on everything."""
    candidates = arrangements(options.board)
    if len(candidates) == 1:
        return candidates[0]
    options = replace(options, reading=replace(options.reading, colours=False))
    samples = images[:: -(-len(images) // SAMPLE) or 1], [film.sample() for film in films]
    corners: Counter[Board] = Counter()
    for part, parts in (samples, (images, films)):
        tasks = [(path, candidate) for candidate in candidates for path in part]
        shown = _search(partial(_detect_file, reading=options.reading), tasks, options, TRYING, progress)
        corners.update(_counts((outcome.item[1], outcome.value.view) for outcome in shown if outcome.value))
        for film in parts:
            looks = _search(look_at, film.tasks(candidates), options, TRYING, progress)
            corners.update(_counts((outcome.item[2], outcome.value.view) for outcome in looks if outcome.value))
        if corners.total():
            break
    return max(candidates, key=lambda candidate: corners[candidate])


def _counts(views: Iterable[tuple[Board, Detection]]) -> Counter[Board]:
    """Return how many corners were found with each board."""
    counts: Counter[Board] = Counter()
    for board, view in views:
        counts[board] += len(view.ids)
    return counts


def _usual_size(views: Sequence[Detection]) -> tuple[int, int]:
    """Return the size of most views with points, (width, height)."""
    sizes = Counter(view.size for view in views if view.found)
    return max(sizes, key=lambda size: sizes[size])


def _of_size(view: Detection, usual: tuple[int, int]) -> Detection:
    """Return the view, without its points if it is of another size than most with points."""
    if view.size == usual or not view.found:
        return view
    reason = f"image {view.size[0]}x{view.size[1]} differs from the majority {usual[0]}x{usual[1]}"
    return replace(Detection.nothing(view.image, view.size, reason), orientation=view.orientation)


def document(report: DetectReport, output: Path | None) -> dict[str, Any]:
    """Return the report as plain data for --json; the corners themselves are in the file."""
    return {
        "output": None if output is None else output.as_posix(),
        "board": boards.block(report.detections.board) if report.detections.board else None,
        "images": [
            {
                "image": view.image,
                "image_size": list(view.size),
                "corners": len(view.ids),
                "reason": view.reason,
                "orientation": view.orientation,
            }
            for view in report.detections.views
        ],
        "frames": [as_data(record) for record in report.frames],
        "notes": list(report.notes),
        "failed": list(report.failed),
        "pictures": [path.as_posix() for path in report.pictures],
    }
