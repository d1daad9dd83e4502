"""Reading the points of a GLB file: the first primitive, as this package writes it and as others may."""

import json
from typing import Any

import numpy as np

from camcal.arrays import Array
from camcal.errors import FileError
from camcal.formats.pointclouds import glb
from camcal.formats.pointclouds.record import PointCloudFile, cloud_of
from camcal.raw.tone import encode
from camcal.stereo.points.frames import METRES

_KINDS = {number: np.dtype(name) for name, number in glb.COMPONENTS.items()}


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
        raise FileError("the description in the GLB file is not one of points") from error
    return cloud_of(columns, **words, notes=notes)


def _chunks(content: bytes) -> tuple[Any, bytes]:
    """Return the description and the binary part."""
    if len(content) < glb.HEADER.size or content[:4] != glb.MAGIC:
        raise FileError("not a GLB file (it begins with glTF)")
    _, version, length = glb.HEADER.unpack_from(content)
    if version != glb.VERSION or length > len(content):
        raise FileError(f"glTF {version} of {length} bytes; found {len(content)} bytes, and only glTF 2 is read")
    chunks: dict[bytes, bytes] = {}
    at = glb.HEADER.size
    while at + glb.CHUNK.size <= length:
        size, kind = glb.CHUNK.unpack_from(content, at)
        at += glb.CHUNK.size
        chunks.setdefault(kind, content[at : at + size])
        at += size
    try:
        return json.loads(chunks[glb.JSON_CHUNK]), chunks.get(glb.BINARY_CHUNK, b"")
    except (KeyError, ValueError, RecursionError) as error:
        raise FileError("the GLB file has no readable description") from error


def _columns(document: Any, binary: bytes) -> dict[str, Array]:
    """Return the columns of the first primitive; raises KeyError and the like where something is missing."""
    if not document.get("meshes"):
        return {name: np.empty(0, np.float32) for name in glb.ATTRIBUTES["POSITION"]}
    found: dict[str, Array] = {}
    for name, index in document["meshes"][0]["primitives"][0]["attributes"].items():
        if name in glb.ATTRIBUTES:
            values = _values(document, index, binary)
            values = _srgb(values) if name == "COLOR_0" else values
            fields = glb.ATTRIBUTES[name]
            found |= dict(zip(fields, values.reshape(len(values), -1).T[: len(fields)], strict=True))
    return found


def _values(document: Any, index: int, binary: bytes) -> Array:
    accessor = document["accessors"][index]
    view = document["bufferViews"][accessor["bufferView"]]
    kind = np.dtype((_KINDS[accessor["componentType"]], glb.SHAPES[accessor["type"]]))
    count, stride = int(accessor["count"]), int(view.get("byteStride", kind.itemsize))
    start = int(view.get("byteOffset", 0)) + int(accessor.get("byteOffset", 0))
    needed = start + max(count - 1, 0) * stride + kind.itemsize
    if min(count, start) < 0 or stride < kind.itemsize or needed > len(binary):
        raise FileError(f"{count} points end {needed} bytes into the GLB file's binary part, which has {len(binary)}")
    return np.ndarray((count, *kind.shape), kind.base, binary, start, (stride, *_steps(kind)))


def _steps(kind: np.dtype[Any]) -> tuple[int, ...]:
    return (kind.base.itemsize,) if kind.shape else ()


def _srgb(linear: Array) -> Array:
    """Return the 8-bit counts of linear light, 0 … 1 or the full scale of integers."""
    if linear.dtype.kind == "f":
        return _encoded(linear)
    scale = np.iinfo(linear.dtype).max
    return np.asarray(_encoded(np.arange(scale + 1) / scale)[linear])


def _encoded(light: Array) -> Array:
    return np.asarray(np.rint(255 * np.clip(encode(np.nan_to_num(light), "srgb"), 0, 1)), np.uint8)
