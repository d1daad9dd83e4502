"""Camera raw files, by way of LibRaw: the sensor's own counts, never its look."""

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from camcal.arrays import Array
from camcal.errors import FileError, InvalidInput
from camcal.files import read_bytes
from camcal.images import exif, limits
from camcal.raw.capture import capture_of
from camcal.raw.mosaic import Mosaic, cell_side, is_x_trans, phases, require_pattern
from camcal.raw.options import MONO

_ORIENTATIONS = (1, 2, 4, 3, 5, 8, 6, 7)  # as EXIF counts them, by LibRaw's bits: mirror in x, in y, then transpose

# LibRaw's XYZ of linear sRGB's red, green and blue, white D65; its own inverse of a camera's matrix goes through it.
_XYZ_M_SRGB = np.array([[0.412453, 0.357580, 0.180423], [0.212671, 0.715160, 0.072169], [0.019334, 0.119193, 0.950227]])

_MASK_GUARD = 8  # columns beside the image that light may creep into
_MASK_WIDTH = 16  # columns, at least, for a median worth the name
_MASK_SPREAD = 0.01  # of the white level: samples without light differ by their noise only


def read_camera_raw(path: Path) -> Mosaic:
    """Return the raw frame of a camera raw file: counts, pattern, levels, white balance, colour, orientation, capture.

    Raises FileError if the file is missing, cut off or not one that LibRaw reads, InvalidInput if it holds no mosaic.
    """
    import rawpy

    content = read_bytes(path)
    if exif.is_cut_off(content):
        raise FileError(f"is cut off: it points beyond its {len(content)} bytes", where=str(path))
    try:
        with rawpy.imread(BytesIO(content)) as raw:
            limits.require_pixels((raw.sizes.raw_width, raw.sizes.raw_height), path)
            if raw.raw_type != rawpy.RawType.Flat:
                raise InvalidInput("holds full colour in every pixel (linear DNG, sRAW or Foveon): there is no mosaic")
            return _frame(raw, content)
    except rawpy.LibRawError as error:
        raise FileError(f"not a camera raw file that can be read ({_reason(error)})", where=str(path)) from error


def pattern_of(codes: Array | None, letters: bytes) -> str:
    """Return the pattern from a camera file's cell of colour indices and the letter of each index.

    Raises InvalidInput for other colours than R, G, B, for other cells than 2 × 2 and X-Trans, and for none at all.
    """
    if codes is None:
        raise InvalidInput("has no colour filter pattern")
    pattern = "".join(chr(letters[code]) for code in codes.ravel())
    if not set(pattern) <= set("RGB"):
        raise InvalidInput(f"has a filter pattern of {', '.join(sorted(set(pattern)))}; only red, green, blue are read")
    if codes.shape != (2, 2) and not is_x_trans(pattern):
        raise InvalidInput(f"has a pattern of {codes.shape[0]} × {codes.shape[1]}; only Bayer and X-Trans are read")
    return pattern if is_x_trans(pattern) else require_pattern(pattern)


def _frame(raw: Any, content: bytes) -> Mosaic:
    codes = None if raw.num_colors == 1 else _cell(raw)
    pattern = MONO if codes is None else pattern_of(codes, raw.color_desc)
    colour = pattern != MONO
    return Mosaic(
        raw.raw_image_visible,
        pattern,
        _black(raw, codes, pattern),
        _white(raw),
        _camera_gains(raw) if colour else None,
        _camera_matrix(raw) if colour else None,
        _ORIENTATIONS[raw.sizes.flip & 7],
        capture_of(content, raw.other),
    )


def _cell(raw: Any) -> Array | None:
    """Return the colour indices of the first cell of the image; LibRaw's own cell of X-Trans begins at the margin."""
    try:
        cell = raw.raw_pattern
    except NotImplementedError as error:  # cells of other heights, which LibRaw can say and its binding cannot
        raise InvalidInput("has a filter pattern that is neither Bayer nor X-Trans") from error
    if cell is None:
        return None
    top, left = raw.sizes.top_margin, raw.sizes.left_margin
    codes = [raw.raw_color(top + row, left + column) for row, column in np.ndindex(*cell.shape)]
    return np.reshape(codes, cell.shape)


def _black(raw: Any, codes: Array | None, pattern: str) -> Array:
    """Return the counts without light of every place of the cell: as stated, else of the columns that see no light."""
    side = cell_side(pattern)
    stated = np.asarray(raw.black_level_per_channel, dtype=float)
    if not stated.any():
        return _masked_black(raw, pattern)
    return np.full((side, side), stated[0]) if codes is None else stated[codes]


def _masked_black(raw: Any, pattern: str) -> Array:
    """Return the median counts of the columns left of the image if they are masked, for every place of the cell.

    They are masked if they differ by noise only and are as dark as the darkest of the image; else the answer is 0.
    """
    side = cell_side(pattern)
    sizes, image = raw.sizes, raw.raw_image_visible
    rows = slice(sizes.top_margin, sizes.top_margin + sizes.height)
    margin = raw.raw_image[rows, sizes.left_margin % side : max(0, sizes.left_margin - _MASK_GUARD)]
    if margin.shape[1] < _MASK_WIDTH:
        return np.zeros((side, side))
    low, middle, high = np.percentile(margin, [1, 50, 99])
    if high - low > _MASK_SPREAD * raw.white_level or middle > np.percentile(image, 1):
        return np.zeros((side, side))
    return np.reshape([np.median(margin[place]) for place in phases(pattern)], (side, side))


def _white(raw: Any) -> float:
    """Return the counts at which the first channel saturates: what the maker says, else what LibRaw knows."""
    darkest = max(raw.black_level_per_channel)
    stated = [level for level in raw.camera_white_level_per_channel or () if level > darkest]
    return float(min(stated, default=raw.white_level))


def _camera_gains(raw: Any) -> Array | None:
    gains = np.asarray(raw.camera_whitebalance[:3], dtype=float)
    return gains if np.isfinite(gains).all() and (gains > 0).all() else None


def _camera_matrix(raw: Any) -> Array | None:
    """Return the matrix from XYZ to the camera's colours, None if unknown.

    LibRaw gives that of a DNG file away only as its way to sRGB: inverted, with every row scaled to a sum of 1 over
    linear sRGB; the scales are its daylight balance.
    """
    stated = np.asarray(raw.rgb_xyz_matrix, dtype=float)[:3]
    if stated.any():
        return stated
    to_srgb = np.asarray(raw.color_matrix, dtype=float)[:, :3]
    scales = np.asarray(raw.daylight_whitebalance[:3], dtype=float)
    if not (scales > 0).all() or not abs(np.linalg.det(to_srgb)) > 0:
        return None
    return np.asarray(np.linalg.inv(_XYZ_M_SRGB @ to_srgb) / scales[:, np.newaxis])


def _reason(error: Exception) -> str:
    text = error.args[0] if error.args else error
    return text.decode(errors="replace") if isinstance(text, bytes) else str(text)
