"""Reading raw frames of every kind: camera raw files, bare mosaics in image files, header-less dumps of a sensor."""

from pathlib import Path

import numpy as np

from camcal.errors import InvalidInput
from camcal.images.load import load
from camcal.raw.camera_raw import read_camera_raw
from camcal.raw.mosaic import PATTERNS, Mosaic, full_scale

BARE_SUFFIXES = frozenset({".png", ".tif", ".tiff", ".pgm", ".npy"})
HEADERLESS_SUFFIXES = frozenset({".raw", ".bin"})


def read_mosaic(path: Path, pattern: str | None = None) -> Mosaic:
    """Return the raw frame of a camera raw file, or of a bare mosaic (PNG, TIFF, PGM, NPY) whose pattern is given.

    A camera file brings its pattern, levels and white balance; a bare mosaic has black 0 and the white of its type.
    Raises FileError if the file cannot be read, InvalidInput if it holds no mosaic, or the pattern is missing
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
    frame = read_camera_raw(path)
    if pattern not in (None, frame.pattern):
        raise InvalidInput(f"the file says {frame.pattern}, --pattern says {pattern}; leave --pattern out")
    return frame
