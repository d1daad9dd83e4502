"""Which ChArUco board images show: the arrangement of the one that is given, or another one where that does not fit."""

from collections import Counter
from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TypeVar

from camcal import opencv
from camcal.arrays import Array
from camcal.progress import Progress
from camcal.raw.options import Reading
from camcal.raw.photograph import read_photograph
from camcal.targets.board import Board
from camcal.targets.checker.charuco import arrangements, ends_after, rows_seen
from camcal.targets.checker.charuco_search import CharucoLayout, common_layout, is_like, search_charuco
from camcal.targets.detect import SEED
from camcal.targets.detection import Detection
from camcal.tasks.calibration.board_remarks import OtherBoard
from camcal.tasks.calibration.image_detection import detect_file, search
from camcal.tasks.calibration.video_frames import Film, Frame, detect_frame

SAMPLE = 6  # images on which it is found out
TRYING, SEARCHING = "trying patterns", "trying other boards"
_ENDING = 1 / 3  # of the images that are tried, that show where a board ends: in others something may hide it
_OFTEN = 0.5  # of the images, in which a board that is the right one is found

Item = TypeVar("Item")


@dataclass(frozen=True)
class Material:
    """Images and videos, how they are read, and how many at a time."""

    images: Sequence[Path]
    films: Sequence[Film]
    reading: Reading
    jobs: int | None
    progress: Progress

    def of(self, names: Container[str]) -> "Material":
        """Return the images and frames of some names."""
        images = [path for path in self.images if path.as_posix() in names]
        return replace(self, images=images, films=[film.only(names) for film in self.films])

    def sample(self) -> "Material":
        """Return a few of the images, and a few frames of every video."""
        return replace(self, images=_spread(self.images), films=[film.sample() for film in self.films])

    def sources(self) -> Iterator[tuple[str, Path | Frame]]:
        """Yield the images, then the frames of one video after another, under their names."""
        yield from ((path.as_posix(), path) for path in self.images)
        for film in self.films:
            yield from ((frame.name, frame) for frame in film.frames())


def _spread(items: Sequence[Item]) -> Sequence[Item]:
    return items[:: -(-len(items) // SAMPLE) or 1]


def arranged(asked: Board, material: Material) -> Board:
    """Return the arrangement of a ChArUco board with which most corners are found on a sample, else on everything."""
    candidates = arrangements(asked)
    if len(candidates) == 1:
        return candidates[0]
    reading, jobs, progress = replace(material.reading, colours=False), material.jobs, material.progress
    corners: Counter[Board] = Counter()
    for part in (material.sample(), material):
        tasks = [(path, candidate) for candidate in candidates for path in part.images]
        shown = search(partial(detect_file, reading=reading), tasks, jobs, TRYING, progress)
        corners.update(_counts((outcome.item[1], outcome.value) for outcome in shown if outcome.value))
        for film in part.films:
            looks = search(detect_frame, film.tasks(candidates), jobs, TRYING, progress)
            corners.update(_counts((outcome.item[2], outcome.value) for outcome in looks if outcome.value))
        if corners.total():
            break
    return max(candidates, key=lambda candidate: corners[candidate])


def _counts(views: Iterable[tuple[Board, Detection]]) -> Counter[Board]:
    """Return how many corners were found with each board."""
    counts: Counter[Board] = Counter()
    for board, view in views:
        counts[board] += len(view.ids)
    return counts


def other_board(asked: Board, board: Board, views: Sequence[Detection], material: Material) -> OtherBoard | None:
    """Return the ChArUco board that images show in place of the one asked for, None if they show no other one.

    board: the arrangement of it that was looked for. views: what was found of it. A board that is found in less than
    half of the images may be a part of one with other columns or more rows; one whose last rows are never seen may end
    before them.
    """
    found = [view for view in views if view.found]
    if len(found) < _OFTEN * len(views):
        other = _searched(asked, material.of({view.image for view in found}) if found else material)
        if other is not None and (not found or _holds(other.board, board)):
            return other
    return _with_fewer_rows(asked, board, found, material)


def _holds(other: Board, board: Board) -> bool:
    """Return whether another board has the same kind of markers in other columns or in more rows."""
    return _family(other) == _family(board) and (other.columns != board.columns or other.rows > board.rows)


def _family(board: Board) -> str:
    """Return what the dictionary of a board has in common with those that hold more or fewer of the same markers."""
    return (board.dictionary or "").rpartition("_")[0]


def _searched(asked: Board, material: Material) -> OtherBoard | None:
    """Return the board that a few images show, looked for until two of them agree."""
    work = partial(_layout_in, reading=replace(material.reading, colours=False), like=asked)
    tasks = list(islice(material.sample().sources(), SAMPLE))
    layouts: list[CharucoLayout] = []
    tried = 0
    for outcome in search(work, tasks, material.jobs, SEARCHING, material.progress):
        tried += 1
        layouts += [outcome.value] if outcome.value else []
        if len(layouts) > len({layout.kind for layout in layouts}):
            break
    common = common_layout(layouts)
    if common is None or is_like(common, asked):
        return None
    shown = sum(layout.kind[:-1] == common.kind[:-1] for layout in layouts)
    return OtherBoard(common.board(asked), shown, tried)


def _layout_in(task: tuple[str, Path | Frame], reading: Reading, like: Board) -> CharucoLayout | None:
    with opencv.repeatable(SEED):
        return search_charuco(_gray(task[1], reading), like)


def _gray(source: Path | Frame, reading: Reading) -> Array:
    return source.image.pixels if isinstance(source, Frame) else read_photograph(source, reading).gray


def _with_fewer_rows(asked: Board, board: Board, found: Sequence[Detection], material: Material) -> OtherBoard | None:
    """Return the board without the rows that no image shows, None where the images do not show that it ends there."""
    rows = max((rows_seen(board, view.ids) for view in found), default=0)
    if rows in (0, board.rows + 1):
        return None
    views = {view.image: view for view in _spread(found)}
    work = partial(_ends_in, reading=replace(material.reading, colours=False), board=board, rows=rows)
    tasks = [(name, source, views[name]) for name, source in material.of(views).sources()]
    outcomes = list(search(work, tasks, material.jobs, SEARCHING, material.progress))
    shown = sum(bool(outcome.value) for outcome in outcomes)
    if not shown or shown < _ENDING * len(outcomes):
        return None
    return OtherBoard(replace(board, rows=rows - 1, legacy=None if rows % 2 else asked.legacy), shown, len(outcomes))


def _ends_in(task: tuple[str, Path | Frame, Detection], reading: Reading, board: Board, rows: int) -> bool:
    _, source, view = task
    return ends_after(_gray(source, reading), board, rows, view.ids, view.pixels)
