"""What one image shows of a board, and how many images are searched at a time."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from camcal.errors import InvalidInput
from camcal.formats.tables import require_cell
from camcal.progress import Outcome, Progress
from camcal.raw.options import Reading
from camcal.raw.photograph import read_photograph
from camcal.run.fanout import fan_out
from camcal.targets.board import Board
from camcal.targets.corners.measure import measure
from camcal.targets.detect import detect
from camcal.targets.detection import Detection

TIMEOUT_S = 600.0  # for one image; the slowest take some seconds

Source = TypeVar("Source")
Shown = TypeVar("Shown")


def detect_file(task: tuple[Path, Board], reading: Reading, parts: bool = False) -> Detection:
    """Return what an image file shows of a board, also in each colour if the reading asks for them.

    Raises FileError or InvalidInput if it cannot be read.
    """
    path, board = task
    require_cell(path)
    photograph = read_photograph(path, reading)
    found = detect(photograph.gray, board, partial=parts, samples=photograph.samples)
    colours = {
        colour: replace(measure(samples, board, found), image=path.as_posix(), size=found.size)
        for colour, samples in photograph.colours.items()
    }
    return replace(
        found,
        image=path.as_posix(),
        orientation=photograph.orientation,
        colours=colours,
        sha256=photograph.sha256,
    )


def require_colours(board: Board, reading: Reading) -> None:
    """Raise InvalidInput if colours are asked for that this type of board does not show: they need checker corners."""
    if reading.colours and not board.checker:
        raise InvalidInput(f"colours are measured at the corners of checker patterns, which no {board.words} has")


def search(
    work: Callable[[Source], Shown], tasks: Iterable[Source], jobs: int | None, what: str, progress: Progress
) -> Iterator[Outcome[Source, Shown]]:
    """Return an iterator with the outcome of every task in their order; one that hangs or crashes costs itself only."""
    timeout = None if jobs == 1 else TIMEOUT_S
    return fan_out(work, tasks, jobs=jobs, processes=True, what=what, progress=progress, timeout=timeout)
