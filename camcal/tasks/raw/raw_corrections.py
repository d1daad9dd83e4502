"""The frames and maps that correct raw frames: read once, for all frames of a sensor."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.raw import bad_pixels, dark_frame, flat_field
from camcal.raw.develop import NO_CORRECTIONS, Corrections, linearise
from camcal.raw.mosaic import Mosaic, channel_names
from camcal.raw.options import HEADERLESS_SUFFIXES, MONO, NO_LAYOUT, GivenLayout
from camcal.raw.reading import read_mosaic
from camcal.run.inputs import find_images

_FOUR = ("R", "Gr", "Gb", "B")  # the order in which four black levels are given


@dataclass(frozen=True)
class RawInput:
    """How raw frames are read and what their counts mean, where their files do not say it.

    pattern, layout: see `read_mosaic`. black: counts without light, one for all samples or four for red, green in red's
    rows, green in blue's rows, blue. white: counts at saturation.
    """

    pattern: str | None = None
    layout: GivenLayout = NO_LAYOUT
    black: tuple[float, ...] | None = None
    white: float | None = None

    def __post_init__(self) -> None:
        if self.black is not None and len(self.black) not in (1, 4):
            raise InvalidInput(f"a black level is one number or four (R,Gr,Gb,B), found {len(self.black)}")

    def read(self, path: Path) -> Mosaic:
        """Return the raw frame of a file, with the levels given here in place of its own."""
        frame = read_mosaic(path, self.pattern, self.layout)
        if self.black is None and self.white is None:
            return frame
        black = frame.black if self.black is None else _laid_out(self.black, frame)
        try:
            return replace(frame, black=black, white=frame.white if self.white is None else self.white)
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


@dataclass(frozen=True)
class CorrectionFiles:
    """Dark frames and flat fields (files, folders, globs), and a map of bad pixels."""

    dark: Sequence[Path | str] = ()
    flat: Sequence[Path | str] = ()
    bad: Path | None = None

    def load(self, reading: RawInput, first: Path) -> Corrections:
        """Return the corrections for the frames of which this is the first.

        Raises FileError or InvalidInput if one of the files is not what it should be.
        """
        if not (self.dark or self.flat or self.bad):
            return NO_CORRECTIONS
        like = reading.read(first)
        dark = dark_frame.average(frames(self.dark, reading), like.white) if self.dark else None
        corrections = Corrections(dark=dark, bad=bad_pixels.read_map(self.bad, like.size) if self.bad else None)
        if self.flat:
            flat = dark_frame.stack(frames(self.flat, reading)).mean
            corrections.require_size(like)
            light = linearise(replace(like, values=flat), dark)
            corrections = replace(corrections, flat=flat_field.flat_gain(light, like.pattern))
        corrections.require_size(like)
        return corrections


def frames(inputs: Sequence[Path | str], reading: RawInput) -> Iterator[Array]:
    """Yield the counts of raw frames, one after the other."""
    return (reading.read(path).values for path in find_images(inputs, also=HEADERLESS_SUFFIXES))
