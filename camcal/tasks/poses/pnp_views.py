"""Observations of objects with known points by one camera, for `camcal pnp`."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from camcal.arrays import Array
from camcal.cameras.model import Camera, resized
from camcal.dataclass import dataclass, field, replace
from camcal.errors import CamcalError, InvalidInput
from camcal.estimate.poses.records import Correspondences
from camcal.formats import boards, tags
from camcal.formats.camera_file import CameraFile
from camcal.formats.poses.record import PoseKey
from camcal.images.video import frames
from camcal.messages import Message
from camcal.progress import Progress, warn_of
from camcal.raw.reading import read_detection_image
from camcal.run.paths import find_media
from camcal.targets.board import Board, Surface
from camcal.targets.detection import BoardDetection
from camcal.tasks.calibration.board_views import BoardViews, board_views, is_table
from camcal.tasks.calibration.which_board import symmetry_warnings
from camcal.tasks.poses.options import DetectionOptions
from camcal.tasks.poses.tag_views import board_frames, tag_views

ADVICE = "; if the images were resized, not cropped, give --scale-intrinsics"


@dataclass(frozen=True, eq=False)
class Observation:
    """What is estimated at once: an object in an image, or at an instant of a rig in the images of several cameras.

    views: of the cameras, in their order. ids: of their points (N,), view by view.
    """

    pose_key: PoseKey
    views: tuple[Correspondences, ...]
    ids: tuple[Array, ...]

    def by_view(self, values: Array) -> list[tuple[Correspondences, Array]]:
        """Return every view with its part of values (N, …) of all points."""
        ends = np.cumsum([len(view.points) for view in self.views])[:-1]
        return list(zip(self.views, np.split(values, ends), strict=True))


@dataclass(frozen=True, eq=False)
class PnpViews:
    """What is there to work on, the unit of its points, images that show nothing, and what is wrong with others.

    lines: lines of the report. spread: where the pixels' covariances come from, if they have any: they were "detected"
    with the pixels, "stated" by the user, or are "relative", σ² over a weight.
    """

    observations: tuple[Observation, ...]
    unit: str = "m"
    spread: Literal["detected", "stated", "relative"] = "detected"
    nothing: Mapping[PoseKey, str] = field(default_factory=dict)
    refused: Mapping[PoseKey, CamcalError] = field(default_factory=dict)
    warnings: tuple[Message, ...] = ()
    lines: tuple[str, ...] = ()
    failed: tuple[str, ...] = ()

    @property
    def has_covariances(self) -> bool:
        """Whether any pixel came with one."""
        return any(view.covariance is not None for each in self.observations for view in each.views)

    def alike(self) -> "PnpViews":
        """Return the same with pixels that are all known equally well."""
        alike = (replace(each, views=tuple(view.alike() for view in each.views)) for each in self.observations)
        return replace(self, observations=tuple(alike))


def seen_by(
    camera: Camera,
    name: str | None,
    file: CameraFile,
    inputs: tuple[str, ...],
    detection: DetectionOptions,
    progress: Progress,
) -> tuple[Camera, PnpViews]:
    """Return what images, videos or a detections file show of a board or of tags to one camera of a file.

    The camera comes first, as it is for images of this size. name: of the camera, by which the views of a detections
    file with several are distinguished.
    Raises InvalidInput, FileError, or InsufficientData if a board is in none of the images.
    """
    tables = any(is_table(text) for text in inputs)
    if detection.tags is not None:
        if tables:
            raise InvalidInput("holds corners of a board; tags are found in images", where=inputs[0])
        return _seen_tags(camera, inputs, detection, progress)
    board = _board(detection, file, tables)
    if not tables:
        camera = _fitting(camera, *first_size(inputs, detection.recursive), detection.scale)
    found = _boards(inputs, board, detection, progress)
    views = _of_one_camera(found.detections.views, name)
    camera = _fitting(camera, *_usual_size(views, camera), detection.scale)
    points, lines, other = _points(found.board, file.board_shape if detection.board_shape else None)
    other += symmetry_warnings(found.board)
    warn_of(other, progress)
    shown = [view for view in views if view.found]
    fitting = [view for view in shown if view.size == camera.image_size]
    return camera, PnpViews(
        tuple(_observation(view, points) for view in fitting),
        found.board.unit,
        nothing={PoseKey(view.image): view.reason or "nothing found" for view in views if not view.found},
        refused={
            PoseKey(view.image): _other_size(view.size, camera) for view in shown if view.size != camera.image_size
        },
        warnings=(*found.warnings, *other),
        lines=(*found.lines, *lines),
        failed=found.failed,
    )


def _observation(view: BoardDetection, points: Array) -> Observation:
    correspondences = Correspondences(view.image, points[view.ids], view.pixels, view.covariance)
    return Observation(PoseKey(view.image), (correspondences,), (view.ids,))


def _seen_tags(
    camera: Camera, inputs: tuple[str, ...], detection: DetectionOptions, progress: Progress
) -> tuple[Camera, PnpViews]:
    objects = tags.load_tags(str(detection.tags))
    camera = _fitting(camera, *first_size(inputs, detection.recursive), detection.scale)
    keep = detection.repeated_ids == "keep"
    found = tag_views(
        inputs,
        objects,
        detection.recursive,
        detection.jobs,
        progress,
        camera.image_size,
        keep_repeated=keep,
        batch=detection.batch,
    )
    observations = (
        Observation(PoseKey(view.image, view.object), (view,), (np.arange(len(view.points)),)) for view in found.views
    )
    nothing = {PoseKey(image): reason for image, reason in found.nothing.items()}
    return camera, PnpViews(tuple(observations), nothing=nothing, warnings=found.warnings, failed=found.failed)


def _board(detection: DetectionOptions, file: CameraFile, tables: bool) -> Board | None:
    """Return the board to search for: the one that is named, or the one whose shape the camera file has.

    None leaves it to the detections file. Raises InvalidInput if nothing says which one.
    """
    if detection.board is not None:
        return boards.load_board(detection.board)
    if tables:
        return None
    if file.board_shape is None:
        raise InvalidInput("no board or tags given: set --board, such as chessboard:9x6:25mm, or --tags")
    return file.board_shape.board


def _boards(
    inputs: tuple[str, ...], board: Board | None, detection: DetectionOptions, progress: Progress
) -> BoardViews:
    """Return what is seen of a board; videos are read frame by frame."""
    jobs, batch = detection.jobs, detection.batch
    if board is None or any(is_table(text) for text in inputs):
        return board_views(inputs, board, detection.recursive, jobs, progress)
    media = find_media(inputs, detection.recursive)
    if not media.videos:
        return board_views(inputs, board, detection.recursive, jobs, progress, batch=batch)
    moving = board_frames(media.videos, board, jobs, progress, batch=batch)
    if not media.images:
        return moving
    still = board_views(tuple(map(str, media.images)), moving.board, False, jobs, progress, batch=batch)
    both = replace(still.detections, views=(*still.detections.views, *moving.detections.views))
    return BoardViews(still.board, both, still.warnings, still.lines, (*still.failed, *moving.failed))


def _of_one_camera(views: Sequence[BoardDetection], name: str | None) -> list[BoardDetection]:
    """Return the views of the named camera where a detections file holds those of several."""
    names = sorted({view.camera for view in views})
    if len(names) < 2:
        return list(views)
    if name not in names:
        raise InvalidInput(f"the detections are of the cameras {', '.join(names)}; choose one with --camera")
    return [view for view in views if view.camera == name]


def _points(board: Board, shape: Surface | None) -> tuple[Array, tuple[str, ...], tuple[Message, ...]]:
    """Return the points (C, 3) of a board, of its measured shape if there is one, lines of the report, and warnings."""
    if shape is None:
        return board.points(), (), ()
    if _numbered(shape.board) != _numbered(board):
        text = "board shape in the camera file is of another board: a planar board as designed is assumed"
        return board.points(), (), (Message("other_board_shape", text),)
    length = f"{1000 * shape.deflection:.2g} mm" if board.unit == "m" else f"{shape.deflection:.2g} squares"
    return shape.points(), (f"board shape from the camera file, deflection {length}",), ()


def _numbered(board: Board) -> Board:
    """Return a board without what changes no point of it."""
    return replace(board, legacy=None, diameter=None, dots=False)


def _usual_size(views: Sequence[BoardDetection], camera: Camera) -> tuple[tuple[int, int], str]:
    """Return the size of most views, the camera's own if any has it, and the first view of that size."""
    sizes = Counter(view.size for view in views if view.found)
    if not sizes or camera.image_size in sizes:
        return camera.image_size, ""
    size = max(sizes, key=lambda each: sizes[each])
    return size, next(view.image for view in views if view.found and view.size == size)


def first_size(inputs: tuple[str, ...], recursive: bool) -> tuple[tuple[int, int] | None, str]:
    """Return the size of the first image or video that can be read, and its name."""
    media = find_media(inputs, recursive)
    for path in (*media.images, *media.videos):
        try:
            if path in media.videos:
                return next(frames(path)).size, str(path)
            height, width = read_detection_image(path).gray.shape
        except CamcalError:
            continue  # it is reported when its turn comes
        return (width, height), str(path)
    return None, ""


def _fitting(camera: Camera, size: tuple[int, int] | None, where: str, scale: bool) -> Camera:
    """Return the camera for images of this size; raises InvalidInput, saying what to do, if it does not fit."""
    if size is None or size == camera.image_size:
        return camera
    try:
        fitted = resized(camera, size)
    except InvalidInput as error:
        raise InvalidInput(error.message, where=where) from error
    if not scale:
        raise InvalidInput(_other_size(size, camera).message, where=where)
    return fitted


def _other_size(size: tuple[int, int], camera: Camera) -> InvalidInput:
    found, known = (f"{width} x {height}" for width, height in (size, camera.image_size))
    return InvalidInput(f"the image has {found} pixels, the camera file is for {known}{ADVICE}")
