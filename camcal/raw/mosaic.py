"""Colour filter patterns, and raw frames: one sample per pixel, before any colour is made.

A pattern is named by the letters of its first cell in reading order: RGGB has red at (0, 0), green beside and below
it. An odd crop or a flip of the array changes the name. The cell of X-Trans has 6 × 6 letters; MONO has no filter.
"""

from math import isqrt
from typing import Any

import numpy as np

from camcal.arrays import Array, FloatArray, PixelArray, readonly
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.raw import MONO, PATTERNS
from camcal.records import Brief

_X_TRANS_LETTERS = 36


@dataclass(frozen=True, eq=False)
class Capture:
    """How a frame was taken, as far as known: exposure_s in seconds, focal_mm, the f-number, ISO speed."""

    make: str = ""
    model: str = ""
    exposure_s: float | None = None
    iso: float | None = None
    f_number: float | None = None
    focal_mm: float | None = None


@dataclass(frozen=True, eq=False)
class Mosaic(Brief):
    """A raw frame (H, W), uint8, uint16 or float32 counts, behind a colour filter.

    black: (2, 2) counts without light, laid out like the first cell of the pattern; (6, 6) for X-Trans.
    white: counts at saturation. camera_gains: (3,) red, green, blue that the camera proposes for its white balance,
    None when it says nothing. camera_M_xyz: (3, 3), CIE XYZ to the camera's colours, None when unknown.
    orientation: the EXIF tag 1 … 8, how to turn the image for looking at it; never applied.
    """

    values: PixelArray
    pattern: str
    black: FloatArray
    white: float
    camera_gains: FloatArray | None = None
    camera_M_xyz: FloatArray | None = None
    orientation: int = 1
    capture: Capture = Capture()

    def __post_init__(self) -> None:
        side = cell_side(self.pattern)
        if self.values.dtype not in (np.uint8, np.uint16, np.float32):
            raise InvalidInput(f"a mosaic is uint8, uint16 or float32, found {self.values.dtype}")
        values = readonly(self.values, (None, None), "mosaic", self.values.dtype)
        if min(values.shape) < side:
            size = f"{values.shape[1]} × {values.shape[0]}"
            raise InvalidInput(f"a mosaic needs at least {side} × {side} pixels, found {size}")
        if values.dtype == np.float32 and not np.isfinite(values).all():
            raise InvalidInput(f"{np.count_nonzero(~np.isfinite(values))} pixels of the mosaic are not finite")
        black = readonly(self.black, (side, side), "black level")
        if not np.isfinite(self.white) or not (black < self.white).all():
            raise InvalidInput(f"the white level {self.white:g} must be above the black level {black.max():g}")
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "black", black)
        for name, shape in (("camera_gains", (3,)), ("camera_M_xyz", (3, 3))):
            if (known := getattr(self, name)) is not None:
                object.__setattr__(self, name, readonly(known, shape, name))

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.values.shape[1], self.values.shape[0]


def require_pattern(pattern: str) -> str:
    """Return the pattern; raises InvalidInput unless it is one of the four Bayer phases or MONO."""
    if pattern not in (*PATTERNS, MONO):
        raise InvalidInput(f"pattern {pattern!r} is unknown; use one of {', '.join((*PATTERNS, MONO))}")
    return pattern


def is_x_trans(pattern: str) -> bool:
    return len(pattern) == _X_TRANS_LETTERS and set(pattern) == set("RGB")


def pattern_words(pattern: str) -> str:
    """Return a pattern as people name it."""
    return "X-Trans" if is_x_trans(pattern) else pattern


def cell_side(pattern: str) -> int:
    """Return the rows and columns of a pattern's cell, 2 or 6; raises InvalidInput for an unknown pattern."""
    return isqrt(len(pattern if is_x_trans(pattern) else require_pattern(pattern)))


def sites(pattern: str, colour: str) -> list[tuple[slice, slice]]:
    """Return where a colour's samples stand in the mosaic: for Bayer one pair of slices for R and for B, two for G."""
    side = cell_side(pattern)
    return [
        (slice(place // side, None, side), slice(place % side, None, side))
        for place, letter in enumerate(pattern)
        if letter == colour
    ]


def phases(pattern: str) -> list[tuple[slice, slice]]:
    """Return where the samples of every place of the cell stand in the mosaic, in reading order."""
    side = cell_side(pattern)
    return [(slice(row, None, side), slice(column, None, side)) for row, column in np.ndindex(side, side)]


def by_place(values: Array, pattern: str) -> list[Array]:
    """Return the samples of every place of the cell, in reading order: equally many, those of the whole cells."""
    side = cell_side(pattern)
    whole = values[: len(values) // side * side, : values.shape[1] // side * side]
    return [whole[site] for site in phases(pattern)]


def channel_names(pattern: str) -> tuple[str, ...]:
    """Return the channel of every place of the cell, in reading order.

    The greens of Bayer are Gr in the rows of red and Gb in those of blue; X-Trans has one G, and MONO is gray.
    """
    if pattern == MONO:
        return ("gray",) * len(pattern)
    if is_x_trans(pattern):
        return tuple(pattern)
    require_pattern(pattern)
    rows = pattern[:2], pattern[2:]
    return tuple(f"G{'r' if 'R' in row else 'b'}" if letter == "G" else letter for row in rows for letter in row)


def full_scale(dtype: np.dtype[Any]) -> float:
    """Return the largest value an image of this type holds by convention: 255, 65535, or 1 for floating point."""
    return float(np.iinfo(dtype).max) if np.issubdtype(dtype, np.integer) else 1.0
