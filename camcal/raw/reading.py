"""Reading raw frames of every kind: camera raw files, bare mosaics in image files, header-less dumps of a sensor."""

from pathlib import Path

import numpy as np

from camcal.errors import InvalidInput
from camcal.images.load import load
from camcal.raw.camera_raw import read_camera_raw
from camcal.raw.headerless import read_headerless
from camcal.raw.mosaic import Mosaic, full_scale
from camcal.raw.options import BARE_SUFFIXES, HEADERLESS_SUFFIXES, NO_LAYOUT, PATTERNS, GivenLayout


def read_mosaic(path: Path, pattern: str | None = None, layout: GivenLayout = NO_LAYOUT) -> Mosaic:
    """Return the raw frame of a camera raw file, a bare mosaic (PNG, TIFF, PGM, NPY), or a header-less file.

    pattern: of a bare mosaic, and of a header-less file whose pixel format does not name it. layout: of a header-less
    file (.raw, .bin). A camera file brings its pattern, levels and white balance; the others have black 0 and the
    white of their type or pixel format.
    Raises FileError if the file cannot be read, InvalidInput if it holds no mosaic, if the pattern or the layout is
    missing (with the layouts that fit the file), or if the pattern contradicts the file, or a layout is given for one
    that says its own.
    """
    suffix = path.suffix.lower()
    try:
        if suffix in HEADERLESS_SUFFIXES:
            return _read_headerless(path, pattern, layout)
        _refuse_layout(layout)
        return _read_bare(path, pattern) if suffix in BARE_SUFFIXES else _read_camera(path, pattern)
    except InvalidInput as error:
        raise InvalidInput(error.message, where=error.where or str(path)) from error


def _refuse_layout(layout: GivenLayout) -> None:
    if layout != NO_LAYOUT:
        raise InvalidInput("says its own layout: --format, --size and the like are for .raw and .bin files")


def _read_headerless(path: Path, pattern: str | None, layout: GivenLayout) -> Mosaic:
    complete = layout.complete(path, pattern)
    values, named = read_headerless(path, complete)
    return Mosaic(values, named, np.zeros((2, 2)), complete.pixel_format.white)


def _read_bare(path: Path, pattern: str | None) -> Mosaic:
    if pattern is None:
        raise missing_pattern(path)
    image = load(path)
    if image.channels != 1:
        raise InvalidInput(f"a mosaic has one channel, this image has {image.channels}: it is in colour already")
    values = image.pixels
    return Mosaic(values, pattern, np.zeros((2, 2)), full_scale(values.dtype), orientation=image.orientation)


def missing_pattern(path: Path) -> InvalidInput:
    """Return the error for a bare mosaic whose pattern was not given."""
    message = f"a bare mosaic does not say its colour pattern; give --pattern {'|'.join(PATTERNS)}"
    return InvalidInput(message, where=str(path))


def _read_camera(path: Path, pattern: str | None) -> Mosaic:
    frame = read_camera_raw(path)
    if pattern not in (None, frame.pattern):
        raise InvalidInput(f"the file says {frame.pattern}, --pattern says {pattern}; leave --pattern out")
    return frame
