"""`camcal demosaic`: raw frames to images, in parallel.

Settings that repeat a development bit for bit are written beside every image. With --preview-patterns, what a mosaic
resembles with each of the four patterns.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import camcal
from camcal import files
from camcal.arrays import Array
from camcal.errors import InvalidInput, Located
from camcal.formats import emit
from camcal.images.image import Image
from camcal.images.save import KINDS, save
from camcal.options import NUMBERS, declared
from camcal.progress import SILENT, Outcome, Progress, reused
from camcal.raw.colour import DTYPES
from camcal.raw.demosaic import resolved
from camcal.raw.develop import Corrections, Picture, clipped_shares, develop, negative
from camcal.raw.dng import write_dng
from camcal.raw.frame_facts import check_phase, green_diagonal, likely_white, low_peak
from camcal.raw.mosaic import Mosaic
from camcal.raw.names import HALF, PATTERNS
from camcal.raw.options import BARE_SUFFIXES, GRAY_WORLD, HEADERLESS_SUFFIXES, NO_BALANCE, Balance, Development
from camcal.raw.planes import Each, one_by_one
from camcal.raw.reading import missing_pattern
from camcal.run import fingerprint
from camcal.run.outputs import claim, writes
from camcal.run.paths import find_images, place
from camcal.run.process import over_threads
from camcal.run.resume import Items, resumable
from camcal.tasks.raw.options import DemosaicOptions
from camcal.tasks.raw.raw_corrections import load_corrections, read_frame

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
    sources = find_images(options.inputs, recursive=options.recursive, also=HEADERLESS_SUFFIXES)
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
    work = partial(_develop_alone if alone else _develop_file, options=options, corrections=corrections)
    made: Items[_Item, DevelopedFrame] = Items(_fingerprint(options, corrections), _inputs, _written, DevelopedFrame)
    frames = list(outputs.items())
    for outcome in resumable(
        work, frames, made, jobs=jobs, batch=batch, what="demosaic", progress=progress, alone=alone
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


def _inputs(item: _Item) -> list[Path | str]:
    """Return a frame and its name, which the settings file holds."""
    return [item[0], item[0].as_posix()]


def _written(item: _Item) -> list[Path]:
    return [item[1], _settings_beside(item[1])]


def _develop_alone(item: _Item, options: DemosaicOptions, corrections: Corrections) -> DevelopedFrame:
    """Return what was written of a frame whose tiles all cores work on."""
    with over_threads(options.jobs) as each:
        return _develop_file(item, options, corrections, each)


def _develop_file(
    item: _Item, options: DemosaicOptions, corrections: Corrections, each: Each = one_by_one
) -> DevelopedFrame:
    source, output = item
    with Located(source):
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
        "sha256": files.sha256(developed.source),
        "image_size": list(developed.size),
        "pattern": developed.pattern,
        "black": list(developed.black),
        "white": developed.white,
        "clipped": list(developed.clipped),
        "capture": _capture_facts(frame),
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
    paths = ("source", "output", "settings")
    return {
        "images": [asdict(frame) | {name: getattr(frame, name).as_posix() for name in paths} for frame in written],
        "reused": reused(outcomes),
        "failed": [
            {"source": outcome.item.as_posix(), "message": str(outcome.error)} for outcome in outcomes if outcome.error
        ],
    }


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


def _capture_facts(frame: Mosaic) -> dict[str, Any]:
    """Return what the file of a frame says of its capture, without what it does not say."""
    capture = frame.capture
    facts = {
        "make": capture.make,
        "model": capture.model,
        "exposure_s": capture.exposure_s,
        "iso": capture.iso,
        "f_number": capture.f_number,
        "focal_mm": capture.focal_mm,
    }
    return {name: value for name, value in facts.items() if value not in (None, "")}


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
    sources = find_images(options.inputs, recursive=options.recursive, also=HEADERLESS_SUFFIXES)
    claim(_preview(options, source, pattern) for source in sources for pattern in PATTERNS)
    for source in sources:
        frame = read_frame(source, replace(options.reading, pattern=options.reading.pattern or PATTERNS[0]))
        if frame.pattern not in PATTERNS:
            raise InvalidInput(f"has the pattern {frame.pattern}, not one of four", where=str(source))
        thumbnails = {}
        for pattern in PATTERNS:
            path = _preview(options, source, pattern)
            save(path, _thumbnail(develop(replace(frame, pattern=pattern), look).pixels))
            thumbnails[pattern] = path
        main = green_diagonal(frame.values, frame.black).main
        likely = tuple(pattern for pattern in PATTERNS if main is None or (pattern[0] == "G") == main)
        written.append(PatternPreviews(source, thumbnails, likely))
    return written


def _preview(options: DemosaicOptions, source: Path, pattern: str) -> Path:
    return options.output / f"{source.stem}_{pattern}.png"


def _thumbnail(pixels: Array) -> Array:
    """Return every so many-th pixel of an image: a thumbnail that keeps its colours."""
    step = -(-max(pixels.shape[:2]) // _LONGEST)
    return np.ascontiguousarray(pixels[::step, ::step])


def previews_document(previews: list[PatternPreviews]) -> dict[str, Any]:
    """Return the previews as plain data for --json."""
    return {
        "previews": [
            {
                "source": each.source.as_posix(),
                "thumbnails": {pattern: path.as_posix() for pattern, path in each.thumbnails.items()},
                "likely": list(each.likely),
            }
            for each in previews
        ]
    }
