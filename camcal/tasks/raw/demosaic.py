"""`camcal demosaic`: raw frames to images, as many at a time as there are cores."""

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from camcal import files
from camcal.errors import InvalidInput
from camcal.images.image import Image
from camcal.images.save import KINDS, save
from camcal.options import NUMBERS
from camcal.progress import SILENT, Outcome, Progress
from camcal.raw.bit_depth import likely_white
from camcal.raw.demosaic import HALF, resolved
from camcal.raw.develop import Corrections, Picture, clipped_shares, develop, negative
from camcal.raw.dng import write_dng
from camcal.raw.mosaic import Mosaic
from camcal.raw.options import BARE_SUFFIXES, HEADERLESS_SUFFIXES, NO_BALANCE
from camcal.raw.phase import check_phase
from camcal.raw.planes import Each, one_by_one
from camcal.raw.reading import missing_pattern
from camcal.raw.tone import DTYPES
from camcal.run.fanout import fan_out, over_threads
from camcal.run.inputs import find_images, recorded
from camcal.run.outputs import place, refuse_overwriting
from camcal.tasks.raw import demosaic_settings
from camcal.tasks.raw.options import DemosaicOptions
from camcal.tasks.raw.raw_corrections import load_corrections, read_frame

DNG = ".dng"


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


def demosaic(options: DemosaicOptions, progress: Progress = SILENT) -> list[Outcome[Path, DevelopedFrame]]:
    """Return what became of every raw frame, in the order of the inputs; a frame that fails costs only itself.

    Raises InvalidInput when the pattern is missing or an output would replace an input, FileError for no input, and
    whatever kept a single frame from being developed.
    """
    sources = find_images(options.inputs, recursive=options.recursive, also=HEADERLESS_SUFFIXES)
    _require_pattern(sources, options.reading.pattern)
    outputs = place(sources, options.output, f".{options.type}", [*KINDS, DNG])
    settings = [demosaic_settings.path_beside(output) for output in outputs.values()]
    refuse_overwriting(settings, sources)
    for path in settings:
        demosaic_settings.require_own(path)
    corrections = load_corrections(options.corrections, options.reading, sources[0])
    into_a_folder = outputs[sources[0]] != options.output
    names = [output.name for output in outputs.values()]
    with recorded(options.output, names) if into_a_folder else nullcontext():
        if len(sources) == 1:
            outcomes = [_alone(sources[0], outputs, options, corrections)]
        else:
            work = partial(_develop_file, options=options, corrections=corrections, outputs=outputs)
            outcomes = list(fan_out(work, sources, jobs=options.jobs, what="demosaic", progress=progress))
    _warn_of_a_short_scale(outcomes, options.reading.white, progress)
    return outcomes


def _alone(
    source: Path, outputs: Mapping[Path, Path], options: DemosaicOptions, corrections: Corrections
) -> Outcome[Path, DevelopedFrame]:
    """Return what became of a single frame: all cores work on its tiles. Raises what keeps it from being developed."""
    with over_threads(options.jobs) as each:
        return Outcome(source, _develop_file(source, options, corrections, outputs, each))


def _develop_file(
    source: Path,
    options: DemosaicOptions,
    corrections: Corrections,
    outputs: Mapping[Path, Path],
    each: Each = one_by_one,
) -> DevelopedFrame:
    try:
        return _developed(source, outputs[source], options, corrections, each)
    except InvalidInput as error:
        raise InvalidInput(error.message, where=error.where or str(source)) from error


def _developed(
    source: Path, output: Path, options: DemosaicOptions, corrections: Corrections, each: Each
) -> DevelopedFrame:
    frame = read_frame(source, options.reading)
    if not options.trust_pattern:
        check_phase(frame)
    settings = demosaic_settings.path_beside(output)
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
    files.write_text(settings, demosaic_settings.text(repeating, _record(frame, developed, options)))
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
        "capture": demosaic_settings.capture_facts(frame),
    }
    if options.development.algorithm == HALF:
        record["pixel_of_the_mosaic"] = "(2 x + 0.5, 2 y + 0.5)"
    return record


def _require_pattern(sources: Sequence[Path], pattern: str | None) -> None:
    bare = [source for source in sources if source.suffix.lower() in BARE_SUFFIXES]
    if bare and pattern is None:
        raise missing_pattern(bare[0])


def _warn_of_a_short_scale(
    outcomes: Sequence[Outcome[Path, DevelopedFrame]], white: float | None, progress: Progress
) -> None:
    """Warn once if files look as if they held fewer bits than they are read with: the images come out almost black."""
    for outcome in outcomes:
        frame = outcome.value
        likely = None if frame is None or white is not None else likely_white(frame.peak, frame.white)
        if frame is not None and likely is not None:
            progress.warn(
                f"{frame.source}: no count above {frame.peak:g} of {frame.white:g}; is it --white {likely:g}?"
            )
            return


def document(outcomes: Sequence[Outcome[Path, DevelopedFrame]]) -> dict[str, Any]:
    """Return what became of the frames as plain data for --json."""
    written = [outcome.value for outcome in outcomes if outcome.value is not None]
    paths = ("source", "output", "settings")
    return {
        "images": [asdict(frame) | {name: getattr(frame, name).as_posix() for name in paths} for frame in written],
        "failed": [
            {"source": outcome.item.as_posix(), "message": str(outcome.error)} for outcome in outcomes if outcome.error
        ],
    }
