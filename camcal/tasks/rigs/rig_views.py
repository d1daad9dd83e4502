"""What the images of several cameras show of a board: searched once for all cameras, matched to captures."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from camcal.calibrate.rigs.record import Captures
from camcal.cameras.validity import ImageCircle
from camcal.dataclass import dataclass, field, replace
from camcal.errors import InsufficientData, InvalidInput
from camcal.messages import Message
from camcal.options import given_words
from camcal.progress import Progress, warn_of
from camcal.raw.options import AS_IMAGES
from camcal.targets.board import Board
from camcal.targets.board_set import BoardSet, board_set
from camcal.targets.detect import require_findable
from camcal.targets.detection import BoardDetection, Detections
from camcal.tasks.calibration.board_search import require_colours
from camcal.tasks.calibration.board_views import board_views, is_located
from camcal.tasks.calibration.detect import search_board
from camcal.tasks.calibration.images_again import with_circle
from camcal.tasks.calibration.mixed_sizes import same_size, usual_size
from camcal.tasks.calibration.options import DetectOptions
from camcal.tasks.calibration.video_frames import FrameRecord, Video, summary
from camcal.tasks.calibration.which_board import board_warnings, pattern_lines
from camcal.tasks.rigs.camera_inputs import SYNTAX, CameraInputs, cameras_of, split_by_name
from camcal.tasks.rigs.matching import (
    Matched,
    each_alone,
    every_frame,
    matched,
    settled_together,
    survey_rig,
    unmatched_words,
    with_own_times,
)
from camcal.tasks.rigs.options import AUTO, TIME, RigSettings
from camcal.tasks.rigs.rig_boards import asked_board, require_other_names, require_size


@dataclass(frozen=True, eq=False)
class RigViews:
    """The board, the captures of it and how they were matched, image circles by camera, and the images that failed.

    warnings, lines: of the report. frames: what became of the frames of videos; videos: these. table: whether all comes
    from detections files. files: the images whose names are not their paths.
    """

    board: Board
    matched: Matched
    circles: Mapping[str, ImageCircle] = field(default_factory=dict)
    warnings: tuple[Message, ...] = ()
    lines: tuple[str, ...] = ()
    failed: tuple[str, ...] = ()
    frames: tuple[FrameRecord, ...] = ()
    videos: tuple[Video, ...] = ()
    table: bool = False
    files: Mapping[str, Path] = field(default_factory=dict)

    @property
    def captures(self) -> Captures:
        """The captures."""
        return self.matched.captures

    def of(self, camera: str) -> list[BoardDetection]:
        """Return the views of a camera."""
        return [view for view in self.captures.of(self.captures.cameras.index(camera)) if view is not None]

    def detections(self) -> Detections:
        """Return all views, one camera after another."""
        views = tuple(view for name in self.captures.cameras for view in self.of(name))
        return Detections(self.board, views, self.circles)

    def with_views(self, views: Mapping[str, Sequence[BoardDetection]]) -> "RigViews":
        """Return the same with other views in the place of every camera's, in their order."""
        left = {name: iter(own) for name, own in views.items()}
        cameras = self.captures.cameras
        rows = tuple(
            tuple(None if view is None else next(left[name]) for name, view in zip(cameras, row, strict=True))
            for row in self.captures.views
        )
        return replace(self, matched=replace(self.matched, captures=replace(self.captures, views=rows)))


def rig_views(inputs: Sequence[str], settings: RigSettings, progress: Progress, *, pair: bool = False) -> RigViews:
    """Return what the inputs of all cameras show of a board; pair: these have to be two.

    Raises InvalidInput where cameras or captures cannot be told apart, FileError if nothing can be read,
    InsufficientData if fewer than two cameras see the board.
    """
    cameras, lines = cameras_of(inputs, settings.recursive, settings.reading.suffixes)
    if pair and len(cameras) > 2:
        names = ", ".join(camera.name for camera in cameras)
        raise InvalidInput(f"{len(cameras)} cameras ({names}): use 'camcal rig'", where=inputs[0])
    tables = [camera for camera in cameras if camera.tables]
    if tables and any(camera.images or camera.videos or len(camera.tables) > 1 for camera in cameras):
        raise InvalidInput("detections files cannot be combined with other inputs", where=tables[0].tables[0])
    if len(tables) not in (0, len(cameras)):
        raise InvalidInput("detections files cannot be combined with images", where=tables[0].tables[0])
    found = _from_tables(cameras, settings, progress) if tables else _from_media(cameras, settings, progress)
    return replace(found, lines=lines + found.lines)


