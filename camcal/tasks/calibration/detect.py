"""`camcal detect`: detection of a board in images and video frames, in parallel, and pictures of the result."""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.errors import CamcalError, FileError, InvalidInput
from camcal.formats import boards, detections, native_entry
from camcal.images.files import KINDS, save
from camcal.images.videos import title
from camcal.messages import Message
from camcal.progress import SILENT, Progress, values_of, warn_of
from camcal.raw.options import AS_IMAGES, ImageReadOptions
from camcal.raw.reading import is_raw, read_detection_image
from camcal.report.overlays import corner_overlay
from camcal.run import fingerprint
from camcal.run.fanout import fan_out
from camcal.run.journal import journal_beside
from camcal.run.outputs import claim, writes
from camcal.run.paths import Media, find_images, find_media, names_file, refuse_collisions, require_one
from camcal.run.resume import Items
from camcal.targets.board import CHARUCO, Board
from camcal.targets.detect import require_findable
from camcal.targets.detection import BoardDetection, Detections
from camcal.tasks.calibration.board_search import (
    Material,
    detect_file,
    first_views,
    require_colours,
    search,
)
from camcal.tasks.calibration.images_again import with_circle
from camcal.tasks.calibration.mixed_sizes import same_size, usual_size
from camcal.tasks.calibration.options import DetectOptions
from camcal.tasks.calibration.video_frames import (
    Frame,
    FrameRecord,
    Video,
    detect_frame,
    require_names,
    settled,
    summary,
    survey,
)
from camcal.tasks.calibration.which_board import (
    board_warnings,
    nothing_found,
    other_board,
    pattern_lines,
    symmetry_warnings,
)

_PICTURE = "_corners.png"
DEMOSAICED = Message(
    "demosaiced_colours",
    "colours come from demosaiced images, which mix them: lateral chromatic aberration may be off by tenths of a "
    "pixel; use raw frames",
)


@dataclass(frozen=True, eq=False)
class DetectReport:
    """The detections with the board as it turned out to be, warnings, and the images that could not be read.

    lines: other lines of the report. frames: what became of the frames of videos that were searched; those that are
    taken are among the detections. videos: where they come from. pictures: those drawn.
    """

    detections: Detections
    warnings: tuple[Message, ...]
    failed: tuple[str, ...]
    lines: tuple[str, ...] = ()
    frames: tuple[FrameRecord, ...] = ()
    videos: tuple[Video, ...] = ()
    pictures: tuple[Path, ...] = ()

    @property
    def used(self) -> int:
        """The number of images with corners."""
        return sum(view.found for view in self.detections.views)


@writes
def detect_images(options: DetectOptions, progress: Progress = SILENT, *, locate: bool = False) -> DetectReport:
    """Return what images and chosen frames of videos show of a board, written to options.output if that is given.

    locate: whether it is enough to locate it, see `targets.detect.locate`.
    Images come in their order, then frames in theirs. A ChArUco board is taken in the arrangement that fits. Images of
    another size than most are left out, or made to fit.
    Raises InvalidInput, FileError if nothing can be read, InsufficientData if the board is nowhere; only pictures are
    drawn then.
    """
    with journal_beside(options.output, options.batch):
        return _detect(options, progress, locate=locate)


def _detect(options: DetectOptions, progress: Progress, *, locate: bool) -> DetectReport:
    if options.board is None:
        raise InvalidInput("--board is needed, such as --board chessboard:9x6:25mm")
    asked = boards.load_board(options.board) if isinstance(options.board, str) else options.board
    require_findable(asked, partial=options.parts)
    require_colours(asked, options.reading)
    media = _media(options)
    _require_outputs(options, media)
    videos = [survey(video, options.frames, progress) for video in media.videos]
    found = search_board(asked, media.images, videos, options, progress, locate=locate)
    board, errors = found.board, found.errors
    if found.nothing:
        _draw_views(found.views, videos, options, progress)  # here the reasons are wanted most
        raise found.nothing
    size = usual_size(found.views)
    records = settled(found.in_videos, board, size, options.frames)
    before = [*found.in_images, *(record.view for record in records if record.taken or options.frames.whole)]
    sized = same_size(before, size, board, mixed=options.mixed_sizes)
    views = sized.views
    demosaiced = any(view.colours and not is_raw(Path(view.image), options.reading) for view in found.in_images)
    mixed = (DEMOSAICED,) if demosaiced else ()
    result = Detections(board, views)
    if options.output is not None:
        result = with_circle(result, videos, options.reading)
        detections.write(options.output, result)
    symmetric = symmetry_warnings(board) if options.output is not None else ()  # calibrations number them themselves
    warnings = (*board_warnings(views, board, asked), *symmetric, *sized.warnings, *mixed)
    warn_of(warnings, progress)
    return DetectReport(
        result,
        warnings,
        failed=tuple(map(str, errors)),
        lines=(
            *pattern_lines(board, asked, views),
            *(circle.words for circle in result.circles.values()),
            *(summary(video, records) for video in videos),
        ),
        frames=records,
        videos=tuple(videos),
        pictures=_draw_views(sized.in_files(before), videos, options, progress),
    )


