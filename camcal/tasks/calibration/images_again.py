"""What images tell of a board once it was found in them, and the lens that saw it is known or asked for.

Where the images show an image circle, it is measured. Corners are measured with the calibrated lens, its poses and the
shape of its board: views whose board was located only are measured here for the first time, along the edges that the
lens expects, or as the image alone has them where it expects none. Screenshots and drawings of a board are told from
photographs: no lens has made them, so none can be calibrated.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import MappingProxyType

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.intrinsics import Calibration, View
from camcal.cameras.validity import ImageCircle
from camcal.dataclass import dataclass, replace
from camcal.errors import CamcalError, InsufficientData
from camcal.images.image_circle import MOST_IMAGES, ImageCircleSearch, evenly_spaced
from camcal.messages import Message
from camcal.progress import Progress
from camcal.raw.options import ImageReadOptions
from camcal.raw.reading import read_detection_image
from camcal.run.fanout import fan_out
from camcal.run.options import BatchOptions
from camcal.targets.board import Board
from camcal.targets.corner_measurement import Expected, measure, remeasure, seen_cells, signs
from camcal.targets.detection import NEAR, BoardDetection, Detections, MaskedImage, size_relation
from camcal.tasks.calibration.board_search import SAMPLE, Material, gray_of
from camcal.tasks.calibration.mixed_sizes import circle_fits, usual_size
from camcal.tasks.calibration.options import CalibrateOptions
from camcal.tasks.calibration.video_frames import Video

# Gray levels that most pixels of a board have: 2 of screenshots, 4 if JPEG has blurred them; 12 at least of photographs
FEW_LEVELS = 5
_MOST = 0.8
FRONTAL = 0.02  # squares, RMS distance of corners from the drawing of the board, moved, turned and scaled
_MAX_BLUR_PX = 3.0  # of edges: whose images are more blurred have larger squares
_RIM_PX = 3.0  # corners nearer to the border of the image are not searched for


def with_circle(
    detections: Detections,
    videos: Sequence[Video],
    reading: ImageReadOptions,
    files: Mapping[str, Path] = MappingProxyType({}),
) -> Detections:
    """Return what was found in images of one camera with its image circle, if the images show one.

    videos: the videos that frames among the images are from. files: the images whose names are not their paths. Some
    images are read once more, until it is clear that there is no circle.
    """
    circle = _measure_again(detections.views, videos, reading, files)
    camera = detections.views[0].camera if len(detections) else ""
    return detections if circle is None else replace(detections, circles={camera: circle})


def _measure_again(
    views: Sequence[BoardDetection], videos: Sequence[Video], reading: ImageReadOptions, files: Mapping[str, Path]
) -> ImageCircle | None:
    """Return the image circle that images show, None if they show none or points of a board lie outside of it."""
    size = usual_size(views)
    names = [view.image for view in views if view.size == size]
    names = [names[index] for index in evenly_spaced(len(names), MOST_IMAGES)]
    search = ImageCircleSearch()
    for gray in _images(names, videos, reading, files):
        if gray.shape[::-1] != size:  # of the file; the view was made to fit
            continue
        search.add(gray)
        if search.ruled_out:
            return None
    found = search.result()
    if found is None or not circle_fits(found, views):
        return None
    return ImageCircle(found.image_size, found.centre, found.radius)


def _images(
    names: Sequence[str], videos: Sequence[Video], reading: ImageReadOptions, files: Mapping[str, Path]
) -> Iterator[Array]:
    """Yield the gray images (H, W) of that name that can be read, frames of videos last."""
    from_videos = frozenset(name for video in videos for name in video.names)
    for name in names:
        if name in from_videos:
            continue
        try:
            yield read_detection_image(files.get(name, Path(name)), reading).gray
        except CamcalError:  # gone since
            continue
    for video in videos:
        yield from (frame.image.pixels for frame in video.only(frozenset(names)).frames())


@dataclass(frozen=True, eq=False)
class CornerRefinement:
    """The views as they are seen again, in the order of a calibration's, numbered as it has numbered them.

    recovered: corners that had not been found before. lost: corners that the calibrated edges do not bear out.
    """

    views: tuple[BoardDetection, ...]
    recovered: int
    lost: int


@dataclass(frozen=True, eq=False)
class _ExpectedView:
    """A view to be examined again, and what is expected of it (None: nothing), with its image: the file, or the frame
    of a video.
    """

    view: BoardDetection
    expected: Expected | None
    image: Path | Array


def refine_corners(
    calibration: Calibration | None,
    board: Board,
    detections: Sequence[BoardDetection],
    videos: Sequence[Video],
    reading: ImageReadOptions,
    jobs: int | None,
    batch: BatchOptions,
    progress: Progress,
    files: Mapping[str, Path] = MappingProxyType({}),
) -> CornerRefinement:
    """Return the views of a calibration with their corners measured along the edges that it expects.

    calibration: None where only what is located is to be measured. detections: of calibration.views, in their order.
    files: the images whose names are not their paths. A measured view that the calibration does not use stays as it is,
    and so does one whose image can no longer be read, or was made to fit the size of the others (--mixed-sizes). A
    located one is measured as the image alone has it, and has no points if that can no longer be read.
    """
    expected: dict[str, _ExpectedView] = {}
    turns = board.symmetries()
    records = [None] * len(detections) if calibration is None else calibration.views
    for view, record in zip(detections, records, strict=True):
        image = files.get(view.image, Path(view.image))
        if calibration is not None and record is not None and record.used:
            numbered = view.renumbered(turns[record.symmetry])
            expected[view.image] = _ExpectedView(numbered, _expected(calibration, record), image)
        elif view.located:
            expected[view.image] = _ExpectedView(view, None, image)
    work = partial(_remeasure, board=board, reading=reading)
    tasks, what = _expected_views(expected, videos), "measuring corners"
    outcomes = fan_out(work, tasks, jobs=jobs, batch=batch.keep_going, processes=True, what=what, progress=progress)
    again = {outcome.value.image: outcome.value for outcome in outcomes if outcome.value is not None}
    numbers = [(expected[image].view.ids, view.ids) for image, view in again.items() if expected[image].expected]
    views = (again.get(view.image, view) for view in detections)
    return CornerRefinement(
        tuple(view.without_points("the image can no longer be read") if view.located else view for view in views),
        recovered=sum(len(np.setdiff1d(after, before)) for before, after in numbers),
        lost=sum(len(np.setdiff1d(before, after)) for before, after in numbers),
    )


def _expected_views(expected: Mapping[str, _ExpectedView], videos: Sequence[Video]) -> Iterator[_ExpectedView]:
    """Yield what is to be examined: image files first, then the frames of one video after another."""
    from_videos = frozenset(name for video in videos for name in video.names)
    yield from (expected_view for image, expected_view in expected.items() if image not in from_videos)
    for video in videos:
        for frame in video.only(expected).frames():
            expected_view = expected[frame.name]
            yield replace(expected_view, image=frame.measured)


def _remeasure(expected_view: _ExpectedView, board: Board, reading: ImageReadOptions) -> BoardDetection:
    """Return a view with its corners measured, or measured again."""
    view, image = expected_view.view, expected_view.image
    samples = _samples(image, view.size, reading) if isinstance(image, Path) else MaskedImage(image)
    if samples is None:
        return view
    if expected_view.expected is not None:
        view = remeasure(samples, view, expected_view.expected)
    return measure(samples, board, view) if view.located else view


def _samples(path: Path, size: tuple[int, int], reading: ImageReadOptions) -> MaskedImage | None:
    """Return the samples of an image, None where those of a view of that size are not its own (--mixed-sizes)."""
    image = read_detection_image(path, reading)
    height, width = image.gray.shape
    same = (width, height) == size or size_relation((width, height), size) == NEAR
    return image.samples if same else None


def _expected(calibration: Calibration, record: View) -> Expected:
    camera, board, pose = calibration.camera, calibration.board, record.camera_T_board
    ids = np.arange(board.count)
    if pose is None:
        raise ValueError(f"{record.image} has no pose")
    pixels, cells = seen_cells(
        board, ids, calibration.surface.points(), lambda points: camera.project(pose.apply(points)).pixels, _MAX_BLUR_PX
    )
    size = np.array(camera.image_size)
    known = np.isfinite(pixels).all(axis=1) & np.isfinite(cells.steps).all(axis=(1, 2))
    known &= np.isfinite(cells.bends).all(axis=1)
    inside = ((pixels > _RIM_PX) & (pixels < size - 1 - _RIM_PX)).all(axis=1)
    return Expected(pixels, cells, np.asarray(known & inside), signs(board))


def screenshots(
    found: Detections,
    board: Board,
    videos: Sequence[Video],
    files: Mapping[str, Path],
    options: CalibrateOptions,
    progress: Progress,
) -> InsufficientData | None:
    """Return the error that views look like screenshots of the board, None where some do not or cannot be read again.

    files: the images whose names are not their paths. The images of a few are read.
    """
    views = {view.image: view for view in found.views if view.found}
    if not views or max(off_drawing(view, board) for view in views.values()) > FRONTAL:
        return None
    in_videos = {name for video in videos for name in video.names}
    named = {files.get(name, Path(name)).as_posix(): name for name in views if name not in in_videos}
    frames = [video.only(views) for video in videos]
    material = Material([*map(Path, named)], frames, options.reading, options.jobs, options.batch, progress)
    levels = 0
    try:
        for name, source in material.sample(SAMPLE).sources():
            view = views[named.get(name, name)]
            levels = max(levels, gray_levels(gray_of(source, options.reading), view.pixels))
    except CamcalError:
        return None
    if levels > FEW_LEVELS:
        return None
    text = (
        "the images look like screenshots or drawings of the board, not photographs: every view is frontal and has "
        f"only {levels} gray levels: photograph the board, tilted by 20° to 45° about both axes"
    )
    return InsufficientData(text, failures=[Message("screenshots", text, {"gray_levels": levels})])


def gray_levels(gray: Array, pixels: Array) -> int:
    """Return how many gray levels most pixels of `gray`, (H, W) uint8, have around points (N, 2)."""
    left, top = np.maximum(np.floor(pixels.min(axis=0)), 0).astype(int)
    right, bottom = np.ceil(pixels.max(axis=0)).astype(int) + 1
    counts = np.sort(np.bincount(gray[top:bottom, left:right].ravel(), minlength=256))[::-1].cumsum()
    return int(np.searchsorted(counts, _MOST * counts[-1])) + 1


def off_drawing(view: BoardDetection, board: Board) -> float:
    """Return how far (squares, RMS) corners are from the board as drawn, moved, turned and scaled."""
    drawn, shown = (points[:, 0] + 1j * points[:, 1] for points in (board.points()[view.ids], view.pixels))
    terms = np.column_stack([drawn, np.ones_like(drawn)])
    solution = np.linalg.lstsq(terms, shown, rcond=None)[0]
    left = np.abs(shown - terms @ solution)
    return float(np.sqrt(np.mean(left**2)) / max(abs(solution[0]) * board.spacing, 1e-9))
