"""Camera raw files, by way of LibRaw: the sensor's own counts, never its look."""

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from camcal.arrays import Array
from camcal.errors import FileError, InvalidInput
from camcal.files import read_bytes
from camcal.raw.mosaic import Mosaic, require_pattern

_ORIENTATIONS = {3: 3, 5: 8, 6: 6}  # LibRaw's turns of 180°, 90° to the left, 90° to the right, as EXIF counts them


def read_camera_raw(path: Path) -> Mosaic:
    """Return the raw frame of a camera raw file, with its pattern, levels, white balance and orientation.

    Raises FileError if the file cannot be read, InvalidInput if it holds no mosaic.
    """
    import rawpy

    content = read_bytes(path)
    try:
        with rawpy.imread(BytesIO(content)) as raw:
            if raw.raw_type != rawpy.RawType.Flat:
                raise InvalidInput("holds full colour already, not a mosaic", where=str(path))
            return Mosaic(
                raw.raw_image_visible,
                pattern_of(raw.raw_pattern, raw.color_desc),
                np.asarray(raw.black_level_per_channel, dtype=float)[raw.raw_pattern],
                _white_level(raw),
                _camera_gains(raw),
                orientation=_ORIENTATIONS.get(raw.sizes.flip, 1),
            )
    except rawpy.LibRawError as error:
        raise FileError(f"not a camera raw file that can be read ({_reason(error)})", where=str(path)) from error


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
