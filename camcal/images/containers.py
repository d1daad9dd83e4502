"""What JPEG and PNG files are made of, as far as it matters here: size, EXIF block, and whether the end is there.

Sources: ITU-T T.81, annex B (JPEG); W3C PNG specification, third edition, section 5 and 11.3.
"""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass

JPEG = b"\xff\xd8\xff"
PNG = b"\x89PNG\r\n\x1a\n"
LONGEST_EXIF = 0xFF00  # bytes that a segment of a JPEG file holds, with room for one entry more

_EXIF_HEADER = b"Exif\0\0"
_APP1, _SCAN, _END = 0xE1, 0xDA, b"\xff\xd9"
_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # tables and extensions share the range
_ALONE = frozenset({0x01, *range(0xD0, 0xD9)})  # markers without a segment


@dataclass(frozen=True)
class JpegHeader:
    """Size (width, height), channels, EXIF block (empty without one), and whether the compressed data has its end."""

    size: tuple[int, int]
    channels: int
    exif: bytes
    complete: bool


def read_jpeg(content: bytes) -> JpegHeader:
    """Return the header of a JPEG file.

    The end is looked for behind the header only: a camera's thumbnail has an end of its own. A decoder fills what is
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
        return _inserted(content, content.index(b"IDAT") - 4, whole)
    payload = _EXIF_HEADER + block
    return _inserted(content, 2, bytes([0xFF, _APP1]) + (len(payload) + 2).to_bytes(2, "big") + payload)


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


def _inserted(content: bytes, position: int, piece: bytes) -> bytes:
    return b"".join((content[:position], piece, content[position:]))
