"""Writing a raw frame as a digital negative that every raw converter opens: one uncompressed image, no preview.

Source: Adobe, Digital Negative (DNG) Specification, version 1.4.0.0; TIFF 6.0; Exif 2.32.
"""

import struct
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.files import write_bytes
from camcal.raw import MONO
from camcal.raw.mosaic import Capture, Mosaic, cell_side

_BYTE, _ASCII, _SHORT, _LONG, _RATIONAL, _SRATIONAL = 1, 2, 3, 4, 5, 10
_CODES = {_BYTE: "B", _ASCII: "c", _SHORT: "H", _LONG: "I", _RATIONAL: "I", _SRATIONAL: "i"}
_CFA, _LINEAR_RAW = 32803, 34892  # photometric interpretations
_COLOURS = {"R": 0, "G": 1, "B": 2}
_D65 = 21  # light source code of the colour matrix
_DENOMINATOR = 1_000_000
_HEADER = 8
_ENTRY = 12
_UNKNOWN_CAMERA = "camcal"

# XYZ to linear sRGB (IEC 61966-2-1): the specification demands a matrix, and this one means "as a display has it".
_SRGB_M_XYZ = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])


class _Entry(NamedTuple):
    """One entry of a directory; rationals are pairs of numbers, one after the other."""

    tag: int
    kind: int
    values: Sequence[int] | bytes


def write_dng(path: Path, frame: Mosaic) -> None:
    """Write the frame as a DNG file; see `dng_bytes`. Raises FileError if the file cannot be written."""
    write_bytes(path, dng_bytes(frame))


def dng_bytes(frame: Mosaic) -> bytes:
    """Return a DNG file of the frame: its counts as they are, pattern, levels, white balance, orientation, capture.

    White balance gains are written up to a common factor. Raises InvalidInput for a frame in floating point.
    """
    if frame.values.dtype == np.float32:
        raise InvalidInput("a DNG file holds 8 or 16 bits, this frame is floating point; give --depth 16")
    entries = [*_image_entries(frame), *_colour_entries(frame), *_level_entries(frame)]
    capture = _capture_entries(frame.capture)
    # What the pointers say does not change how long the directory is: lay it out once to learn where things go.
    length = len(_directory([*entries, *_pointers(0, 0)], _HEADER))
    exif = _directory(capture, _HEADER + length)
    pixels = _HEADER + length + len(exif)
    first = _directory([*entries, *_pointers(pixels, _HEADER + length)], _HEADER)
    samples = frame.values.astype(frame.values.dtype.newbyteorder("<"), copy=False)
    return b"".join([struct.pack("<2sHI", b"II", 42, _HEADER), first, exif, np.ascontiguousarray(samples).data])


def _pointers(pixels: int, exif: int) -> list[_Entry]:
    return [_Entry(0x0111, _LONG, [pixels]), _Entry(0x8769, _LONG, [exif])]


def _image_entries(frame: Mosaic) -> list[_Entry]:
    width, height = frame.size
    camera = " ".join(filter(None, (frame.capture.make, frame.capture.model))) or _UNKNOWN_CAMERA
    return [
        _Entry(0x00FE, _LONG, [0]),  # the image itself, not a preview
        _Entry(0x0100, _LONG, [width]),
        _Entry(0x0101, _LONG, [height]),
        _Entry(0x0102, _SHORT, [8 * frame.values.itemsize]),
        _Entry(0x0103, _SHORT, [1]),  # not compressed
        _text(0x010F, frame.capture.make or _UNKNOWN_CAMERA),
        _text(0x0110, frame.capture.model or _UNKNOWN_CAMERA),
        _Entry(0x0112, _SHORT, [frame.orientation]),
        _Entry(0x0115, _SHORT, [1]),  # one sample per pixel
        _Entry(0x0116, _LONG, [height]),  # in one strip
        _Entry(0x0117, _LONG, [frame.values.nbytes]),
        _Entry(0x011C, _SHORT, [1]),  # in one plane
        _Entry(0xC612, _BYTE, [1, 4, 0, 0]),  # DNG version
        _Entry(0xC613, _BYTE, [1, 1, 0, 0]),  # readable from this version on
        _text(0xC614, camera),
    ]


