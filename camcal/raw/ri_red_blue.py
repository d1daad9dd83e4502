"""The second half of `ri`: red and blue where the sensor saw something else, as what green leaves of them.

What is interpolated is the residual: red minus green times the gain with which the two vary together nearby. First
comes the middle of four samples, where the opposite colour stands, then the green samples between two samples and two
such middles. The direction counts the more along which the residual changes less. Where green is flat but red and blue
are not, as at the edge of red and blue, the second difference of the opposite colour's residual corrects the middles.
Source: Kiku et al., Beyond Color Difference: Residual Interpolation for Color Image Demosaicking, IEEE TIP 2016;
Hamilton and Adams, US patent 5629734 (second differences).
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from camcal.raw.planes import (
    HERE,
    Learning,
    Plane,
    Tile,
    add_product,
    blended,
    difference,
    filtered,
    plus_scaled,
    weighted,
)
from camcal.raw.tiling import Bayer, Missing

REACH = 12  # half-size pixels of green around a pixel that its red and blue depend on, rounded up to an even number

_NARROW = np.array([0.2, 1.0, 0.2], np.float32) / np.float32(1.4)  # a window of about 5 × 5
_ON_GREEN = Learning(flat=20.0, steepest=1.1)
_ON_OPPOSITE = Learning(flat=1000.0, steepest=1.0, expected=0.0)
_LAPLACIAN_NOISE = 12.0  # variance of the second difference of interpolated green, in that of a green sample's noise
_CORRECTION = -0.25  # of the second difference over two pixels, of a mean of neighbours
_SUM = np.ones(3, np.float32)
_QUIET = 40.0  # a sum of changes over 3 × 3 pixels that counts as none

Shift = tuple[int, int]


class _Colour(NamedTuple):
    """Red or blue: its samples, green there, their gain, and the second difference of what green leaves."""

    samples: Plane
    green: Plane
    gain: Plane
    curve: Plane


class _Full(NamedTuple):
    """The three colours at the samples of red or of blue."""

    red: Plane
    green: Plane
    blue: Plane


def red_and_blue(tile: Tile, bayer: Bayer, green_at_red: Plane, green_at_blue: Plane, noise: float) -> Missing:
    """Return what the cells lack; green at red and blue is handed through. noise: variance of green samples."""
    learning = replace(_ON_GREEN, noise=_LAPLACIAN_NOISE * noise)
    red = _residual(tile, bayer.red, green_at_red, learning)
    blue = _residual(tile, bayer.blue, green_at_blue, learning)
    at_blue = _Full(_between_four(tile, red, blue, 1), green_at_blue, bayer.blue)
    at_red = _Full(bayer.red, green_at_red, _between_four(tile, blue, red, -1))
    tile.give_back(red.curve, blue.curve)
    gains = red.gain, blue.gain
    red_right, blue_right = _at_green(tile, bayer.right, gains, (at_red, (0, 1)), (at_blue, (-1, 0)))
    red_below, blue_below = _at_green(tile, bayer.below, gains, (at_blue, (0, -1)), (at_red, (1, 0)))
    tile.give_back(*gains)
    return Missing(
        green_at_red=green_at_red,
        green_at_blue=green_at_blue,
        red_right=red_right,
        red_below=red_below,
        red_at_blue=at_blue.red,
        blue_right=blue_right,
        blue_below=blue_below,
        blue_at_red=at_red.blue,
    )


def _residual(tile: Tile, samples: Plane, green: Plane, learning: Learning) -> _Colour:
    curve, green_curve = _laplacian(tile, samples), _laplacian(tile, green)
    gain = tile.slope(curve, green_curve, _NARROW, learning)
    np.multiply(green_curve[HERE], gain[HERE], out=green_curve[HERE])
    np.subtract(curve[HERE], green_curve[HERE], out=curve[HERE])
    tile.give_back(green_curve)
    return _Colour(samples, green, gain, curve)


def _laplacian(tile: Tile, plane: Plane) -> Plane:
    result = tile.take()
    np.add(plane[0, 1], plane[0, -1], out=result[HERE])
    np.add(result[HERE], plane[1, 0], out=result[HERE])
    np.add(result[HERE], plane[-1, 0], out=result[HERE])
    plus_scaled(result[HERE], plane[HERE], -4, result[HERE])
    return result


def _between_four(tile: Tile, colour: _Colour, opposite: _Colour, towards: int) -> Plane:
    """Return a colour at the samples of the opposite one, each in the middle of four of its own.

    towards: 1 if the opposite colour comes after this one in a cell, -1 if before.
    """
    row, column, corner = (0, towards), (towards, 0), (towards, towards)
    falling = _change(tile, colour, HERE, corner)
    rising = _change(tile, colour, row, column)
    result, level, work = tile.take(), tile.take(), tile.take()
    for plane, means in ((colour.green, level), (colour.samples, result)):
        weighted(plane[HERE], 0.5, plane[corner], 0.5, means[HERE])
        weighted(plane[row], 0.5, plane[column], 0.5, work[HERE])
        blended(means[HERE], work[HERE], rising[HERE], falling[HERE], means[HERE])
    np.subtract(opposite.green[HERE], level[HERE], out=level[HERE])
    add_product(level[HERE], colour.gain[HERE], result[HERE])
    share = _slope_on_opposite(tile, colour.curve, opposite.curve, towards)
    add_product(share[HERE], opposite.curve[HERE], result[HERE])
    tile.give_back(falling, rising, level, work, share)
    return result


def _slope_on_opposite(tile: Tile, curve: Plane, opposite: Plane, towards: int) -> Plane:
    """Return what the second difference of the opposite colour's residual adds to the mean of four samples."""
    beside = tile.take()
    weighted(opposite[HERE], 0.25, opposite[0, -towards], 0.25, beside[HERE])
    plus_scaled(beside[HERE], opposite[-towards, 0], 0.25, beside[HERE])
    plus_scaled(beside[HERE], opposite[-towards, -towards], 0.25, beside[HERE])
    share = tile.slope(curve, beside, _NARROW, _ON_OPPOSITE, times=_CORRECTION)
    tile.give_back(beside)
    return share


