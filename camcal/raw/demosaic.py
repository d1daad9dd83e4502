"""From one colour sample per pixel to three: the demosaicing filters.

Colour comes back as (H, W, 3) in the order blue, green, red, as everywhere in this package.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.raw.mosaic import require_pattern, sites

BILINEAR = "bilinear"
NONE = "none"

# OpenCV's two-letter names count from the second row and column; the four-letter names mean the first cell.
_CODES = {
    "RGGB": cv2.COLOR_BayerRGGB2BGR,
    "GRBG": cv2.COLOR_BayerGRBG2BGR,
    "GBRG": cv2.COLOR_BayerGBRG2BGR,
    "BGGR": cv2.COLOR_BayerBGGR2BGR,
}
_MARGIN = 2  # an even number of pixels keeps the phase; OpenCV leaves the outermost one unfinished

_RED_OR_BLUE = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]], np.float32) / 4
_GREEN = np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]], np.float32) / 4
_KERNELS = {"B": _RED_OR_BLUE, "G": _GREEN, "R": _RED_OR_BLUE}


def demosaic(values: Array, pattern: str, algorithm: str = BILINEAR) -> Array:
    """Return colour (H, W, 3) blue, green, red of a mosaic, in its own type; for "none" the mosaic (H, W) itself.

    values: (H, W) uint8, uint16 or float32, at least 2 × 2; white balance belongs before this step.
    Outside the border the mosaic continues as its mirror image about the border pixels, which keeps the colours.
    Raises InvalidInput for an unknown pattern or algorithm, or a mosaic without a whole cell.
    """
    require_pattern(pattern)
    require_algorithm(algorithm)
    if values.ndim != 2 or min(values.shape) < 2:
        raise InvalidInput(f"a mosaic needs at least 2 × 2 pixels of one channel, found the shape {values.shape}")
    return ALGORITHMS[algorithm](values, pattern)


def require_algorithm(algorithm: str) -> str:
    """Return the algorithm; raises InvalidInput unless it exists."""
    if algorithm not in ALGORITHMS:
        raise InvalidInput(f"algorithm {algorithm!r} does not exist; use one of {', '.join(ALGORITHMS)}")
    return algorithm


def _untouched(values: Array, pattern: str) -> Array:  # noqa: ARG001
    return values


def _bilinear(values: Array, pattern: str) -> Array:
    """Return every missing colour as the mean of its nearest samples: two or four of them."""
    if values.dtype in (np.uint8, np.uint16):
        return _bilinear_integer(values, pattern)
    return _bilinear_float(values.astype(np.float32, copy=False), pattern)


def _bilinear_integer(values: Array, pattern: str) -> Array:
    margin = (_MARGIN,) * 4
    padded = cv2.copyMakeBorder(values, *margin, borderType=cv2.BORDER_REFLECT_101)
    return cv2.demosaicing(padded, _CODES[pattern])[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN]


def _bilinear_float(values: Array, pattern: str) -> Array:
    """Return the same means as a convolution of each colour's samples, all other pixels zero."""
    planes = [np.zeros_like(values) for _ in "BGR"]
    for plane, colour in zip(planes, "BGR", strict=True):
        for site in sites(pattern, colour):
            plane[site] = values[site]
        cv2.filter2D(plane, -1, _KERNELS[colour], dst=plane, borderType=cv2.BORDER_REFLECT_101)
    return cv2.merge(planes)


ALGORITHMS: Mapping[str, Callable[[Array, str], Array]] = MappingProxyType({BILINEAR: _bilinear, NONE: _untouched})
