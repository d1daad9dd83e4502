"""LAS and LAZ, the formats of laser scanning, by laspy (the extra [clouds]): point format 2, in metres.

Coordinates are whole counts of a scale, a micrometre or as fine as the extent allows. Normals and sigma are extra
bytes of a point. Frame and notes stand in a record of their own. Vertices without a position are left out.
"""

import json
import struct
from importlib import import_module
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, BinaryIO

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.errors import FileError, InvalidInput
from camcal.formats.pointclouds.record import MILLIMETRES, PointCloudFile, blocks_of, cloud_of
from camcal.stereo.depth import COLOUR, INTENSITY, NORMAL, POSITION, SIGMA, VertexStream

_POINT_FORMAT = 2  # x y z, intensity, red green blue
_FINEST = 1e-6  # m
_COUNTS = 2e9  # of 32 bits with a sign
_FULL = 65535  # of intensity and colour
_OWNER, _RECORD = "camcal", 1
_BLOCK = 1 << 18
_HEADER = struct.Struct("<94xHIIBHI")  # sizes of header and of all before the points, records, format, point, points
_PLACE, _CHUNKS = struct.Struct("<q"), struct.Struct("<II")  # of the table of chunks; its version and length
_LEAST, _RECORD_HEADER = 227, 54  # bytes of a header, and of that of a record
_COMPRESSED = 128  # flag in the number of the point format
_DATE = 90  # where the header says day and year
# What damaged files raise within laspy and lazrs besides their own errors.
_DAMAGE = (
    ArithmeticError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    RuntimeError,
    TypeError,
    ValueError,
    struct.error,
)


def require_laspy() -> None:
    """Raise InvalidInput unless laspy is installed."""
    if find_spec("laspy") is None:
        raise InvalidInput("LAS and LAZ need the extra [clouds]: pip install 'camcal[clouds]', or write .ply")


def write(file: BinaryIO, stream: VertexStream, *, compress: bool) -> None:
    """Write a cloud by way of a temporary file, because its extent must be known before its first point.

    Raises InvalidInput if laspy is missing.
    """
    require_laspy()
    laspy: Any = import_module("laspy")
    with TemporaryFile(dir=Path(file.name).parent) as spool:
        header = _header_of(laspy, stream, _spool(spool, stream))
        spool.seek(0)
        backend = laspy.LazBackend.Lazrs if compress else None  # the other one starts threads
        with laspy.open(file, mode="w", header=header, laz_backend=backend, closefd=False) as writer:
            while len(block := np.fromfile(spool, stream.type, _BLOCK)):
                writer.write_points(_points(laspy, header, block, _metres(stream.unit)))
    file.seek(_DATE)
    file.write(bytes(4))  # laspy writes the day; unknown, so that the same cloud is the same bytes


