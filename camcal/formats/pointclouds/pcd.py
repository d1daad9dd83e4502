"""PCD 0.7, the format of the Point Cloud Library (PCL): binary or ASCII written; compressed read as well.

Colour is one field rgb of 32 bits, 0x00RRGGBB. PCL calls its type F in binary and U, an integer, in ASCII files. The
compression is LZF (M. Lehmann, liblzf), which is read only.
"""

from collections.abc import Iterator, Mapping
from typing import Any, BinaryIO

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass, replace
from camcal.errors import FileError
from camcal.formats.pointclouds.record import (
    PointCloudFile,
    blocks_of,
    comments_of,
    from_comments,
    numbers_in,
    text_rows,
)
from camcal.parsing import parse_integer
from camcal.stereo.depth import COLOUR, VertexStream

_NAMES = {"nx": "normal_x", "ny": "normal_y", "nz": "normal_z"}  # as PCL has them
_PACKED = ("rgb", "rgba")
_LONGEST_HEADER = 1 << 20  # bytes
_LARGEST_COUNT = 1 << 16  # numbers of one field, such as a histogram

_LITERALS = 32  # a control byte below this announces that many bytes less one as they are
_LONG = 7  # a length that another byte adds to


@dataclass(frozen=True)
class _Header:
    type: np.dtype[np.void]
    width: int
    height: int
    data: str
    comments: list[str]

    @property
    def count(self) -> int:
        return self.width * self.height


def write(file: BinaryIO, stream: VertexStream) -> None:
    """Write a cloud as binary, block by block."""
    kind = _type_of(stream, "<f4")
    file.write(_header_of(stream, kind, "binary"))
    file.writelines(block.data for block in _pack(stream, kind))


def write_text(file: BinaryIO, stream: VertexStream) -> None:
    """Write a cloud as ASCII, block by block."""
    kind = _type_of(stream, "<u4")
    file.write(_header_of(stream, kind, "ascii"))
    file.writelines(text_rows(_pack(stream, kind)))


def _type_of(stream: VertexStream, rgb: str) -> np.dtype[np.void]:
    fields = []
    for name in stream.type.names or ():
        if name not in COLOUR:
            fields.append((_NAMES.get(name, name), "<f4"))
        elif name == COLOUR[0]:
            fields.append((_PACKED[0], rgb))
    return np.dtype(fields)


def _pack(stream: VertexStream, kind: np.dtype[np.void]) -> Iterator[Array]:
    for block in blocks_of(stream):
        packed = np.empty(len(block), kind)
        for name in stream.type.names or ():
            if name not in COLOUR:
                packed[_NAMES.get(name, name)] = block[name]
        if _PACKED[0] in (kind.names or ()):
            red, green, blue = (block[name].astype("<u4") for name in COLOUR)
            packed[_PACKED[0]] = (red << 16 | green << 8 | blue).view(kind[_PACKED[0]])
        yield packed


def _header_of(stream: VertexStream, kind: np.dtype[np.void], data: str) -> bytes:
    names = kind.names or ()
    width, height = stream.grid or (stream.count, 1)
    lines = [
        "# .PCD v0.7 - Point Cloud Data file format",
        *(f"# {comment}" for comment in comments_of(stream)),
        "VERSION 0.7",
        f"FIELDS {' '.join(names)}",
        f"SIZE {' '.join(str(kind[name].itemsize) for name in names)}",
        f"TYPE {' '.join(kind[name].kind.upper() for name in names)}",
        f"COUNT {' '.join('1' for _ in names)}",
        f"WIDTH {width}",
        f"HEIGHT {height}",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {stream.count}",
        f"DATA {data}",
    ]
    return ("\n".join(lines) + "\n").encode()


def read(content: bytes) -> PointCloudFile:
    """Return the vertices of a PCD file.

    Raises FileError if the header or the numbers are not as the format has them.
    """
    lines, start = _header_lines(content)
    header = _parse(lines)
    columns = _READERS[header.data](memoryview(content)[start:], header)
    grid = (header.width, header.height) if header.height > 1 else None
    return replace(from_comments(_unpack(columns), header.comments), grid=grid)


def _header_lines(content: bytes) -> tuple[list[str], int]:
    """Return the lines of the header, and the byte at which the data begin."""
    at, lines = 0, []
    while (end := content.find(b"\n", at, _LONGEST_HEADER)) >= 0:
        lines.append(content[at:end].decode("utf-8", "replace").strip())
        at = end + 1
        if lines[-1].split()[:1] == ["DATA"]:
            return lines, at
    raise FileError("not a PCD file (its header ends with a line DATA)")


def _parse(lines: list[str]) -> _Header:
    words = {line.split()[0]: line.split()[1:] for line in lines if line and not line.startswith("#")}
    data = (words["DATA"] or [""])[0]
    if data not in _READERS:
        raise FileError(f"PCD data of the kind {data or 'nothing'}; use one of {', '.join(_READERS)}")
    try:
        width, height = parse_integer(words["WIDTH"][0]), parse_integer(words["HEIGHT"][0])
        kind = _fields(words)
    except (KeyError, IndexError, ValueError, TypeError) as error:
        raise FileError(
            "the PCD header has no FIELDS, SIZE, TYPE, COUNT, WIDTH and HEIGHT that fit together"
        ) from error
    points = words.get("POINTS", [str(width * height)])
    if width < 0 or height < 0 or points != [str(width * height)]:
        raise FileError(f"the PCD header has {width} × {height}, and {' '.join(points)} points")
    return _Header(kind, width, height, data, [line.lstrip("# ") for line in lines if line.startswith("#")])


