"""Colour filter patterns, and raw frames: one sample per pixel, before any colour is made.

A pattern is named by the four letters of the first 2 × 2 pixels in reading order: RGGB has red at (0, 0), green
beside and below it. An odd crop or a flip of the array changes the name.
"""

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from camcal.arrays import Array, readonly
from camcal.errors import FileError, InvalidInput
from camcal.files import read_bytes
from camcal.images.load import load

PATTERNS = ("RGGB", "GRBG", "GBRG", "BGGR")
BARE_SUFFIXES = frozenset({".png", ".tif", ".tiff", ".pgm", ".npy"})
HEADERLESS_SUFFIXES = frozenset({".raw", ".bin"})

_ORIENTATIONS = {3: 3, 5: 8, 6: 6}  # LibRaw's turns of 180°, 90° to the left, 90° to the right, as EXIF counts them
_CELL = ((0, 0), (0, 1), (1, 0), (1, 1))


@dataclass(frozen=True, eq=False)
class Mosaic:
    """A raw frame (H, W), uint8, uint16 or float32 counts, behind a 2 × 2 colour filter.

    black: (2, 2) counts without light, laid out like the first cell of the pattern. white: counts at saturation.
    camera_gains: (3,) red, green, blue that the camera proposes for its white balance, None when it says nothing.
    orientation: the EXIF tag 1 … 8, how to turn the image for looking at it; never applied.
    """

    values: Array
    pattern: str
    black: Array
    white: float
    camera_gains: Array | None = None
    orientation: int = 1

    def __post_init__(self) -> None:
        require_pattern(self.pattern)
        if self.values.dtype not in (np.uint8, np.uint16, np.float32):
            raise InvalidInput(f"a mosaic is uint8, uint16 or float32, found {self.values.dtype}")
        values = readonly(self.values, (None, None), "mosaic", self.values.dtype)
        if min(values.shape) < 2:
            raise InvalidInput(f"a mosaic needs at least 2 × 2 pixels, found {values.shape[1]} × {values.shape[0]}")
        if not np.isfinite(values).all():
            raise InvalidInput(f"{np.count_nonzero(~np.isfinite(values))} pixels of the mosaic are not finite")
        black = readonly(self.black, (2, 2), "black level")
        if not np.isfinite(self.white) or not (black < self.white).all():
            raise InvalidInput(f"the white level {self.white:g} must be above the black level {black.max():g}")
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "black", black)
        if self.camera_gains is not None:
            object.__setattr__(self, "camera_gains", readonly(self.camera_gains, (3,), "camera white balance"))


def require_pattern(pattern: str) -> str:
    """Return the pattern; raises InvalidInput unless it is one of the four Bayer phases."""
    if pattern not in PATTERNS:
        raise InvalidInput(f"pattern {pattern!r} is unknown; use one of {', '.join(PATTERNS)}")
    return pattern


def sites(pattern: str, colour: str) -> list[tuple[slice, slice]]:
    """Return where a colour's samples stand in the mosaic: one pair of slices for R and for B, two for G."""
    return [
        (slice(row, None, 2), slice(column, None, 2))
        for letter, (row, column) in zip(pattern, _CELL, strict=True)
        if letter == colour
    ]


def full_scale(dtype: np.dtype[Any]) -> float:
    """Return the largest value an image of this type holds by convention: 255, 65535, or 1 for floating point."""
    return float(np.iinfo(dtype).max) if np.issubdtype(dtype, np.integer) else 1.0


def read_mosaic(path: Path, pattern: str | None = None) -> Mosaic:
    """Return the raw frame of a camera raw file, or of a bare mosaic (PNG, TIFF, PGM, NPY) whose pattern is given.

    A camera file brings its pattern, levels and white balance; a bare mosaic has black 0 and the white of its type.
    Raises FileError if the file cannot be read, InvalidInput if it holds no Bayer mosaic, or the pattern is missing
    for a bare mosaic or contradicts a camera file.
    """
    suffix = path.suffix.lower()
    if suffix in HEADERLESS_SUFFIXES:
        raise InvalidInput(f"header-less {suffix} files are not read; give PNG, TIFF, PGM or NPY", where=str(path))
    try:
        return _read_bare(path, pattern) if suffix in BARE_SUFFIXES else _read_camera(path, pattern)
    except InvalidInput as error:
        raise InvalidInput(error.message, where=str(path)) from error


def _read_bare(path: Path, pattern: str | None) -> Mosaic:
    if pattern is None:
        raise InvalidInput(f"a bare mosaic does not say its colour pattern; give --pattern {'|'.join(PATTERNS)}")
    image = load(path)
    if image.channels != 1:
        raise InvalidInput(f"a mosaic has one channel, this image has {image.channels}: it is in colour already")
    values = image.pixels
    return Mosaic(values, pattern, np.zeros((2, 2)), full_scale(values.dtype), orientation=image.orientation)


def _read_camera(path: Path, pattern: str | None) -> Mosaic:
    import rawpy

    content = read_bytes(path)
    try:
        with rawpy.imread(BytesIO(content)) as raw:
            if raw.raw_type != rawpy.RawType.Flat:
                raise InvalidInput("holds full colour already, not a mosaic")
            found = pattern_of(raw.raw_pattern, raw.color_desc)
            black = np.asarray(raw.black_level_per_channel, dtype=float)[raw.raw_pattern]
            frame = Mosaic(
                raw.raw_image_visible,
                found,
                black,
                _white_level(raw),
                _camera_gains(raw),
                _ORIENTATIONS.get(raw.sizes.flip, 1),
            )
    except rawpy.LibRawError as error:
        raise FileError(f"not a camera raw file that can be read ({_reason(error)})", where=str(path)) from error
    if pattern not in (None, found):
        raise InvalidInput(f"the file says {found}, --pattern says {pattern}; leave --pattern out")
    return frame


def pattern_of(codes: Array | None, letters: bytes) -> str:
    """Return the pattern from a camera file's cell of colour indices and the letter of each index.

    Raises InvalidInput for X-Trans (a cell of 6 × 6), for other colours than R, G, B, and for no pattern at all.
    """
    if codes is None:
        raise InvalidInput("has no colour filter pattern")
    if codes.shape != (2, 2):
        raise InvalidInput(f"has a cell of {codes.shape[0]} × {codes.shape[1]} (X-Trans); only 2 × 2 Bayer is read")
    pattern = "".join(chr(letters[code]) for code in codes.ravel())
    return require_pattern(pattern)


def _white_level(raw: Any) -> float:
    """Return the counts at which the first channel saturates: what the maker says, else what LibRaw knows."""
    stated = [level for level in raw.camera_white_level_per_channel or () if level > 0]
    return float(min(stated, default=raw.white_level))


def _camera_gains(raw: Any) -> Array | None:
    gains = np.asarray(raw.camera_whitebalance[:3], dtype=float)
    return gains if np.isfinite(gains).all() and (gains > 0).all() else None


def _reason(error: Exception) -> str:
    text = error.args[0] if error.args else error
    return text.decode(errors="replace") if isinstance(text, bytes) else str(text)