@dataclass(frozen=True, eq=False)
class FoundBoards:
    """The board in the arrangement that was found, what images and frames of videos show of it, and failed reads.

    nothing: what to raise where the board is nowhere.
    """

    board: Board
    in_images: tuple[BoardDetection, ...]
    in_videos: tuple[BoardDetection, ...]
    errors: tuple[CamcalError, ...]
    nothing: CamcalError | None = None

    @property
    def views(self) -> tuple[BoardDetection, ...]:
        """All views, those of images first."""
        return self.in_images + self.in_videos


def search_board(
    asked: Board,
    images: Sequence[Path],
    videos: Sequence[Video],
    options: DetectOptions,
    progress: Progress,
    *,
    locate: bool = False,
) -> FoundBoards:
    """Return what images, and the chosen frames of videos, show of a board; of the options, how they are read counts.

    locate: whether it is enough to locate it. Raises FileError if nothing can be read.
    """
    material = Material(images, videos, options.reading, options.jobs, options.batch, progress)
    board, without = first_views(asked, material, parts=options.parts)
    if without:
        few, total = material.of({view.image for view in without}), len(material.names)
        return FoundBoards(board, tuple(without), (), (), _nothing(asked, board, without, few, options, total))
    seen, errors = _seen(images, board, options, progress, locate=locate)
    errors += [video.error for video in videos if video.error is not None]
    options.batch.raise_first(errors)
    framed, lost = _in_videos(videos, board, options, progress, locate=locate)
    errors += lost
    options.batch.raise_first(errors)
    found = [*seen, *framed]
    if not found:
        raise errors[0] if len(errors) == 1 else FileError(f"none of {len(errors)} images can be read; {errors[0]}")
    nothing = _nothing(asked, board, found, material, options)
    return FoundBoards(board, tuple(seen), tuple(framed), tuple(errors), nothing)


def _nothing(
    asked: Board,
    board: Board,
    views: Sequence[BoardDetection],
    material: Material,
    options: DetectOptions,
    total: int | None = None,
) -> CamcalError | None:
    """Return the error that says which board images show in place of the one asked for, None where they show that.

    board: its arrangement that was searched for. total: the number of images where these are some of them.
    """
    instead = other_board(asked, board, views, material) if board.type == CHARUCO else None
    return (
        instead.error(views, asked, total) if instead else nothing_found(views, board, parts=options.parts, total=total)
    )


def _media(options: DetectOptions) -> Media:
    """Return what there is to look at; videos are no raw frames and are left out where these are asked for."""
    if options.reading != AS_IMAGES:
        return Media(tuple(find_images(options.inputs, options.recursive, options.reading.suffixes)), ())
    media = find_media(options.inputs, options.recursive)
    require_names(media.videos)
    return media


def _require_outputs(options: DetectOptions, media: Media) -> None:
    """Raise InvalidInput if results have no place, or that of an input."""
    if options.draw is None:
        return
    if names_file(options.draw, KINDS):
        require_one(options.draw, len(media.images))
        if media.videos:
            raise InvalidInput("frames of a video do not go into one file; give a folder", where=str(options.draw))
    claim(pictures([path.as_posix() for path in media.images], options.draw).values(), elsewhere=True)


def _seen(
    images: Sequence[Path], board: Board, options: DetectOptions, progress: Progress, *, locate: bool
) -> tuple[list[BoardDetection], list[CamcalError]]:
    """Return what images show, and why others could not be read."""
    work = partial(detect_file, reading=options.reading, parts=options.parts, hashed=True, measured=not locate)
    tasks = [(path, board) for path in images]
    found: Items[tuple[Path, Board], BoardDetection] = Items(
        _settings(options, locate=locate), _of_file, result=BoardDetection
    )
    outcomes = list(search(work, tasks, options.jobs, options.batch, "detecting", progress, found)) if images else []
    errors = [outcome.error for outcome in outcomes if outcome.error is not None]
    return [outcome.value for outcome in outcomes if outcome.value is not None], errors


