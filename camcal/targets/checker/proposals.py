"""Where a chessboard may be: checker patterns in copies of an image, the cheap ones first.

Finding asks for structure, not for precision, so large images are searched in reduced copies: the time goes with the
number of pixels. What is proposed is verified and located at full resolution by targets/checker/checker.py.
"""

from collections.abc import Iterator

import numpy as np

from camcal import opencv
from camcal.arrays import Array
from camcal.targets.checker.lattice import patterns
from camcal.targets.checker.saddles import find_saddles

SMALL = 0.35e6  # pixels of the first copy, about
MOST = 6e6  # of the largest
ENLARGED = 0.5e6  # images with fewer pixels are also searched enlarged
TRIED = 3  # patterns of a copy


def proposals(gray: Array) -> Iterator[list[Array]]:
    """Yield what every copy shows of checker patterns, the largest first.

    Each is a grid of corners (rows, columns, 2) in pixels of `gray`, (H, W) uint8, NaN where one was not seen. Most
    boards show in the first copy; those out of focus or in much noise in one of half its width, small ones in larger
    ones.
    """
    for scale in _scales(gray.size):
        copy = gray if scale == 1 else opencv.resized(gray, scale)
        yield [_from_copy(grid, copy, gray) for grid in patterns(find_saddles(copy))[:TRIED]]


def _scales(size: int) -> Iterator[float]:
    """Yield the scales of the copies to search of an image of so many pixels."""
    first = max(1, round(float(np.sqrt(size / SMALL))))
    yield from (1 / first, 1 / (2 * first))
    scale = 1 / first
    while scale < 1 and 4 * scale**2 * size < MOST:
        scale = min(1.0, 2 * scale)
        yield scale
    if size < ENLARGED:
        yield 2.0


def _from_copy(corners: Array, copy: Array, gray: Array) -> Array:
    """Return corners in a copy as pixels of the image: the outer edges of both coincide."""
    scale = np.array(gray.shape[::-1]) / np.array(copy.shape[::-1])
    return np.asarray((corners + 0.5) * scale - 0.5)
