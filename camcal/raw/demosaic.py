"""Demosaicing algorithms by name.

Colour comes back as (H, W, 3) in the order blue, green, red, as everywhere in this package.

LibRaw's own filters are for whoever wants to compare or is used to their look. A mosaic reaches them as a digital
negative in memory, so they work for bare mosaics and for camera files alike.
"""

from collections.abc import Callable, Mapping
from io import BytesIO
from math import inf, isfinite
from types import MappingProxyType
from typing import Any

import numpy as np

from camcal.arrays import Array, PixelArray
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.raw import AUTO, GRAY, GREEN, HALF, LIBRAW, MONO, NONE, RI
from camcal.raw.dng import dng_bytes
from camcal.raw.filters import bilinear, edge_aware, green, half, malvar, vng
from camcal.raw.mosaic import Mosaic, cell_side, full_scale, is_x_trans
from camcal.raw.residual import residual_interpolation
from camcal.raw.tiles import Each, one_by_one, rounded

X_TRANS_NAME = "AHD"  # under this name LibRaw runs Markesteijn's filter on X-Trans

_SATURATION = 65535
_SMALLEST = {2: 22, 6: 512}  # by the side of the cell: LibRaw opens no smaller image, or cannot fill a tile of X-Trans


@dataclass(frozen=True)
class Job:
    """A mosaic (H, W) of uint8, uint16 or float32, and how to read its numbers.

    white: the number that means saturation; nothing in the result is above it. linear: the numbers are proportional to
    light, not gamma-encoded. each: runs the work on tiles.
    """

    values: Array
    pattern: str
    white: float
    linear: bool = True
    each: Each = one_by_one


def demosaic(
    values: Array,
    pattern: str,
    algorithm: str = AUTO,
    *,
    white: float | None = None,
    linear: bool | None = None,
    each: Each = one_by_one,
) -> PixelArray:
    """Return what the algorithm makes of a mosaic (H, W), in its type: colour (H, W, 3) or, see ALGORITHMS, another.

    values: uint8, uint16 or float32; white balance belongs before this step. white: by default the full scale of the
    type. linear: by default 8 bits are gamma-encoded and everything else is linear. Beyond the border the mosaic
    continues as its mirror image about the border pixels, which keeps the colours in their places.
    A MONO frame has no colour: it comes back as it is, as a mosaic does by "gray" and "none". Light below black stays
    negative in floating point, except by "ea" and LibRaw's filters, which work on integers.
    Raises InvalidInput for an unknown pattern or algorithm, for one that cannot do this mosaic, for another type, and
    for a white level that its type cannot hold.
    """
    algorithm = resolved(require_algorithm(algorithm), pattern)
    side = cell_side(pattern)
    if values.ndim != 2 or min(values.shape) < side:
        raise InvalidInput(f"a mosaic needs at least {side} × {side} pixels of one channel, found {values.shape}")
    if pattern == MONO:
        return values
    job = Job(
        values,
        pattern,
        _white_level(values, white),
        values.dtype != np.uint8 if linear is None else linear,
        each,
    )
    if algorithm.startswith(LIBRAW):
        counts, scale = _sixteen_bits(job)  # LibRaw works on 16 bits; others are scaled there and back
        colour = demosaic_with_libraw(counts, pattern, algorithm.removeprefix(LIBRAW)) / scale
        return np.asarray((colour if values.dtype == np.float32 else np.rint(colour)).astype(values.dtype))
    if is_x_trans(pattern) and algorithm != NONE:
        raise InvalidInput(
            f"{algorithm} is for Bayer sensors, this is X-Trans; use auto, {LIBRAW}{X_TRANS_NAME}, or none"
        )
    return ALGORITHMS[algorithm].run(job)


def require_algorithm(algorithm: str) -> str:
    """Return the algorithm; raises InvalidInput, with what there is, unless it exists."""
    if algorithm.startswith(LIBRAW):
        require_libraw_filter(algorithm.removeprefix(LIBRAW))
    elif algorithm not in ALGORITHMS:
        names = ", ".join([*ALGORITHMS, f"{LIBRAW}NAME"])
        raise InvalidInput(f"algorithm {algorithm!r} does not exist; use one of {names}")
    return algorithm


def _white_level(values: Array, white: float | None) -> float:
    if values.dtype not in (np.uint8, np.uint16, np.float32):
        raise InvalidInput(f"a mosaic is uint8, uint16 or float32, found {values.dtype}")
    highest = full_scale(values.dtype) if values.dtype != np.float32 else inf
    if white is not None and not (0 < white <= highest and isfinite(white)):
        raise InvalidInput(f"a white level of {white:g} for {values.dtype}; give a positive number it can hold")
    return full_scale(values.dtype) if white is None else white


def resolved(algorithm: str, pattern: str) -> str:
    """Return the name of the algorithm that `auto` stands for with a pattern; others are themselves."""
    if algorithm != AUTO:
        return algorithm
    if pattern == MONO:
        return NONE
    return f"{LIBRAW}{X_TRANS_NAME}" if is_x_trans(pattern) else RI


