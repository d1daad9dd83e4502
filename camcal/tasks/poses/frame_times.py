"""Time stamps of frames: from a rate, a file, their names, their EXIF data, or the video."""

import re
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path, PurePath

import numpy as np

from camcal.arrays import Array
from camcal.errors import FileError, InvalidInput
from camcal.formats import tables
from camcal.images import exif, video
from camcal.images.files import load
from camcal.messages import Message
from camcal.parsing import LARGEST, parse_number
from camcal.progress import Progress
from camcal.run.paths import require_there
from camcal.tasks.timing import UNITS, Timing

_NAME, _EXIF = "name", "exif"
_NUMBER = r"(\d+(?:\.\d+)?)(?!.*\d)"  # the last number of a name
_UNEVEN = 1.5  # longest over shortest step of a video whose rate varies
_EXIF_FORM = "%Y:%m:%d %H:%M:%S"


def frame_times(frames: Sequence[str], videos: Sequence[Path], timing: Timing, progress: Progress) -> Array:
    """Return the times (N,) s of frames, which are named in order.

    videos: those that frames may stem from. Raises InvalidInput if nothing tells the times, or they do not increase.
    """
    times = _told(frames, videos, timing, progress)
    late = np.flatnonzero(~(np.diff(times) > 0))
    if len(late):
        first, second = late[0], late[0] + 1
        how = "the time of" if times[first] == times[second] else "a time before"
        of_file = timing.source is not None and timing.source != _EXIF and not timing.by_name
        raise InvalidInput(
            f"{times[second]:.9g} s is {how} the frame before, {frames[first]}; times must increase",
            where=f"{timing.source}: {frames[second]}" if of_file else frames[second],
        )
    return times


def require_times(videos: Sequence[Path], timing: Timing) -> None:
    """Raise InvalidInput or FileError if nothing tells when frames were taken, before they are examined."""
    if timing.source not in (None, _EXIF) and not timing.by_name:
        require_there(Path(str(timing.source)))
    elif timing.source is None and timing.fps is None and not any(video.stamps(path) is not None for path in videos):
        raise _nothing_tells(videos)


def _told(frames: Sequence[str], videos: Sequence[Path], timing: Timing, progress: Progress) -> Array:
    if timing.by_name:
        return _of_names(frames, timing)
    if timing.source == _EXIF:
        return np.array([_of_exif(Path(frame)) for frame in frames])
    if timing.source is not None:
        return _of_file(Path(timing.source), frames, UNITS[timing.unit])
    own = video.stamps(videos[0]) if len(videos) == 1 else None
    if timing.fps is not None:
        _warn_of_rate(frames, own, progress)
        return np.arange(len(frames)) / timing.fps
    if own is None:
        raise _nothing_tells(videos)
    known = {video.frame_name(videos[0], number): stamp for number, stamp in enumerate(own)}
    unknown = [frame for frame in frames if frame not in known]
    if unknown:
        raise InvalidInput("not a frame of the video; set --fps or --timestamps for all", where=unknown[0])
    return np.array([known[frame] for frame in frames])


def _nothing_tells(videos: Sequence[Path]) -> InvalidInput:
    if videos:
        return InvalidInput("No timestamps in the video; set --fps", where=str(videos[0]))
    return InvalidInput("unknown times of the frames: set --fps, or --timestamps with a file, name or exif")


def _warn_of_rate(frames: Sequence[str], own: Array | None, progress: Progress) -> None:
    """Warn where one rate for all frames is likely wrong."""
    if own is not None:
        steps = np.diff(own)
        if steps.max() > _UNEVEN * steps.min():
            text = "variable frame rate: --fps replaces the time stamps of the video; leave it out to use them"
            progress.warn(Message("variable_frame_rate", text))
        return
    numbers = [re.search(_NUMBER, PurePath(frame).stem) for frame in frames]
    steps = np.diff([float(number[1]) for number in numbers if number])
    if len(steps) == len(frames) - 1 and steps.size and steps.max() != steps.min():
        text = "frame numbers missing in the names, and --fps assumes none is: add --timestamps name"
        progress.warn(Message("missing_frame_numbers", text))


def _of_names(frames: Sequence[str], timing: Timing) -> Array:
    _, _, given = str(timing.source).partition(":")
    try:
        pattern = re.compile(given or _NUMBER)
    except re.error as error:
        raise InvalidInput(f"--timestamps {timing.source}: invalid regular expression: {error}") from error
    if pattern.groups < 1:
        raise InvalidInput(f"--timestamps {timing.source}: put the number in parentheses, such as name:frame_(\\d+)")
    scale = UNITS[timing.unit] if timing.fps is None else 1 / timing.fps
    return np.array([_number_in(frame, pattern) * scale for frame in frames])


def _number_in(frame: str, pattern: re.Pattern[str]) -> float:
    found = pattern.search(PurePath(frame).stem)
    if found is None or found[1] is None:
        raise InvalidInput(f"has no time in its name ({pattern.pattern})", where=frame)
    return _time(frame, found[1])


def _of_exif(path: Path) -> float:
    said = exif.time_taken(load(path).exif)
    if said is None:
        raise InvalidInput("no time in EXIF; set --fps or --timestamps", where=str(path))
    taken, fraction = said
    try:
        whole = datetime.strptime(taken, _EXIF_FORM).replace(tzinfo=UTC)
    except ValueError:
        raise InvalidInput(f"EXIF has {taken!r}, which is not a time", where=str(path)) from None
    return whole.timestamp() + float(f"0.{fraction.strip() or 0}")


def _of_file(path: Path, frames: Sequence[str], scale: float) -> Array:
    """Return the times of a file: a number a line, for each frame one; or with names, `time name` or a CSV."""
    lines = [(number, line) for number, line in tables.numbered_lines(path) if not line.startswith("#")]
    if not lines:
        raise FileError("contains no times", where=str(path))
    if "," in lines[0][1] and not lines[0][1][0].isdigit():
        table = tables.Table.from_csv(str(path), lines, ["t"], ["image"])
        stamps, names, places = table.numbers("t"), list(table.columns.get("image", [])), table.lines
    else:
        cells = [(number, line.replace(",", " ").split(maxsplit=1)) for number, line in lines]
        stamps = np.array([_time(f"{path}:{number}", cell[0]) for number, cell in cells])
        names, places = [cell[1].strip() for _, cell in cells if len(cell) > 1], [number for number, _ in cells]
    stamps = stamps * scale
    if (far := np.flatnonzero(~(np.abs(stamps) <= LARGEST))).size:
        raise InvalidInput(f"a time of {stamps[far[0]]:g} s", where=f"{path}:{places[far[0]]}")
    if names and len(names) == len(stamps):
        known = {PurePath(name).name: stamp for name, stamp in zip(names, stamps, strict=True)}
        without = [frame for frame in frames if PurePath(frame).name not in known]
        if without:
            raise InvalidInput(f"has no time of {PurePath(without[0]).name}", where=str(path))
        return np.array([known[PurePath(frame).name] for frame in frames])
    if len(stamps) != len(frames):
        raise InvalidInput(f"{len(stamps)} times for {len(frames)} frames", where=str(path))
    return stamps


def _time(where: str, text: str) -> float:
    try:
        return parse_number(text)
    except ValueError:
        raise InvalidInput(f"{text!r} is not a time", where=where) from None
