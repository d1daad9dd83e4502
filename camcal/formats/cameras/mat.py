"""MAT-files of versions 5 to 7 as plain data: numbers, texts, structs, and cells of numbers.

SciPy's reader may end the process at a damaged file. Source: MathWorks, MAT-File Format, level 5, tables 1-1 to 1-3.
"""

import struct
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np

_WORDS = "i1 u1 i2 u2 i4 u4 f4 - f8 - - i8 u8 - - u1 u2"  # types of numbers, from 1
_TYPES = {kind: word for kind, word in enumerate(_WORDS.split(), 1) if word != "-"}
_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT, _CHAR, _NUMBERS = 1, 2, 4, range(6, 16)  # classes of arrays
_HEADER, _LARGEST, _DEEPEST = 128, 64 << 20, 16


def variables(content: bytes) -> dict[str, Any]:
    """Return the variables of a file by their names, tuples for cells, None for what is no number, text or struct.

    Raises ValueError, struct.error or zlib.error for a damaged file, and one of big-endian numbers.
    """
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