def _fields(words: Mapping[str, list[str]]) -> np.dtype[np.void]:
    """Return the record of a point; raises ValueError, KeyError or TypeError if the header tells none."""
    names, sizes, kinds = words.get("FIELDS") or words["COLUMNS"], words["SIZE"], words["TYPE"]
    counts = [parse_integer(count) for count in words.get("COUNT", ["1"] * len(names))]
    if not all(0 < count <= _LARGEST_COUNT for count in counts) or not set(kinds) <= set("FIU"):
        raise ValueError
    rows = enumerate(zip(names, kinds, sizes, counts, strict=True))
    # A field _ is room left free, and there may be several.
    return np.dtype(
        [
            (f"_{index}" if name == "_" else name, f"<{kind.lower()}{size}", () if count == 1 else (count,))
            for index, (name, kind, size, count) in rows
        ]
    )


def _binary(body: memoryview, header: _Header) -> dict[str, Array]:
    _require(len(body), header.count * header.type.itemsize, header)
    table: Array = np.ndarray(header.count, header.type, body)
    return {name: table[name] for name in header.type.names or ()}


def _compress(body: memoryview, header: _Header) -> dict[str, Array]:
    """Return the fields, of which each stands as a whole in the compressed data."""
    if len(body) < 8:
        raise FileError(f"compressed PCD data begin with their two sizes, found {len(body)} bytes")
    packed, size = (int(number) for number in np.frombuffer(body, "<u4", 2))
    _require(len(body) - 8, packed, header)
    _require(size, header.count * header.type.itemsize, header)
    content = lzf_decompressed(bytes(body[8 : 8 + packed]), size)
    columns, at = {}, 0
    for name in header.type.names or ():
        kind = header.type[name]
        columns[name] = np.ndarray((header.count, *kind.shape), kind.base, content, at)
        at += header.count * kind.itemsize
    return columns


def _text(body: memoryview, header: _Header) -> dict[str, Array]:
    lines = [line for line in str(body, "ascii", "replace").splitlines() if line.strip()]
    if len(lines) < header.count:
        raise FileError(f"the PCD header promises {header.count} points, there are {len(lines)} lines")
    numbers = numbers_in(lines[: header.count], sum(_numbers_of(header.type[name]) for name in header.type.names or ()))
    columns, at = {}, 0
    for name in header.type.names or ():
        with np.errstate(invalid="ignore", over="ignore"):
            columns[name] = numbers[:, at].astype(header.type[name].base)  # of several numbers the first
        at += _numbers_of(header.type[name])
    return columns


def _numbers_of(field: np.dtype[Any]) -> int:
    return field.itemsize // field.base.itemsize


def _require(found: int, needed: int, header: _Header) -> None:
    if found < needed:
        raise FileError(f"{header.width} × {header.height} points take {needed} bytes, found {found}")


def _unpack(columns: dict[str, Array]) -> dict[str, Array]:
    """Return the columns with red, green and blue in the place of rgb."""
    packed = next((columns[name] for name in _PACKED if name in columns), None)
    if packed is None or packed.dtype.itemsize != 4 or packed.ndim != 1:
        return columns
    bits = np.ascontiguousarray(packed).view("<u4")
    shifts = zip(COLOUR, (16, 8, 0), strict=True)
    return columns | {name: (bits >> shift & 255).astype(np.uint8) for name, shift in shifts}


_READERS = {"binary": _binary, "binary_compressed": _compress, "ascii": _text}


def lzf_decompressed(packed: bytes, size: int) -> bytearray:
    """Return the `size` bytes that were packed; raises FileError if it is another number of bytes, or damaged."""
    found = bytearray()
    at = 0
    try:
        while at < len(packed) and len(found) <= size:
            control = packed[at]
            if control < _LITERALS:
                found += packed[at + 1 : at + 2 + control]
                at += 2 + control
            else:
                at = _repeat(found, packed, at)
    except IndexError as error:
        raise FileError(f"compressed data damaged at byte {at}") from error
    if len(found) != size:
        raise FileError(f"compressed data hold {len(found)} bytes or more, the header promises {size}")
    return found


def _repeat(found: bytearray, packed: bytes, at: int) -> int:
    """Append a piece of what stands already in `found`; return where the next control byte is."""
    length, distance = packed[at] >> 5, (packed[at] & 31) << 8
    if length == _LONG:
        at += 1
        length += packed[at]
    distance += packed[at + 1] + 1
    length += 2
    start = len(found) - distance
    if start < 0:
        raise IndexError
    piece = found[start : start + length]
    found += (piece * (length // len(piece) + 1))[:length]  # the piece may run into itself
    return at + 2
