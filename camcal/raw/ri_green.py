"""The first half of `ri`: green at red and blue samples, as the difference of the colours.

Along rows and along columns every colour is estimated where it is missing: the mean of its two neighbours, corrected
by the second difference of the colour that is there, times the gain with which the two vary together nearby. Of the
differences of the colours along rows and columns, each side of a pixel counts the more the smoother it is.

All of it works on tiles of half-size planes (see `planes`), on a scale of 0 … 255.
Source: Hamilton and Adams, US patent 5629734 (second differences); Kiku et al., Beyond Color Difference, IEEE TIP 2016
(local gains); Pekkucuksen and Altunbasak, ICIP 2010 (weights by gradients); Zhang and Wu, IEEE TIP 2005 (calming).
"""

from typing import NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.raw.tiles import (
    HERE,
    Bayer,
    Plane,
    Tile,
    add_product,
    blended,
    difference,
    filtered,
    plus_scaled,
    weighted,
)

REACH = 12  # half-size pixels around a pixel that its colour difference depends on, rounded up to an even number
SMOOTHING_REACH = 8  # of green that of the differences

WIDE = np.array([0.8, 1.0, 0.8], np.float32) / np.float32(2.6)  # a window of about 7 × 7

_QUIET = 0.25  # a sum of gradients that counts as none
_LARGE = 16.0  # makes roughness large against what OpenCV adds to weights, and its square small enough for float32
_BESIDE, _BEYOND, _MIDDLE = 0.35, 0.10, 0.55  # weights of the differences on one side of a pixel, and of its own
_GAUSSIAN = np.array([0.239, 0.522, 0.239], np.float32)
_DETAIL_VARIANCE = 0.1  # variance of a colour difference that is taken for detail
_ARTEFACT_SHARE = 0.4  # how much of the variance within 3 × 3 pixels is taken for an artefact


@dataclass(frozen=True)
class Learning:
    """How the slope of one plane on another is learnt from a window.

    flat: mean square of the other plane below which the slope tends to `expected`. steepest: largest magnitude of the
    slope. noise: mean square of the other plane that is noise; the slope is multiplied by the share that is not
    (Wiener's gain).
    """

    flat: float
    steepest: float
    expected: float = 1.0
    noise: float = 0.0


# Gains may be negative: one colour rises where another falls, as at the edge of two saturated colours.
_LEARNING = Learning(flat=10.0, steepest=1.0)


class _Line(NamedTuple):
    """Green minus the other colour along rows or along columns, and how rough the side of a pixel is.

    red, blue: at the samples of these colours. by_red, by_blue: at the green samples in line with them.
    red_side, blue_side: roughness of the side towards higher indices.
    """

    red: Plane
    by_red: Plane
    blue: Plane
    by_blue: Plane
    red_side: Plane
    blue_side: Plane


def colour_differences(tile: Tile, bayer: Bayer) -> tuple[Plane, Plane]:
    """Return green minus red at the red samples and green minus blue at the blue ones."""
    rows = _line(tile, bayer.red, bayer.right, bayer.below, bayer.blue, (0, 1))
    columns = _line(tile, bayer.red, bayer.below, bayer.right, bayer.blue, (1, 0))
    at_red = _fuse(
        tile,
        _Sides(rows.red, rows.by_red, rows.red_side, (0, 1), first=True),
        _Sides(columns.red, columns.by_red, columns.red_side, (1, 0), first=True),
    )
    at_blue = _fuse(
        tile,
        _Sides(rows.blue, rows.by_blue, rows.blue_side, (0, 1), first=False),
        _Sides(columns.blue, columns.by_blue, columns.blue_side, (1, 0), first=False),
    )
    tile.give_back(*rows, *columns)
    return at_red, at_blue


def _line(tile: Tile, red: Plane, by_red: Plane, by_blue: Plane, blue: Plane, step: tuple[int, int]) -> _Line:
    """Return the differences along one direction; red and by_blue stand first in a cell of that direction."""
    red_by_red, green_at_red = _estimates(tile, red, by_red, step)
    green_at_blue, blue_by_blue = _estimates(tile, by_blue, blue, step)
    at_red, at_blue = green_at_red, green_at_blue
    np.subtract(green_at_red[HERE], red[HERE], out=at_red[HERE])
    np.subtract(green_at_blue[HERE], blue[HERE], out=at_blue[HERE])
    beside_red, beside_blue = red_by_red, blue_by_blue
    np.subtract(by_red[HERE], red_by_red[HERE], out=beside_red[HERE])
    np.subtract(by_blue[HERE], blue_by_blue[HERE], out=beside_blue[HERE])
    return _Line(
        at_red, beside_red, at_blue, beside_blue, *_roughness(tile, at_red, beside_red, at_blue, beside_blue, step)
    )


