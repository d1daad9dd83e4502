"""MAT-files of versions 5 to 7.3 as plain data: numbers, texts, structs, and cells of numbers.

SciPy's reader may end the process at a damaged file. Version 7.3 is HDF5 behind 512 bytes, read by h5py: structs are
groups, arrays are transposed, cells and arrays of structs are references to objects in the group #refs#.
Source: MathWorks, MAT-File Format, level 5, tables 1-1 to 1-3; MAT-File versions.
"""

import io
import struct
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from camcal.errors import FileError, InvalidInput

_WORDS = "i1 u1 i2 u2 i4 u4 f4 - f8 - - i8 u8 - - u1 u2"  # types of numbers, from 1
_TYPES = {kind: word for kind, word in enumerate(_WORDS.split(), 1) if word != "-"}
_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT, _CHAR, _NUMBERS = 1, 2, 4, range(6, 16)  # classes of arrays
_HEADER, _LARGEST, _DEEPEST = 128, 64 << 20, 16
_HDF5, _OBJECT = b"MATLAB 7.3", 640  # bytes that an object counts for, beside its numbers
_DAMAGE = ValueError, LookupError, TypeError, OverflowError, OSError, RuntimeError, MemoryError  # what h5py raises, too


def variables(content: bytes) -> dict[str, Any]:
    """Return the variables of a file by their names, tuples for cells, None for what is no number, text or struct.

    Raises FileError for a damaged file, and one of big-endian numbers; InvalidInput if h5py is needed and missing.
    """
    is_hdf5 = content.startswith(_HDF5)
    try:
        return _of_hdf5(content) if is_hdf5 else _of_level_5(content)
    except (*_DAMAGE, struct.error, zlib.error) as error:
        kind = "7.3" if is_hdf5 else "5 to 7"
        raise FileError(f"is damaged or truncated, or not a MAT-file of version {kind}") from error


def _of_hdf5(content: bytes) -> dict[str, Any]:
    try:
        import h5py
    except ModuleNotFoundError as error:
        advice = "pip install 'camcal[matlab]', or save it with save(…, '-v7')"
        raise InvalidInput(f"is a MAT-file of version 7.3, which needs the extra [matlab]: {advice}") from error
    left = _LARGEST

    def struct_of(group: Any, depth: int) -> dict[str, Any]:
        own = [key for key in group if key[0] != "#" and isinstance(group.get(key, getlink=True), h5py.HardLink)]
        return {key: value_of(group[key], depth + 1) for key in own}

    def value_of(item: Any, depth: int) -> Any:
        nonlocal left
        is_own = isinstance(item, h5py.Dataset) and not (item.is_virtual or item.external)  # not of other files
        size = _OBJECT + (item.nbytes if is_own else 0)
        if size > left or depth > _DEEPEST or "MATLAB_object_decode" in item.attrs:
            return None
        left -= size
        if isinstance(item, h5py.Group):
            return struct_of(item, depth)
        return array_of(item, depth) if is_own else None

    def array_of(item: Any, depth: int) -> Any:
        numbers = item[()].ravel() if "MATLAB_empty" not in item.attrs else np.empty(0)  # in MATLAB's order
        if item.attrs.get("MATLAB_class") == b"char":
            return "".join(map(chr, numbers.tolist()))
        if item.dtype.kind == "O":
            return tuple(value_of(file[each], depth + 1) for each in numbers)
        if item.dtype.kind not in "biuf":
            return None
        return numbers.astype(float).reshape(item.shape if len(numbers) else 0).T.squeeze().tolist()

    with h5py.File(io.BytesIO(content), "r") as file:
        return struct_of(file, 0)


def _of_level_5(content: bytes) -> dict[str, Any]:
    if content[126:128] != b"IM":
        raise ValueError("not little endian")
    found = {}
    for kind, data in _elements(content[_HEADER:]):
        whole = zlib.decompressobj().decompress(data, _LARGEST) if kind == _COMPRESSED else b""
        for inner, part in _elements(whole) if whole else [(kind, data)]:
            if inner == _MATRIX:
                name, value = _array(part, 0)
                found[name] = value
    return found


def _elements(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the type and the bytes of every element."""
    place = 0
    while place < len(data):
        kind, size = struct.unpack_from("<II", data, place)
        start = place + 8
        if kind >> 16:  # few bytes, within the tag
            kind, size, start = kind & 0xFFFF, kind >> 16, place + 4
        if start + size > len(data):
            raise ValueError("an element is longer than the file")
        yield kind, data[start : start + size]
        place = max(start + size, place + 8)
        place += -place % 8 if kind != _COMPRESSED else 0


def _array(data: bytes, depth: int) -> tuple[str, Any]:
    """Return the name and the value of an array."""
    parts = list(_elements(data))
    kind = struct.unpack_from("<I", parts[0][1])[0] & 0xFF if parts else 0
    if depth > _DEEPEST or len(parts) < 3 or kind not in (*((_CELL,) if depth == 0 else ()), _STRUCT, _CHAR, *_NUMBERS):
        return "", None
    name, rest = parts[2][1].decode("ascii", "replace"), parts[3:]
    if kind == _CELL:
        return name, tuple(_array(each, depth + 1)[1] for _, each in rest)
    sides = np.frombuffer(parts[1][1], "<i4").tolist()
    if kind == _STRUCT:
        length = struct.unpack_from("<i", rest[0][1])[0]
        fields = [rest[1][1][start : start + length] for start in range(0, len(rest[1][1]), max(length, 1))]
        keys = [field.partition(b"\0")[0].decode("ascii", "replace") for field in fields]
        return name, {key: _array(each, depth + 1)[1] for key, (_, each) in zip(keys, rest[2:], strict=False)}
    if not rest or rest[0][0] not in _TYPES:
        return name, None
    numbers = np.frombuffer(rest[0][1], f"<{_TYPES[rest[0][0]]}")
    if kind == _CHAR:
        return name, "".join(map(chr, numbers.tolist()))
    matrix = numbers.reshape(sides, order="F").astype(float)
    return name, matrix.squeeze().tolist()