def captured(
    board: Board, views: Mapping[str, Sequence[BoardDetection]], settings: RigSettings, progress: Progress
) -> RigViews:
    """Return the captures of views of every camera; warns of images without a partner and cameras without the board."""
    named = {name: [replace(view, camera=name) for view in own] for name, own in views.items()}
    blind = [name for name, own in named.items() if not any(view.found for view in own)]
    seeing = {name: own for name, own in named.items() if name not in blind}
    if len(seeing) < 2:
        raise InsufficientData(
            f"no image of camera {', '.join(blind)} shows the board: a rig needs two cameras that see it"
            if seeing
            else "no image shows the board"
        )
    result = each_alone(seeing) if settings.timed else matched(seeing, settings.match, settings.tolerance)
    warnings = [
        Message("camera_without_board", f"camera {name}: none of {len(named[name])} images shows the board: left out")
        for name in blind
    ]
    if result.unmatched:
        values = {"images": tuple(result.unmatched)}
        warnings.append(Message("unmatched_images", unmatched_words(result.unmatched), values))
    warn_of(warnings, progress)
    return RigViews(board, result, warnings=tuple(warnings), lines=() if settings.timed else (result.line,))


def captured_boards(
    boards: BoardSet,
    views: Mapping[str, Mapping[str, Sequence[BoardDetection]]],
    settings: RigSettings,
    progress: Progress,
) -> RigViews:
    """Return the captures of views of every camera, by the names of boards and then of cameras, each board with
    captures of its own.

    Raises InsufficientData, beside what `captured` does, for a board that no camera sees.
    """
    for name in boards.names:
        if not any(view.found for own in views.get(name, {}).values() for view in own):
            raise InsufficientData(f"board {name}: no image of any camera shows it")
    cameras = dict.fromkeys(camera for own in views.values() for camera in own)
    of_image: dict[tuple[str, str, str], BoardDetection] = {}  # by camera, image and board
    shown: dict[str, dict[str, BoardDetection]] = {camera: {} for camera in cameras}
    for name, by_camera in views.items():
        for camera, own in by_camera.items():
            for view in own:
                of_image[camera, view.image, name] = view
                if not shown[camera].setdefault(view.image, view).found:
                    shown[camera][view.image] = view
    found = captured(boards, {camera: tuple(own.values()) for camera, own in shown.items()}, settings, progress)
    captures = found.captures
    names, rows, moments, places = [], [], [], []
    for place, name in enumerate(boards.names):
        for moment, (capture, row) in enumerate(zip(captures.names, captures.views, strict=True)):
            shows = [_of_board(view, name, of_image, boards, first=not place) for view in row]
            if any(view is not None for view in shows):
                names.append(f"{capture} {name}")
                rows.append(tuple(shows))
                moments.append(moment)
                places.append(place)
    several = Captures(captures.cameras, tuple(names), tuple(rows), tuple(moments), tuple(places))
    return replace(found, matched=replace(found.matched, captures=several), lines=(found.matched.line,))


def captured_table(
    board: Board, views: Mapping[str, Sequence[BoardDetection]], settings: RigSettings, progress: Progress
) -> RigViews:
    """Return the captures of views of every camera that say which of several boards they are of; see `captured`."""
    if not isinstance(board, BoardSet):
        return captured(board, views, settings, progress)
    require_other_names(board, list(views))
    by_board = {
        name: {
            camera: [replace(view, camera=camera) for view in own if view.body in (name, "")]
            for camera, own in views.items()
        }
        for name in board.names
    }
    return captured_boards(board, by_board, settings, progress)


def _of_board(
    view: BoardDetection | None,
    name: str,
    of_image: Mapping[tuple[str, str, str], BoardDetection],
    boards: BoardSet,
    *,
    first: bool,
) -> BoardDetection | None:
    """Return what an image shows of a board, None where it does not; of an image without any board, what it shows
    instead, with the `first` of the boards.
    """
    if view is None:
        return None
    own = of_image.get((view.camera, view.image, name))
    if own is not None and own.found:
        numbered = own if own.body else boards.numbered(name, own)
        return replace(numbered, camera=view.camera, time=view.time)
    return replace(view, body=name) if first and not view.found else None