def _estimates(tile: Tile, first: Plane, second: Plane, step: tuple[int, int]) -> tuple[Plane, Plane]:
    """Return the first colour at the second one's samples, and the second at the first one's, along one direction."""
    ahead, behind = step, (-step[0], -step[1])
    first_curve = _second_difference(tile, first, ahead, behind)
    second_curve = _second_difference(tile, second, ahead, behind)
    first_at_second = _estimate(tile, first, first_curve, second_curve, ahead, behind)
    second_at_first = _estimate(tile, second, second_curve, first_curve, behind, ahead)
    tile.give_back(first_curve, second_curve)
    return first_at_second, second_at_first


def _second_difference(tile: Tile, plane: Plane, ahead: tuple[int, int], behind: tuple[int, int]) -> Plane:
    result = tile.take()
    np.add(plane[ahead], plane[behind], out=result[HERE])
    plus_scaled(result[HERE], plane[HERE], -2, result[HERE])
    return result


def _estimate(
    tile: Tile, colour: Plane, curve: Plane, other_curve: Plane, towards: tuple[int, int], away: tuple[int, int]
) -> Plane:
    """Return a colour at the samples of another, which stand half a cell `towards` its own.

    curve, other_curve: second differences of both. The gain is the slope of the regression of one on the other.
    """
    beside = tile.take()
    weighted(other_curve[HERE], 0.5, other_curve[away], 0.5, beside[HERE])
    gain = regress(tile, curve, beside, WIDE, _LEARNING, times=-0.25)
    result = beside
    weighted(colour[HERE], 0.5, colour[towards], 0.5, result[HERE])
    add_product(gain[HERE], other_curve[HERE], result[HERE])
    tile.give_back(gain)
    return result


def regress(tile: Tile, of: Plane, on: Plane, taps: Array, learning: Learning, times: float = 1.0) -> Plane:
    """Return the slope of the regression of a plane on another in windows, times a factor.

    What is regressed is a difference and has no mean of its own. The slope is found at half the plane's size and
    interpolated.
    """
    result, power = tile.take(), tile.take()
    np.multiply(of[HERE], on[HERE], out=result[HERE])
    np.multiply(on[HERE], on[HERE], out=power[HERE])
    slopes = tile.mean(result, taps, learning.expected * learning.flat)
    powers = tile.mean(power, taps, learning.flat)
    np.divide(slopes, powers, out=slopes)
    np.clip(slopes, -learning.steepest, learning.steepest, out=slopes)
    if learning.noise:
        np.divide(np.float32(-learning.noise), powers, out=powers)
        np.add(powers, np.float32(1), out=powers)
        np.maximum(powers, 0, out=powers)
        np.multiply(slopes, powers, out=slopes)
    if times != 1:
        slopes *= np.float32(times)
    tile.forget(powers)
    tile.give_back(power)
    tile.spread(slopes, result)
    return result


def _roughness(
    tile: Tile, red: Plane, by_red: Plane, blue: Plane, by_blue: Plane, step: tuple[int, int]
) -> tuple[Plane, Plane]:
    """Return how rough the differences are on the side ahead of the red and of the blue samples.

    That is the cube of the sum of their gradients along the direction, over 5 × 5 pixels from the sample on.
    """
    ahead, behind, twice = step, (-step[0], -step[1]), (2 * step[0], 2 * step[1])
    across, back = step[::-1], (-step[1], -step[0])
    at_red, at_by_red, at_blue, at_by_blue = gradients = [tile.take() for _ in range(4)]
    difference(by_red[HERE], by_red[behind], at_red[HERE])
    difference(red[HERE], red[ahead], at_by_red[HERE])
    difference(by_blue[HERE], by_blue[ahead], at_blue[HERE])
    difference(blue[HERE], blue[behind], at_by_blue[HERE])
    pairs = [tile.take() for _ in range(4)]
    for gradient, pair in zip(gradients, pairs, strict=True):
        np.add(gradient[HERE], gradient[across], out=pair[HERE])
    red_pair, by_red_pair, blue_pair, by_blue_pair = pairs
    even, odd = tile.take(), tile.take()
    # Lines of red are two lines of the mosaic apart, with a line of blue between them.
    _five(red_pair[back], at_red[across], by_blue_pair[back], even[HERE])
    _five(by_red_pair[back], at_by_red[across], blue_pair[back], odd[HERE])
    red_side = tile.take()
    np.add(even[HERE], odd[HERE], out=odd[HERE])
    np.add(odd[HERE], odd[ahead], out=red_side[HERE])
    weighted(red_side[HERE], _LARGE, even[twice], _LARGE, red_side[HERE], _LARGE * _QUIET)
    _five(blue_pair[back], at_blue[across], by_red_pair[HERE], odd[HERE])
    _five(by_blue_pair[back], at_by_blue[across], red_pair[HERE], even[HERE])
    blue_side = tile.take()
    np.add(even[HERE], odd[HERE], out=even[HERE])
    np.add(even[ahead], even[twice], out=blue_side[HERE])
    weighted(blue_side[HERE], _LARGE, odd[HERE], _LARGE, blue_side[HERE], _LARGE * _QUIET)
    for side in (red_side, blue_side):
        np.multiply(side[HERE], side[HERE], out=even[HERE])
        np.multiply(even[HERE], side[HERE], out=side[HERE])
    tile.give_back(*gradients, *pairs, even, odd)
    return red_side, blue_side


