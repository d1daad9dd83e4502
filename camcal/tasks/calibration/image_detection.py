"""What one image shows of a board, and how many images are searched at a time."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from camcal.formats.tables import require_cell
from camcal.progress import Outcome, Progress
from camcal.run.fanout import fan_out
from camcal.targets.board import Board, Detection
from camcal.targets.detect import detect
from camcal.tasks.calibration.options import Reading
from camcal.tasks.calibration.photographs import in_colours, read_photograph

TIMEOUT_S = 600.0  # for one image; the slowest take some seconds

Source = TypeVar("Source")
Shown = TypeVar("Shown")


@dataclass(frozen=True)
class Seen:
    """What one image shows, and its colours if asked for; other: the board in sight that is not the one looked for.

    demosaiced: whether the colours had been mixed.
    """

    view: Detection
    other: Board | None
    colours: Mapping[str, Detection] = field(default_factory=dict)
    demosaiced: bool = False


def detect_file(task: tuple[Path, Board], reading: Reading, parts: bool = False) -> Seen:
    """Return what an image file shows of a board. Raises FileError or InvalidInput if it cannot be read."""
    path, board = task
    require_cell(path)
    photograph = read_photograph(path, reading)
    sighting = detect(photograph.gray, board, partial=parts, samples=photograph.samples)
    height, width = photograph.gray.shape
    found = sighting.in_image(path.as_posix(), (width, height), photograph.orientation)
    return Seen(found, sighting.other, in_colours(photograph, found, board), photograph.demosaiced)


def search(
    work: Callable[[Source], Shown], tasks: Iterable[Source], jobs: int | None, what: str, progress: Progress
) -> Iterator[Outcome[Source, Shown]]:
    """Return an iterator with the outcome of every task in their order; one that hangs or crashes costs itself only."""
    timeout = None if jobs == 1 else TIMEOUT_S
    return fan_out(work, tasks, jobs=jobs, processes=True, what=what, progress=progress, timeout=timeout)
