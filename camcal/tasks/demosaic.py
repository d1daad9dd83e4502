"""`camcal demosaic`: raw frames to images, as many at a time as there are cores."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from camcal.errors import InvalidInput
from camcal.images.develop import Development, develop
from camcal.images.mosaic import BARE_SUFFIXES, PATTERNS, Mosaic, read_mosaic, require_pattern
from camcal.images.npy import write_npy
from camcal.images.save import save
from camcal.progress import SILENT, Outcome, Progress
from camcal.run.fanout import fan_out
from camcal.run.inputs import find_images

OUTPUT_SUFFIXES = frozenset({".tif", ".tiff", ".png", ".ppm", ".npy"})
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

    Raises InvalidInput when the pattern is missing or an output would replace an input, FileError for no input.
    """
    frames = find_images(options.inputs)
    _require_pattern(frames, options.pattern)
    outputs = _outputs(frames, options.output)
    work = partial(_develop_file, options=options)
    pairs = list(zip(frames, outputs, strict=True))
    outcomes = [
        Outcome(frame, outcome.value, outcome.error)
        for frame, outcome in zip(frames, fan_out(work, pairs, jobs=options.jobs, what="demosaic", progress=progress))
    ]
    _warn_of_a_short_scale(outcomes, progress)
    return outcomes


def _develop_file(pair: tuple[Path, Path], options: DemosaicOptions) -> DevelopedFrame:
    source, output = pair
    frame = _with_levels(read_mosaic(source, options.pattern), options)
    picture = develop(frame, options.development)
    write_npy(output, picture.pixels) if output.suffix.lower() == ".npy" else save(output, picture.pixels)
    height, width = picture.pixels.shape[:2]
    return DevelopedFrame(
        source=source,
        output=output,
        size=(width, height),
        pattern=frame.pattern,
        black=tuple(frame.black.ravel().tolist()),
        white=frame.white,
        peak=float(frame.values.max()),
        gains=picture.gains,
    )


def _with_levels(frame: Mosaic, options: DemosaicOptions) -> Mosaic:
    black = frame.black if options.black is None else np.full((2, 2), options.black)
    return replace(frame, black=black, white=frame.white if options.white is None else options.white)


def _outputs(frames: Sequence[Path], output: Path) -> list[Path]:
    """Return the file each frame is written to: the output itself for a single frame, else one by name in its folder.

    Raises InvalidInput if two frames want the same file, or a file is an input or of a kind that is not written.
    """
    if output.suffix and not output.is_dir():
        if len(frames) > 1:
            raise InvalidInput(f"{len(frames)} frames cannot go into one file; give a folder", where=str(output))
        if output.suffix.lower() not in OUTPUT_SUFFIXES:
            raise InvalidInput(f"{output.suffix} is not written; use {', '.join(OUTPUT_SUFFIXES)}", where=str(output))
        files = [output]
    else:
        files = [output / f"{frame.stem}{_DEFAULT_SUFFIX}" for frame in frames]
    sources = {frame.resolve() for frame in frames}
    for file, frame in zip(files, frames, strict=True):
        if file.resolve() in sources:
            raise InvalidInput("is an input and would be overwritten; give another output", where=str(file))
    return files
