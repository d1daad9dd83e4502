"""`camcal detect`: the corners of a board in a set of images, as many at a time as there are cores."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from camcal.errors import FileError, InvalidInput
from camcal.formats import boards, detections
from camcal.progress import SILENT, Outcome, Progress
from camcal.run.fanout import fan_out
from camcal.run.inputs import find_images
from camcal.run.outputs import refuse_overwriting
from camcal.targets.board import CHARUCO, Board, Detection, Detections
from camcal.targets.charuco import arrangements
from camcal.targets.detect import detect, require_findable
from camcal.tasks.calibration.board_remarks import nothing_found, remarks
from camcal.tasks.calibration.photographs import AS_IMAGES, Reading, in_colours, measured, read_photograph

SUFFIXES = (".csv", ".vnl")
SAMPLE = 6  # images on which the arrangement of a ChArUco board is found out
TIMEOUT_S = 600.0  # for one image; the slowest take some seconds
MIXED = (
    "red and blue come from demosaiced images, which mix them with green: the aberration may be wrong by tenths of a "
    "pixel; use raw frames"
)

Task = tuple[Path, Board]


@dataclass(frozen=True)
class DetectOptions:
    """Images (files, folders, globs), the board that is looked for, and the detections file, None to write none.

    reading: what is made of camera raw files and bare mosaics.
    """

    inputs: Sequence[Path | str]
    board: Board
    output: Path | None = None
    recursive: bool = False
    jobs: int | None = None
    reading: Reading = AS_IMAGES


@dataclass(frozen=True, eq=False)
class DetectReport:
    """The detections with the board as it turned out to be, remarks, and the images that could not be read.

    colours: the same views by the samples of red and of blue, if the reading asked for them.
    """

    detections: Detections
    notes: tuple[str, ...]
    failed: tuple[str, ...]
    colours: Mapping[str, tuple[Detection, ...]] = field(default_factory=dict)

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
    """Return what a set of images shows of a board, in the order of the images, written to options.output if given.

    A ChArUco board is taken in the arrangement that fits the images. Images of another size than most are left out.
    Raises InvalidInput, FileError if no image can be read, InsufficientData if the board is in none of them.
    """
    require_findable(options.board)
    images = find_images(options.inputs, recursive=options.recursive, also=options.reading.suffixes)
    _require_output(options.output, images)
    board = _arranged(options, images, progress) if options.board.type == CHARUCO else options.board
    outcomes = _search([(path, board) for path in images], options, "detecting", progress)
    seen = [outcome.value for outcome in outcomes if outcome.value is not None]
    errors = [outcome.error for outcome in outcomes if outcome.error is not None]
    if not seen:
        raise errors[0] if len(errors) == 1 else FileError(f"none of {len(errors)} images can be read; {errors[0]}")
    if error := nothing_found([item.view for item in seen], [item.pattern for item in seen], board):
        raise error
    views = _of_one_size([item.view for item in seen])
    report = DetectReport(
        Detections(board, tuple(views)),
        remarks(views, board, options.board) + ((MIXED,) if any(item.demosaiced for item in seen) else ()),
        tuple(map(str, errors)),
        {colour: tuple(item.colours[colour] for item in seen) for colour in seen[0].colours},
    )
    if options.output is not None:
        detections.write(options.output, report.detections)
    return report


def _require_output(output: Path | None, images: Sequence[Path]) -> None:
    if output is None:
        return
    if output.suffix.lower() not in SUFFIXES:
        raise InvalidInput(f"detections are written as {' or '.join(SUFFIXES)}", where=str(output))
    refuse_overwriting([output], images)


def _search(tasks: Sequence[Task], options: DetectOptions, what: str, progress: Progress) -> list[Outcome[Task, Seen]]:
    timeout = None if options.jobs == 1 else TIMEOUT_S
    work = partial(_detect_file, reading=options.reading)
    return list(fan_out(work, tasks, jobs=options.jobs, processes=True, what=what, progress=progress, timeout=timeout))


def _detect_file(task: Task, reading: Reading) -> Seen:
    path, board = task
    photograph = read_photograph(path, reading)
    sighting = detect(photograph.gray, board)
    height, width = photograph.gray.shape
    found = Detection(
        path.as_posix(),
        (width, height),
        sighting.ids,
        sighting.pixels,
        reason=sighting.reason,
        orientation=photograph.orientation,
    )
    view = measured(photograph, found, board)
    return Seen(view, sighting.pattern, in_colours(photograph, view, board), photograph.demosaiced)


def _arranged(options: DetectOptions, images: Sequence[Path], progress: Progress) -> Board:
    """Return the arrangement of a ChArUco board with which most corners are found on a sample, else on all images."""
    candidates = arrangements(options.board)
    if len(candidates) == 1:
        return candidates[0]
    options = replace(options, reading=replace(options.reading, colours=False))
    stride = -(-len(images) // SAMPLE)
    for part in dict.fromkeys((tuple(images[::stride]), tuple(images))):
        tasks = [(path, candidate) for candidate in candidates for path in part]
        corners: Counter[Board] = Counter()
        for outcome in _search(tasks, options, "trying patterns", progress):
            corners[outcome.item[1]] += len(outcome.value.view.ids) if outcome.value else 0
        if corners.total():
            break
    return max(candidates, key=lambda candidate: corners[candidate])


def _of_one_size(views: Sequence[Detection]) -> list[Detection]:
    """Return the views, those without their points that are of another size than most with points."""
    sizes = Counter(view.size for view in views if view.found)
    usual = max(sizes, key=lambda size: sizes[size])
    return [view if view.size == usual or not view.found else _left_out(view, usual) for view in views]


def _left_out(view: Detection, usual: tuple[int, int]) -> Detection:
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
        "notes": list(report.notes),
        "failed": list(report.failed),
    }
