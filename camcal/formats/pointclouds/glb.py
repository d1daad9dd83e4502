"""GLB, the binary form of glTF 2.0: one primitive of points, for viewers on the web and for modelling programs.

The vertices stay in their own frame and unit. The node that holds them turns them into glTF's, metres with x right,
y up and z towards the viewer. Colour is linear in glTF, and has 16 bits so that the 8-bit colour comes back. Vertices
without a position are left out. Of a file the first primitive is read, as this package writes it and as others may.
Source: Khronos, glTF 2.0 specification, sections 3.6.2, 3.7.2.1, 3.9.2 and 4.4.
"""

import json
import struct
from collections.abc import Iterator
from typing import Any, BinaryIO

import numpy as np

from camcal.arrays import Array
from camcal.errors import FileError, InvalidInput
from camcal.formats.pointclouds.record import MILLIMETRES, PointCloudFile, blocks_of, cloud_of
from camcal.geometry.pose import rotation_of
from camcal.raw.develop import encode
from camcal.stereo.depth import COLOUR, INTENSITY, METRES, NORMAL, POSITION, SIGMA, VertexStream

MAGIC, VERSION = b"glTF", 2
HEADER = struct.Struct("<4sII")  # magic, version, bytes of the file
CHUNK = struct.Struct("<I4s")  # bytes, kind
JSON_CHUNK, BINARY_CHUNK = b"JSON", b"BIN\0"

ATTRIBUTES: dict[str, tuple[str, ...]] = {
    "POSITION": POSITION,
    "COLOR_0": COLOUR,
    "NORMAL": NORMAL,
    "_INTENSITY": (INTENSITY,),
    "_SIGMA": (SIGMA,),
}
COMPONENTS = {"<f4": 5126, "<u2": 5123, "|u1": 5121}
SHAPES: dict[str, tuple[int, ...]] = {"SCALAR": (), "VEC3": (3,), "VEC4": (4,)}

_OPAQUE = 65535
_POINTS = 0  # the mode of a primitive
_LIMIT = (1 << 32) - (1 << 20)  # bytes; the lengths in the file have 32 bits
_GLTF_R_CAMERA = np.diag([1.0, -1.0, -1.0])

_KINDS = {number: np.dtype(name) for name, number in COMPONENTS.items()}


def write(file: BinaryIO, stream: VertexStream) -> None:
    """Write a cloud block by block, and then in front of it how many points there are and how far they reach.

    Raises InvalidInput if the file would pass 4 GiB.
    """
    kind = _type_of(stream)
    if stream.count * kind.itemsize > _LIMIT:
        raise InvalidInput(f"{stream.count} points exceed the 4 GiB of a GLB file; write .ply")
    longest = np.full((2, 3), np.finfo(np.float32).min)
    room = (len(_description(stream, kind, stream.count, longest)) + 3) // 4 * 4
    start = HEADER.size + CHUNK.size + room + CHUNK.size
    file.seek(start)
    count, extent = _write_points(file, stream, kind)
    text = _description(stream, kind, count, extent).ljust(room)
    file.seek(0)
    file.write(HEADER.pack(MAGIC, VERSION, start + count * kind.itemsize))
    file.write(CHUNK.pack(room, JSON_CHUNK) + text)
    file.write(CHUNK.pack(count * kind.itemsize, BINARY_CHUNK))


def _write_points(file: BinaryIO, stream: VertexStream, kind: np.dtype[np.void]) -> tuple[int, Array]:
    """Return the number of points written, and the smallest and largest x, y, z (2, 3)."""
    count, low, high = 0, np.full(3, np.inf, np.float32), np.full(3, -np.inf, np.float32)
    for block in _interleave(stream, kind):
        file.write(block.data)
        count += len(block)
        for axis, column in enumerate(block["POSITION"].T):
            low[axis] = column.min(initial=low[axis])
            high[axis] = column.max(initial=high[axis])
    return count, np.stack([low, high])


def _type_of(stream: VertexStream) -> np.dtype[np.void]:
    """Return the record of one point; the attributes begin at multiples of four bytes, as glTF wants them."""
    names = stream.type.names or ()
    fields: list[tuple[str, str, tuple[int, ...]]] = []
    for attribute, own in ATTRIBUTES.items():
        if own[0] in names:
            shape = () if len(own) == 1 else (len(own),)
            fields.append((attribute, "<u2", (4,)) if own == COLOUR else (attribute, "<f4", shape))
    return np.dtype(fields)


def _interleave(stream: VertexStream, kind: np.dtype[np.void]) -> Iterator[Array]:
    value = np.arange(256) / 255  # to linear light: IEC 61966-2-1
    light = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    linear = np.asarray(np.rint(light * _OPAQUE), np.uint16)
    for block in blocks_of(stream):
        kept = block[np.isfinite(block["x"]) & np.isfinite(block["y"]) & np.isfinite(block["z"])]
        points = np.empty(len(kept), kind)
        for attribute in kind.names or ():
            for column, field in enumerate(ATTRIBUTES[attribute]):
                target = points[attribute] if kind[attribute].shape == () else points[attribute][:, column]
                target[:] = linear[kept[field]] if attribute == "COLOR_0" else kept[field]
        if "COLOR_0" in (kind.names or ()):
            points["COLOR_0"][:, 3] = _OPAQUE
        yield points


