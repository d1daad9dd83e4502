"""The values of a camera file below one key, each checked: what is wrong is said with file, line and key."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.formats.documents import Document, Fault, child
from camcal.formats.schema import FOCAL_LENGTH, LARGEST_SIDE, number
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.messages import Message
from camcal.parsing import parse_number

ROUNDED = 1e-4  # orthonormality error of rotations that other programs have rounded

_EXACT = 1e-6
_NUMBER = number()  # within the bounds of every number of a file
_CHANNELS = {"d", "f", "i", "u", "w", "s", "c", "n", "b"}  # one number each, OpenCV's letters for types


class Values:
    """The values below one key of a document; whatever is wrong is raised as InvalidInput with file, line and key.

    warnings: about values that are used nevertheless.
    """

    def __init__(self, document: Document, path: str = "", data: Mapping[str, Any] | None = None) -> None:
        self.document = document
        self.path = path
        self.data: Mapping[str, Any] = document if data is None else data
        self.warnings: list[Message] = []

    def __contains__(self, key: str) -> bool:
        return self.data.get(key) is not None

    def below(self, key: str) -> "Values":
        """Return the values below a key, which is to be a mapping."""
        value = self.data.get(key)
        if not isinstance(value, dict):
            text = "is not a mapping of keys to values" if key in self.data else f"has no {key}"
            raise self.wrong(key if key in self.data else "", text)
        return Values(self.document, child(self.path, key), value)

    def each(self, key: str) -> Iterator["Values"]:
        """Yield the values below every item of a list of mappings; a single mapping does, too."""
        value = self.data.get(key)
        items = [value] if isinstance(value, dict) else value
        if not isinstance(items, list) or not all(isinstance(item, dict) for item in items):
            raise self.wrong(key, "is not a list of mappings")
        for index, item in enumerate(items):
            yield Values(self.document, child(child(self.path, key), index), item)

    def wrong(self, key: str, text: str) -> InvalidInput:
        """Return the error of what stands under a key."""
        return self.document.error([Fault(child(self.path, key) if key else self.path, text)])

    def warn(self, code: str, key: str, text: str) -> None:
        """Keep a warning about what stands under a key."""
        self.warnings.append(self.document.located(Message(code, text, where=child(self.path, key))))

    def text(self, key: str) -> str:
        """Return a text, empty if the key is missing."""
        value = self.data.get(key)
        return "" if value is None else str(value).strip()

    def number(self, key: str) -> float:
        """Return a finite number."""
        return float(self.numbers(key, 1)[0])

    def side(self, key: str) -> int:
        """Return a number of pixels."""
        value = self.number(key)
        if not 1 <= value <= LARGEST_SIDE or value != int(value):
            raise self.wrong(key, f"{value:g} is not a number of pixels")
        return int(value)

    def sides(self, key: str) -> tuple[int, int]:
        """Return the width and height of an image, pixels."""
        width, height = self.numbers(key, 2).tolist()
        if not all(1 <= side <= LARGEST_SIDE and side == int(side) for side in (width, height)):
            raise self.wrong(key, f"{width:g} x {height:g} is not a width and height in pixels")
        return int(width), int(height)

    def numbers(self, key: str, *counts: int) -> Array:
        """Return the finite numbers (N,) of a list, a matrix or one number; counts: how many there may be."""
        return self.matrix_of(key, *counts).ravel()

    def matrix(self, key: str, rows: int, columns: int) -> Array:
        """Return a matrix (rows, columns) of finite numbers; one list of all its elements does, too."""
        found = self.matrix_of(key, rows * columns)
        if found.shape not in ((rows, columns), (1, rows * columns), (rows * columns, 1)):
            raise self.wrong(key, f"is {found.shape[0]} x {found.shape[1]}, and has to be {rows} x {columns}")
        return found.reshape(rows, columns)

    def matrix_of(self, key: str, *counts: int) -> Array:
        """Return a matrix of any shape whose elements are finite and as many as one of `counts`."""
        rows = self._rows(key)
        widths = {len(row) for row in rows}
        if len(widths) > 1:
            raise self.wrong(key, "its rows have different lengths")
        count = len(rows) * max(widths, default=0)
        if counts and count not in counts:
            raise self.wrong(key, f"{count} numbers; {' or '.join(map(str, counts))} are needed")
        return np.array([[self._finite(key, item) for item in row] for row in rows]).reshape(len(rows), -1)

    def _rows(self, key: str) -> list[list[Any]]:
        value = self.data.get(key)
        if value is None:
            raise self.wrong("" if key not in self.data else key, f"has no {key}")
        if isinstance(value, dict):
            return self._stored_rows(key, value)
        if not isinstance(value, list):
            return [[value]]
        nested = any(isinstance(item, list) for item in value)
        return [item if isinstance(item, list) else [item] for item in value] if nested else [value]

    def _stored_rows(self, key: str, value: Mapping[str, Any]) -> list[list[Any]]:
        """Return the rows of a matrix that is written as {rows, cols, dt, data} or {sizes, dt, data}."""
        data = value.get("data")
        sizes = value.get("sizes", [value.get("rows"), value.get("cols")])
        sizes = [sizes] if isinstance(sizes, int) else sizes
        whole = isinstance(sizes, list) and sizes and all(type(side) is int and side >= 0 for side in sizes)
        if not isinstance(data, list) or not whole or len(sizes) > 2:
            raise self.wrong(key, "is not a matrix with rows, cols and data")
        if str(value.get("dt", "d")) not in _CHANNELS:
            raise self.wrong(key, f"dt {value['dt']!r} is not the type of a matrix of numbers (d, f, i)")
        rows, columns = sizes if len(sizes) == 2 else (1, sizes[0])
        if rows * columns != len(data):
            raise self.wrong(key, f"{len(data)} numbers; {rows} x {columns} are {rows * columns}")
        return [data[row * columns : (row + 1) * columns] for row in range(rows)]

    def _finite(self, key: str, item: Any) -> float:
        try:
            value = parse_number(item) if isinstance(item, str) else float(item)
        except (TypeError, ValueError, OverflowError):
            value = np.nan
        if not np.isfinite(value) or isinstance(item, bool):
            shown = repr(item)[:40] if isinstance(item, (str, int, float)) else "a list or mapping"
            raise self.wrong(key, f"{shown} is not a finite number")
        for fault in _NUMBER(value, ""):
            raise self.wrong(key, fault.text)
        return value

    def camera_matrix(self, key: str) -> tuple[float, float, float, float]:
        """Return fx, fy, cx, cy of a camera matrix (3, 3), pixels."""
        matrix = self.matrix(key, 3, 3)
        fx, fy, cx, cy = (float(matrix[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2)))
        if matrix[2, 0] and matrix[2, 1] and not (cx or cy):
            raise self.wrong(key, "possibly transposed: cx, cy in the last row")
        if not np.array_equal(matrix, [(fx, 0, cx), (0, fy, cy), (0, 0, 1)]):
            raise self.wrong(key, "is not fx 0 cx, 0 fy cy, 0 0 1; camcal's lens models have no skew")
        self.require_focal(key, fx, fy)
        return fx, fy, cx, cy

    def require_focal(self, key: str, *lengths: float) -> None:
        """Raise InvalidInput for focal lengths, pixels, that no camera has."""
        for name, length in zip(("fx", "fy"), lengths, strict=True):
            for fault in FOCAL_LENGTH(length, ""):
                raise self.wrong(key, f"{name}: {fault.text}")

    def rigid(self, key: str) -> Pose:
        """Return the pose of a matrix (4, 4) whose last row is 0 0 0 1."""
        matrix = self.matrix(key, 4, 4)
        if not np.allclose(matrix[3], (0, 0, 0, 1), rtol=0, atol=1e-9):
            raise self.wrong(key, f"its last row is {matrix[3].tolist()}, not 0 0 0 1")
        return self.pose(key, matrix[:3, :3], matrix[:3, 3])

    def pose(self, key: str, rotation: Array, translation: Array) -> Pose:
        """Return the pose of a rotation (3, 3), the nearest one if it was rounded, and a translation (3,)."""
        found = so3.examine(rotation)
        if fault := found.fault(ROUNDED):
            raise self.wrong(key, fault)
        if found.error > _EXACT:
            self.warn(
                "rounded_rotation",
                key,
                f"rounded (orthonormality error {found.error:.1e}); the nearest rotation is used",
            )
            rotation = so3.nearest(rotation)
        return Pose(rotation, translation)
