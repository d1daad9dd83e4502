"""Where a chessboard may be: what OpenCV's detectors say of copies of an image, the cheap ones first.

The detectors look for structure, not for precision, so large images are searched in reduced copies: the time goes with
the number of pixels. What they propose is verified and located at full resolution by targets/checker.py.
"""

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from camcal import opencv
from camcal.arrays import Array

SMALL, MEDIUM, LARGE = 0.5e6, 1.5e6, 6e6  # pixels of the reduced copies
ENLARGED = 0.16e6  # images with fewer pixels are also searched enlarged
ENLARGEMENT = 2.0

_Finder = Callable[[Array, int, int], Array | None]
_thorough: _Finder = partial(opencv.find_chessboard_sb, thorough=True)


def proposals(gray: Array, columns: int, rows: int) -> Iterator[Array]:
    """Yield grids of corners (rows, columns, 2) in pixels of `gray`, (H, W) uint8, each from another attempt.

    On real images linking dark squares finds nine boards of ten in a hundredth of a second, the sector-based detector
    boards in shade and blur, its thorough form those of weak contrast, an enlarged copy the smallest.
    """
    for scale, find in _attempts(gray.size):
        copy = gray if scale == 1 else opencv.resized(gray, scale)
        corners = find(copy, columns, rows)
        if corners is not None:
            yield _from_copy(corners, copy, gray)


def largest_patterns(gray: Array) -> Iterator[Array]:
    """Yield the corners (rows, columns, 2), in pixels of `gray`, of the largest checker pattern in sight, if any."""
    scale = _scale(gray.size, SMALL)
    copy = gray if scale == 1 else opencv.resized(gray, scale)
    corners = opencv.largest_chessboard(copy)
    if corners is not None:
        yield _from_copy(corners, copy, gray)


def _attempts(size: int) -> Iterator[tuple[float, _Finder]]:
    """Yield scales of the copies to search and how, for an image of so many pixels."""
    small, medium, large = (_scale(size, pixels) for pixels in (SMALL, MEDIUM, LARGE))
    classic, sector_based = opencv.find_chessboard_classic, opencv.find_chessboard_sb
    yield from ((small, classic), (small, sector_based), (small, _thorough))
    if size < ENLARGED:
        yield from ((ENLARGEMENT, sector_based), (ENLARGEMENT, classic))
    if small < 1:
        yield from ((medium, classic), (medium, sector_based))
    if medium < 1:
        yield (large, sector_based)


def _scale(size: int, pixels: float) -> float:
    """Return the scale that leaves so many pixels, 1 if there are no more."""
    return min(1.0, float(np.sqrt(pixels / size)))


def _from_copy(corners: Array, copy: Array, gray: Array) -> Array:
    """Return corners in a copy as pixels of the image: the outer edges of both coincide."""
    scale = np.array(gray.shape[::-1]) / np.array(copy.shape[::-1])
    return np.asarray((corners + 0.5) * scale - 0.5)
