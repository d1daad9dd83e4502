"""Writing point clouds: PLY (binary or ASCII) and plain XYZ text.

A vertex holds x y z in metres and, where the cloud has them, red green blue 0 … 255 and intensity 0 … 1. Text carries
nine significant digits, which is all a float32 holds.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.files import replacing
from camcal.stereo.cloud import PointCloud

SUFFIXES = (".ply", ".xyz")

_BLOCK = 1 << 16  # vertices written at a time, so that memory does not grow with the cloud
_PLY_TYPES = {"f": "float", "u": "uchar"}
_TEXT_FORMATS = {"f": "%.9g", "u": "%d"}


def write(path: Path, cloud: PointCloud, *, ascii_text: bool = False) -> None:
    """Write a cloud as its suffix says: .ply (binary, or ASCII if asked) or .xyz (text, a row per point).

    Raises InvalidInput for another suffix, FileError if the file cannot be written.
    """
    require_suffix(path)
    with replacing(path) as temporary, temporary.open("wb") as stream:
        if path.suffix.lower() == ".xyz":
            stream.writelines(_text(cloud))
            return
        stream.write(_ply_header(cloud, ascii_text=ascii_text))
        stream.writelines(_text(cloud) if ascii_text else (block.tobytes() for block in _vertices(cloud)))


def require_suffix(path: Path) -> None:
    """Raise InvalidInput unless the file name ends as a point cloud that can be written."""
    if path.suffix.lower() not in SUFFIXES:
        raise InvalidInput(f"{path.suffix or 'no suffix'} is not written; use {' or '.join(SUFFIXES)}", where=str(path))


def _fields(cloud: PointCloud) -> np.dtype[np.void]:
    """Return the record of one vertex, without padding."""
    names = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]
    if cloud.colours is not None:
        names += [("red", "u1"), ("green", "u1"), ("blue", "u1")]
    if cloud.intensity is not None:
        names += [("intensity", "<f4")]
    return np.dtype(names)


def _ply_header(cloud: PointCloud, *, ascii_text: bool) -> bytes:
    fields = _fields(cloud)
    lines = [
        "ply",
        f"format {'ascii' if ascii_text else 'binary_little_endian'} 1.0",
        "comment unit metre",
        "comment frame left camera: x right, y down, z forward",
        f"element vertex {len(cloud.points)}",
        *(f"property {_PLY_TYPES[fields[name].kind]} {name}" for name in fields.names or ()),
        "end_header",
    ]
    return ("\n".join(lines) + "\n").encode("ascii")


def _vertices(cloud: PointCloud) -> Iterator[Array]:
    """Yield the vertices as structured arrays of at most `_BLOCK`."""
    fields = _fields(cloud)
    for start in range(0, len(cloud.points), _BLOCK):
        part = slice(start, start + _BLOCK)
        block = np.empty(len(cloud.points[part]), fields)
        block["x"], block["y"], block["z"] = cloud.points[part].T
        if cloud.colours is not None:
            block["red"], block["green"], block["blue"] = cloud.colours[part].T
        if cloud.intensity is not None:
            block["intensity"] = cloud.intensity[part]
        yield block


def _text(cloud: PointCloud) -> Iterator[bytes]:
    fields = _fields(cloud)
    row = " ".join(_TEXT_FORMATS[fields[name].kind] for name in fields.names or ()) + "\n"
    for block in _vertices(cloud):
        yield "".join(row % vertex for vertex in block.tolist()).encode("ascii")
