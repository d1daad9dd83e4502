"""LibRaw's own demosaicing filters, for whoever wants to compare or is used to their look.

A mosaic reaches them as a digital negative in memory, so they work for bare mosaics and for camera files alike.
"""

from io import BytesIO
from typing import Any

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.raw.dng import dng_bytes
from camcal.raw.mosaic import Mosaic, cell_side, is_x_trans
from camcal.raw.options import MONO

X_TRANS_NAME = "AHD"  # under this name LibRaw runs Markesteijn's filter on X-Trans

_SATURATION = 65535
_SMALLEST = {2: 22, 6: 512}  # by the side of the cell: LibRaw opens no smaller image, or cannot fill a tile of X-Trans


def names() -> list[str]:
    """Return the names of the filters that the installed LibRaw has."""
    import rawpy

    return [algorithm.name for algorithm in rawpy.DemosaicAlgorithm if algorithm.isSupported]


def require_name(name: str) -> str:
    """Return the name of a filter in capitals; raises InvalidInput unless the installed LibRaw has it."""
    known = names()
    if name.upper() not in known:
        raise InvalidInput(
            f"LibRaw as installed has no filter {name!r} and would silently take AHD instead; use one of "
            + ", ".join(known)
        )
    return name.upper()


def demosaic_with_libraw(values: Array, pattern: str, name: str) -> Array:
    """Return colour (H, W, 3) blue, green, red, uint16, made by a filter of LibRaw without any scaling.

    values: (H, W) uint16 light, 0 at black and 65535 at saturation, white balance applied. They come back unchanged
    where they were. The border is as LibRaw leaves it: in a corner without one of the colours that colour may be 0.
    Raises InvalidInput for a filter that the installed LibRaw has not, for X-Trans with another than AHD, for MONO.
    """
    import rawpy

    name = require_name(name)
    if pattern == MONO:
        raise InvalidInput("a mosaic without colour filter needs no demosaicing")
    if is_x_trans(pattern) and name != X_TRANS_NAME:
        raise InvalidInput(f"LibRaw has one filter for X-Trans: use {X_TRANS_NAME}, it runs Markesteijn's there")
    height, width = values.shape
    side = cell_side(pattern)
    frame = Mosaic(_enlarged(values, side), pattern, np.zeros((side, side)), _SATURATION)
    with rawpy.imread(BytesIO(dng_bytes(frame))) as raw:
        colour = raw.postprocess(_neutral(rawpy.DemosaicAlgorithm[name]))
    return np.ascontiguousarray(colour[:height, :width, ::-1])


def _enlarged(values: Array, side: int) -> Array:
    """Return the mosaic, its last cell repeated beyond the right and lower edge as far as LibRaw's smallest image."""
    smallest = _SMALLEST[side]
    if min(values.shape) >= smallest:
        return values
    return values[np.ix_(*(_repeating(length, smallest, side) for length in values.shape))]


def _repeating(length: int, smallest: int, side: int) -> Array:
    places = np.arange(max(length, smallest))
    return np.where(places < length, places, length - side + (places - length) % side)


def _neutral(algorithm: Any) -> Any:
    """Return LibRaw's settings under which it does nothing but demosaic."""
    import rawpy

    return rawpy.Params(
        demosaic_algorithm=algorithm,
        gamma=(1, 1),
        no_auto_bright=True,
        no_auto_scale=True,
        output_color=rawpy.ColorSpace.raw,
        user_wb=[1, 1, 1, 1],
        output_bps=16,
        user_flip=0,
        user_black=0,
        user_sat=_SATURATION,
    )
