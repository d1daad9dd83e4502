"""Demosaicing by linear filters: `malvar`, those of OpenCV, and simple ones.

`malvar` has 5 × 5 filters, on half-size planes; the others are means of neighbours, a cell as a pixel, green alone.
Source: Malvar, He and Cutler, High-quality linear interpolation for demosaicing of Bayer-patterned color images,
ICASSP 2004; gains 1/2, 5/8 and 3/4.
"""

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.raw.mosaic import sites
from camcal.raw.planes import HERE, Each, Plane, Tile, one_by_one, plus_scaled, weighted
from camcal.raw.tiling import TILE, Bayer, Counts, Missing, TiledMosaic

_REACH = 2  # cells

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


def malvar(
    values: Array, pattern: str, white: float, *, each: Each = one_by_one, tile: tuple[int, int] = TILE
) -> Array:
    """Return colour (H, W, 3) blue, green, red of a Bayer mosaic (H, W), in its own type, nothing above `white`.

    each, tile: see `residual.residual_interpolation`.
    """
    return TiledMosaic(values, pattern, _REACH, Counts(white)).in_one_pass(_missing, each, tile)


def _missing(tile: Tile, bayer: Bayer) -> Missing:
    red, right, below, blue = bayer
    green_at_red, blue_at_red = _at_colour(tile, red, right, below, blue, -1)
    green_at_blue, red_at_blue = _at_colour(tile, blue, below, right, red, 1)
    red_right, blue_right = _at_green(tile, right, below, red, blue, 1)
    blue_below, red_below = _at_green(tile, below, right, blue, red, -1)
    return Missing(
        green_at_red=green_at_red,
        green_at_blue=green_at_blue,
        red_right=red_right,
        red_below=red_below,
        red_at_blue=red_at_blue,
        blue_right=blue_right,
        blue_below=blue_below,
        blue_at_red=blue_at_red,
    )


def _at_colour(
    tile: Tile, colour: Plane, beside: Plane, across: Plane, opposite: Plane, other: int
) -> tuple[Plane, Plane]:
    """Return green and the opposite colour at the samples of red or blue.

    beside, across: green in its rows and in its columns. other: where the second neighbour on each side is, -1 or 1.
    """
    row, column, corner = (0, other), (other, 0), (other, other)
    curve, green, result = tile.take(), tile.take(), tile.take()
    _sum(colour, ((0, 1), (0, -1), (1, 0), (-1, 0)), curve)
    plus_scaled(curve[HERE], colour[HERE], -4, curve[HERE])
    np.add(beside[HERE], beside[row], out=green[HERE])
    np.add(green[HERE], across[HERE], out=green[HERE])
    np.add(green[HERE], across[column], out=green[HERE])
    weighted(green[HERE], 1 / 4, curve[HERE], -1 / 8, green[HERE])
    _sum(opposite, (HERE, row, column, corner), result)
    weighted(result[HERE], 1 / 4, curve[HERE], -3 / 16, result[HERE])
    tile.give_back(curve)
    return green, result


def _at_green(
    tile: Tile, green: Plane, diagonal: Plane, in_row: Plane, in_column: Plane, after: int
) -> tuple[Plane, Plane]:
    """Return the colour that stands in its row, and the one in its column, at green samples.

    diagonal: the other green samples. after: where the second neighbour in the row is; in the column it is opposite.
    """
    along, down, around = tile.take(), tile.take(), tile.take()
    np.add(green[0, 1], green[0, -1], out=along[HERE])
    np.add(green[1, 0], green[-1, 0], out=down[HERE])
    _sum(diagonal, (HERE, (0, after), (-after, 0), (-after, after)), around)
    weighted(green[HERE], 5, around[HERE], -1, around[HERE])
    results = []
    for colour, step, same, other in (
        (in_row, (0, after), along, down),
        (in_column, (-after, 0), down, along),
    ):
        result = tile.take()
        np.add(colour[HERE], colour[step], out=result[HERE])
        weighted(result[HERE], 1 / 2, around[HERE], 1 / 8, result[HERE])
        plus_scaled(result[HERE], same[HERE], -1 / 8, result[HERE])
        plus_scaled(result[HERE], other[HERE], 1 / 16, result[HERE])
        results.append(result)
    tile.give_back(along, down, around)
    first, second = results
    return first, second


def _sum(plane: Plane, steps: tuple[tuple[int, int], ...], out: Plane) -> None:
    """Write the sum of a plane seen from four steps."""
    first, second, third, fourth = steps
    np.add(plane[first], plane[second], out=out[HERE])
    np.add(out[HERE], plane[third], out=out[HERE])
    np.add(out[HERE], plane[fourth], out=out[HERE])


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
