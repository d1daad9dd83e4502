"""The size that the header of an image file states, found without decoding: memory is taken only for what is allowed.

Sources: W3C PNG, section 5 and 11.2; ITU-T T.81, annex B; TIFF 6.0, section 2; Microsoft BITMAPINFOHEADER; Netpbm's pnm
and pam; Google's WebP container and lossless bitstream; ITU-T T.800, annex A and I.
"""

import re
import struct
from collections.abc import Callable

from camcal.images import containers, exif

Size = tuple[int, int]

_CHUNK = 12  # bytes of a chunk of a PNG file around its data: length, kind, checksum
_PACKED = 1040  # deflate makes at most so many bytes of one
_PNM = re.compile(rb"P[1-6fF](?:\s|#[^\n]*\n)+([0-9]{1,9})(?:\s|#[^\n]*\n)+([0-9]{1,9})\s")
_PAM = re.compile(rb"P7\n(?:.*\n)*?WIDTH ([0-9]{1,9})\n(?:.*\n)*?HEIGHT ([0-9]{1,9})\n")
_PAM_HEADER = 1000  # bytes
_OLD_BMP = 12  # bytes of the header that OS/2 writes
_J2K = b"\xff\x4f\xff\x51"
_LARGEST_LOSSLESS = 0x3FFF


def stated_size(content: bytes) -> Size | None:
    """Return the size (width, height) that the header of an image file states; None for other kinds of files.

    Raises ValueError if the header is damaged, or states what its file is too short for.
    """
    try:
        for starts, read in _READERS:
            if content.startswith(starts):
                return read(content)
    except (struct.error, IndexError) as error:
        raise ValueError("the header is cut off") from error
    return None


def _png(content: bytes) -> Size:
    """Return the size of a PNG file all of whose chunks lie within it: OpenCV makes room for what a chunk says."""
    width, height, depth, colour = struct.unpack_from(">IIBB", content, 16)
    position = len(containers.PNG)
    while position < len(content):
        length, kind = struct.unpack_from(">I4s", content, position)
        if position + length + _CHUNK > len(content):
            raise ValueError(f"a chunk of {length} bytes ends beyond the file")
        position += length + _CHUNK
        if kind == b"IEND":
            break
    bits = width * height * depth * {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}.get(colour, 1)
    if bits > 8 * _PACKED * len(content):
        raise ValueError(f"{width} x {height} pixels do not fit into its {len(content)} bytes")
    return width, height


def _jpeg(content: bytes) -> Size:
    size = containers.read_jpeg(content).size
    if size == (0, 0):
        raise ValueError("it has no frame")
    return size


def _tiff(content: bytes) -> Size:
    return exif.stated_size(content)


def _bmp(content: bytes) -> Size:
    (length,) = struct.unpack_from("<I", content, 14)
    width, height = struct.unpack_from("<HH" if length == _OLD_BMP else "<ii", content, 18)
    return width, abs(height)  # below 0: rows from the top down


def _pnm(content: bytes) -> Size:
    match = _PNM.match(content)
    if match is None:
        raise ValueError("width and height are not there")
    return int(match[1]), int(match[2])


def _pam(content: bytes) -> Size:
    match = _PAM.match(content[:_PAM_HEADER])
    if match is None:
        raise ValueError("WIDTH and HEIGHT are not there")
    return int(match[1]), int(match[2])


def _webp(content: bytes) -> Size:
    kind = content[12:16]
    if kind == b"VP8X":
        return 1 + int.from_bytes(content[24:27], "little"), 1 + int.from_bytes(content[27:30], "little")
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", content, 21)
        return 1 + (bits & _LARGEST_LOSSLESS), 1 + (bits >> 14 & _LARGEST_LOSSLESS)
    width, height = struct.unpack_from("<HH", content, 26)
    return width & _LARGEST_LOSSLESS, height & _LARGEST_LOSSLESS


def _jpeg_2000(content: bytes) -> Size:
    """Return the size of the code stream, which is what a decoder makes room for."""
    start = content.find(_J2K)
    if start < 0:
        raise ValueError("it has no code stream")
    right, bottom, left, top = struct.unpack_from(">IIII", content, start + 8)
    return right - left, bottom - top


_READERS: tuple[tuple[bytes | tuple[bytes, ...], Callable[[bytes], Size]], ...] = (
    (containers.PNG, _png),
    (containers.JPEG, _jpeg),
    ((b"II*\0", b"MM\0*"), _tiff),
    (b"BM", _bmp),
    (b"P7", _pam),
    ((b"P1", b"P2", b"P3", b"P4", b"P5", b"P6", b"PF", b"Pf"), _pnm),
    (b"RIFF", _webp),
    ((b"\0\0\0\x0cjP", _J2K), _jpeg_2000),
)
