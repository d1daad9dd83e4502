"""Selection of video frames for detection: sharp ones, then those with most information on the lens.

A video is read twice. The first time every frame is reduced and its sharpness noted; the sharpest frame of each stretch
is then searched for the board at its full size, and `calibrate.frames` chooses among those that show it. No frame is
kept in memory.
"""

import hashlib
from collections import Counter
from collections.abc import Container, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from camcal import opencv
from camcal.arrays import Array, PixelArray
from camcal.calibrate.frames import BLURRED, CHOSEN, MOVING, SAME, SURPLUS, FrameChoice, choose_frames
from camcal.dataclass import dataclass, replace
from camcal.errors import CamcalError, InvalidInput
from camcal.images import video
from camcal.images.files import gray_8bit, gray_levels
from camcal.images.image import Image
from camcal.images.video import focus, motion, reduced
from camcal.images.videos import title
from camcal.progress import Progress
from camcal.report.table import Column
from camcal.targets.board import Board
from camcal.targets.corner_measurement import edge_blur
from camcal.targets.detect import SEED, detect, locate
from camcal.targets.detection import BoardDetection, MaskedImage
from camcal.tasks.calibration.options import FrameOptions

COLUMNS = (
    Column("frame", file=True),
    Column("corners"),
    Column("blur", "px", priority=1),
    Column("motion", "px", priority=2),
    Column("order", priority=3),
    Column("reason", wraps=True),
)
SEARCHED_PER_CHOSEN = 8  # frames that are searched for every one that may be chosen


class Frame(NamedTuple):
    """A gray frame of a video under its name; before: a reduced copy of the frame before it, None of the first one.

    levels: see `gray_levels`, where the frame has more than 8 bits.
    """

    name: str
    image: Image
    before: PixelArray | None
    levels: PixelArray | None = None

    @property
    def measured(self) -> PixelArray:
        """The gray levels (H, W) by which corners are measured."""
        return self.image.pixels if self.levels is None else self.levels


