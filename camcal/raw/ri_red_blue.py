"""The second half of `ri`: red and blue where the sensor saw something else, as what green leaves of them.

What is interpolated is the residual: red minus green times the gain with which the two vary together nearby. In the
middle of four samples the diagonal counts the more along which the residual changes less.
Source: Kiku et al., Beyond Color Difference: Residual Interpolation for Color Image Demosaicking, IEEE TIP 2016.
"""

import numpy as np

from camcal.raw.planes import HERE, Plane, Tile, add_product, blended, difference, filtered, plus_scaled, weighted

REACH = 8  # half-size pixels of green around a pixel that its red and blue depend on, rounded up to an even number

_NARROW = np.array([0.2, 1.0, 0.2], np.float32) / np.float32(1.4)  # a window of about 5 × 5
_FLAT = 20.0  # squared second difference below which the gain is not learnt and tends to 1
_STEEPEST = 1.1
_SUM = np.ones(3, np.float32)
_QUIET = 9.0  # a sum of changes over 3 × 3 pixels that counts as none


def spread_colour(
    tile: Tile, colour: Plane, green: Plane, beside: Plane, across: Plane, opposite: Plane, towards: int
) -> tuple[Plane, Plane, Plane]:
    """Return a colour at the green samples in its rows, at those in its columns, and at the opposite colour's.

    green: at the colour's samples; beside, across, opposite: at those three. towards: 1 if these come after the colour
    in a cell, -1 if before.
    """
    row, column, corner = (0, towards), (towards, 0), (towards, towards)
    gain = _gain(tile, colour, green)
    in_rows = _between_two(tile, colour, green, beside, gain, row)
    in_columns = _between_two(tile, colour, green, across, gain, column)
    at_opposite = _between_four(tile, colour, green, opposite, gain, (row, column, corner))
    tile.give_back(gain)
    return in_rows, in_columns, at_opposite


def _gain(tile: Tile, colour: Plane, green: Plane) -> Plane:
    colour_curve, green_curve = _laplacian(tile, colour), _laplacian(tile, green)
    result = tile.slope(colour_curve, green_curve, _NARROW, _FLAT, _STEEPEST)
    tile.give_back(colour_curve, green_curve)
    return result


def _laplacian(tile: Tile, plane: Plane) -> Plane:
    result = tile.take()
    np.add(plane[0, 1], plane[0, -1], out=result[HERE])
    np.add(result[HERE], plane[1, 0], out=result[HERE])
    np.add(result[HERE], plane[-1, 0], out=result[HERE])
    plus_scaled(result[HERE], plane[HERE], -4, result[HERE])
    return result


def _between_two(tile: Tile, colour: Plane, green: Plane, target: Plane, gain: Plane, step: tuple[int, int]) -> Plane:
    """Return the colour between two of its samples; target: green there."""
    result, work = tile.take(), tile.take()
    weighted(green[HERE], -0.5, green[step], -0.5, work[HERE])
    np.add(work[HERE], target[HERE], out=work[HERE])
    weighted(colour[HERE], 0.5, colour[step], 0.5, result[HERE])
    add_product(work[HERE], gain[HERE], result[HERE])
    tile.give_back(work)
    return result


def _between_four(
    tile: Tile, colour: Plane, green: Plane, target: Plane, gain: Plane, steps: tuple[tuple[int, int], ...]
) -> Plane:
    """Return the colour in the middle of four of its samples; target: green there."""
    row, column, corner = steps
    falling = _change(tile, colour, green, gain, HERE, corner)
    rising = _change(tile, colour, green, gain, row, column)
    result, residual, work = tile.take(), tile.take(), tile.take()
    for plane, means in ((green, residual), (colour, result)):
        weighted(plane[HERE], 0.5, plane[corner], 0.5, means[HERE])
        weighted(plane[row], 0.5, plane[column], 0.5, work[HERE])
        blended(means[HERE], work[HERE], rising[HERE], falling[HERE], means[HERE])
    np.subtract(target[HERE], residual[HERE], out=residual[HERE])
    add_product(residual[HERE], gain[HERE], result[HERE])
    tile.give_back(falling, rising, residual, work)
    return result


def _change(
    tile: Tile, colour: Plane, green: Plane, gain: Plane, one: tuple[int, int], other: tuple[int, int]
) -> Plane:
    """Return the square of how much the residual changes along a diagonal, summed over 3 × 3 pixels."""
    result, work = tile.take(), tile.take()
    np.subtract(green[one], green[other], out=work[HERE])
    np.multiply(work[HERE], gain[HERE], out=work[HERE])
    np.subtract(colour[one], colour[other], out=result[HERE])
    difference(result[HERE], work[HERE], result[HERE])
    filtered(result, _SUM, result, _QUIET)
    np.multiply(result[HERE], result[HERE], out=result[HERE])
    tile.give_back(work)
    return result
