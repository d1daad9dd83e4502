"""`camcal demosaic`: raw frames to images, as many at a time as there are cores."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from camcal.errors import InvalidInput
from camcal.images.image import Image
from camcal.images.save import KINDS, save
from camcal.progress import SILENT, Outcome, Progress
from camcal.raw.develop import Development, develop
from camcal.raw.mosaic import PATTERNS, Mosaic, require_pattern
from camcal.raw.reading import BARE_SUFFIXES, read_mosaic
from camcal.run.fanout import fan_out
from camcal.run.inputs import find_images, record_outputs

_SIXTEEN_BITS = 65535.0
_DEFAULT_SUFFIX = ".tiff"  # 16-bit PNG takes seventeen times as long to write


@dataclass(frozen=True)
class DemosaicOptions:
    """Raw frames (files, folders, globs), where the images go, and what is done to them.

    output: a file for a single frame, otherwise a folder. pattern: of bare mosaics; camera files bring their own.
    black, white: counts that take the place of the file's levels.
    """

    inputs: Sequence[Path | str]
    output: Path
    pattern: str | None = None
    development: Development = field(default_factory=Development)
    black: float | None = None
    white: float | None = None
    recursive: bool = False
    jobs: int | None = None

    def __post_init__(self) -> None:
        if self.pattern is not None:
            require_pattern(self.pattern)


@dataclass(frozen=True)
class DevelopedFrame:
    """One image written: its source, its size (width, height), and the levels and gains that made it.

    black: counts of the four phases in reading order. peak: the largest count of the raw frame.
    """

    source: Path
    output: Path
    size: tuple[int, int]
    pattern: str
    black: tuple[float, ...]
    white: float
    peak: float
    gains: tuple[float, float, float] | None


def demosaic(options: DemosaicOptions, progress: Progress = SILENT) -> list[Outcome[Path, DevelopedFrame]]:
    """Return what became of every raw frame, in the order of the inputs; a frame that fails costs only itself.

    Raises InvalidInput when the pattern is missing or an output would replace an input, FileError for no input, and
    whatever kept a single frame from being developed.
    """
    frames = find_images(options.inputs, recursive=options.recursive)
    _require_pattern(frames, options.pattern)
    outputs = _outputs(frames, options.output)
    work = partial(_develop_file, options=options, outputs=outputs)
    outcomes = list(fan_out(work, frames, jobs=options.jobs, what="demosaic", progress=progress))
    if len(outcomes) == 1 and outcomes[0].error is not None:
        raise outcomes[0].error
    if outputs[frames[0]] != options.output:
        record_outputs(options.output, [outputs[outcome.item].name for outcome in outcomes if outcome.value])
    _warn_of_a_short_scale(outcomes, progress)
    return outcomes


def _develop_file(source: Path, options: DemosaicOptions, outputs: Mapping[Path, Path]) -> DevelopedFrame:
    output = outputs[source]
    frame = _with_levels(read_mosaic(source, options.pattern), options)
    picture = develop(frame, options.development)
    image = Image(picture.pixels, frame.orientation)
    save(output, image)
    return DevelopedFrame(
        source=source,
        output=output,
        size=image.size,
        pattern=frame.pattern,
        black=tuple(frame.black.ravel().tolist()),
        white=frame.white,
        peak=float(frame.values.max()),
        gains=picture.gains,
    )


def _with_levels(frame: Mosaic, options: DemosaicOptions) -> Mosaic:
    black = frame.black if options.black is None else np.full((2, 2), options.black)
    return replace(frame, black=black, white=frame.white if options.white is None else options.white)


def _outputs(frames: Sequence[Path], output: Path) -> dict[Path, Path]:
    """Return the file each frame is written to: the output itself for a single frame, else one by its name in a folder.

    Raises InvalidInput if two frames want the same file, or a file is an input or of a kind that is not written.
    """
    if output.suffix and not output.is_dir():
        if len(frames) > 1:
            raise InvalidInput(f"{len(frames)} frames do not go into one file; give a folder", where=str(output))
        if output.suffix.lower() not in KINDS:
            raise InvalidInput(f"{output.suffix} is not written; use {', '.join(KINDS)}", where=str(output))
        outputs = {frames[0]: output}
    else:
        outputs = {frame: output / f"{frame.stem}{_DEFAULT_SUFFIX}" for frame in frames}
    _refuse_collisions(outputs)
    return outputs


def _refuse_collisions(outputs: Mapping[Path, Path]) -> None:
    inputs = {frame.resolve() for frame in outputs}
    taken: dict[Path, Path] = {}
    for frame, file in outputs.items():
        if file.resolve() in inputs:
            raise InvalidInput("is an input and is not overwritten; choose another output", where=str(file))
        if file in taken:
            raise InvalidInput(f"{taken[file]} and {frame} would both be written to it; rename one", where=str(file))
        taken[file] = frame


def _require_pattern(frames: Sequence[Path], pattern: str | None) -> None:
    bare = [frame for frame in frames if frame.suffix.lower() in BARE_SUFFIXES]
    if bare and pattern is None:
        raise InvalidInput(
            f"a bare mosaic does not say its colour pattern; give --pattern {'|'.join(PATTERNS)}", where=str(bare[0])
        )


def _warn_of_a_short_scale(outcomes: Sequence[Outcome[Path, DevelopedFrame]], progress: Progress) -> None:
    """Warn once if 16-bit files look as if they held fewer bits: the images then come out almost black."""
    for outcome in outcomes:
        frame = outcome.value
        if frame is not None and frame.white == _SIXTEEN_BITS and 0 < frame.peak < _SIXTEEN_BITS / 4:
            likely = 2 ** max(8, int(frame.peak).bit_length()) - 1
            progress.warn(f"{frame.source}: no count above {frame.peak:g} of 65535; is it --white {likely}?")
            return


def document(outcomes: Sequence[Outcome[Path, DevelopedFrame]]) -> dict[str, Any]:
    """Return what became of the frames as plain data for --json."""
    written = [outcome.value for outcome in outcomes if outcome.value is not None]
    return {
        "images": [
            asdict(frame) | {"source": frame.source.as_posix(), "output": frame.output.as_posix()} for frame in written
        ],
        "failed": [
            {"source": outcome.item.as_posix(), "message": str(outcome.error)} for outcome in outcomes if outcome.error
        ],
    }