def _description(stream: VertexStream, kind: np.dtype[np.void], count: int, extent: Array) -> bytes:
    """Return the JSON of a file of so many points between two corners (2, 3)."""
    node: dict[str, Any] = {"name": "points", "matrix": _placement(stream).T.ravel().tolist()}
    node["extras"] = {"unit": stream.unit, "frame": stream.frame, "notes": stream.notes}
    document: dict[str, Any] = {
        "asset": {"version": f"{VERSION}.0", "generator": "camcal"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [node],
    }
    if count:  # a buffer or an accessor of nothing is not allowed
        node["mesh"] = 0
        document |= _mesh(kind, count, extent)
    return json.dumps(document, separators=(",", ":")).encode("ascii")


def _mesh(kind: np.dtype[np.void], count: int, extent: Array) -> dict[str, Any]:
    names = kind.names or ()
    accessors = [_accessor(kind, name, count) for name in names]
    accessors[0] |= {"min": extent[0].tolist(), "max": extent[1].tolist()}
    attributes = {name: index for index, name in enumerate(names)}
    return {
        "meshes": [{"primitives": [{"attributes": attributes, "mode": _POINTS}]}],
        "accessors": accessors,
        "bufferViews": [{"buffer": 0, "byteLength": count * kind.itemsize, "byteStride": kind.itemsize}],
        "buffers": [{"byteLength": count * kind.itemsize}],
    }


def _accessor(kind: np.dtype[np.void], name: str, count: int) -> dict[str, Any]:
    field, offset = kind.fields[name][:2] if kind.fields else (kind, 0)
    accessor = {
        "bufferView": 0,
        "byteOffset": offset,
        "componentType": COMPONENTS[field.base.str],
        "count": count,
        "type": next(word for word, shape in SHAPES.items() if shape == field.shape),
    }
    return accessor if field.base.kind == "f" else accessor | {"normalized": True}


def _placement(stream: VertexStream) -> Array:
    """Return the matrix (4, 4) from the unit and frame of the vertices to those of glTF."""
    placement = np.eye(4)
    placement[:3, :3] = _GLTF_R_CAMERA @ rotation_of(stream.frame)
    if stream.unit == MILLIMETRES:
        placement[:3, :3] *= 1e-3
    return placement + 0.0  # without negative zeros


def read(content: bytes) -> PointCloudFile:
    """Return the vertices of the first primitive, in their own frame: what the node does to them is left undone.

    Raises FileError if the file is damaged, or describes its points in another way than by interleaved or plain
    arrays of floating-point numbers and normalised colours.
    """
    document, binary = _chunks(content)
    try:
        columns = _columns(document, binary)
        extras = document["nodes"][0].get("extras", {})
        notes = {str(key): str(value) for key, value in extras.get("notes", {}).items()}
        words = {"unit": str(extras.get("unit", METRES)), "frame": str(extras.get("frame", ""))}
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise FileError("the GLB file contains no points") from error
    return cloud_of(columns, **words, notes=notes)


def _chunks(content: bytes) -> tuple[Any, bytes]:
    """Return the description and the binary part."""
    if len(content) < HEADER.size or content[:4] != MAGIC:
        raise FileError("not a GLB file (it begins with glTF)")
    _, version, length = HEADER.unpack_from(content)
    if version != VERSION or length > len(content):
        raise FileError(f"glTF {version} of {length} bytes; found {len(content)} bytes, and only glTF 2 is read")
    chunks: dict[bytes, bytes] = {}
    at = HEADER.size
    while at + CHUNK.size <= length:
        size, kind = CHUNK.unpack_from(content, at)
        at += CHUNK.size
        chunks.setdefault(kind, content[at : at + size])
        at += size
    try:
        return json.loads(chunks[JSON_CHUNK]), chunks.get(BINARY_CHUNK, b"")
    except (KeyError, ValueError, RecursionError) as error:
        raise FileError("the GLB file has no readable JSON") from error


def _columns(document: Any, binary: bytes) -> dict[str, Array]:
    """Return the columns of the first primitive; raises KeyError and the like where something is missing."""
    if not document.get("meshes"):
        return {name: np.empty(0, np.float32) for name in ATTRIBUTES["POSITION"]}
    found: dict[str, Array] = {}
    for name, index in document["meshes"][0]["primitives"][0]["attributes"].items():
        if name in ATTRIBUTES:
            values = _values(document, index, binary)
            values = _srgb(values) if name == "COLOR_0" else values
            fields = ATTRIBUTES[name]
            found |= dict(zip(fields, values.reshape(len(values), -1).T[: len(fields)], strict=True))
    return found


def _values(document: Any, index: int, binary: bytes) -> Array:
    accessor = document["accessors"][index]
    view = document["bufferViews"][accessor["bufferView"]]
    kind = np.dtype((_KINDS[accessor["componentType"]], SHAPES[accessor["type"]]))
    count, stride = int(accessor["count"]), int(view.get("byteStride", kind.itemsize))
    start = int(view.get("byteOffset", 0)) + int(accessor.get("byteOffset", 0))
    needed = start + max(count - 1, 0) * stride + kind.itemsize
    if min(count, start) < 0 or stride < kind.itemsize or needed > len(binary):
        raise FileError(f"{count} points end {needed} bytes into the GLB file's binary part, which has {len(binary)}")
    steps = (stride, kind.base.itemsize) if kind.shape else (stride,)
    return np.ndarray((count, *kind.shape), kind.base, binary, start, steps)


def _srgb(linear: Array) -> Array:
    """Return the 8-bit counts of linear light, 0 … 1 or the full scale of integers."""
    if linear.dtype.kind == "f":
        return _encode(linear)
    scale = np.iinfo(linear.dtype).max
    return np.asarray(_encode(np.arange(scale + 1) / scale)[linear])


def _encode(light: Array) -> Array:
    return np.asarray(np.rint(255 * np.clip(encode(np.nan_to_num(light), "srgb"), 0, 1)), np.uint8)
