"""NumPy's own file formats, for frames and maps that no image format holds; sizes in a header are checked first."""

import io
import math
import zipfile
import zlib
from pathlib import Path
from tokenize import TokenError

import numpy as np

from camcal.arrays import Array
from camcal.errors import FileError
from camcal.files import read_bytes, replacing

_READERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
# What NumPy's reader of headers, which are Python, and the ZIP reader raise on damaged files.
_BAD_HEADER = (ValueError, TypeError, SyntaxError, TokenError, EOFError, RecursionError, MemoryError, OverflowError)
_BAD_ARCHIVE = (
    *(
        EOFError,
        KeyError,
        LookupError,
        NotImplementedError,
        OSError,
        OverflowError,
        RuntimeError,
        TypeError,
        ValueError,
    ),
    *(zipfile.BadZipFile, zlib.error),
)
_PACKED = 100  # a compressed array has fewer times the bytes of its file, or is small
_SMALL = 256 << 20  # bytes


def read_npy(path: Path, kinds: str = "uif", content: bytes | None = None) -> Array:
    """Return the array of a .npy file in this machine's byte order; floating point comes as float32.

    kinds: NumPy's letters of the kinds of numbers that will do. content: of the file, where it has been read already.
    Raises FileError if the file is missing, empty, truncated, of another kind or holds no numbers.
    """
    content = read_bytes(path) if content is None else content
    try:
        values = array_of(content)
    except ValueError as error:
        raise FileError("not a readable NumPy array file", where=str(path)) from error
    if values.dtype.kind not in kinds:
        raise FileError("contains no numeric array", where=str(path))
    with np.errstate(over="ignore", invalid="ignore"):  # of what float32 does not hold
        return values.astype(np.float32 if values.dtype.kind == "f" else values.dtype.newbyteorder("="))


def array_of(content: bytes) -> Array:
    """Return the array in the bytes of a .npy file, read-only; raises ValueError if it is damaged or holds objects."""
    stream = io.BytesIO(content)
    try:
        shape, columns_first, kind = _READERS[np.lib.format.read_magic(stream)](stream)
        count, start = math.prod(shape), stream.tell()
        if kind.hasobject or min(shape, default=0) < 0 or count * kind.itemsize != len(content) - start:
            raise ValueError(f"{shape} of {kind} do not take {len(content) - start} bytes")
        if not count * kind.itemsize:
            return np.empty(shape, kind)
        return np.frombuffer(content, kind, count, start).reshape(shape, order="F" if columns_first else "C")
    except (KeyError, *_BAD_HEADER) as error:
        raise ValueError("a damaged or unknown NumPy header") from error


def arrays_of(content: bytes) -> dict[str, Array]:
    """Return the arrays in the bytes of a .npz file by their names, read-only; raises ValueError if it is damaged."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = [member for member in archive.infolist() if member.filename.endswith(".npy")]
            if sum(member.file_size for member in members) > max(_SMALL, _PACKED * len(content)):
                raise ValueError("archive size exceeds its bytes")
            return {member.filename.removesuffix(".npy"): array_of(archive.read(member)) for member in members}
    except _BAD_ARCHIVE as error:
        raise ValueError("a damaged NumPy archive") from error


def names_in(content: bytes) -> list[str]:
    """Return the names of the arrays in the bytes of a .npz file, none if it is damaged."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            return [name.removesuffix(".npy") for name in archive.namelist()]
    except _BAD_ARCHIVE:
        return []


def write_npy(path: Path, values: Array) -> None:
    """Write an array as a .npy file, in one step."""
    with replacing(path) as temporary:
        np.save(temporary, values, allow_pickle=False)
