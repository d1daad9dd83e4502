"""`ri`: demosaicing by residual interpolation, in two passes over tiles that stay in the processor's cache."""

import numpy as np

from camcal.arrays import Array
from camcal.raw import ri_green, ri_red_blue
from camcal.raw.green_noise import noise_of_green
from camcal.raw.planes import Each, Plane, Tile, one_by_one
from camcal.raw.scales import scale_of
from camcal.raw.tiling import TILE, Box, TiledMosaic, boxes

_COLOUR_REACH = ri_green.CALMING_REACH + ri_red_blue.REACH


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
