"""How a raw frame was taken, wherever its maker keeps that: as TIFF, in a preview, or in boxes.

Source: Exif 2.32 (JEITA CP-3451E), section 4.6; L. Chevalier, "Describing the Canon Raw v3 (CR3) file format".
"""

import struct
from typing import Any

from camcal.images import containers, exif
from camcal.raw.mosaic import Capture

_FUJI = b"FUJIFILMCCD-RAW"
_FUJI_PREVIEW = 84  # where the offset and the length of the preview stand, a JPEG file with an EXIF block
_CANON_BOXES = (b"CMT1", b"CMT2")  # the first directory, and the one about the capture
_CANON_SEARCH = 1 << 16


def capture_of(content: bytes, known: Any) -> Capture:
    """Return how a frame was taken by the EXIF tags of its camera file, where they are silent by what LibRaw knows.

    known: LibRaw's iso_speed, shutter_speed (s), aperture (f-number) and focal_length (mm).
    """
    said: dict[str, Any] = {
        "exposure_s": _unless_default(known.shutter_speed),
        "iso": known.iso_speed or None,
        "f_number": _unless_default(known.aperture),
        "focal_mm": known.focal_length or None,
    }
    for block in _blocks(content):
        said |= exif.capture_facts(block)
    return Capture(**said)


def _unless_default(value: float) -> float | None:
    """Return the value unless it is what LibRaw makes of no value: 0, or 2 to the power of 0."""
    return None if value in (0, 1) else value


def _blocks(content: bytes) -> list[bytes]:
    if content.startswith(_FUJI):
        return [_preview_exif(content)]
    if content[4:8] == b"ftyp":
        return [_box(content, name) for name in _CANON_BOXES]
    return [content]


def _preview_exif(content: bytes) -> bytes:
    try:
        offset, length = struct.unpack_from(">II", content, _FUJI_PREVIEW)
    except struct.error:
        return b""
    preview = content[offset : offset + length]
    return containers.read_jpeg(preview).exif if preview.startswith(containers.JPEG) else b""


def _box(content: bytes, name: bytes) -> bytes:
    """Return what a box of a Canon CR3 file holds, nothing if it is not there; its length stands before its name."""
    place = content.find(name, 4, _CANON_SEARCH)
    if place < 0:
        return b""
    (length,) = struct.unpack_from(">I", content, place - 4)
    return content[place + 4 : place - 4 + length]
