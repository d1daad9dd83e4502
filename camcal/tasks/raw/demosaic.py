"""`camcal demosaic`: raw frames to images, in parallel.

Settings that repeat a development bit for bit are written beside every image. The frames and maps that correct raw
frames are read once, for all frames of a sensor. With --preview-patterns, what a mosaic resembles with each of the four
patterns; with --make-bad-pixel-map, the pixels of a sensor that dark frames give away.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import camcal
from camcal import files
from camcal.arrays import Array
from camcal.dataclass import dataclass, field, replace
from camcal.errors import InvalidInput, Located
from camcal.formats import emit
from camcal.images.bag import count
from camcal.images.files import KINDS, save
from camcal.images.image import Image
from camcal.images.video import frame_name
from camcal.images.videos import address_of
from camcal.options import NUMBERS, declared
from camcal.progress import SILENT, Outcome, Progress, failed_items, reused
from camcal.raw import HALF, MONO, PATTERNS, calibration_frames
from camcal.raw.calibration_frames import dark_average, flat_gain, stack
from camcal.raw.demosaic import resolved
from camcal.raw.develop import (
    DTYPES,
    NO_CORRECTIONS,
    Corrections,
    Picture,
    clipped_shares,
    develop,
    linearise,
    negative,
)
from camcal.raw.dng import write_dng
from camcal.raw.frame_facts import check_phase, green_diagonal, likely_white, low_peak
from camcal.raw.mosaic import Mosaic, channel_names
from camcal.raw.options import BARE_SUFFIXES, GRAY_WORLD, HEADERLESS_SUFFIXES, NO_BALANCE, Balance, Development
from camcal.raw.reading import missing_pattern, read_mosaic
from camcal.raw.tiles import Each, one_by_one
from camcal.records import entry
from camcal.run import fingerprint
from camcal.run.outputs import claim, writes
from camcal.run.paths import find_images, find_media, place
from camcal.run.process import over_threads
from camcal.run.resume import Items, resumable
from camcal.tasks.raw.options import NO_FILES, CorrectionFiles, DemosaicOptions, RawInput

DNG = ".dng"

_SETTINGS = ".yaml"
_COMMENT = "What camcal demosaic did; given to --config, this file repeats it."
_LONGEST = 480  # pixels of a thumbnail's longer side


_Item = tuple[Path, Path]  # a frame and the image that is written


@dataclass(frozen=True)
class DevelopedFrame:
    """One image written: its source, its size (width, height), and the levels and gains that made it.

    black: counts of the places of the cell in reading order. peak: the largest count of the raw frame. clipped: share
    of the samples at or above white, by place of the cell. settings: the file that repeats it.
    """

    source: Path
    output: Path
    settings: Path
    size: tuple[int, int]
    pattern: str
    black: tuple[float, ...]
    white: float
    peak: float
    clipped: tuple[float, ...]
    gains: tuple[float, float, float] | None


@writes
def demosaic(options: DemosaicOptions, progress: Progress = SILENT) -> list[Outcome[Path, DevelopedFrame]]:
    """Return what became of every raw frame, in the order of the inputs; a frame that fails costs only itself.

    Raises InvalidInput when the pattern is missing or an output would replace an input, FileError for no input, and
    whatever kept a single frame from being developed.
    """
    sources = find_frames(options.inputs, options.recursive)
    bare = [source for source in sources if source.suffix.lower() in BARE_SUFFIXES]
    if bare and options.reading.pattern is None:
        raise missing_pattern(bare[0])
    outputs = place(sources, options.output, f".{options.type}", [*KINDS, DNG])
    settings = [_settings_beside(output) for output in outputs.values()]
    claim([*outputs.values(), *settings])
    corrections = load_corrections(options.corrections, options.reading, sources[0])
    outcomes = list(_outcomes(outputs, options, corrections, progress))
    _warn_of_a_short_scale(outcomes, options.reading.white, progress)
    return outcomes


def _outcomes(
    outputs: Mapping[Path, Path], options: DemosaicOptions, corrections: Corrections, progress: Progress
) -> Iterator[Outcome[Path, DevelopedFrame]]:
    """Yield what becomes of every frame; raises what keeps a single one from being developed."""
    jobs, batch = options.jobs, options.batch
    alone = len(outputs) == 1
    work = partial(_develop_file, options=options, corrections=corrections, alone=alone)
    made: Items[_Item, DevelopedFrame] = Items(
        _fingerprint(options, corrections), _inputs_of, _outputs_of, DevelopedFrame
    )
    items = list(outputs.items())
    for outcome in resumable(
        work, items, made, jobs=jobs, batch=batch, what="demosaic", progress=progress, alone=alone
    ):
        yield outcome.of(outcome.item[0])


def _fingerprint(options: DemosaicOptions, corrections: Corrections) -> str:
    """Return the fingerprint of what frames are developed with; settings files name the frames that correct them."""
    given = options.corrections
    settings = fingerprint.of_settings(options, without=("inputs", "recursive", "corrections.dark", "corrections.flat"))
    arrays = [None if each is None else fingerprint.of_array(each) for each in (corrections.dark, corrections.flat)]
    return fingerprint.of_data(
        [settings, arrays, given.dark, given.flat, None if given.bad is None else str(given.bad)]
    )


def _inputs_of(item: _Item) -> list[Path | str]:
    """Return a frame and its name, which the settings file holds."""
    return [item[0], item[0].as_posix()]


def _outputs_of(item: _Item) -> list[Path]:
    return [item[1], _settings_beside(item[1])]


def _develop_file(item: _Item, options: DemosaicOptions, corrections: Corrections, *, alone: bool) -> DevelopedFrame:
    """Return what was written of a frame; alone: all cores work on its tiles."""
    source, output = item
    with Located(source), over_threads(options.jobs) if alone else nullcontext(one_by_one) as each:
        return _develop(source, output, options, corrections, each)


def _develop(
    source: Path, output: Path, options: DemosaicOptions, corrections: Corrections, each: Each
) -> DevelopedFrame:
    frame = read_frame(source, options.reading)
    if not options.trust_pattern:
        check_phase(frame)
    settings = _settings_beside(output)
    if output.suffix.lower() == DNG:
        kept = negative(frame, options.development, corrections)
        write_dng(output, kept)
        picture = Picture(kept.values, None, linear=True, clipped=clipped_shares(frame))
    else:
        picture = develop(frame, options.development, corrections, each)
        save(output, Image(picture.pixels, frame.orientation))
    developed = DevelopedFrame(
        source=source,
        output=output,
        settings=settings,
        size=(picture.pixels.shape[1], picture.pixels.shape[0]),
        pattern=frame.pattern,
        black=tuple(frame.black.ravel().tolist()),
        white=frame.white,
        peak=float(frame.values.max()),
        clipped=picture.clipped,
        gains=picture.gains,
    )
    repeating = _repeating(options, picture, frame.pattern)
    files.write_text(settings, _settings_text(repeating, _record(frame, developed, options)))
    return developed


def _repeating(options: DemosaicOptions, picture: Picture, pattern: str) -> DemosaicOptions:
    """Return the options that repeat a development, with what was found in place of what was to be found."""
    gains = NO_BALANCE if picture.gains is None else NUMBERS.write(picture.gains)
    development = replace(
        options.development,
        balance=replace(options.development.balance, text=gains),
        algorithm=resolved(options.development.algorithm, pattern),
        encoding="linear" if picture.linear else "gamma",
        depth=next(name for name, dtype in DTYPES.items() if dtype == picture.pixels.dtype),
    )
    return replace(options, development=development)


def _record(frame: Mosaic, developed: DevelopedFrame, options: DemosaicOptions) -> dict[str, Any]:
    """Return what was found of a frame, for people and programs; nothing of it is needed to repeat it."""
    record = {
        "source": developed.source.as_posix(),
        "sha256": fingerprint.of_source(developed.source),
        "image_size": list(developed.size),
        "pattern": developed.pattern,
        "black": list(developed.black),
        "white": developed.white,
        "clipped": list(developed.clipped),
        "capture": {name: value for name, value in asdict(frame.capture).items() if value not in (None, "")},
    }
    if options.development.algorithm == HALF:
        record["pixel_of_the_mosaic"] = "(2 x + 0.5, 2 y + 0.5)"
    return record


def _warn_of_a_short_scale(
    outcomes: Sequence[Outcome[Path, DevelopedFrame]], white: float | None, progress: Progress
) -> None:
    """Warn once if files look as if they held fewer bits than they are read with: the images come out almost black."""
    for outcome in outcomes:
        frame = outcome.value
        likely = None if frame is None or white is not None else likely_white(frame.peak, frame.white)
        if frame is not None and likely is not None:
            progress.warn(low_peak(frame.peak, frame.white, likely).at(frame.source))
            return


def document(outcomes: Sequence[Outcome[Path, DevelopedFrame]]) -> dict[str, Any]:
    """Return what became of the frames as plain data for --json."""
    written = [outcome.value for outcome in outcomes if outcome.value is not None]
    return {"images": written, "reused": reused(outcomes), "failed": failed_items(outcomes, "source")}


def _settings_beside(image: Path) -> Path:
    """Return where the settings of an image stand."""
    return image.with_name(image.name + _SETTINGS)


def _settings_text(options: DemosaicOptions, record: Mapping[str, Any]) -> str:
    """Return the settings file: options of the command by name, and under x_record what was found on the way.

    Of the development it has everything, so that another version with other defaults repeats it too.
    """
    recorded = [each for each in declared(DemosaicOptions) if each.option.recorded and not each.positional]
    settings = {
        each.key: each.setting(value)
        for each in recorded
        if (value := each.of(options)) is not None and (value != each.default or each.path[0] == "development")
    }
    return emit.document({**settings, "x_record": {"camcal": camcal.__version__, **record}}, _COMMENT)


@dataclass(frozen=True)
class PatternPreviews:
    """The thumbnails of one frame by pattern, and the patterns that its greens allow: two, or all four."""

    source: Path
    thumbnails: dict[str, Path]
    likely: tuple[str, ...]


@writes
def preview_patterns(options: DemosaicOptions) -> list[PatternPreviews]:
    """Return what was written: for each raw frame four small PNG images in the folder options.output.

    White balance is that of a gray world and tone sRGB, so that wrong colours are seen, not only wrong levels.
    Raises FileError or InvalidInput as reading does, InvalidInput for a frame without a Bayer mosaic.
    """
    look = Development(HALF, Balance(GRAY_WORLD), tone="srgb", depth="8")
    written = []
    sources = find_frames(options.inputs, options.recursive)
    claim(_preview(options, source, pattern) for source in sources for pattern in PATTERNS)
    for source in sources:
        frame = read_frame(source, replace(options.reading, pattern=options.reading.pattern or PATTERNS[0]))
        if frame.pattern not in PATTERNS:
            raise InvalidInput(f"has the pattern {frame.pattern}, not one of four", where=str(source))
        thumbnails = {}
        for pattern in PATTERNS:
            path = _preview(options, source, pattern)
            pixels = develop(replace(frame, pattern=pattern), look).pixels
            step = -(-max(pixels.shape[:2]) // _LONGEST)  # every so many-th pixel, which keeps the colours
            save(path, np.ascontiguousarray(pixels[::step, ::step]))
            thumbnails[pattern] = path
        main = green_diagonal(frame.values, frame.black).main
        likely = tuple(pattern for pattern in PATTERNS if main is None or (pattern[0] == "G") == main)
        written.append(PatternPreviews(source, thumbnails, likely))
    return written


def _preview(options: DemosaicOptions, source: Path, pattern: str) -> Path:
    return options.output / f"{source.stem}_{pattern}.png"


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
        flat = stack(frames(given.flat, reading))[1]
        corrections.require_size(like)
        light = linearise(replace(like, values=flat), dark)
        corrections = replace(corrections, flat=flat_gain(light, like.pattern))
    corrections.require_size(like)
    return corrections


def frames(inputs: Sequence[Path | str], reading: RawInput) -> Iterator[Array]:
    """Yield the counts of raw frames, one after the other."""
    return (read_frame(path, reading).values for path in find_frames(inputs))


def find_frames(inputs: Sequence[Path | str], recursive: bool = False) -> list[Path]:
    """Return the raw frames that inputs stand for, those of topics of bags as `video.frame_name` has them."""
    media = find_media(inputs, recursive, HEADERLESS_SUFFIXES)
    topics = [path for path in media.videos if address_of(path) is not None]
    if (not media.images and not topics) or len(topics) < len(media.videos):
        return find_images(inputs, recursive, HEADERLESS_SUFFIXES)
    return [*media.images, *(Path(frame_name(each, number)) for each in topics for number in range(count(each)))]


@dataclass(frozen=True)
class BadPixelMap:
    """The map that was written: how many frames it is made of, how many pixels are bad, of how many."""

    output: Path = field(metadata=entry("bad_pixel_map"))
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
