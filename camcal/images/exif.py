"""The orientation tag and the little else of EXIF that matters to pixels, in EXIF blocks and in TIFF files alike.

An EXIF block is a TIFF file without an image: a header, then directories of entries of 12 bytes.
Source: TIFF 6.0, section 2; Exif 2.32 (JEITA CP-3451E), section 4.6.
"""

import struct
from typing import NamedTuple

UPRIGHT = 1

_ORDERS = {b"II*\0": "<", b"MM\0*": ">"}
_ORIENTATION, _EXIF_DIRECTORY, _WIDTH, _HEIGHT = 0x0112, 0x8769, 0xA002, 0xA003
_SHORT, _LONG = 3, 4
_ENTRY_BYTES = 12
_EMPTY = b"II*\0\x08\0\0\0" + b"\0\0" + b"\0\0\0\0"  # a header and a directory without entries


class _Directory(NamedTuple):
    """Where the entry of each tag begins, and where the offset of the next directory stands."""

    entries: dict[int, int]
    end: int


def is_readable(block: bytes) -> bool:
    """Return whether the block has directories that can be read."""
    try:
        order = _ORDERS[block[:4]]
        entries = _first_directory(block, order).entries
        _capture_directory(block, order, entries)
    except (KeyError, struct.error):
        return False
    return bool(entries)


def orientation(block: bytes) -> int:
    """Return the orientation tag 1 … 8 of an EXIF block or a TIFF file; 1, upright, where there is none."""
    if not is_readable(block):
        return UPRIGHT
    order = _ORDERS[block[:4]]
    position = _first_directory(block, order).entries.get(_ORIENTATION)
    value = UPRIGHT if position is None else _value(block, order, position)
    return value if value in range(1, 9) else UPRIGHT


def with_orientation(block: bytes, value: int) -> bytes:
    """Return an EXIF block or TIFF file that carries this orientation once; an empty block gives a new one."""
    result = bytearray(block or _EMPTY)
    order = _ORDERS[bytes(result[:4])]
    directory = _first_directory(result, order)
    entry = struct.pack(order + "HHIHH", _ORIENTATION, _SHORT, 1, value, 0)
    if _ORIENTATION in directory.entries:
        position = directory.entries[_ORIENTATION]
        result[position : position + _ENTRY_BYTES] = entry
        return bytes(result)
    return _with_entry(result, order, directory, entry)


def of_image(block: bytes, size: tuple[int, int]) -> bytes:
    """Return an EXIF block for an image of another size (width, height): the size told, the thumbnail left out."""
    result = bytearray(block)
    order = _ORDERS[block[:4]]
    first = _first_directory(block, order)
    struct.pack_into(order + "I", result, first.end, 0)  # the second directory is the thumbnail's
    entries = _capture_directory(block, order, first.entries)
    for tag, value in ((_WIDTH, size[0]), (_HEIGHT, size[1])):
        if tag in entries:
            struct.pack_into(order + "HHII", result, entries[tag], tag, _LONG, 1, value)
    return bytes(result)


def _with_entry(block: bytearray, order: str, directory: _Directory, entry: bytes) -> bytes:
    """Return the block with a first directory of one more entry, written at its end: nothing else has to move."""
    kept = {tag: bytes(block[position : position + _ENTRY_BYTES]) for tag, position in directory.entries.items()}
    kept[_ORIENTATION] = entry
    block += bytes(len(block) % 2)  # directories begin on even bytes
    struct.pack_into(order + "I", block, 4, len(block))
    successor = bytes(block[directory.end : directory.end + 4])
    block += struct.pack(order + "H", len(kept)) + b"".join(kept[tag] for tag in sorted(kept)) + successor
    return bytes(block)


def _first_directory(block: bytes | bytearray, order: str) -> _Directory:
    (start,) = struct.unpack_from(order + "I", block, 4)
    return _directory(block, order, start)


def _capture_directory(block: bytes, order: str, first: dict[int, int]) -> dict[int, int]:
    """Return the entries of the directory about the capture, which the first one points to; empty without one."""
    if _EXIF_DIRECTORY not in first:
        return {}
    (start,) = struct.unpack_from(order + "I", block, first[_EXIF_DIRECTORY] + 8)
    return _directory(block, order, start).entries


def _directory(block: bytes | bytearray, order: str, start: int) -> _Directory:
    """Return the directory at `start`; raises struct.error if it does not lie within the block."""
    (count,) = struct.unpack_from(order + "H", block, start)
    end = start + 2 + _ENTRY_BYTES * count
    struct.unpack_from(order + "I", block, end)
    positions = range(start + 2, end, _ENTRY_BYTES)
    return _Directory({struct.unpack_from(order + "H", block, at)[0]: at for at in positions}, end)


def _value(block: bytes, order: str, position: int) -> int:
    (kind,) = struct.unpack_from(order + "H", block, position + 2)
    (value,) = struct.unpack_from(order + ("I" if kind == _LONG else "H"), block, position + 8)
    return int(value)