def _detection(board: Board, settings: RigSettings) -> DetectOptions:
    """Return how a board is searched for; raises InvalidInput for one that cannot be found so."""
    require_findable(board, partial=settings.parts)
    require_colours(board, settings.reading)
    return DetectOptions(
        board=board,
        jobs=settings.jobs,
        batch=settings.batch,
        reading=settings.reading,
        frames=settings.frames,
        parts=settings.parts,
        mixed_sizes=settings.mixed_sizes,
    )


def _from_media(cameras: Sequence[CameraInputs], settings: RigSettings, progress: Progress) -> RigViews:
    asked = asked_board(settings)
    if asked is None:
        raise InvalidInput("--board is needed to find one in images, such as --board chessboard:9x6:25mm")
    require_size(asked)
    if isinstance(asked, BoardSet):
        return _from_images_of_boards(cameras, asked, settings, progress)
    options = _detection(asked, settings)
    videos = None
    every = every_frame(cameras, settings.frames, progress) if settings.timed else {}
    if any(camera.videos for camera in cameras) and not settings.timed:
        videos = survey_rig(cameras, settings.frames, settings.tolerance, progress)
    images = [path for camera in cameras for path in camera.images]
    locate = is_located(settings.refine, settings.reading, mixed_sizes=settings.mixed_sizes)
    searched = list(videos.videos.values() if videos else every.values())
    found = search_board(asked, images, searched, options, progress, locate=locate)
    if found.nothing:
        raise found.nothing
    by_name = {view.image: view for view in found.views}
    taken = _of_images(cameras, by_name, every, settings, progress)
    records: tuple[FrameRecord, ...] = ()
    if videos is not None:
        own = {
            name: [by_name[each] for each in video.names if each in by_name] for name, video in videos.videos.items()
        }
        settled = settled_together(videos, own, found.board, settings.frames)
        taken = {
            name: [
                replace(record.view, time=videos.time_of(name, record.view.image)) for record in each if record.taken
            ]
            for name, each in settled.items()
        }
        records = tuple(record for each in settled.values() for record in each)
    sized = {
        name: same_size(views, usual_size(views), found.board, mixed=settings.mixed_sizes)
        for name, views in taken.items()
    }
    if videos is not None:  # their frames were chosen by the time
        settings = replace(settings, match=TIME, tolerance=videos.tolerance)
    result = captured(found.board, {name: each.views for name, each in sized.items()}, settings, progress)
    warnings = (
        *board_warnings(found.views, found.board, asked),
        *(warning for each in sized.values() for warning in each.warnings),
    )
    warn_of(warnings, progress)
    in_videos = tuple(videos.videos.values() if videos else every.values())
    told = () if settings.timed else tuple(summary(video, records) for video in in_videos)
    lines = (*pattern_lines(found.board, asked, found.views), *told)
    return replace(
        result,
        warnings=warnings + result.warnings,
        lines=lines + result.lines,
        failed=tuple(map(str, found.errors)),
        frames=records,
        videos=in_videos,
    )


def _from_images_of_boards(
    cameras: Sequence[CameraInputs], asked: BoardSet, settings: RigSettings, progress: Progress
) -> RigViews:
    """Return what images show of several boards: each is searched as it is where it is alone."""
    if videos := [path for camera in cameras for path in camera.videos]:
        raise InvalidInput("several boards are searched in images, not in videos: extract frames", where=str(videos[0]))
    require_other_names(asked, [camera.name for camera in cameras])
    images = [path for camera in cameras for path in camera.images]
    locate = is_located(settings.refine, settings.reading, mixed_sizes=settings.mixed_sizes)
    members: dict[str, Board] = {}
    views: dict[str, dict[str, Sequence[BoardDetection]]] = {}
    warnings: list[Message] = []
    failed: dict[str, None] = {}
    for name, member in asked.members.items():
        found = search_board(member, images, [], _detection(member, settings), progress, locate=locate)
        if found.nothing:
            raise type(found.nothing)(f"board {name}: {found.nothing.message}") from found.nothing
        members[name] = found.board
        taken = _of_images(cameras, {view.image: view for view in found.views}, {}, settings, progress)
        views[name] = {}
        for camera, own in taken.items():
            sized = same_size(own, usual_size(own), found.board, mixed=settings.mixed_sizes)
            views[name][camera] = [replace(view, camera=camera) for view in sized.views]
            warnings += sized.warnings
        failed |= dict.fromkeys(map(str, found.errors))
    several = board_set(members)
    result = captured_boards(several, views, settings, progress)
    warn_of(warnings, progress)
    return replace(result, warnings=(*warnings, *result.warnings), failed=tuple(failed))