def _sixteen_bits(job: Job) -> tuple[Array, np.float32]:
    """Return the mosaic as uint16 with white at the top, and the factor that took it there."""
    scale = np.float32(full_scale(np.dtype(np.uint16)) / job.white)
    return rounded(job.values.astype(np.float32, copy=False), float(scale), np.dtype(np.uint16)), scale


@dataclass(frozen=True)
class Algorithm:
    """A way of demosaicing: what it does in words, and the function."""

    words: str
    run: Callable[[Job], Array]


def _ri(job: Job) -> Array:
    return residual_interpolation(job.values, job.pattern, job.white, linear=job.linear, each=job.each)


def _edge_aware(job: Job) -> Array:
    """Return OpenCV's edge-aware colour, which knows integers only."""
    if job.values.dtype == np.float32:
        counts, scale = _sixteen_bits(job)
        return np.asarray(edge_aware(counts, job.pattern) / scale)
    return _cap(edge_aware)(job)


def _cap(function: Callable[[Array, str], Array]) -> Callable[[Job], Array]:
    """Return a filter whose result ends at the white level."""

    def run(job: Job) -> Array:
        colour = function(job.values, job.pattern)
        return (
            colour if job.white == full_scale(colour.dtype) != 1 else np.minimum(colour, colour.dtype.type(job.white))
        )

    return run


ALGORITHMS: Mapping[str, Algorithm] = MappingProxyType(
    {
        AUTO: Algorithm("ri for Bayer sensors, LibRaw's for X-Trans", _ri),
        RI: Algorithm("residual interpolation: the best colour", _ri),
        "malvar": Algorithm(
            "linear 5 x 5 filters: fast", lambda job: malvar(job.values, job.pattern, job.white, each=job.each)
        ),
        "bilinear": Algorithm("the mean of the nearest samples: fastest", _cap(bilinear)),
        "ea": Algorithm("OpenCV's edge-aware filter", _edge_aware),
        "vng": Algorithm(
            "variable number of gradients", lambda job: vng(job.values, job.pattern, job.white, each=job.each)
        ),
        HALF: Algorithm("one pixel per cell, half the size: not for calibration", _cap(half)),
        GREEN: Algorithm("one channel: green, its gaps filled; for calibration, whatever the lens", _cap(green)),
        GRAY: Algorithm(
            "one channel: the balanced mosaic; for calibration, if the lens has no lateral colour",
            lambda job: job.values,
        ),
        NONE: Algorithm("the mosaic itself", lambda job: job.values),
    }
)


def libraw_filters() -> list[str]:
    """Return the names of the filters that the installed LibRaw has."""
    import rawpy

    return [algorithm.name for algorithm in rawpy.DemosaicAlgorithm if algorithm.isSupported]


def require_libraw_filter(name: str) -> str:
    """Return the name of a filter in capitals; raises InvalidInput unless the installed LibRaw has it."""
    supported = libraw_filters()
    if name.upper() not in supported:
        raise InvalidInput(
            f"LibRaw as installed does not support {name!r} and would use AHD instead; use one of "
            + ", ".join(supported)
        )
    return name.upper()


def demosaic_with_libraw(values: Array, pattern: str, name: str) -> Array:
    """Return colour (H, W, 3) blue, green, red, uint16, made by a filter of LibRaw without any scaling.

    values: (H, W) uint16 light, 0 at black and 65535 at saturation, white balance applied. They come back unchanged
    where they were. The border is as LibRaw leaves it: in a corner without one of the colours that colour may be 0.
    Raises InvalidInput for a filter that the installed LibRaw has not, for X-Trans with another than AHD, for MONO.
    """
    import rawpy

    name = require_libraw_filter(name)
    if pattern == MONO:
        raise InvalidInput("a mosaic without colour filter needs no demosaicing")
    if is_x_trans(pattern) and name != X_TRANS_NAME:
        raise InvalidInput(f"LibRaw has one filter for X-Trans: use {X_TRANS_NAME}, it runs Markesteijn's there")
    height, width = values.shape
    side = cell_side(pattern)
    if min(values.shape) < _SMALLEST[side]:  # the last cell is repeated beyond the right and lower edge
        places = [np.arange(max(length, _SMALLEST[side])) for length in values.shape]
        ends = zip(places, values.shape, strict=True)
        values = values[np.ix_(*(np.where(at < end, at, end - side + (at - end) % side) for at, end in ends))]
    frame = Mosaic(values, pattern, np.zeros((side, side)), _SATURATION)
    with rawpy.imread(BytesIO(dng_bytes(frame))) as raw:
        colour = raw.postprocess(_neutral(rawpy.DemosaicAlgorithm[name]))
    return np.ascontiguousarray(colour[:height, :width, ::-1])


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
