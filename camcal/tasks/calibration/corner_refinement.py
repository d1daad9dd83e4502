"""Measurement of corners with the calibrated lens, its poses and the shape of its board.

Views whose board was located only are measured here for the first time: along the edges that the lens expects, or as
the image alone has them where it expects none.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.intrinsics import Calibration, View
from camcal.errors import InvalidInput
from camcal.progress import Progress
from camcal.raw.options import ImageReadOptions
from camcal.raw.reading import read_detection_image
from camcal.run.fanout import fan_out
from camcal.run.options import BatchOptions
from camcal.targets.board import Board
from camcal.targets.corners.measure import Expected, measure, remeasure, seen_cells, signs
from camcal.targets.detection import NEAR, BoardDetection, MaskedImage, size_relation
from camcal.tasks.calibration.video_frames import Video

_MAX_BLUR_PX = 3.0  # of edges: whose images are more blurred have larger squares
_RIM_PX = 3.0  # corners nearer to the border of the image are not searched for


@dataclass(frozen=True, eq=False)
class CornerRefinement:
    """The views as they are seen again, in the order of a calibration's, numbered as it has numbered them.

    recovered: corners that had not been found before. lost: corners that the calibrated edges do not bear out.
    """

    views: tuple[BoardDetection, ...]
    recovered: int
    lost: int


@dataclass(frozen=True)
class RefinementSummary:
    """How many corners measuring them again with the calibrated lens has added and removed."""

    added: int
    removed: int

    @property
    def lines(self) -> tuple[str, ...]:
        """The line of the report, none where nothing has changed."""
        if not self.added and not self.removed:
            return ()
        return (f"corner refinement with the calibrated lens: {self.added} added, {self.removed} removed",)


def is_refined(asked: bool | None, board: Board, *, table: bool) -> bool:
    """Return whether the corners of images are to be measured again; asked: by the user, None for where it can be.

    table: the corners come from a detections file. Raises InvalidInput if it is asked for and cannot be.
    """
    if asked is None:
        return board.has_saddle_corners and not table
    if asked and not board.has_saddle_corners:
        raise InvalidInput(f"--refine needs a board with checkerboard corners, not a {board.words}")
    if asked and table:
        raise InvalidInput("--refine needs images, not a detections file")
    return asked


def is_located(refine: bool | None, reading: ImageReadOptions, *, mixed_sizes: bool | None) -> bool:
    """Return whether it is enough to locate a board in images, as its corners are measured with the calibrated lens.

    refine: as `is_refined` has it. Colours are measured where the board is found, views of other sizes before they are
    made to fit.
    """
    return refine is not False and not reading.colours and not mixed_sizes


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