def _colour_entries(frame: Mosaic) -> list[_Entry]:
    if frame.pattern == MONO:
        return [_Entry(0x0106, _SHORT, [_LINEAR_RAW])]
    side = cell_side(frame.pattern)
    matrix = _SRGB_M_XYZ if frame.camera_M_xyz is None else frame.camera_M_xyz
    gains = frame.camera_gains
    neutral = [] if gains is None else [_Entry(0xC628, _RATIONAL, _rationals(gains.min() / gains))]
    return [
        _Entry(0x0106, _SHORT, [_CFA]),
        _Entry(0x828D, _SHORT, [side, side]),
        _Entry(0x828E, _BYTE, [_COLOURS[letter] for letter in frame.pattern]),
        _Entry(0xC616, _BYTE, [0, 1, 2]),  # planes are red, green, blue
        _Entry(0xC617, _SHORT, [1]),  # on a rectangular grid
        _Entry(0xC621, _SRATIONAL, _rationals(matrix.ravel())),
        *neutral,  # how white looks to the camera
        _Entry(0xC65A, _SHORT, [_D65]),
    ]


def _level_entries(frame: Mosaic) -> list[_Entry]:
    black = frame.black.ravel()
    if black.min() < 0:
        raise InvalidInput(f"a DNG file cannot hold a black level below 0, found {black.min():g}")
    return [
        _Entry(0xC619, _SHORT, list(frame.black.shape)),
        _Entry(0xC61A, _RATIONAL, _rationals(black)),
        _Entry(0xC61D, _LONG, [round(frame.white)]),
    ]


def _capture_entries(capture: Capture) -> list[_Entry]:
    iso = [] if capture.iso is None else [_Entry(0x8827, _SHORT, [min(round(capture.iso), 0xFFFF)])]
    known = ((0x829A, capture.exposure_s), (0x829D, capture.f_number), (0x920A, capture.focal_mm))
    rationals = [_Entry(tag, _RATIONAL, _rationals([value])) for tag, value in known if value is not None]
    return [_Entry(0x9000, 7, b"0230"), *iso, *rationals]


def _text(tag: int, text: str) -> _Entry:
    return _Entry(tag, _ASCII, text.encode("ascii", errors="replace") + b"\0")


def _rationals(values: Sequence[float] | Array) -> list[int]:
    """Return numerator and denominator of every value, one after the other."""
    fractions = (Fraction(float(value)).limit_denominator(_DENOMINATOR) for value in values)
    return [number for fraction in fractions for number in (fraction.numerator, fraction.denominator)]


def _directory(entries: Sequence[_Entry], start: int) -> bytes:
    """Return the last directory of a file, to stand at `start`: its entries by tag, then what they do not hold."""
    outside = bytearray()
    beyond = start + 2 + _ENTRY * len(entries) + 4
    packed = bytearray(struct.pack("<H", len(entries)))
    for entry in sorted(entries):
        values, per_value = entry.values, 2 if entry.kind in (_RATIONAL, _SRATIONAL) else 1
        content = values if isinstance(values, bytes) else struct.pack(f"<{len(values)}{_CODES[entry.kind]}", *values)
        packed += struct.pack("<HHI", entry.tag, entry.kind, len(values) // per_value)
        packed += content.ljust(4, b"\0") if len(content) <= 4 else struct.pack("<I", beyond + len(outside))
        if len(content) > 4:
            outside += content + bytes(len(content) % 2)  # values begin on even bytes
    return bytes(packed) + struct.pack("<I", 0) + bytes(outside)
