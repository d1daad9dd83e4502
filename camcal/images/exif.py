"""The orientation tag and other relevant EXIF tags, in EXIF blocks and in TIFF files.

An EXIF block is a TIFF file without an image: a header, then directories of entries of 12 bytes. Of JPEG and PNG files
it is found here, with the size, and whether the end is there.
Sources: TIFF 6.0, section 2; Exif 2.32 (JEITA CP-3451E), section 4.6; ITU-T T.81, annex B (JPEG); W3C PNG
specification, third edition, section 5 and 11.3.
"""

import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, NamedTuple

from camcal.dataclass import dataclass

UPRIGHT = 1
JPEG = b"\xff\xd8\xff"
PNG = b"\x89PNG\r\n\x1a\n"
LONGEST_EXIF = 0xFF00  # bytes that a segment of a JPEG file holds, with room for one entry more

_ORDERS = {b"II*\0": "<", b"MM\0*": ">"}
_RAW_ORDERS = {b"II": "<", b"MM": ">"}  # camera makers have numbers of their own where TIFF has 42
_ORIENTATION, _EXIF_DIRECTORY, _WIDTH, _HEIGHT = 0x0112, 0x8769, 0xA002, 0xA003
_IMAGE_WIDTH, _IMAGE_HEIGHT = 0x0100, 0x0101
_SUBDIRECTORIES = 0x014A
_BLOCKS = ((0x0111, 0x0117), (0x0144, 0x0145))  # offsets and lengths of strips, and of tiles
_CAPTURE = {
    "make": (0x010F,),
    "model": (0x0110,),
    "exposure_s": (0x829A,),
    "iso": (0x8827, 0x8832, 0x8831, 0x0017),  # the first ends at 65535; then Exif 2.3's longer ones; Panasonic's
    "f_number": (0x829D,),
    "focal_mm": (0x920A,),
}
_TEXT = {"make", "model"}
_TAKEN = 0x9003, 0x9291  # date and time, and the fraction of a second
_ASCII, _SHORT, _LONG, _RATIONAL = 2, 3, 4, 5
_TOO_LARGE = 0xFFFF  # "this or more" in the ISO tag
_ENTRY_BYTES = 12
_EMPTY = b"II*\0\x08\0\0\0" + b"\0\0" + b"\0\0\0\0"  # a header and a directory without entries

_EXIF_HEADER = b"Exif\0\0"
_APP1, _SCAN, _END = 0xE1, 0xDA, b"\xff\xd9"
_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # tables and extensions share the range
_ALONE = frozenset({0x01, *range(0xD0, 0xD9)})  # markers without a segment


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
    numbers = _numbers(block, order, _first_directory(block, order).entries.get(_ORIENTATION))
    value = next(iter(numbers), UPRIGHT)
    return value if value in range(1, 9) else UPRIGHT


def capture_facts(block: bytes) -> dict[str, Any]:
    """Return how the image was taken: make, model, exposure_s, iso, f_number, focal_mm, as far as known.

    block: an EXIF block, or a file built like TIFF, as most camera raw files are. Zero counts as not said, and so does
    a number in place of a name or a text in place of a number.
    """
    try:
        order = _RAW_ORDERS[block[:2]]
        first = _first_directory(block, order).entries
        entries = first | _capture_directory(block, order, first)
    except (KeyError, struct.error):
        return {}
    said = {
        name: next(filter(None, (_fact(block, order, entries[tag]) for tag in tags if tag in entries)), None)
        for name, tags in _CAPTURE.items()
    }
    return {
        name: value for name, value in said.items() if value is not None and isinstance(value, str) == (name in _TEXT)
    }


def time_taken(block: bytes) -> tuple[str, str] | None:
    """Return when an image was taken, as `YYYY:MM:DD hh:mm:ss` and the second's decimals; None if not said."""
    try:
        order = _ORDERS[block[:4]]
        entries = _capture_directory(block, order, _first_directory(block, order).entries)
    except (KeyError, struct.error):
        return None
    taken, fraction = (_fact(block, order, entries[tag]) if tag in entries else None for tag in _TAKEN)
    return (str(taken), str(fraction or "")) if taken else None


def stated_size(content: bytes) -> tuple[int, int]:
    """Return the size (width, height) of the largest image in a TIFF file, (0, 0) if it states none.

    Raises struct.error if the first directory does not lie within the file.
    """
    order = _ORDERS[content[:4]]
    sizes = [
        (width[0], height[0])
        for entries in _directories(content, order, _first_directory(content, order))
        if (width := _numbers(content, order, entries.get(_IMAGE_WIDTH)))
        and (height := _numbers(content, order, entries.get(_IMAGE_HEIGHT)))
    ]
    return max(sizes, key=lambda size: size[0] * size[1], default=(0, 0))


def is_cut_off(content: bytes) -> bool:
    """Return whether a TIFF file lacks its first directory, or pixels that its directories point at."""
    order = _ORDERS.get(content[:4])
    if order is None:
        return False
    try:
        first = _first_directory(content, order)
    except struct.error:
        return True
    return any(_pixel_end(content, order, entries) > len(content) for entries in _directories(content, order, first))


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
            entry = struct.pack(order + "HHII", tag, _LONG, 1, value)
            result[entries[tag] : entries[tag] + _ENTRY_BYTES] = entry
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