def _in_videos(
    videos: Sequence[Video], board: Board, options: DetectOptions, progress: Progress, *, locate: bool
) -> tuple[list[BoardDetection], list[CamcalError]]:
    """Return what the frames of videos show that are searched, and why others could not be."""
    views: list[BoardDetection] = []
    errors: list[CamcalError] = []
    for video in videos:
        # one outcome after another: each holds its frame
        work = partial(detect_frame, parts=options.parts, measured=not locate)
        what = f"detecting in {title(video.path)}"
        found: Items[tuple[str, Frame, Board], BoardDetection] = Items(
            _settings(options, locate=locate), _of_frame, result=BoardDetection
        )
        for outcome in search(work, video.tasks([board]), options.jobs, options.batch, what, progress, found):
            views += [outcome.value] if outcome.value else []
            errors += [outcome.error] if outcome.error else []
    return views, errors


def _settings(options: DetectOptions, *, locate: bool) -> str:
    return fingerprint.of_data([fingerprint.of_settings(options.reading), options.parts, locate])


def _of_file(task: tuple[Path, Board]) -> list[Path | str]:
    """Return what is searched for a board: a file, by its name too, which the view has."""
    path, board = task
    return [path, path.as_posix(), repr(board)]


def _of_frame(task: tuple[str, Frame, Board]) -> list[Path | str]:
    """Return what is searched for a board: a frame, by its name too, and the one before, which tells of motion."""
    name, frame, board = task
    before = () if frame.before is None else (fingerprint.of_array(frame.before),)
    return [name, fingerprint.of_array(frame.measured), str(frame.image.orientation), *before, repr(board)]


def document(report: DetectReport, output: Path | None) -> dict[str, Any]:
    """Return the report as plain data for --json; the corners themselves are in the file."""
    return {
        "output": None if output is None else output.as_posix(),
        "board": boards.block(report.detections.board) if report.detections.board else None,
        "image_circle": native_entry.circle_block(report.detections.circles.get("")),
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
        "frames": [record.as_data() for record in report.frames],
        "failed": list(report.failed),
        "pictures": [path.as_posix() for path in report.pictures],
    }


@dataclass(frozen=True, eq=False)
class _Sheet:
    """A picture to be made of a view; gray: of a frame of a video, None for an image that is to be read."""

    view: BoardDetection
    output: Path
    gray: Array | None = None


def pictures(images: Sequence[str], output: Path) -> dict[str, Path]:
    """Return the file for each image, by its name as the views have it: one in a folder, or the output itself.

    Raises InvalidInput if two images would have one picture.
    """
    if names_file(output, KINDS):
        return dict.fromkeys(images, output)
    stems = {image: Path(image).stem for image in images}
    if len(set(stems.values())) < len(stems):  # of several folders
        stems = {image: f"{Path(image).parent.name}_{stem}" for image, stem in stems.items()}
    outputs = {image: output / f"{stem}{_PICTURE}" for image, stem in stems.items()}
    refuse_collisions({Path(image): output for image, output in outputs.items()})
    return outputs


def _draw_views(
    views: Sequence[BoardDetection], videos: Sequence[Video], options: DetectOptions, progress: Progress
) -> tuple[Path, ...]:
    """Return the pictures that were written, one for each view if any are wanted; FileError if one cannot be."""
    if options.draw is None:
        return ()
    outputs = pictures([view.image for view in views], options.draw)
    sheets = _sheets(views, outputs, videos)
    work = partial(_draw, reading=options.reading)
    return tuple(
        values_of(fan_out(work, sheets, jobs=options.jobs, batch=options.batch, what="drawing", progress=progress))
    )


def _sheets(views: Sequence[BoardDetection], outputs: Mapping[str, Path], videos: Sequence[Video]) -> Iterator[_Sheet]:
    """Yield what is to be drawn: images first, then the frames of one video after another."""
    names = frozenset(name for video in videos for name in video.names)
    from_videos = {view.image: view for view in views if view.image in names}
    for view in views:
        if view.image not in from_videos:
            yield _Sheet(view, outputs[view.image])
    for video in videos:
        for frame in video.only(from_videos).frames():
            yield _Sheet(from_videos[frame.name], outputs[frame.name], frame.image.pixels)


def _draw(sheet: _Sheet, reading: ImageReadOptions) -> Path:
    gray = sheet.gray if sheet.gray is not None else read_detection_image(Path(sheet.view.image), reading).gray
    save(sheet.output, corner_overlay(gray, sheet.view))
    return sheet.output
