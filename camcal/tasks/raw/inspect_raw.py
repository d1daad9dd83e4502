"""`camcal inspect` of a raw frame: levels, exposure, and metadata."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from camcal.dataclass import dataclass
from camcal.images.image import RAW_SUFFIXES
from camcal.raw import MONO
from camcal.raw.frame_facts import BINS, ChannelFacts, channel_facts
from camcal.raw.headerless import CandidateLayout, fitting_layouts, length_of
from camcal.raw.mosaic import Capture, Mosaic, pattern_words
from camcal.raw.options import BARE_SUFFIXES, HEADERLESS_SUFFIXES
from camcal.raw.pixel_formats import pixel_format_named
from camcal.raw.reading import read_mosaic
from camcal.report.table import Column
from camcal.report.text_figures import letters
from camcal.tasks.file_options import InspectOptions

LAYOUT_COLUMNS = (Column("size"), Column("stride"), Column("format", wraps=True))
CHANNEL_COLUMNS = ("channel", "mean", "least", "most", "% at black", "% at white")

_UPRIGHT = 1
_LONG_S = 0.3  # exposures below are written as fractions, as on cameras


@dataclass(frozen=True, eq=False)
class RawInspection:
    """A raw frame and what its counts say, channel by channel."""

    path: Path
    frame: Mosaic
    channels: tuple[ChannelFacts, ...]


def is_raw(path: Path) -> bool:
    """Return whether a file's name is that of a raw frame: a camera's, a bare mosaic, or a dump of a sensor."""
    return path.suffix.lower() in RAW_SUFFIXES | BARE_SUFFIXES | HEADERLESS_SUFFIXES


def lacks_layout(options: InspectOptions) -> bool:
    """Return whether the file has no header and its layout is not given."""
    unknown = None in (options.layout.format, options.layout.size)
    return options.address[0].suffix.lower() in HEADERLESS_SUFFIXES and unknown


def inspect_raw(options: InspectOptions) -> RawInspection:
    """Return what a raw frame holds; raises FileError and InvalidInput as `read_mosaic` does."""
    path, _ = options.address
    frame = read_mosaic(path, options.pattern, options.layout)
    return RawInspection(path, frame, channel_facts(frame))


@dataclass(frozen=True)
class LayoutGuess:
    """A header-less file of `length` bytes, and the layouts that need exactly these, the most likely first."""

    path: Path
    length: int
    fits: tuple[CandidateLayout, ...]


def guess_layout(options: InspectOptions) -> LayoutGuess:
    """Return what a header-less file may be by its length, keeping the format, size and offset that are given.

    Raises FileError if it is missing or empty, InvalidInput for a format that does not exist.
    """
    given, (path, _) = options.layout, options.address
    pixel_format = None if given.format is None else pixel_format_named(given.format)
    length = length_of(path)
    return LayoutGuess(path, length, tuple(fitting_layouts(length - given.offset, pixel_format, given.size)))


def guess_title(guess: LayoutGuess) -> str:
    fits = "these fit, give --format and --size" if guess.fits else "no common format and size fits"
    return f"{guess.path}: {guess.length} bytes without a header; {fits}"


def guess_rows(guess: LayoutGuess) -> list[list[object]]:
    """Return size, stride (None without padding) and pixel formats of every layout that fits."""
    return [["{}x{}".format(*fit.size), fit.stride, " ".join(each.name for each in fit.formats)] for fit in guess.fits]


def guess_document(guess: LayoutGuess) -> dict[str, Any]:
    """Return the guess as plain data for --json."""
    fits = [
        {"formats": [each.name for each in fit.formats], "size": fit.size, "stride": fit.stride} for fit in guess.fits
    ]
    return {"file": guess.path, "bytes": guess.length, "layouts": fits}


def frame_lines(inspection: RawInspection) -> Iterator[str]:
    """Yield what is known of the frame as a whole, a line each."""
    frame = inspection.frame
    width, height = frame.size
    yield f"{inspection.path}: {width}x{height}, {pattern_words(frame.pattern)}, {frame.values.dtype}"
    if words := _capture_words(frame.capture):
        yield words
    black = " ".join(f"{level:g}" for level in (frame.black.ravel() if np.ptp(frame.black) else [frame.black[0, 0]]))
    yield f"black {black}, white {frame.white:g}"
    if frame.camera_gains is not None:
        gains = frame.camera_gains / frame.camera_gains.min()
        yield "white balance of the camera " + ", ".join(f"{c} {g:.4g}" for c, g in zip("RGB", gains, strict=True))
    elif frame.pattern != MONO and inspection.path.suffix.lower() in RAW_SUFFIXES:
        yield "no white balance of the camera in the file: --wb gray-world, a patch or gains R,G,B"
    if frame.orientation != _UPRIGHT:
        yield f"EXIF orientation {frame.orientation}"


def _capture_words(capture: Capture) -> str:
    """Return camera, exposure, aperture, speed and focal length, as far as known."""
    maker = "" if capture.model.startswith(capture.make.partition(" ")[0]) else capture.make
    words = [f"{maker} {capture.model}".strip()]
    if capture.exposure_s is not None:
        fraction = f"1/{1 / capture.exposure_s:.0f}" if capture.exposure_s < _LONG_S else f"{capture.exposure_s:g}"
        words.append(f"{fraction} s")
    words += [] if capture.f_number is None else [f"f/{capture.f_number:g}"]
    words += [] if capture.iso is None else [f"ISO {capture.iso:g}"]
    words += [] if capture.focal_mm is None else [f"{capture.focal_mm:g} mm"]
    return ", ".join(filter(None, words))


def channel_rows(inspection: RawInspection) -> list[list[object]]:
    """Return name, mean, extremes, and the per cent of samples at black and at white of every channel."""
    return [
        [facts.name, f"{facts.mean:.2f}", facts.least, facts.most, _per_cent(facts.at_black), _per_cent(facts.at_white)]
        for facts in inspection.channels
    ]


def _per_cent(share: float) -> float:
    return round(100 * share, 3)


def histogram_lines(inspection: RawInspection, _: int, encoding: str | None) -> list[str]:
    """Return a line of columns for every channel; their heights are square roots, so that small numbers show."""
    column, rows = letters(encoding).column, []
    for facts in inspection.channels:
        heights = np.ceil((len(column) - 1) * np.sqrt(facts.histogram / max(facts.histogram.max(), 1)))
        rows.append(f"  {facts.name:4} |{''.join(column[int(height)] for height in heights)}|")
    return [f"histogram, {BINS} bins from 0 to {inspection.frame.white:g}", *rows]


def document(inspection: RawInspection) -> dict[str, Any]:
    """Return the inspection as plain data for --json."""
    frame = inspection.frame
    return {
        "file": inspection.path,
        "raw": {
            "size": frame.size,
            "pattern": frame.pattern,
            "type": str(frame.values.dtype),
            "black": frame.black,
            "white": frame.white,
            "camera_gains": frame.camera_gains,
            "camera_M_xyz": frame.camera_M_xyz,
            "orientation": frame.orientation,
            "capture": frame.capture,
            "channels": inspection.channels,
        },
    }
