"""`ri`: demosaicing by residual interpolation, in two passes over tiles that stay in the processor's cache.

How noisy the green samples of a mosaic are is told by the mosaic itself. Second differences along both diagonals leave
nothing of a plane, and little of anything smooth. The least of their mean squares over blocks is that of a block
without detail: it is noise. Blocks whose samples are cut off at black or at white say too little.
Source: J. Immerkær, Fast Noise Variance Estimation, CVIU 1996 (the filter, here on the diagonal grid of green).
"""

import numpy as np

from camcal.arrays import Array
from camcal.raw import ri_green, ri_red_blue
from camcal.raw.planes import Each, Plane, Tile, one_by_one
from camcal.raw.tiling import TILE, WHITE, Box, TiledMosaic, boxes, scale_of

_COLOUR_REACH = ri_green.CALMING_REACH + ri_red_blue.REACH

_BLOCK = 6  # cells a side
_MOST_BANDS = 64  # rows of blocks: more of them change nothing
_SMALL = 0.05  # share of the blocks that are taken for smooth
_CUT_OFF = 0.02  # share of the samples of a block
_TOP = WHITE - 0.01
_SMALLEST = 4.0  # variance that is never counted: fine texture and the rounding of 8 bits
_GAIN = 36.0  # variance of the filter's result, in that of the samples


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

    linear: the values are proportional to light, not gamma-encoded; see `scales`. each: runs the work on tiles, one
    after another unless the caller has threads. tile: rows and columns of cells, even; the result does not depend on
    it.
    """
    scale = scale_of(values, pattern, white, linear=linear)
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
            found = ri_green.colour_differences(tile, bayer)
            inside = box._replace(row=ri_green.REACH, column=ri_green.REACH).slices
            for differences, plane in zip(self._differences, found, strict=True):
                differences[box.slices] = plane.image[inside]
            tile.give_back(*bayer, *found)

    def find_colours(self, box: Box) -> None:
        """Leave the colours of a box of cells."""
        around = box.widened(_COLOUR_REACH)
        with self.mosaic.tile(around) as tile:
            bayer = self.mosaic.samples(tile, around.moved(ri_green.REACH))
            at_red, at_blue = (
                self._green(tile, differences[around.slices], samples)
                for differences, samples in zip(self._differences, (bayer.red, bayer.blue), strict=True)
            )
            missing = ri_red_blue.red_and_blue(tile, bayer, at_red, at_blue, self._noise)
            self.mosaic.write(tile, box, _COLOUR_REACH, bayer, missing)
            tile.give_back(*bayer, *missing)

    @staticmethod
    def _green(tile: Tile, differences: Array, samples: Plane) -> Plane:
        plane = tile.take()
        plane.fill(differences)
        return ri_green.green_from(tile, plane, samples)


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