def _change(tile: Tile, colour: _Colour, one: Shift, other: Shift) -> Plane:
    """Return the cube of how much the residual changes from one sample to another, summed over 3 × 3 pixels."""
    step = tile.take()
    np.subtract(colour.green[one], colour.green[other], out=step[HERE])
    change = _residual_change(tile, colour.samples, colour.gain, step, one, other)
    tile.give_back(step)
    return _roughness(tile, change)


def _residual_change(tile: Tile, colour: Plane, gain: Plane, green_step: Plane, one: Shift, other: Shift) -> Plane:
    """Return by how much a colour changes more than its gain makes of the change of green."""
    result, work = tile.take(), tile.take()
    np.multiply(green_step[HERE], gain[HERE], out=work[HERE])
    np.subtract(colour[one], colour[other], out=result[HERE])
    difference(result[HERE], work[HERE], result[HERE])
    tile.give_back(work)
    return result


def _roughness(tile: Tile, change: Plane) -> Plane:
    """Return the cube of changes summed over 3 × 3 pixels; they are used up."""
    filtered(change, _SUM, change, _QUIET)
    result = tile.take()
    np.multiply(change[HERE], change[HERE], out=result[HERE])
    np.multiply(result[HERE], change[HERE], out=result[HERE])
    tile.give_back(change)
    return result


def _at_green(
    tile: Tile, green: Plane, gains: tuple[Plane, Plane], in_row: tuple[_Full, Shift], in_column: tuple[_Full, Shift]
) -> tuple[Plane, Plane]:
    """Return red and blue at green samples, each between two pixels in its row and two in its column.

    in_row, in_column: the colours at one of the two, and where the other one stands. gains: of red and of blue.
    """
    row, column = (_change_of_both(tile, full, gains, shift) for full, shift in (in_row, in_column))
    level = _blend_of_means(tile, "green", in_row, in_column, row, column)
    np.subtract(green[HERE], level[HERE], out=level[HERE])
    red, blue = (_blend_of_means(tile, colour, in_row, in_column, row, column) for colour in ("red", "blue"))
    for colour, gain in zip((red, blue), gains, strict=True):
        add_product(level[HERE], gain[HERE], colour[HERE])
    tile.give_back(row, column, level)
    return red, blue


def _change_of_both(tile: Tile, full: _Full, gains: tuple[Plane, Plane], shift: Shift) -> Plane:
    """Return the cube of how much the residuals of red and blue change between two pixels, over 3 × 3 pixels."""
    step = tile.take()
    np.subtract(full.green[HERE], full.green[shift], out=step[HERE])
    of_red, of_blue = (
        _residual_change(tile, colour, gain, step, HERE, shift)
        for colour, gain in zip((full.red, full.blue), gains, strict=True)
    )
    np.add(of_red[HERE], of_blue[HERE], out=of_red[HERE])
    tile.give_back(step, of_blue)
    return _roughness(tile, of_red)


def _blend_of_means(
    tile: Tile, colour: str, in_row: tuple[_Full, Shift], in_column: tuple[_Full, Shift], row: Plane, column: Plane
) -> Plane:
    """Return the means of a colour in rows and in columns, each weighted by the roughness of the other."""
    result, work = tile.take(), tile.take()
    for (full, shift), means in ((in_row, result), (in_column, work)):
        plane: Plane = getattr(full, colour)
        weighted(plane[HERE], 0.5, plane[shift], 0.5, means[HERE])
    blended(result[HERE], work[HERE], column[HERE], row[HERE], result[HERE])
    tile.give_back(work)
    return result
