"""EXR files of 32-bit floating point channels, uncompressed: OpenCV's wheels neither read nor write any.

They are a header of named attributes, the place of every row, the rows: channel by channel in the order of their names
(OpenEXR File Layout, openexr.com).
"""

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from camcal.arrays import Array
from camcal.errors import FileError
from camcal.files import read_bytes, replacing

_MAGIC = b"\x76\x2f\x31\x01"
_VERSION = struct.pack("<I", 2)  # rows, no tiles, no long names, one part
_NO_COMPRESSION = b"\0"
_ROWS_DOWN = b"\0"
_FLOAT = 2
_NOT_OURS = "is not an EXR file of one uncompressed 32-bit channel; convert it to PFM or TIFF"


def write_exr(path: Path, values: Array | Mapping[str, Array]) -> None:
    """Write values (H, W) as float32 in one step, of several channels by the names that other programs show."""
    channels = values if isinstance(values, Mapping) else {"Y": values}
    names = sorted(channels)
    height, width = channels[names[0]].shape
    header = _header((width, height), names)
    rows = np.zeros(height, _row_type(width, len(names)))
    rows["y"], rows["bytes"] = np.arange(height), 4 * width * len(names)
    rows["values"] = np.stack([channels[name] for name in names], axis=1).reshape(height, -1)
    first = len(header) + 8 * height
    with replacing(path) as temporary, temporary.open("wb") as stream:
        stream.write(header)
        stream.write((first + rows.itemsize * np.arange(height)).astype("<u8").data)
        stream.write(rows.data)


def read_exr(path: Path) -> Array:
    """Return the values (H, W), float32, of a file as `write_exr` makes them of one channel.

    Raises FileError if it is missing, cut off, or any other kind of EXR file.
    """
    content = read_bytes(path)
    if not content.startswith(_MAGIC + _VERSION):
        raise FileError(_NOT_OURS, where=str(path))
    try:
        attributes, place = _attributes(content)
        left, top, right, bottom = struct.unpack("<4i", attributes["dataWindow"])
        channel = attributes["channels"]
        plain = (attributes["compression"], attributes["lineOrder"]) == (_NO_COMPRESSION, _ROWS_DOWN)
        ours = plain and channel == _channel_list([channel[: channel.index(b"\0")].decode("latin-1")])
    except (KeyError, ValueError, struct.error) as error:
        raise FileError("damaged or truncated EXR file", where=str(path)) from error
    width, height = right - left + 1, bottom - top + 1
    if not ours or width < 1 or height < 1:
        raise FileError(_NOT_OURS, where=str(path))
    need = place + height * (8 + 8 + 4 * width)  # a place, then y, the number of bytes and the values
    if len(content) != need:
        raise FileError(f"{width} × {height} pixels take {need} bytes, found {len(content)}", where=str(path))
    rows = np.frombuffer(content, _row_type(width), count=height, offset=place + 8 * height)
    return rows["values"].astype(np.float32)


def _row_type(width: int, channels: int = 1) -> np.dtype[np.void]:
    return np.dtype([("y", "<i4"), ("bytes", "<i4"), ("values", "<f4", (width * channels,))])


def _header(size: tuple[int, int], channels: Sequence[str]) -> bytes:
    window = struct.pack("<4i", 0, 0, size[0] - 1, size[1] - 1)
    attributes = (
        ("channels", "chlist", _channel_list(channels)),
        ("compression", "compression", _NO_COMPRESSION),
        ("dataWindow", "box2i", window),
        ("displayWindow", "box2i", window),
        ("lineOrder", "lineOrder", _ROWS_DOWN),
        ("pixelAspectRatio", "float", struct.pack("<f", 1)),
        ("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0)),
        ("screenWindowWidth", "float", struct.pack("<f", 1)),
    )
    parts = [
        f"{name}\0{kind}\0".encode("ascii") + struct.pack("<i", len(value)) + value for name, kind, value in attributes
    ]
    return _MAGIC + _VERSION + b"".join(parts) + b"\0"


def _channel_list(names: Sequence[str]) -> bytes:
    """Return the list of channels: each its name, type, whether it is linear, its sampling across and down."""
    kind = struct.pack("<iB3xii", _FLOAT, 0, 1, 1)
    return b"".join(name.encode("latin-1") + b"\0" + kind for name in names) + b"\0"


def _attributes(content: bytes) -> tuple[dict[str, bytes], int]:
    """Return the values of the header by name, and where the header ends. Raises ValueError, struct.error."""
    found: dict[str, bytes] = {}
    place = len(_MAGIC) + len(_VERSION)
    while content[place : place + 1] != b"\0":
        name_end = content.index(b"\0", place)
        kind_end = content.index(b"\0", name_end + 1)
        (size,) = struct.unpack_from("<i", content, kind_end + 1)
        start = kind_end + 5
        if size < 0:
            raise ValueError(f"an attribute of {size} bytes")
        found[content[place:name_end].decode("latin-1")] = content[start : start + size]
        place = start + size
    return found, place + 1
