"""`camcal demosaic --make-bad-pixel-map`: the pixels of a sensor that dark frames give away."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from camcal.progress import SILENT, Progress
from camcal.raw import bad_pixels
from camcal.raw.options import HEADERLESS_SUFFIXES, MONO
from camcal.run.inputs import find_images
from camcal.run.outputs import refuse_overwriting
from camcal.tasks.raw.options import DemosaicOptions
from camcal.tasks.raw.raw_corrections import read_frame


@dataclass(frozen=True)
class BadPixelMap:
    """The map that was written: how many frames it is made of, how many pixels are bad, of how many."""

    output: Path
    frames: int
    bad: int
    pixels: int


def make_bad_pixel_map(options: DemosaicOptions, progress: Progress = SILENT) -> BadPixelMap:
    """Return what was found after writing the map to options.output: text as dcraw reads it, PNG or NPY.

    Raises FileError or InvalidInput for files that are no raw frames of one size, InsufficientData if too many pixels
    stand out to be called bad.
    """
    sources = find_images(options.inputs, recursive=options.recursive, also=HEADERLESS_SUFFIXES)
    refuse_overwriting([options.output], sources)
    pattern = options.reading.pattern or read_frame(sources[0], options.reading).pattern
    progress.start("dark frames", len(sources))

    def counts() -> Any:
        for source in sources:
            yield read_frame(source, options.reading).values
            progress.advance()

    mask = bad_pixels.make_map(counts(), pattern or MONO)
    progress.finish()
    bad_pixels.write_map(options.output, mask)
    return BadPixelMap(options.output, len(sources), int(np.count_nonzero(mask)), mask.size)


def document(found: BadPixelMap) -> dict[str, Any]:
    """Return the result as plain data for --json."""
    return {"bad_pixel_map": found.output.as_posix(), "frames": found.frames, "bad": found.bad, "pixels": found.pixels}
