"""The filters that OpenCV has or that are a line: colour as means of neighbours, a cell as a pixel, green alone."""

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.raw.mosaic import sites

# OpenCV's two-letter names count from the second row and column; the four-letter names mean the first cell.
_BILINEAR = {
    "RGGB": cv2.COLOR_BayerRGGB2BGR,
    "GRBG": cv2.COLOR_BayerGRBG2BGR,
    "GBRG": cv2.COLOR_BayerGBRG2BGR,
    "BGGR": cv2.COLOR_BayerBGGR2BGR,
}
_EDGE_AWARE = {
    "RGGB": cv2.COLOR_BayerBG2BGR_EA,
    "GRBG": cv2.COLOR_BayerGB2BGR_EA,
    "GBRG": cv2.COLOR_BayerGR2BGR_EA,
    "BGGR": cv2.COLOR_BayerRG2BGR_EA,
}
_MARGIN = 4  # an even number of pixels keeps the phase; OpenCV leaves the outermost ones unfinished

_RED_OR_BLUE = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]], np.float32) / 4
_GREEN = np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]], np.float32) / 4
_KERNELS = {"B": _RED_OR_BLUE, "G": _GREEN, "R": _RED_OR_BLUE}


def bilinear(values: Array, pattern: str) -> Array:
    """Return every missing colour as the mean of its nearest samples: two or four of them."""
    if values.dtype in (np.uint8, np.uint16):
        return by_opencv(values, _BILINEAR[pattern])
    return cv2.merge([_spread(values.astype(np.float32, copy=False), pattern, colour) for colour in "BGR"])


def edge_aware(values: Array, pattern: str) -> Array:
    """Return OpenCV's edge-aware colour of a mosaic of uint8 or uint16."""
    return by_opencv(values, _EDGE_AWARE[pattern])


def half(values: Array, pattern: str) -> Array:
    """Return one pixel per cell (H // 2, W // 2, 3): blue, the mean of both greens, red.

    Its pixel (x, y) stands for (2 x + 0.5, 2 y + 0.5) of the mosaic. A last odd row or column is left out.
    """
    whole = values[: len(values) // 2 * 2, : values.shape[1] // 2 * 2]
    (red,), (blue,), (first, second) = (sites(pattern, colour) for colour in "RBG")
    green = cv2.addWeighted(whole[first], 0.5, whole[second], 0.5, 0)
    return cv2.merge([whole[blue], green, whole[red]])


def green(values: Array, pattern: str) -> Array:
    """Return green (H, W): its samples, and between them the mean of their four neighbours."""
    plane = _spread(values.astype(np.float32), pattern, "G")
    return plane if values.dtype == np.float32 else np.rint(plane).astype(values.dtype)


def by_opencv(values: Array, code: int) -> Array:
    """Return the colour that OpenCV makes under a code of its own, the mosaic continued as its mirror image."""
    margin = (_MARGIN,) * 4
    padded = cv2.copyMakeBorder(values, *margin, borderType=cv2.BORDER_REFLECT_101)
    return cv2.demosaicing(padded, code)[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN]


def _spread(values: Array, pattern: str, colour: str) -> Array:
    """Return a colour's samples and the means between them: a convolution of the samples, all other pixels zero."""
    plane = np.zeros_like(values)
    for site in sites(pattern, colour):
        plane[site] = values[site]
    return cv2.filter2D(plane, -1, _KERNELS[colour], dst=plane, borderType=cv2.BORDER_REFLECT_101)
