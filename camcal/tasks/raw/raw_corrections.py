"""The frames and maps that correct raw frames: read once, for all frames of a sensor.

With `camcal demosaic --make-bad-pixel-map`, the pixels of a sensor that dark frames give away.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput, Located
from camcal.progress import SILENT, Progress
from camcal.raw import calibration_frames
from camcal.raw.calibration_frames import dark_average, flat_gain, stack
from camcal.raw.develop import NO_CORRECTIONS, Corrections, linearise
from camcal.raw.mosaic import Mosaic, channel_names
from camcal.raw.names import MONO
from camcal.raw.options import HEADERLESS_SUFFIXES
from camcal.raw.reading import read_mosaic
from camcal.run.outputs import writes
from camcal.run.paths import find_images
from camcal.tasks.raw.options import NO_FILES, CorrectionFiles, DemosaicOptions, RawInput

_FOUR = ("R", "Gr", "Gb", "B")  # the order in which four black levels are given


def read_frame(path: Path, reading: RawInput) -> Mosaic:
    """Return the raw frame of a file, with the levels that were given in place of its own."""
    frame = read_mosaic(path, reading.pattern, reading.layout)
    if reading.black is None and reading.white is None:
        return frame
    black = frame.black if reading.black is None else _laid_out(reading.black, frame)
    with Located(path):
        return replace(frame, black=black, white=frame.white if reading.white is None else reading.white)


def _laid_out(black: tuple[float, ...], frame: Mosaic) -> Array:
    if len(black) == 1:
        return np.full(frame.black.shape, black[0])
    if frame.black.shape != (2, 2):
        raise InvalidInput("four black levels need a Bayer sensor; give one")
    if frame.pattern == MONO:
        return np.reshape(black, (2, 2))
    levels = dict(zip(_FOUR, black, strict=True))
    return np.reshape([levels[name] for name in channel_names(frame.pattern)], (2, 2))


def load_corrections(given: CorrectionFiles, reading: RawInput, first: Path) -> Corrections:
    """Return the corrections for the frames of which this is the first.

    Raises FileError or InvalidInput if one of the files is not what it should be.
    """
    if given == NO_FILES:
        return NO_CORRECTIONS
    like = read_frame(first, reading)
    dark = dark_average(frames(given.dark, reading), like.white) if given.dark else None
    corrections = Corrections(dark=dark, bad=calibration_frames.read_map(given.bad, like.size) if given.bad else None)
    if given.flat:
        flat = stack(frames(given.flat, reading)).mean
        corrections.require_size(like)
        light = linearise(replace(like, values=flat), dark)
        corrections = replace(corrections, flat=flat_gain(light, like.pattern))
    corrections.require_size(like)
    return corrections


def frames(inputs: Sequence[Path | str], reading: RawInput) -> Iterator[Array]:
    """Yield the counts of raw frames, one after the other."""
    return (read_frame(path, reading).values for path in find_images(inputs, also=HEADERLESS_SUFFIXES))


@dataclass(frozen=True)
class BadPixelMap:
    """The map that was written: how many frames it is made of, how many pixels are bad, of how many."""

    output: Path
    frames: int
    bad: int
    pixels: int


@writes
def make_bad_pixel_map(options: DemosaicOptions, progress: Progress = SILENT) -> BadPixelMap:
    """Return what was found after writing the map to options.output: text as dcraw reads it, PNG or NPY.

    Raises FileError or InvalidInput for files that are no raw frames of one size, InsufficientData if too many pixels
    stand out to be called bad.
    """
    sources = find_images(options.inputs, recursive=options.recursive, also=HEADERLESS_SUFFIXES)
    pattern = options.reading.pattern or read_frame(sources[0], options.reading).pattern
    progress.start("dark frames", len(sources))

    def counts() -> Any:
        for source in sources:
            yield read_frame(source, options.reading).values
            progress.advance()

    mask = calibration_frames.make_map(counts(), pattern or MONO)
    progress.finish()
    calibration_frames.write_map(options.output, mask)
    return BadPixelMap(options.output, len(sources), int(np.count_nonzero(mask)), mask.size)


def map_document(found: BadPixelMap) -> dict[str, Any]:
    """Return the result as plain data for --json."""
    return {"bad_pixel_map": found.output.as_posix(), "frames": found.frames, "bad": found.bad, "pixels": found.pixels}
