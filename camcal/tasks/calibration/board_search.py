"""Parallel search for a board in images and frames of videos, first in a few, which also tell its arrangement."""

from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from camcal import opencv
from camcal.arrays import Array, IntArray
from camcal.dataclass import dataclass, replace
from camcal.errors import InvalidInput
from camcal.formats.tables import require_cell
from camcal.progress import Outcome, Progress
from camcal.raw.options import ImageReadOptions
from camcal.raw.reading import read_detection_image
from camcal.run.fanout import fan_out
from camcal.run.journal import journaled
from camcal.run.options import BatchOptions
from camcal.run.resume import Items
from camcal.targets.board import APRILGRID, ASYMMETRIC_CIRCLES, CHARUCO, CHESSBOARD, CIRCLES, Board
from camcal.targets.checker.charuco import arrangement_votes, arrangements
from camcal.targets.corner_measurement import measure
from camcal.targets.detect import SEED, detect, locate
from camcal.targets.detection import BoardDetection
from camcal.tasks.calibration.video_frames import Frame, Video, detect_frame

SAMPLE = 6  # images on which it is found out which board they show
# Images, evenly spread, one of which must show the board before more are searched: what takes 10 s at 1280 x 800
TRIED = {CHESSBOARD: 40, CHARUCO: 16, APRILGRID: 10, CIRCLES: 16, ASYMMETRIC_CIRCLES: 16}
_TRYING = "trying patterns"
TIMEOUT_S = 600.0  # for one image; the slowest take some seconds
Item = TypeVar("Item")
Source = TypeVar("Source")
Shown = TypeVar("Shown")


@dataclass(frozen=True)
class Material:
    """Images and videos, how they are read, how many at a time and how else they are worked on."""

    images: Sequence[Path]
    videos: Sequence[Video]
    reading: ImageReadOptions
    jobs: int | None
    batch: BatchOptions
    progress: Progress

    def of(self, names: Container[str]) -> "Material":
        """Return the images and frames of some names."""
        images = [path for path in self.images if path.as_posix() in names]
        return replace(self, images=images, videos=[video.only(names) for video in self.videos])

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the images, then of the frames of the videos."""
        frames = [name for video in self.videos for name in video.names]
        return (*(path.as_posix() for path in self.images), *frames)

    def sample(self, count: int) -> "Material":
        """Return so many of the images and frames, evenly spread, or all if there are no more."""
        return self.of(frozenset(spread(self.names, count)))

    def search(
        self, work: Callable[[Source], Shown], tasks: Iterable[Source], what: str
    ) -> Iterator[Outcome[Source, Shown]]:
        """Return an iterator with the outcome of every task, also after one that failed."""
        return search(work, tasks, self.jobs, self.batch.keep_going, what, self.progress)

    def sources(self) -> Iterator[tuple[str, Path | Frame]]:
        """Yield the images, then the frames of one video after another, under their names."""
        yield from ((path.as_posix(), path) for path in self.images)
        for video in self.videos:
            yield from ((frame.name, frame) for frame in video.frames())


def spread(items: Sequence[Item], count: int) -> Sequence[Item]:
    """Return so many of the items, evenly spread, or all if there are no more."""
    return items if len(items) <= count else [items[index * len(items) // count] for index in range(count)]


def first_views(asked: Board, material: Material, *, parts: bool) -> tuple[Board, list[BoardDetection]]:
    """Return a board in the arrangement that most markers of a few images speak for, and what these show in its place.

    Nothing where one of them shows it, or where these are all images there are.
    """
    boards = arrangements(asked) if asked.type == CHARUCO else (asked,)
    few = material.sample(TRIED[asked.type])
    whole = len(few.names) == len(material.names)
    if whole and len(boards) == 1:
        return boards[0], []
    reading = replace(material.reading, colours=False)
    work = partial(_try_in, reading=reading, boards=boards, parts=parts, votes_only=whole)
    votes, without, shown = np.zeros(len(boards), np.intp), list[BoardDetection](), 0
    for outcome in material.search(work, few.sources(), _TRYING):
        own, view = outcome.value or (np.zeros_like(votes), None)
        votes, shown = votes + own, shown + bool(own.any())
        without += [view] if view is not None else []
        if shown == (SAMPLE if len(boards) > 1 else 1):
            break
    return boards[int(votes.argmax())], [] if shown else without


def _try_in(
    task: tuple[str, Path | Frame], reading: ImageReadOptions, boards: Sequence[Board], parts: bool, votes_only: bool
) -> tuple[IntArray, BoardDetection | None]:
    """Return what speaks for each of the boards in an image, and what it shows where that is nothing."""
    votes = np.zeros(1, np.intp)
    if len(boards) > 1:
        with opencv.repeatable(SEED):
            votes = arrangement_votes(gray_of(task[1], reading), boards)
        if votes_only or votes.any():
            return votes, None
    name, source = task
    if isinstance(source, Frame):
        view = detect_frame((name, source, boards[0]), parts, measured=False)
    else:
        view = detect_file((source, boards[0]), reading, parts, measured=False)
    return votes + len(view.ids), None if view.found else view


def gray_of(source: Path | Frame, reading: ImageReadOptions) -> Array:
    """Return the gray levels (H, W) uint8 of an image file or of a frame."""
    return source.image.pixels if isinstance(source, Frame) else read_detection_image(source, reading).gray


def detect_file(
    task: tuple[Path, Board],
    reading: ImageReadOptions,
    parts: bool = False,
    hashed: bool = False,
    measured: bool = True,
) -> BoardDetection:
    """Return what an image file shows of a board, also in each colour if the reading asks for them.

    hashed: with the hash of the file. measured: whether corners are measured, or located only. Raises FileError or
    InvalidInput if it cannot be read.
    """
    path, board = task
    require_cell(path)
    image = read_detection_image(path, reading, hashed=hashed)
    found = (detect if measured else locate)(image.gray, board, partial=parts, samples=image.samples)
    colours = {
        colour: replace(measure(samples, board, found), image=path.as_posix(), size=found.size)
        for colour, samples in image.colours.items()
    }
    return replace(
        found,
        image=path.as_posix(),
        orientation=image.orientation,
        colours=colours,
        sha256=image.sha256,
    )


def require_colours(board: Board, reading: ImageReadOptions) -> None:
    """Raise InvalidInput if colours are asked for that this type of board does not show: they need checker corners."""
    if reading.colours and not board.checker:
        raise InvalidInput(f"colours need a board with checkerboard corners, not a {board.words}")


def search(
    work: Callable[[Source], Shown],
    tasks: Iterable[Source],
    jobs: int | None,
    batch: BatchOptions,
    what: str,
    progress: Progress,
    found: Items[Source, Shown] | None = None,
) -> Iterator[Outcome[Source, Shown]]:
    """Return an iterator with the outcome of every task in their order; one that hangs or crashes costs itself only.

    found: how outcomes are kept in the journal of the command, None for not at all.
    """
    timeout = None if jobs == 1 else TIMEOUT_S
    if found is not None:
        return journaled(work, tasks, found, jobs=jobs, batch=batch, what=what, progress=progress, timeout=timeout)
    return fan_out(work, tasks, jobs=jobs, batch=batch, processes=True, what=what, progress=progress, timeout=timeout)
