"""`vng`: demosaicing by a variable number of gradients.

Around every sample eight directions are examined, and only those count along which the mosaic changes little.
Source: Chang, Cheung and Pang, Color filter array recovery using a threshold-based variable number of gradients,
SPIE 3650, 1999.
"""

from functools import cache
from itertools import groupby
from typing import NamedTuple

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.raw.linear_filters import by_opencv
from camcal.raw.planes import HERE, Each, Plane, Tile, difference, one_by_one, plus_scaled, weighted
from camcal.raw.tiling import PLACES, Bayer, Counts, Missing, TiledMosaic

# OpenCV's two-letter names count from the second row and column.
_EIGHT_BITS = {
    "RGGB": cv2.COLOR_BayerBG2BGR_VNG,
    "GRBG": cv2.COLOR_BayerGB2BGR_VNG,
    "GBRG": cv2.COLOR_BayerGR2BGR_VNG,
    "BGGR": cv2.COLOR_BayerRG2BGR_VNG,
}
_REACH = 2  # cells
_TILE = (64, 512)  # cells; smaller than other filters', for more planes are in use at a time

_Step = tuple[int, int]  # rows down and columns to the right of the sample


class _GradientDirection(NamedTuple):
    """A direction: the pairs of samples whose differences, each with its weight, make its gradient; what is seen there.

    seen: samples, those of one colour next to each other; their mean is that colour in this direction.
    """

    changes: tuple[tuple[_Step, _Step, float], ...]
    seen: tuple[_Step, ...]

    def turned(self) -> "_GradientDirection":
        """Return the way after a quarter turn."""
        changes = tuple((_turned(one), _turned(other), weight) for one, other, weight in self.changes)
        return _GradientDirection(changes, tuple(map(_turned, self.seen)))


def _turned(step: _Step) -> _Step:
    return step[1], -step[0]


def _all_around(*ways: _GradientDirection) -> list[_GradientDirection]:
    """Return the ways and what three quarter turns make of them."""
    found = list(ways)
    for _ in range(3):
        found += [way.turned() for way in found[-len(ways) :]]
    return found


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


def vng(values: Array, pattern: str, white: float, *, each: Each = one_by_one, tile: tuple[int, int] = _TILE) -> Array:
    """Return colour (H, W, 3) blue, green, red of a Bayer mosaic (H, W), in its own type, nothing above `white`.

    each, tile: see `residual.residual_interpolation`. Eight bits are left to OpenCV, which is several times faster
    and has nothing for other types.
    """
    if values.dtype == np.uint8:
        return np.minimum(by_opencv(values, _EIGHT_BITS[pattern]), np.uint8(white))
    return TiledMosaic(values, pattern, _REACH, Counts(white)).in_one_pass(_missing, each, tile)


def _missing(tile: Tile, bayer: Bayer) -> Missing:
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
def _located(place: int, step: _Step) -> tuple[int, _Step]:
    """Return the place within the cell, and the step in cells, that a step from a place leads to."""
    (down, row), (right, column) = (divmod(start + way, 2) for start, way in zip(divmod(place, 2), step, strict=True))
    return 2 * row + column, (down, right)


class _Surroundings:
    """A tile as the samples of one place of the cell see it: [dy, dx] is the sample that far down and right."""

    def __init__(self, bayer: Bayer, place: int) -> None:
        self._bayer, self._place = bayer, place
        self.colour = PLACES[place]

    def __getitem__(self, step: _Step) -> Array:
        place, cell = _located(self._place, step)
        return self._bayer[place][cell]

    def colour_at(self, step: _Step) -> str:
        return PLACES[_located(self._place, step)[0]]


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
    own = sums.pop(around.colour)
    for plane in sums.values():
        np.subtract(plane[HERE], own[HERE], out=plane[HERE])
        np.divide(plane[HERE], count[HERE], out=plane[HERE])
        np.add(plane[HERE], around[HERE], out=plane[HERE])
    tile.give_back(*gradients, threshold, count, work, own)
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
