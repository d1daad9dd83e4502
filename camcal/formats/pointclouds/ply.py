"""PLY, the polygon file format: written binary (little endian) or ASCII; read in any byte order, vertices only.

The header says float and uchar rather than float32 and uint8, because some readers know only the names of the original
description (Turk, The PLY polygon file format, 1994).
"""

import re
from typing import BinaryIO

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.errors import FileError
from camcal.formats.pointclouds.record import (
    PointCloudFile,
    blocks_of,
    comments_of,
    from_comments,
    text_rows,
    text_table,
)
from camcal.stereo.depth import VertexStream

_WRITTEN = {"f": "float", "u": "uchar"}
_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}
_HEADER = re.compile(rb"ply\s.*?\nend_header[ \t]*(\r\n|\n)", re.DOTALL)
_LONGEST_HEADER = 1 << 20  # bytes; a damaged file is not searched to its end


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: list[tuple[str, str | None]]  # name and NumPy's type without its byte order, None for a list


@dataclass(frozen=True)
class _Header:
    order: str  # NumPy's letter of the byte order, "=" for text
    elements: list[_Element]
    comments: list[str]


def write(file: BinaryIO, stream: VertexStream) -> None:
    """Write a cloud as binary, block by block."""
    file.write(_header_of(stream, "binary_little_endian"))
    file.writelines(block.data for block in blocks_of(stream))


def write_text(file: BinaryIO, stream: VertexStream) -> None:
    """Write a cloud as ASCII, block by block."""
    file.write(_header_of(stream, "ascii"))
    file.writelines(text_rows(blocks_of(stream)))


def _header_of(stream: VertexStream, form: str) -> bytes:
    lines = [
        "ply",
        f"format {form} 1.0",
        *(f"comment {comment}" for comment in comments_of(stream)),
        f"element vertex {stream.count}",
        *(f"property {_WRITTEN[stream.type[name].kind]} {name}" for name in stream.type.names or ()),
        "end_header",
    ]
    return ("\n".join(lines) + "\n").encode()


def read(content: bytes) -> PointCloudFile:
    """Return the vertices of a PLY file; faces and other elements are passed over.

    Raises FileError if the header or the numbers are not as the format has them.
    """
    found = _HEADER.match(content, 0, _LONGEST_HEADER)
    if found is None:
        raise FileError("not a PLY file (it begins with ply and has a line end_header)")
    header = _parse(found[0].decode("utf-8", "replace").splitlines())
    names = [element.name for element in header.elements]
    if "vertex" not in names:
        raise FileError("PLY file without vertices")
    before, vertex = header.elements[: names.index("vertex")], header.elements[names.index("vertex")]
    body = memoryview(content)[found.end() :]
    table = _text(body, before, vertex) if header.order == "=" else _binary(body, header.order, before, vertex)
    return from_comments(table, header.comments)


def _parse(lines: list[str]) -> _Header:
    order = ""
    elements: list[_Element] = []
    comments: list[str] = []
    for number, line in enumerate(lines[1:-1], 2):
        match line.split():
            case ["comment" | "obj_info", *_]:
                comments.append(line.partition(" ")[2])
            case ["format", name, _] if name in _ORDERS:
                order = _ORDERS[name]
            case ["element", name, count] if re.fullmatch("[0-9]{1,18}", count):
                elements.append(_Element(name, int(count), []))
            case ["property", "list", _, _, name] if elements:
                elements[-1].properties.append((name, None))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].properties.append((name, _TYPES[kind]))
            case []:
                continue
            case _:
                raise FileError(f"line {number} of the PLY header is invalid: {line[:80]}")
    if not order:
        raise FileError("the PLY header has no line format")
    return _Header(order, elements, comments)


def _binary(body: memoryview, order: str, before: list[_Element], vertex: _Element) -> Array:
    start = sum(element.count * _type_of(element, order).itemsize for element in before)
    kind = _type_of(vertex, order)
    needed = start + vertex.count * kind.itemsize
    if len(body) < needed:
        raise FileError(f"{vertex.count} vertices end {needed} bytes after the header, the file has {len(body)} there")
    return np.ndarray(vertex.count, kind, body, start)


def _text(body: memoryview, before: list[_Element], vertex: _Element) -> Array:
    """Return the vertices of an ASCII file, of which every element is a line."""
    kind = _type_of(vertex, "=")
    start = sum(element.count for element in before)
    lines = [line for line in str(body, "ascii", "replace").splitlines() if line.strip()]
    if len(lines) < start + vertex.count:
        raise FileError(f"{vertex.count} vertices end on line {start + vertex.count}, there are {len(lines)} lines")
    return text_table(lines[start : start + vertex.count], kind)


def _type_of(element: _Element, order: str) -> np.dtype[np.void]:
    """Return the record of one row of an element; raises FileError if it has lists, or a name twice."""
    names = [name for name, _ in element.properties]
    if len(set(names)) < len(names):
        raise FileError(f"a PLY element {element.name} with two properties {max(names, key=names.count)}")
    lists = [name for name, kind in element.properties if kind is None]
    if lists:
        raise FileError(f"a PLY element {element.name} with the list {lists[0]} is not read; save it without")
    return np.dtype([(name, f"{order}{kind}") for name, kind in element.properties])