def _spool(spool: BinaryIO, stream: VertexStream) -> Array:
    """Copy the vertices that have a position; return the smallest and largest x, y, z (2, 3), metres."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for block in blocks_of(stream):
        points = np.stack([block[name] for name in POSITION])
        kept = np.isfinite(points).all(axis=0)
        spool.write(block[kept].data)
        low = np.minimum(low, points[:, kept].min(1, initial=np.inf))
        high = np.maximum(high, points[:, kept].max(1, initial=-np.inf))
    spool.flush()
    return np.stack([low, high]) * _metres(stream.unit) if np.isfinite(low).all() else np.zeros((2, 3))


def _header_of(laspy: Any, stream: VertexStream, extent: Array) -> Any:
    header = laspy.LasHeader(point_format=_POINT_FORMAT, version="1.2")
    header.generating_software = "camcal"
    header.offsets = np.floor(extent[0])
    finest = max(float((extent[1] - header.offsets).max()) / _COUNTS, _FINEST)
    header.scales = np.full(3, 10.0 ** np.ceil(np.log10(finest) - 1e-9))
    extra = [name for name in (*NORMAL, SIGMA) if name in (stream.type.names or ())]
    header.add_extra_dims([laspy.ExtraBytesParams(name, np.float32) for name in extra])
    words = {"frame": stream.frame, "notes": stream.notes, "fields": stream.type.names}
    text = files.utf8(json.dumps(words, ensure_ascii=False))
    header.vlrs.append(laspy.VLR(_OWNER, _RECORD, "frame and notes, JSON", text))
    return header


def _points(laspy: Any, header: Any, block: Array, metres: float) -> Any:
    points = laspy.ScaleAwarePointRecord.zeros(len(block), header=header)
    for name in block.dtype.names or ():
        if name in POSITION:
            points[name] = block[name].astype(np.float64) * metres
        elif name in COLOUR:
            points[name] = block[name].astype(np.uint16) * 257
        elif name == INTENSITY:
            points[name] = np.rint(np.clip(np.nan_to_num(block[name]), 0, 1) * _FULL).astype(np.uint16)
        else:
            points[name] = block[name] * np.float32(metres) if name == SIGMA else block[name]
    return points


def _metres(unit: str) -> float:
    return 1e-3 if unit == MILLIMETRES else 1.0


def read(content: bytes) -> PointCloudFile:
    """Return the points of a LAS or LAZ file, in metres.

    Raises InvalidInput if laspy is missing, FileError if the file is damaged.
    """
    require_laspy()
    _require_whole(content)
    laspy: Any = import_module("laspy")
    try:
        with laspy.open(BytesIO(content), laz_backend=laspy.LazBackend.Lazrs) as reader:
            words = _words(reader.header)
            columns = _columns(reader)
    except (laspy.LaspyException, *_DAMAGE) as error:
        raise FileError(f"not a readable LAS file ({error})") from error
    return cloud_of(_fill(columns, words["fields"]), frame=words["frame"], notes=words["notes"])


def _columns(reader: Any) -> dict[str, Array]:
    """Return the columns of all points, read block by block so that a wrong count takes no memory."""
    dimensions = {*POSITION, *reader.header.point_format.dimension_names}
    names = [name for name in (*POSITION, *COLOUR, INTENSITY, *NORMAL, SIGMA) if name in dimensions]
    with np.errstate(over="ignore"):  # the scale may be any number
        parts = [[np.asarray(part[name]) for name in names] for part in reader.chunk_iterator(_BLOCK)]
    if not parts:
        return dict.fromkeys(names, np.empty(0))
    return {name: np.concatenate([part[index] for part in parts]) for index, name in enumerate(names)}


def _require_whole(content: bytes) -> None:
    """Raise FileError unless the counts in the header fit the file: laspy does not check them."""
    if len(content) < _LEAST or content[:4] != b"LASF":
        raise FileError("not a LAS file (it begins with LASF)")
    header, start, records, form, length, count = _HEADER.unpack_from(content)
    needed = start if form & _COMPRESSED else start + count * length
    if header + records * _RECORD_HEADER > start or needed > len(content):
        raise FileError(f"{count} points end {needed} bytes into the file, which has {len(content)}")
    if form & _COMPRESSED and count:
        _require_chunks(content, start)


def _require_chunks(content: bytes, start: int) -> None:
    """Raise FileError unless the chunks of a LAZ file can be as many as it says: lazrs ends the process otherwise."""
    try:
        (table,) = _PLACE.unpack_from(content, start)
        if table == -1:  # it was written to a stream, and stands at the end
            (table,) = _PLACE.unpack_from(content, len(content) - _PLACE.size)
        _, chunks = _CHUNKS.unpack_from(content, table)
    except struct.error as error:
        raise FileError("not a readable LAS file (it has no table of chunks)") from error
    if table < start or chunks > len(content):
        raise FileError(f"{chunks} chunks of points do not fit into {len(content)} bytes")


def _words(header: Any) -> dict[str, Any]:
    """Return frame, notes and the names of the fields, None where the file was written by another program."""
    for record in header.vlrs:
        if (record.user_id, record.record_id) == (_OWNER, _RECORD):
            found = json.loads(record.record_data)
            notes = {str(key): str(value) for key, value in found["notes"].items()}
            return {"frame": str(found["frame"]), "notes": notes, "fields": [str(name) for name in found["fields"]]}
    return {"frame": "", "notes": {}, "fields": None}


def _fill(columns: dict[str, Array], fields: list[str] | None) -> dict[str, Array]:
    """Return the columns that mean something: those said to, or those that are not all zero.

    Colours that never pass 255 are 8-bit ones, which some programs leave unscaled.
    """
    kept = {
        name: column
        for name, column in columns.items()
        if name in POSITION or (column.any() if fields is None else name in fields)
    }
    colours = {name: kept[name] for name in COLOUR if name in kept}
    if fields is None and max((column.max(initial=0) for column in colours.values()), default=0) <= 255:
        kept |= {name: column.astype(np.uint8) for name, column in colours.items()}
    return kept
