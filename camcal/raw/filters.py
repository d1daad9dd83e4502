"""Demosaicing by filters: `malvar`, `vng`, those of OpenCV, and simple ones.

`malvar` has 5 × 5 linear filters, on half-size planes. For `vng`, a variable number of gradients, eight directions are
examined around every sample, and only those count along which the mosaic changes little. The others are means of
neighbours, a cell as a pixel, green alone.
Sources: Malvar, He and Cutler, High-quality linear interpolation for demosaicing of Bayer-patterned color images,
ICASSP 2004; gains 1/2, 5/8 and 3/4. Chang, Cheung and Pang, Color filter array recovery using a threshold-based
variable number of gradients, SPIE 3650, 1999.
"""

from functools import cache
from itertools import groupby
from typing import NamedTuple

import cv2
import numpy as np

from camcal import opencv
from camcal.arrays import Array
from camcal.raw.mosaic import sites
from camcal.raw.tiles import (
    HERE,
    PLACES,
    TILE,
    Bayer,
    Each,
    Missing,
    Plane,
    Scale,
    Tile,
    TiledMosaic,
    difference,
    one_by_one,
    plus_scaled,
    weighted,
)

_REACH = 2  # cells

_RED_OR_BLUE = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]], np.float32) / 4
_GREEN = np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]], np.float32) / 4
_KERNELS = {"B": _RED_OR_BLUE, "G": _GREEN, "R": _RED_OR_BLUE}


def malvar(
    values: Array, pattern: str, white: float, *, each: Each = one_by_one, tile: tuple[int, int] = TILE
) -> Array:
    """Return colour (H, W, 3) blue, green, red of a Bayer mosaic (H, W), in its own type, nothing above `white`.

    each, tile: see `residual.residual_interpolation`.
    """
    return TiledMosaic(values, pattern, _REACH, Scale(white)).in_one_pass(_find_by_lines, each, tile)


def _find_by_lines(tile: Tile, bayer: Bayer) -> Missing:
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
        return opencv.demosaiced(values, opencv.BILINEAR[pattern])
    return cv2.merge([_spread(values.astype(np.float32, copy=False), pattern, colour) for colour in "BGR"])


def edge_aware(values: Array, pattern: str) -> Array:
    """Return OpenCV's edge-aware colour of a mosaic of uint8 or uint16."""
    return opencv.demosaiced(values, opencv.EDGE_AWARE[pattern])


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


def _spread(values: Array, pattern: str, colour: str) -> Array:
    """Return a colour's samples and the means between them: a convolution of the samples, all other pixels zero."""
    plane = np.zeros_like(values)
    for site in sites(pattern, colour):
        plane[site] = values[site]
    return cv2.filter2D(plane, -1, _KERNELS[colour], dst=plane, borderType=cv2.BORDER_REFLECT_101)


# OpenCV's two-letter names count from the second row and column.
_EIGHT_BITS = {
    "RGGB": cv2.COLOR_BayerBG2BGR_VNG,
    "GRBG": cv2.COLOR_BayerGB2BGR_VNG,
    "GBRG": cv2.COLOR_BayerGR2BGR_VNG,
    "BGGR": cv2.COLOR_BayerRG2BGR_VNG,
}
_VNG_TILE = (64, 512)  # cells; smaller than other filters', for more planes are in use at a time

_Step = tuple[int, int]  # rows down and columns to the right of the sample


class _GradientDirection(NamedTuple):
    """A direction: the pairs of samples whose differences, each with its weight, make its gradient; what is seen there.

    seen: samples, those of one colour next to each other; their mean is that colour in this direction.
    """

    changes: tuple[tuple[_Step, _Step, float], ...]
    seen: tuple[_Step, ...]

    def turned(self) -> "_GradientDirection":
        """Return the way after a quarter turn."""
        changes = tuple((_turn(one), _turn(other), weight) for one, other, weight in self.changes)
        return _GradientDirection(changes, tuple(map(_turn, self.seen)))


def _turn(step: _Step) -> _Step:
    return step[1], -step[0]


def _all_around(*ways: _GradientDirection) -> list[_GradientDirection]:
    """Return the ways and what three quarter turns make of them."""
    directions = list(ways)
    for _ in range(3):
        directions += [way.turned() for way in directions[-len(ways) :]]
    return directions


_UP = (
    ((-1, 0), (1, 0), 1.0),
    ((-2, 0), (0, 0), 1.0),
    ((-1, -1), (1, -1), 0.5),
    ((-1, 1), (1, 1), 0.5),
    ((-2, -1), (0, -1), 0.5),
    ((-2, 1), (0, 1), 0.5),
)
_UP_RIGHT = (((-1, 1), (1, -1), 1.0), ((-2, 2), (0, 0), 1.0))
_GREEN_UP_RIGHT = (
    ((-1, 0), (0, -1), 0.5),
    ((0, 1), (1, 0), 0.5),
    ((-2, 1), (-1, 0), 0.5),
    ((-1, 2), (0, 1), 0.5),
)
_COLOURS_UP_RIGHT = (((-2, 1), (0, -1), 1.0), ((-1, 2), (1, 0), 1.0))