def _directories(block: bytes, order: str, first: _Directory) -> Iterator[dict[int, int]]:
    """Yield the entries of every directory of images once; pointers that lead out of the file lead nowhere."""
    seen: set[int] = set()
    waiting = [first]
    while waiting:
        directory = waiting.pop()
        yield directory.entries
        below = _numbers(block, order, directory.entries.get(_SUBDIRECTORIES))
        for start in {*below, *struct.unpack_from(order + "I", block, directory.end)} - seen - {0}:
            seen.add(start)
            with suppress(struct.error):
                waiting.append(_directory(block, order, start))


def _pixel_end(block: bytes, order: str, entries: dict[int, int]) -> int:
    """Return where the last strip or tile of a directory ends; 0 without any."""
    blocks = [
        (offset, length)
        for offsets, lengths in _BLOCKS
        for offset, length in zip(
            _numbers(block, order, entries.get(offsets)), _numbers(block, order, entries.get(lengths)), strict=False
        )
    ]
    return max((offset + length for offset, length in blocks if length), default=0)


def _numbers(block: bytes, order: str, position: int | None) -> tuple[int, ...]:
    """Return the short or long numbers of the entry at `position`; none for other kinds, and for no entry."""
    if position is None:
        return ()
    kind, count = struct.unpack_from(order + "HI", block, position + 2)
    letter = {_SHORT: "H", _LONG: "I"}.get(kind)
    if letter is None:
        return ()
    layout = f"{order}{count}{letter}"
    try:
        return struct.unpack_from(layout, block, _place(block, order, position, struct.calcsize(layout)))
    except struct.error:
        return ()


def _fact(block: bytes, order: str, position: int) -> str | float | None:
    """Return the text or the number of the entry at `position`, None if it has neither or stands outside."""
    kind, count = struct.unpack_from(order + "HI", block, position + 2)
    if kind == _ASCII:
        start = _place(block, order, position, count)
        return block[start : start + count].partition(b"\0")[0].decode("ascii", errors="replace").strip()
    if kind == _RATIONAL:
        try:
            over, under = struct.unpack_from(order + "II", block, _place(block, order, position, 8))
        except struct.error:
            return None
        return over / under if under else None
    number = next(iter(_numbers(block, order, position)), None)
    return None if number == _TOO_LARGE else number


def _place(block: bytes, order: str, position: int, length: int) -> int:
    """Return where the values of an entry stand: in the entry itself, if they are at most 4 bytes long."""
    return int(position + 8 if length <= 4 else struct.unpack_from(order + "I", block, position + 8)[0])


@dataclass(frozen=True)
class JpegHeader:
    """Size (width, height), channels, EXIF block (empty without one), and whether the compressed data has its end."""

    size: tuple[int, int]
    channels: int
    exif: bytes
    complete: bool


def read_jpeg(content: bytes) -> JpegHeader:
    """Return the header of a JPEG file.

    The end is searched for behind the header only: a camera's thumbnail has an end of its own. A decoder fills what is
    missing with gray and says so to nobody.
    """
    size, channels, exif = (0, 0), 0, b""
    for marker, start, end in _segments(content):
        if marker == _APP1 and not exif and content.startswith(_EXIF_HEADER, start):
            exif = content[start + len(_EXIF_HEADER) : end]
        elif marker in _FRAMES and end - start > 5:
            height, width = (int.from_bytes(content[at : at + 2], "big") for at in (start + 1, start + 3))
            size, channels = (width, height), content[start + 5]
        elif marker == _SCAN:
            return JpegHeader(size, channels, exif, content.rfind(_END, end) >= 0)
    return JpegHeader(size, channels, exif, complete=False)


def read_png_exif(content: bytes) -> bytes:
    """Return the EXIF block of a PNG file, empty without one."""
    position = len(PNG)
    while position + 8 <= len(content):
        length = int.from_bytes(content[position : position + 4], "big")
        if content.startswith(b"eXIf", position + 4):
            return content[position + 8 : position + 8 + length]
        position += length + 12
    return b""


def insert_exif(content: bytes, block: bytes) -> bytes:
    """Return a JPEG or PNG file, that has none yet, with an EXIF block.

    block: at most 65 527 bytes for a JPEG file.
    """
    if content.startswith(PNG):
        chunk = b"eXIf" + block
        whole = len(block).to_bytes(4, "big") + chunk + zlib.crc32(chunk).to_bytes(4, "big")
        return _insert(content, content.index(b"IDAT") - 4, whole)
    payload = _EXIF_HEADER + block
    return _insert(content, 2, bytes([0xFF, _APP1]) + (len(payload) + 2).to_bytes(2, "big") + payload)


def _segments(content: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield the markers of a JPEG file with the start and end of their segments, as far as they are whole."""
    position = 2
    while position + 4 <= len(content) and content[position] == 0xFF:
        marker = content[position + 1]
        if marker == 0xFF:  # fill byte
            position += 1
        elif marker in _ALONE:
            position += 2
        else:
            end = position + 2 + int.from_bytes(content[position + 2 : position + 4], "big")
            if end > len(content):
                return
            yield marker, position + 4, end
            position = end


def _insert(content: bytes, position: int, piece: bytes) -> bytes:
    return b"".join((content[:position], piece, content[position:]))
