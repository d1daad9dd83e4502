"""`ri`: demosaicing by residual interpolation, in two passes over tiles that stay in the processor's cache.

The first pass is in `ri_green`. The second finds red and blue where the sensor saw something else. What is interpolated
is the residual: red minus green times the gain with which the two vary together nearby. First comes the middle of four
samples, where the opposite colour stands, then the green samples between two samples and two such middles. The
direction counts the more along which the residual changes less. Where green is flat but red and blue are not, as at the
edge of red and blue, the second difference of the opposite colour's residual corrects the middles.

How noisy the green samples of a mosaic are is told by the mosaic itself. Second differences along both diagonals leave
nothing of a plane, and little of anything smooth. The least of their mean squares over blocks is that of a block
without detail: it is noise. Blocks whose samples are cut off at black or at white say too little.
Sources: Kiku et al., Beyond Color Difference: Residual Interpolation for Color Image Demosaicking, IEEE TIP 2016;
Hamilton and Adams, US patent 5629734 (second differences); J. Immerkær, Fast Noise Variance Estimation, CVIU 1996 (the
filter, here on the diagonal grid of green).
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.raw import ri_green
from camcal.raw.tiles import (
    HERE,
    TILE,
    WHITE,
    Bayer,
    Box,
    Each,
    Missing,
    Plane,
    Root,
    Scale,
    Tile,
    TiledMosaic,
    add_product,
    blended,
    boxes,
    detail_balance,
    difference,
    filtered,
    one_by_one,
    plus_scaled,
    weighted,
)

RED_BLUE_REACH = 12  # half-size pixels of green that red and blue of a pixel depend on, rounded up to an even number

_NARROW = np.array([0.2, 1.0, 0.2], np.float32) / np.float32(1.4)  # a window of about 5 × 5
_ON_GREEN = ri_green.Learning(flat=20.0, steepest=1.1)
_ON_OPPOSITE = ri_green.Learning(flat=1000.0, steepest=1.0, expected=0.0)
_LAPLACIAN_NOISE = 12.0  # variance of the second difference of interpolated green, in that of a green sample's noise
_CORRECTION = -0.25  # of the second difference over two pixels, of a mean of neighbours
_SUM = np.ones(3, np.float32)
_QUIET = 40.0  # a sum of changes over 3 × 3 pixels that counts as none
_COLOUR_REACH = ri_green.SMOOTHING_REACH + RED_BLUE_REACH

_BLOCK = 6  # cells a side
_MOST_BANDS = 64  # rows of blocks: more of them change nothing
_SMALL = 0.05  # share of the blocks that are taken for smooth
_CUT_OFF = 0.02  # share of the samples of a block
_TOP = WHITE - 0.01
_SMALLEST = 4.0  # variance that is never counted: fine texture and the rounding of 8 bits
_GAIN = 36.0  # variance of the filter's result, in that of the samples

Shift = tuple[int, int]


def residual_interpolation(
    values: Array,
    pattern: str,
    white: float,
    *,
    linear: bool = True,
    each: Each = one_by_one,
    tile: tuple[int, int] = TILE,
) -> Array:
    """Return colour (H, W, 3) blue, green, red of a Bayer mosaic (H, W), in its own type, nothing above `white`.

    linear: the values are proportional to light, not gamma-encoded; see `Root`. each: runs the work on tiles, one
    after another unless the caller has threads. tile: rows and columns of cells, even; the result does not depend on
    it.
    """
    scale = Root(white, gains=detail_balance(values, pattern)) if linear else Scale(white, WHITE)
    mosaic = TiledMosaic(values, pattern, ri_green.REACH + _COLOUR_REACH, scale)
    mosaic.fill(each)
    frame = _TwoPasses(mosaic)
    each(frame.find_differences, boxes(frame.extended, tile))
    each(frame.find_colours, boxes(frame.mosaic.cells, tile))
    return frame.mosaic.result()


class _TwoPasses:
    """A mosaic, and the colour differences that the first pass leaves for the second.

    extended: the frame of cells whose differences the second pass needs.
    """

    def __init__(self, mosaic: TiledMosaic) -> None:
        self.mosaic = mosaic
        self.extended = mosaic.cells.widened(_COLOUR_REACH)
        self._noise = noise_of_green(mosaic.green)
        self._differences = np.empty((2, self.extended.rows, self.extended.columns), np.float32)

    def find_differences(self, box: Box) -> None:
        """Leave the colour differences of a box of the extended frame."""
        around = box.widened(ri_green.REACH)
        with self.mosaic.tile(around) as tile:
            bayer = self.mosaic.samples(tile, around)
            of_colours = ri_green.colour_differences(tile, bayer)
            inside = box._replace(row=ri_green.REACH, column=ri_green.REACH).slices
            for differences, plane in zip(self._differences, of_colours, strict=True):
                differences[box.slices] = plane.image[inside]
            tile.give_back(*bayer, *of_colours)

    def find_colours(self, box: Box) -> None:
        """Leave the colours of a box of cells."""
        around = box.widened(_COLOUR_REACH)
        with self.mosaic.tile(around) as tile:
            bayer = self.mosaic.samples(tile, around.moved(ri_green.REACH))
            at_red, at_blue = (
                self._green(tile, differences[around.slices], samples)
                for differences, samples in zip(self._differences, (bayer.red, bayer.blue), strict=True)
            )
            missing = _red_and_blue(tile, bayer, at_red, at_blue, self._noise)
            self.mosaic.write(tile, box, _COLOUR_REACH, bayer, missing)
            tile.give_back(*bayer, *missing)

    @staticmethod
    def _green(tile: Tile, differences: Array, samples: Plane) -> Plane:
        plane = tile.take()
        plane.fill(differences)
        return ri_green.green_from(tile, plane, samples)


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


def _red_and_blue(tile: Tile, bayer: Bayer, green_at_red: Plane, green_at_blue: Plane, noise: float) -> Missing:
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


def _residual(tile: Tile, samples: Plane, green: Plane, learning: ri_green.Learning) -> _Colour:
    curve, green_curve = _laplacian(tile, samples), _laplacian(tile, green)
    gain = ri_green.regress(tile, curve, green_curve, _NARROW, learning)
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
    share = ri_green.regress(tile, curve, beside, _NARROW, _ON_OPPOSITE, times=_CORRECTION)
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


def noise_of_green(green: tuple[Array, Array]) -> float:
    """Return the variance of the noise of green samples beyond what is negligible, in the filters' numbers.

    green: two planes (rows, columns), at the right and at the bottom of red. A frame without a whole block has none.
    """
    right, below = green
    if min(right.shape) < _BLOCK + 2:
        return 0.0
    variances, cut_off = _blocks(right, below)
    usable = variances[cut_off <= _CUT_OFF] if (cut_off <= _CUT_OFF).any() else variances
    return max(float(np.quantile(usable, _SMALL, method="lower")) - _SMALLEST, 0.0)


def _blocks(right: Array, below: Array) -> tuple[Array, Array]:
    """Return the mean square of the second differences of every block, and the share of samples that are cut off."""
    rows, columns = ((length - 2) // _BLOCK for length in right.shape)
    chosen = range(0, rows, -(-rows // _MOST_BANDS))
    variances, cut_off = np.empty((len(chosen), columns)), np.empty((len(chosen), columns))
    for place, row in enumerate(chosen):
        band = slice(row * _BLOCK, (row + 1) * _BLOCK + 2), slice(0, columns * _BLOCK + 2)
        middle = right[band][1:-1, 1:-1]
        variances[place] = _block_means(np.square(_second_difference(right[band], below[band])) / _GAIN)
        cut_off[place] = _block_means((middle == 0) | (middle >= _TOP))
    return variances, cut_off


def _second_difference(right: Array, below: Array) -> Array:
    """Return the second difference along both diagonals of the mosaic at the inner samples to the right of red."""
    corners = below[1:-1, 1:-1] + below[1:-1, 2:] + below[:-2, 1:-1] + below[:-2, 2:]
    beyond = right[:-2, 1:-1] + right[2:, 1:-1] + right[1:-1, :-2] + right[1:-1, 2:]
    return np.asarray(4 * right[1:-1, 1:-1] - 2 * corners + beyond)


def _block_means(band: Array) -> Array:
    return np.asarray(band.reshape(_BLOCK, -1, _BLOCK).mean(axis=(0, 2), dtype=np.float64))