@dataclass(frozen=True)
class Video:
    """A video, how many frames it has, the numbers of those to be searched, in order, and what ended it too early."""

    path: Path
    count: int
    numbers: tuple[int, ...]
    error: CamcalError | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the frames that are to be searched."""
        return tuple(video.frame_name(self.path, number) for number in self.numbers)

    def frames(self) -> Iterator[Frame]:
        """Yield the frames that are to be searched, as far as the video can be read; `survey` said what ended it."""
        wanted, last = frozenset(self.numbers), max(self.numbers, default=-1)
        before: Array | None = None
        with suppress(CamcalError):
            for number, image in enumerate(video.frames(self.path)):
                gray = gray_8bit(image.pixels) if number in wanted or number + 1 in wanted else image.pixels
                if number in wanted:
                    levels = None if image.pixels.dtype == np.uint8 else gray_levels(image.pixels)
                    yield Frame(video.frame_name(self.path, number), Image(gray, image.orientation), before, levels)
                before = reduced(gray) if number + 1 in wanted else None
                if number >= last:
                    break

    def tasks(self, boards: Sequence[Board]) -> Iterator[tuple[str, Frame, Board]]:
        """Yield the frames that are to be searched under their names, each with every board."""
        for frame in self.frames():
            yield from ((frame.name, frame, board) for board in boards)

    def only(self, names: Container[str]) -> "Video":
        """Return the video with those of its frames that have these names."""
        numbers = zip(self.numbers, self.names, strict=True)
        return replace(self, numbers=tuple(number for number, name in numbers if name in names))


@dataclass(frozen=True)
class FrameRecord:
    """What became of a frame that was searched, why, and the figures behind it: see `calibrate.frames.FrameChoice`."""

    view: BoardDetection
    taken: bool
    reason: str
    choice: FrameChoice | None = None

    def as_data(self) -> dict[str, object]:
        """Return it as plain data for --json; NaN where a figure is not known."""
        view, choice = self.view, self.choice
        return {
            "frame": view.image,
            "corners": len(view.ids),
            "taken": self.taken,
            "reason": self.reason,
            "order": None if choice is None or choice.rank is None else choice.rank + 1,
            "blur_px": view.blur_px,
            "motion_px": view.motion_px,
            "error_px": None if choice is None else choice.error_px,
            "gain": None if choice is None else choice.gain,
        }


def require_names(videos: Sequence[Path]) -> None:
    """Raise InvalidInput if frames of two videos would have one name."""
    named: dict[str, Path] = {}
    for path in videos:
        other = named.setdefault(video.frame_name(path, 0), path)
        if other != path:
            raise InvalidInput(f"frame names would equal those of {other.name}; rename one", where=str(path))


@dataclass(frozen=True)
class SurveyedVideo:
    """A video read to its end: how many frames it has, the numbers of some and how sharp they are, and what ended it
    too early.
    """

    path: Path
    count: int
    numbers: tuple[int, ...]
    sharpness: tuple[float, ...]
    error: CamcalError | None = None

    def video(self, numbers: Sequence[int]) -> Video:
        """Return the video with these frames to be searched."""
        return Video(self.path, self.count, tuple(numbers), self.error)


def survey(path: Path, options: FrameOptions, progress: Progress) -> Video:
    """Return a video and the frames to search: the sharpest in each of SEARCHED_PER_CHOSEN · most intervals, or all."""
    found = surveyed(path, options, progress)
    if options.whole:
        return found.video(found.numbers)
    return found.video(sharpest(found.numbers, found.sharpness, SEARCHED_PER_CHOSEN * options.most))


def surveyed(path: Path, options: FrameOptions, progress: Progress) -> SurveyedVideo:
    """Return what every frame of a video is worth, every options.every-th one; nothing where all are taken."""
    progress.start(f"surveying {title(path)}", None)
    sharpness: list[float] = []
    numbers: list[int] = []
    count, error = 0, None
    try:
        with opencv.repeatable(SEED):
            for count, image in enumerate(video.frames(path), start=1):
                if (count - 1) % options.every == 0:
                    numbers.append(count - 1)
                    sharpness.append(0.0 if options.whole else focus(reduced(gray_8bit(image.pixels))))
                progress.advance()
    except CamcalError as failure:
        error = failure
    finally:
        progress.finish()
    return SurveyedVideo(path, count, tuple(numbers), tuple(sharpness), error)


def sharpest(numbers: Sequence[int], sharpness: Sequence[float], stretches: int) -> list[int]:
    """Return the number of the sharpest frame of each of so many stretches, or all if there are no more frames."""
    if len(numbers) <= stretches:
        return list(numbers)
    parts = np.array_split(np.arange(len(numbers)), stretches)
    return [numbers[part[0] + int(np.argmax(np.take(sharpness, part)))] for part in parts]


def detect_frame(task: tuple[str, Frame, Board], parts: bool = False, measured: bool = True) -> BoardDetection:
    """Return what a frame shows of a board; its name comes first, as errors have it. parts: see `detect`, partial.

    measured: whether corners are measured, or located only.
    """
    name, frame, board = task
    gray = frame.image.pixels
    digest = hashlib.sha256(gray.tobytes()).hexdigest()
    found = (detect if measured else locate)(gray, board, partial=parts, samples=MaskedImage(frame.measured))
    found = replace(found, image=name, orientation=frame.image.orientation, sha256=digest)
    if not found.found:
        return found
    copy = reduced(gray)
    moved = np.nan
    if frame.before is not None and frame.before.shape == copy.shape:
        moved = motion(frame.before, copy, found.pixels, gray.shape[1] // copy.shape[1])
    return replace(found, blur_px=edge_blur(gray, found.pixels), motion_px=moved)


def settled(
    views: Sequence[BoardDetection], board: Board, size: tuple[int, int], options: FrameOptions
) -> tuple[FrameRecord, ...]:
    """Return what becomes of every frame that was searched; only those of a size with the board can be taken."""
    usable = [index for index, view in enumerate(views) if view.found and view.size == size]
    if options.whole or not usable:
        return tuple(FrameRecord(view, index in usable, _refusal(view, size)) for index, view in enumerate(views))
    some = [views[index] for index in usable]
    by_view = dict(zip(usable, choose_frames(some, board, options.most), strict=True))
    names = [view.image for view in some]
    records = []
    for index, view in enumerate(views):
        choice = by_view.get(index)
        reason = _refusal(view, size) if choice is None else _reason(choice, view, names)
        records.append(FrameRecord(view, choice is not None and choice.chosen, reason, choice))
    return tuple(records)


def _refusal(view: BoardDetection, size: tuple[int, int]) -> str:
    if not view.found:
        return view.reason or "nothing found"
    if view.size != size:
        return "is {}x{}, most images are {}x{}".format(*view.size, *size)
    return ""


def _reason(choice: FrameChoice, view: BoardDetection, names: Sequence[str]) -> str:
    """Return why a frame that shows the board is taken or not."""
    if choice.why == SAME and choice.like is not None:
        return f"like {Path(names[choice.like]).name}"
    return {
        CHOSEN: "adds most",
        SURPLUS: "adds less",
        BLURRED: f"blurred by {view.blur_px:.1f} px",
        MOVING: f"moves {view.motion_px:.0f} px a frame"
        if np.isfinite(view.motion_px)
        else "moves too fast to be tracked",
    }[choice.why]


def summary(surveyed: Video, records: Sequence[FrameRecord]) -> str:
    """Return in a line what became of the frames of a video; records: its own and those of others."""
    names = frozenset(surveyed.names)
    own = [record for record in records if record.view.image in names]
    whys = Counter(record.choice.why for record in own if record.choice is not None)
    words = {SAME: "like these", BLURRED: "blurred", MOVING: "moving fast", SURPLUS: "adding less"}
    others = "".join(f", {whys[why]} {text}" for why, text in words.items() if whys[why])
    taken, found = sum(record.taken for record in own), sum(record.view.found for record in own)
    return (
        f"{title(surveyed.path)}: {taken} of {surveyed.count} frames used; {len(own)} searched, "
        f"{found} with the board{others}"
    )


def cells(record: FrameRecord) -> list[object]:
    """Return what is listed of a frame under COLUMNS, None where a figure is not known."""
    view, choice = record.view, record.choice
    figures = [round(value, 2) if np.isfinite(value) else None for value in (view.blur_px, view.motion_px)]
    order = None if choice is None or choice.rank is None else choice.rank + 1
    return [view.image, len(view.ids), *figures, order, record.reason]