def _of_images(
    cameras: Sequence[CameraInputs],
    by_name: Mapping[str, BoardDetection],
    videos: Mapping[str, Video],
    settings: RigSettings,
    progress: Progress,
) -> dict[str, list[BoardDetection]]:
    """Return the views of the images of every camera and of frames of videos, with their times where these are to be
    used.
    """
    views = {
        camera.name: [by_name[name] for path in camera.images if (name := path.as_posix()) in by_name]
        for camera in cameras
    }
    views |= {name: [by_name[each] for each in video.names if each in by_name] for name, video in videos.items()}
    timing = settings.timing
    told = timing.source is not None or timing.fps is not None
    if not settings.timed and not (told and settings.match in (AUTO, TIME)):
        return views
    return {
        name: with_own_times(own, [videos[name].path] if name in videos else [], timing, progress)
        for name, own in views.items()
    }


def _from_tables(cameras: Sequence[CameraInputs], settings: RigSettings, progress: Progress) -> RigViews:
    """Return the captures of detections files: one for each camera, or one with the views of all."""
    asked = asked_board(settings)
    if settings.reading != AS_IMAGES:
        raise InvalidInput(f"{given_words(settings.reading)[0]} applies to images, not to a detections file")
    found = {
        camera.name: board_views(
            camera.tables,
            asked,
            settings.recursive,
            settings.jobs,
            progress,
            image_size=settings.image_size,
            mixed_sizes=settings.mixed_sizes if camera.name else None,
        )
        for camera in cameras
    }
    known = {each.board for each in found.values()}
    if len(known) > 1:
        words = " and ".join(sorted({board.words for board in known}))
        raise InvalidInput(f"the detections are of several boards: {words}")
    circles: dict[str, ImageCircle] = {}
    views: dict[str, list[BoardDetection]] = {}
    for camera in cameras:
        table = found[camera.name].detections
        own = _by_camera(table, camera)
        views.update(own)
        circles |= {name: circle for name in own if (circle := table.circles.get(name, table.circles.get("")))}
    if settings.timed:
        views = {name: with_own_times(own, [], settings.timing, progress) for name, own in views.items()}
    result = captured_table(known.pop(), views, settings, progress)
    warnings = tuple(warning for each in found.values() for warning in each.warnings)
    return replace(result, circles=circles, warnings=warnings + result.warnings, table=True)


def _by_camera(table: Detections, camera: CameraInputs) -> dict[str, list[BoardDetection]]:
    """Return the views of a detections file that are of a camera; of one without a name, those of all cameras."""
    where, names = camera.tables[0], list(dict.fromkeys(view.camera for view in table.views))
    if camera.name:
        if len(names) > 1 and camera.name not in names:
            raise InvalidInput(f"no camera {camera.name!r}; it has {', '.join(names)}", where=where)
        return {camera.name: [view for view in table.views if len(names) == 1 or view.camera == camera.name]}
    if len(names) > 1:
        return {name or "camera": [view for view in table.views if view.camera == name] for name in names}
    groups = split_by_name([Path(view.image) for view in table.views])
    if groups is None:
        raise InvalidInput(f"names one camera only: {SYNTAX}", where=where)
    by_path = {Path(view.image): view for view in table.views}
    return {name: [by_path[path] for path in paths] for name, paths in groups.items()}


def with_circles(views: RigViews, settings: RigSettings) -> RigViews:
    """Return the same with the image circles that the images of the cameras show; read from files as they are."""
    if views.table:
        return views
    circles: dict[str, ImageCircle] = {}
    for name in views.captures.cameras:
        own = Detections(views.board, tuple(views.of(name)))
        circles |= with_circle(own, views.videos, settings.reading, views.files).circles
    lines = (f"{name}: {circle.words}" for name, circle in circles.items())
    return replace(views, circles=circles, lines=(*views.lines, *lines))
