"""Pixel formats: how the samples of a sensor lie in bytes, under the names that cameras and drivers give them.

Names are those of the Pixel Format Naming Convention (PFNC) of GenICam, the four characters of Video4Linux, and the
names of libcamera, where MIPI formats have no other. A name without a colour (Bayer12p, RAW10) leaves the pattern open.
Source: EMVA, Pixel Format Naming Convention 2.4; MIPI CSI-2; Linux kernel, Documentation/userspace-api/media/v4l.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.parsing import nearest
from camcal.raw import ALIGNS, ENDIANS, MONO
from camcal.raw.packing import BLOCK_PIXELS, Packing, gige_vision, lsb_first, mipi, msb_first, unpack_rows


@dataclass(frozen=True, eq=False)
class PixelFormat:
    """How samples lie in bytes.

    family: the name that leaves the pattern open. bits: of a sample. pattern: four letters, MONO, or None when the
    name leaves it open. packing: None when a pixel has one byte (8 bits) or two of its own. code: PFNC's number.
    """

    name: str
    family: str
    bits: int
    pattern: str | None
    packing: Packing | None
    aliases: tuple[str, ...] = ()
    code: int | None = None

    @property
    def names(self) -> tuple[str, ...]:
        return self.name, *self.aliases

    @property
    def white(self) -> int:
        """The largest value that a sample can have."""
        return (1 << self.bits) - 1

    @property
    def has_byte_order(self) -> bool:
        """Whether byte order and alignment are open: only samples in two bytes of their own have a choice."""
        return self.packing is None and self.bits > 8

    @property
    def rows_start_groups(self) -> bool:
        """Whether drivers pad the rows of this format; the others run on from row to row unless a stride is given."""
        return self.packing is None or self.packing.by_row


class _Family(NamedTuple):
    """Formats that differ in their pattern only; codes and fourccs in the order of _COLOURS."""

    suffix: str
    bits: int
    packing: Packing | None
    codes: tuple[int, ...] = ()
    fourccs: str = ""
    libcamera: str = ""


_COLOURS = {"Mono": MONO, "BayerGR": "GRBG", "BayerRG": "RGGB", "BayerGB": "GBRG", "BayerBG": "BGGR"}


def _run(mono: int, first: int, step: int = 1) -> tuple[int, ...]:
    """Return the code of Mono and those of GR, RG, GB, BG, which follow each other."""
    return mono, *range(first, first + 4 * step, step)


_FAMILIES = (
    _Family("8", 8, None, _run(0x01080001, 0x01080008), "GREY GRBG RGGB GBRG BA81", "8"),
    _Family("10", 10, None, _run(0x01100003, 0x0110000C), "Y10 BA10 RG10 GB10 BG10", "10"),
    _Family("12", 12, None, _run(0x01100005, 0x01100010), "Y12 BA12 RG12 GB12 BG12", "12"),
    _Family("14", 14, None, _run(0x01100025, 0x01100109), "Y14 GR14 RG14 GB14 BG14", "14"),
    _Family("16", 16, None, _run(0x01100007, 0x0110002E), "Y16 GR16 RG16 GB16 BYR2", "16"),
    _Family("10p", 10, lsb_first(10), (0x010A0046, 0x010A0056, 0x010A0058, 0x010A0054, 0x010A0052)),
    _Family("12p", 12, lsb_first(12), (0x010C0047, 0x010C0057, 0x010C0059, 0x010C0055, 0x010C0053)),
    _Family("14p", 14, lsb_first(14), _run(0x010E0104, 0x010E0105)),
    _Family("10Packed", 10, gige_vision(10), _run(0x010C0004, 0x010C0026)),
    _Family("12Packed", 12, gige_vision(12), _run(0x010C0006, 0x010C002A)),
    _Family("10pmsb", 10, msb_first(10)),
    _Family("12pmsb", 12, msb_first(12)),
    _Family("14pmsb", 14, msb_first(14)),
    _Family("RAW10", 10, mipi(10), (), "Y10P pgAA pRAA pGAA pBAA", "10_CSI2P"),
    _Family("RAW12", 12, mipi(12), (), "Y12P pgCC pRCC pGCC pBCC", "12_CSI2P"),
    _Family("RAW14", 14, mipi(14), (), "Y14P pgEE pREE pGEE pBEE", "14_CSI2P"),
)


def _members(family: _Family) -> Iterator[PixelFormat]:
    """Yield the format without a pattern, then those of every pattern."""
    suffix, bits, packing, codes, fourccs, libcamera = family
    of_pfnc = not suffix.startswith("RAW")
    name = f"Bayer{suffix}" if of_pfnc else suffix
    yield PixelFormat(name, name, bits, None, packing)
    for place, (prefix, pattern) in enumerate(_COLOURS.items()):
        names = [f"{prefix}{suffix}"] if of_pfnc else []
        if libcamera:
            names.append(("R" if pattern == MONO else f"S{pattern}") + libcamera)
        names += fourccs.split()[place : place + 1]
        code = codes[place] if codes else None
        yield PixelFormat(
            name=names[0], family=name, bits=bits, pattern=pattern, packing=packing, aliases=tuple(names[1:]), code=code
        )


FORMATS = tuple(member for family in _FAMILIES for member in _members(family))
FAMILIES = tuple(each for each in FORMATS if each.pattern is None)


def pixel_format_named(name: str) -> PixelFormat:
    """Return the pixel format of a name of any of the three vocabularies, or of PFNC's number written 0x010C0059.

    Capitals do not matter except where they are all that tells two names apart (pGAA is GBRG, pgAA is GRBG).
    Raises InvalidInput with the nearest name and the families there are.
    """
    text = name.strip()
    for matches in (
        [each for each in FORMATS if text in each.names],
        [each for each in FORMATS if text.casefold() in (other.casefold() for other in each.names)],
        [each for each in FORMATS if each.code is not None and text.lower() == f"0x{each.code:08x}"],
    ):
        if len(matches) == 1:
            return matches[0]
        if matches:
            choices = " or ".join(f"{each.name} ({each.pattern})" for each in matches)
            raise InvalidInput(f"pixel format {name!r} needs its capitals: it may be {choices}")
    near = nearest(text, [other for each in FORMATS for other in each.names])
    hint = f"did you mean {near}? " if near else ""
    suffixes = "|".join(each.suffix for each in _FAMILIES if not each.suffix.startswith("RAW"))
    choices = f"{hint}there are Mono and BayerRG|GR|GB|BG with {suffixes}, and SRGGB10_CSI2P (12, 14) for MIPI"
    raise InvalidInput(f"pixel format {name!r} is unknown; {choices}")


def row_bytes(pixel_format: PixelFormat, width: int) -> int:
    """Return the bytes that the pixels of one row take, without padding, when every row starts in its own byte."""
    packing = pixel_format.packing
    if packing is None:
        return width * _plain_type(pixel_format).itemsize
    return -(-width // packing.pixels) * packing.size if packing.by_row else -(-width * packing.stored_bits // 8)


def frame_bytes(pixel_format: PixelFormat, size: tuple[int, int], stride: int | None = None) -> int:
    """Return the bytes from the start of a frame to its last pixel; size is (width, height), stride bytes per row.

    Without a stride nothing is padded, and packed PFNC data run on from row to row inside a group.
    Raises InvalidInput if the size is not positive or the stride shorter than a row.
    """
    width, height = size
    if width < 1 or height < 1:
        raise InvalidInput(f"a frame of {width}x{height} pixels is empty")
    row = row_bytes(pixel_format, width)
    if stride is None:
        return row * height if pixel_format.rows_start_groups else row_bytes(pixel_format, width * height)
    if stride < row:
        raise InvalidInput(f"a stride of {stride} bytes is too short: {width} pixels of {pixel_format.name} take {row}")
    return stride * (height - 1) + row


def unpack(
    data: bytes | bytearray | memoryview | Array,
    pixel_format: PixelFormat,
    size: tuple[int, int],
    *,
    stride: int | None = None,
    endian: str = "little",
    align: str = "lsb",
) -> Array:
    """Return the samples (height, width), uint8 for 8 bits, else uint16 counts from 0.

    data: bytes, or an array of them; what follows the last pixel is not read. size: (width, height) pixels.
    stride: bytes from row to row; None: rows follow each other without padding. endian, align: of unpacked samples of
    10 … 16 bits; "msb" ones lie in the upper bits of their two bytes and are shifted down.
    Raises InvalidInput if data are too short or an argument does not belong to the format.
    """
    require_byte_order(pixel_format, endian, align)
    needed = frame_bytes(pixel_format, size, stride)
    content = np.frombuffer(data, np.uint8)
    if len(content) < needed:
        wanted = f"{pixel_format.name} {size[0]}x{size[1]}"
        raise InvalidInput(f"{wanted} needs {needed} bytes, found {len(content)}")
    if pixel_format.packing is None:
        return _unpack_plain(content, pixel_format, size, stride, endian, align)
    return _unpack_packed(content[:needed], pixel_format.packing, size, stride)


def _unpack_plain(
    content: Array, pixel_format: PixelFormat, size: tuple[int, int], stride: int | None, endian: str, align: str
) -> Array:
    stored = _plain_type(pixel_format, endian)
    step = stride or size[0] * stored.itemsize
    samples: Array = np.ndarray(size[::-1], stored, content, 0, (step, stored.itemsize))
    values = samples.astype(stored.newbyteorder("="))
    if align == "msb":
        values >>= 16 - pixel_format.bits
    return values


def _unpack_packed(content: Array, packing: Packing, size: tuple[int, int], stride: int | None) -> Array:
    width, height = size
    if stride is None and not packing.by_row:  # one stream, cut where it suits the cache
        groups = -(-width * height // packing.pixels)
        row = min(groups, BLOCK_PIXELS // packing.pixels)
        lanes = unpack_rows(packing, content, -(-groups // row), row, row * packing.size)
        return lanes.ravel()[: width * height].reshape(height, width)
    groups = -(-width // packing.pixels)
    lanes = unpack_rows(packing, content, height, groups, stride or groups * packing.size)
    return np.ascontiguousarray(lanes[:, :width])


def pack(
    values: Array,
    pixel_format: PixelFormat,
    *,
    stride: int | None = None,
    endian: str = "little",
    align: str = "lsb",
) -> bytes:
    """Return the bytes of samples (height, width) of whole counts; the inverse of `unpack`, padding is zero.

    Raises InvalidInput if a sample is no whole number or above white, or an argument does not belong to the format.
    """
    require_byte_order(pixel_format, endian, align)
    if values.ndim != 2 or values.dtype.kind not in "ui":
        raise InvalidInput(f"samples are (H, W) whole numbers, found {values.dtype} {values.shape}")
    height, width = values.shape
    length = frame_bytes(pixel_format, (width, height), stride)
    if values.min() < 0 or values.max() > pixel_format.white:
        found = f"{values.min()} … {values.max()}"
        raise InvalidInput(f"{pixel_format.name} holds 0 … {pixel_format.white}, found {found}")
    if stride is None and not pixel_format.rows_start_groups:
        return _pack_rows(values.reshape(1, -1), pixel_format, endian, align).tobytes()[:length]
    rows = _pack_rows(values, pixel_format, endian, align)[:, : row_bytes(pixel_format, width)]
    padded = np.zeros((height, stride or rows.shape[1]), np.uint8)
    padded[:, : rows.shape[1]] = rows
    return padded.tobytes()


def _pack_rows(values: Array, pixel_format: PixelFormat, endian: str, align: str) -> Array:
    """Return the bytes (rows, N) of every row by itself, whole groups with zeros for missing pixels."""
    packing = pixel_format.packing
    if packing is None:
        shift = 16 - pixel_format.bits if align == "msb" else 0
        stored = values.astype(np.uint16) << shift
        return stored.astype(_plain_type(pixel_format, endian)).view(np.uint8)
    missing = -values.shape[1] % packing.pixels
    return packing.pack(np.pad(values.astype(np.uint16), ((0, 0), (0, missing))))


def _plain_type(pixel_format: PixelFormat, endian: str = "little") -> np.dtype[Any]:
    if pixel_format.bits == 8:
        return np.dtype(np.uint8)
    return np.dtype("<u2" if endian == "little" else ">u2")


def require_byte_order(pixel_format: PixelFormat, endian: str, align: str) -> None:
    """Raise InvalidInput unless byte order and alignment are known words and open in this format."""
    for name, value, known in (("endian", endian, ENDIANS), ("align", align, ALIGNS)):
        if value not in known:
            raise InvalidInput(f"{name} {value!r} is unknown; use {' or '.join(known)}")
        if value != known[0] and not pixel_format.has_byte_order:
            raise InvalidInput(f"{pixel_format.name} has a fixed layout; {name} {value} is for unpacked 10 … 16 bits")
