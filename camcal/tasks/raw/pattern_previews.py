"""`camcal demosaic --preview-patterns`: what a mosaic looks like with each of the four patterns."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.images.save import save
from camcal.raw.demosaic import HALF
from camcal.raw.develop import develop
from camcal.raw.mosaic import Mosaic
from camcal.raw.options import GRAY_WORLD, HEADERLESS_SUFFIXES, PATTERNS, Balance, Development
from camcal.raw.phase import green_diagonal
from camcal.run.inputs import find_images, record_outputs
from camcal.tasks.raw.options import DemosaicOptions
from camcal.tasks.raw.raw_corrections import read_frame

_LONGEST = 480  # pixels of a thumbnail's longer side


@dataclass(frozen=True)
class PatternPreviews:
    """The thumbnails of one frame by pattern, and the patterns that its greens allow: two, or all four."""

    source: Path
    thumbnails: dict[str, Path]
    likely: tuple[str, ...]


def preview_patterns(options: DemosaicOptions) -> list[PatternPreviews]:
    """Return what was written: for each raw frame four small PNG images in the folder options.output.

    White balance is that of a gray world and tone sRGB, so that wrong colours are seen, not only wrong levels.
    Raises FileError or InvalidInput as reading does, InvalidInput for a frame without a Bayer mosaic.
    """
    look = Development(HALF, Balance(GRAY_WORLD), tone="srgb", depth="8")
    written = []
    for source in find_images(options.inputs, recursive=options.recursive, also=HEADERLESS_SUFFIXES):
        frame = read_frame(source, replace(options.reading, pattern=options.reading.pattern or PATTERNS[0]))
        if frame.pattern not in PATTERNS:
            raise InvalidInput(f"has the pattern {frame.pattern}, not one of four", where=str(source))
        thumbnails = {}
        for pattern in PATTERNS:
            path = options.output / f"{source.stem}_{pattern}.png"
            save(path, _small(develop(replace(frame, pattern=pattern), look).pixels))
            thumbnails[pattern] = path
        record_outputs(options.output, [path.name for path in thumbnails.values()])
        written.append(PatternPreviews(source, thumbnails, _likely(frame)))
    return written


def _likely(frame: Mosaic) -> tuple[str, ...]:
    main = green_diagonal(frame.values, frame.black).main
    return tuple(pattern for pattern in PATTERNS if main is None or (pattern[0] == "G") == main)


def _small(pixels: Array) -> Array:
    """Return every so many-th pixel of an image: a thumbnail that keeps its colours."""
    step = -(-max(pixels.shape[:2]) // _LONGEST)
    return np.ascontiguousarray(pixels[::step, ::step])


def document(previews: list[PatternPreviews]) -> dict[str, Any]:
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