def _five(pair: Array, third: Array, between: Array, out: Array) -> None:
    """Write the sum over five lines: a pair and a third of one kind, and the pair between them."""
    np.add(pair, third, out=out)
    np.add(out, between, out=out)


class _Sides(NamedTuple):
    """The differences along one direction at samples of one colour, and at the green ones in line with them.

    roughness: of the side ahead; that of the other side stands two cells before it. first: whether the colour comes
    before green in a cell of the direction.
    """

    differences: Plane
    beside: Plane
    roughness: Plane
    step: tuple[int, int]
    first: bool


def _fuse(tile: Tile, rows: _Sides, columns: _Sides) -> Plane:
    """Return the mean of the differences on the four sides of every sample, each weighted by 1 / roughness."""
    along_rows, roughness_of_rows = _both_sides(tile, rows)
    along_columns, roughness_of_columns = _both_sides(tile, columns)
    result = along_rows
    blended(along_rows[HERE], along_columns[HERE], roughness_of_columns[HERE], roughness_of_rows[HERE], result[HERE])
    tile.give_back(roughness_of_rows, along_columns, roughness_of_columns)
    return result


def _both_sides(tile: Tile, sides: _Sides) -> tuple[Plane, Plane]:
    """Return the mean of the differences on both sides along one direction, and the roughness of the two together."""
    dy, dx = sides.step
    ahead, behind, twice_behind = sides.step, (-dy, -dx), (-2 * dy, -2 * dx)
    beside_ahead, beside_behind = (HERE, behind) if sides.first else (ahead, HERE)
    result, roughness, work = tile.take(), tile.take(), tile.take()
    rough_ahead, rough_behind = sides.roughness[HERE], sides.roughness[twice_behind]
    weighted(sides.beside[beside_ahead], _BESIDE, sides.differences[ahead], _BEYOND, result[HERE])
    weighted(sides.beside[beside_behind], _BESIDE, sides.differences[behind], _BEYOND, work[HERE])
    blended(result[HERE], work[HERE], rough_behind, rough_ahead, result[HERE])
    plus_scaled(result[HERE], sides.differences[HERE], _MIDDLE, result[HERE])
    np.multiply(rough_ahead, rough_behind, out=roughness[HERE])
    np.add(rough_ahead, rough_behind, out=work[HERE])
    np.divide(roughness[HERE], work[HERE], out=roughness[HERE])
    tile.give_back(work)
    return result, roughness


def green_from(tile: Tile, differences: Plane, samples: Plane) -> Plane:
    """Return green at the samples of a colour: the differences, calmed where they vary more than their means do.

    The differences are used up. Source: Zhang and Wu 2005, eq. 9: the linear least-squares estimate from local means
    and variances; their ratio is found at half the planes' size and interpolated.
    """
    mean, square = tile.take(), tile.take()
    filtered(differences, _GAUSSIAN, mean)
    np.subtract(differences[HERE], mean[HERE], out=differences[HERE])
    np.multiply(differences[HERE], differences[HERE], out=square[HERE])
    noise = tile.mean(square, WIDE)
    np.multiply(mean[HERE], mean[HERE], out=square[HERE])
    detail, level = tile.mean(square, WIDE, _DETAIL_VARIANCE), tile.mean(mean, WIDE)
    np.multiply(level, level, out=level)
    np.subtract(detail, level, out=detail)
    plus_scaled(detail, noise, _ARTEFACT_SHARE, noise)
    np.divide(detail, noise, out=detail)
    tile.forget(noise)
    tile.forget(level)
    tile.spread(detail, square)
    result = mean
    np.add(mean[HERE], samples[HERE], out=result[HERE])
    add_product(square[HERE], differences[HERE], result[HERE])
    tile.give_back(square, differences)
    return result