_AROUND_COLOUR = _all_around(
    _GradientDirection(_UP, ((-2, 0), (0, 0), (-1, 0), (-1, -1), (-1, 1))),
    _GradientDirection(_UP_RIGHT + _GREEN_UP_RIGHT, ((-2, 2), (0, 0), (-1, 1), (-2, 1), (-1, 2), (-1, 0), (0, 1))),
)
_AROUND_GREEN = _all_around(
    _GradientDirection(_UP, ((-2, 0), (0, 0), (-1, 0), (-2, -1), (-2, 1), (0, -1), (0, 1))),
    _GradientDirection(_UP_RIGHT + _COLOURS_UP_RIGHT, ((-1, 1), (-1, 0), (-1, 2), (-2, 1), (0, 1))),
)


def vng(
    values: Array, pattern: str, white: float, *, each: Each = one_by_one, tile: tuple[int, int] = _VNG_TILE
) -> Array:
    """Return colour (H, W, 3) blue, green, red of a Bayer mosaic (H, W), in its own type, nothing above `white`.

    each, tile: see `residual.residual_interpolation`. Eight bits are left to OpenCV, which is several times faster
    and has nothing for other types.
    """
    if values.dtype == np.uint8:
        return np.minimum(opencv.demosaiced(values, _EIGHT_BITS[pattern]), np.uint8(white))
    return TiledMosaic(values, pattern, _REACH, Scale(white)).in_one_pass(_find_by_gradients, each, tile)


def _find_by_gradients(tile: Tile, bayer: Bayer) -> Missing:
    red, right, below, blue = (_find_missing(tile, _Surroundings(bayer, place)) for place in range(len(PLACES)))
    return Missing(
        green_at_red=red["G"],
        green_at_blue=blue["G"],
        red_right=right["R"],
        red_below=below["R"],
        red_at_blue=blue["R"],
        blue_right=right["B"],
        blue_below=below["B"],
        blue_at_red=red["B"],
    )


@cache
def _locate(place: int, step: _Step) -> tuple[int, _Step]:
    """Return the place within the cell, and the step in cells, that a step from a place leads to."""
    (down, row), (right, column) = (divmod(start + way, 2) for start, way in zip(divmod(place, 2), step, strict=True))
    return 2 * row + column, (down, right)


class _Surroundings:
    """A tile as the samples of one place of the cell see it: [dy, dx] is the sample that far down and right."""

    def __init__(self, bayer: Bayer, place: int) -> None:
        self._bayer, self._place = bayer, place
        self.colour = PLACES[place]

    def __getitem__(self, step: _Step) -> Array:
        place, cell = _locate(self._place, step)
        return self._bayer[place][cell]

    def colour_at(self, step: _Step) -> str:
        return PLACES[_locate(self._place, step)[0]]


def _find_missing(tile: Tile, around: _Surroundings) -> dict[str, Plane]:
    """Return the colours that samples lack: themselves plus the mean difference of the colours in the smooth ways."""
    ways = _AROUND_GREEN if around.colour == "G" else _AROUND_COLOUR
    gradients = [_gradient(tile, around, way) for way in ways]
    threshold = _threshold(tile, gradients)
    count, work = tile.take(), tile.take()
    count.image.fill(0)
    sums = {colour: tile.take() for colour in "RGB"}
    for plane in sums.values():
        plane.image.fill(0)
    for gradient, way in zip(gradients, ways, strict=True):
        smooth = gradient
        np.less_equal(gradient[HERE], threshold[HERE], out=smooth[HERE])
        np.add(count[HERE], smooth[HERE], out=count[HERE])
        for colour, steps in groupby(way.seen, around.colour_at):
            np.multiply(_mean(around, list(steps), work), smooth[HERE], out=work[HERE])
            np.add(sums[colour][HERE], work[HERE], out=sums[colour][HERE])
    of_own_colour = sums.pop(around.colour)
    for plane in sums.values():
        np.subtract(plane[HERE], of_own_colour[HERE], out=plane[HERE])
        np.divide(plane[HERE], count[HERE], out=plane[HERE])
        np.add(plane[HERE], around[HERE], out=plane[HERE])
    tile.give_back(*gradients, threshold, count, work, of_own_colour)
    return sums


def _gradient(tile: Tile, around: _Surroundings, way: _GradientDirection) -> Plane:
    result, change = tile.take(), tile.take()
    result.image.fill(0)
    for one, other, weight in way.changes:
        difference(around[one], around[other], change[HERE])
        plus_scaled(result[HERE], change[HERE], weight, result[HERE])
    tile.give_back(change)
    return result


def _threshold(tile: Tile, gradients: list[Plane]) -> Plane:
    """Return the largest gradient that counts as smooth: 1.5 times the least, plus half of their range."""
    least, greatest = tile.take(), tile.take()
    first, *others = gradients
    np.copyto(least[HERE], first[HERE])
    np.copyto(greatest[HERE], first[HERE])
    for gradient in others:
        cv2.min(least[HERE], gradient[HERE], least[HERE])
        cv2.max(greatest[HERE], gradient[HERE], greatest[HERE])
    weighted(least[HERE], 1, greatest[HERE], 0.5, least[HERE])
    tile.give_back(greatest)
    return least


def _mean(around: _Surroundings, steps: list[_Step], out: Plane) -> Array:
    """Return the mean of one, two or four samples, in the plane if it has to be computed."""
    if len(steps) == 1:
        return around[steps[0]]
    first, second, *others = (around[step] for step in steps)
    weighted(first, 1 / len(steps), second, 1 / len(steps), out[HERE])
    for other in others:
        plus_scaled(out[HERE], other, 1 / len(steps), out[HERE])
    return out[HERE]
