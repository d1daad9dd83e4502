"""The frames and maps that correct raw frames: read once, for all frames of a sensor."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.raw import bad_pixels, dark_frame, flat_field
from camcal.raw.develop import NO_CORRECTIONS, Corrections, linearise
from camcal.raw.mosaic import Mosaic, channel_names
from camcal.raw.options import HEADERLESS_SUFFIXES, MONO
from camcal.raw.reading import read_mosaic
from camcal.run.inputs import find_images
from camcal.tasks.raw.options import NO_FILES, CorrectionFiles, RawInput

_FOUR = ("R", "Gr", "Gb", "B")  # the order in which four black levels are given


def read_frame(path: Path, reading: RawInput) -> Mosaic:
    """Return the raw frame of a file, with the levels that were given in place of its own."""
    frame = read_mosaic(path, reading.pattern, reading.layout)
    if reading.black is None and reading.white is None:
        return frame
    black = frame.black if reading.black is None else _laid_out(reading.black, frame)
    try:
        return replace(frame, black=black, white=frame.white if reading.white is None else reading.white)
    except InvalidInput as error:
        raise InvalidInput(error.message, where=str(path)) from error


def _laid_out(black: tuple[float, ...], frame: Mosaic) -> Array:
    if len(black) == 1:
        return np.full(frame.black.shape, black[0])
    if frame.black.shape != (2, 2):
        raise InvalidInput("four black levels are for Bayer sensors; give one")
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
    dark = dark_frame.average(frames(given.dark, reading), like.white) if given.dark else None
    corrections = Corrections(dark=dark, bad=bad_pixels.read_map(given.bad, like.size) if given.bad else None)
    if given.flat:
        flat = dark_frame.stack(frames(given.flat, reading)).mean
        corrections.require_size(like)
        light = linearise(replace(like, values=flat), dark)
        corrections = replace(corrections, flat=flat_field.flat_gain(light, like.pattern))
    corrections.require_size(like)
    return corrections


def frames(inputs: Sequence[Path | str], reading: RawInput) -> Iterator[Array]:
    """Yield the counts of raw frames, one after the other."""
    return (read_frame(path, reading).values for path in find_images(inputs, also=HEADERLESS_SUFFIXES))
