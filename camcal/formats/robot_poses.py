"""Poses of a robot as robots and people write them: a row of numbers each, in a form that the file seldom says.

Rows of text or CSV, after the name of an image or without one; 4 x 4 matrices on lines of four; a list in YAML or JSON,
of numbers, matrices, or mappings such as ROS's position and orientation; a MATLAB file (version 5 to 7) with one
array of them, 4 x 4 x N or a row each.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.errors import FileError, InvalidInput, Located
from camcal.formats.documents import parse_foreign
from camcal.formats.pose_text import Form
from camcal.geometry.rotation import EulerOrder
from camcal.parsing import is_number, parse_numbers

_UNITS = ("rad", "deg")
_ORDERS = tuple(
    "".join(axes) for axes in product("XYZ", repeat=3) if axes[0] != axes[1] != axes[2]
)  # intrinsic ones; in small letters extrinsic ones
_COUNTS = (6, 7, 8, 12, 16)
_LARGEST = 16 << 20
_SEPARATORS = re.compile(r"[\s,;\[\]()]+")
_PLACE = ("position", "translation", "t", "xyz", "tvec")
_TURN = ("orientation", "rotation", "quaternion", "q", "rvec", "euler")
_NAME = ("image", "file", "name", "filename")


@dataclass(frozen=True, eq=False)
class RobotRows:
    """Numbers (N, k) of N poses; names: of their images, None where the file has none."""

    numbers: Array
    names: tuple[str, ...] | None = None

    @property
    def times(self) -> Array | None:
        """The times (N,) of poses, s, where the file has what can be times."""
        first = self.numbers[:, 0]
        return first if self.numbers.shape[1] == 8 and len(first) > 1 and (np.diff(first) > 0).all() else None

    def forms(self) -> tuple[Form, ...]:
        """Return the forms that rows of so many numbers may have."""
        count = self.numbers.shape[1]
        if count in (12, 16):
            return (Form("matrix"),)
        if count == 8:
            return (Form("tum"), Form("dual-quat"))
        if count == 7:
            return (Form("ros"), Form("quat", "wxyz"), Form("colmap"))
        orders = (*_ORDERS, *map(str.lower, _ORDERS))
        angles = (Form("euler", euler=EulerOrder.named(order), unit=unit) for order in orders for unit in _UNITS)
        return (*(Form("rvec", unit=unit) for unit in _UNITS), *angles)


def read(path: Path) -> RobotRows:
    """Return the rows of a file; raises FileError, InvalidInput for what is no list of poses."""
    where = str(path)
    if path.suffix.lower() == ".mat":
        return RobotRows(_finite(_of_matlab(path), where))
    text = files.read_text(path, _LARGEST)
    if path.suffix.lower() in (".yaml", ".yml", ".json"):
        rows = list(_of_document(parse_foreign(_as_mapping(text), where).data))
    else:
        rows = list(_of_lines(text))
        if rows and {len(row) for _, row in rows} == {4} and not len(rows) % 4:
            stacked = np.array([row for _, row in rows]).reshape(-1, 16)
            rows = [("", row.tolist()) for row in stacked]
    if not rows:
        raise FileError("holds no poses: a row of numbers each", where=where)
    counts = sorted({len(row) for _, row in rows})
    if len(counts) > 1 or counts[0] not in _COUNTS:
        found = " and ".join(map(str, counts))
        raise InvalidInput(f"rows of {found} numbers; a pose has 6, 7, 8, 12 or 16", where=where)
    numbers = _finite(np.array([row for _, row in rows], float), where)
    names = tuple(name for name, _ in rows)
    return RobotRows(numbers, names if all(names) else None)


def _finite(numbers: Array, where: str) -> Array:
    if not np.isfinite(numbers).all():
        raise InvalidInput("holds numbers that are not finite", where=where)
    return numbers


def _of_matlab(path: Path) -> Array:
    """Return the numbers (N, k) of the one array of a MATLAB file that can be poses; raises FileError, InvalidInput."""
    from camcal.formats.cameras import mat  # here, since it loads what reads camera files

    with Located(path):
        variables = mat.variables(files.read_bytes(path, _LARGEST))
    found = {name: rows for name, value in variables.items() if (rows := _of_array(value)) is not None}
    if len(found) != 1:
        listed = f"poses in several variables: {', '.join(found)}" if found else "no array 4 x 4 x N or N x 6 of poses"
        raise InvalidInput(f"{listed}; one is needed", where=str(path))
    return next(iter(found.values()))


def _of_array(value: Any) -> Array | None:
    """Return the numbers (N, k) of an array of MATLAB, or of its cells, None where it cannot be poses."""
    try:
        cells = isinstance(value, tuple)
        value = np.stack([np.asarray(each, float) for each in value], axis=2) if cells else np.asarray(value, float)
    except (TypeError, ValueError):  # texts, structs, cells of several shapes
        return None
    if value.ndim == 3 and value.shape[:2] in ((4, 4), (3, 4)):
        matrices = np.moveaxis(value, 2, 0)
        # a row vector times its matrix, as MATLAB had it before 2022b
        if value.shape[0] == 4 and not matrices[:, :3, 3].any() and matrices[:, 3, :3].any():
            matrices = matrices.transpose(0, 2, 1)
        return np.asarray(matrices.reshape(len(matrices), -1))
    return np.asarray(value) if value.ndim == 2 and value.shape[1] in _COUNTS and len(value) > 1 else None


def _as_mapping(text: str) -> str:
    """Return a document whose whole is a mapping: a list of YAML or JSON below a key."""
    first = text.lstrip()
    if first.startswith("["):
        return f'{{"poses": {text}}}'
    return f"poses:\n{text}" if first.startswith("- ") else text


def _of_lines(text: str) -> Iterator[tuple[str, list[float]]]:
    """Yield the name, empty for none, and the numbers of every line that has numbers."""
    for line in text.splitlines():
        words = _SEPARATORS.split(line.strip(" \t,;[]()"))
        if not words[0] or words[0].startswith("#"):
            continue
        name = "" if is_number(words[0]) else words.pop(0).strip("\"':")
        if words and all(map(is_number, words)):
            yield name, list(parse_numbers(words))


def _of_document(data: Any) -> Iterator[tuple[str, list[float]]]:
    """Yield names and numbers of the poses of a list, or of a mapping by names."""
    if isinstance(data, Mapping):
        lists = [value for value in data.values() if isinstance(value, list) and value and not _is_numbers(value)]
        if len(lists) == 1 and len(lists[0]) > 1 and not _pose(data):
            yield from _of_document(lists[0])
            return
        items: list[tuple[str, Any]] = [(str(key), value) for key, value in data.items()]
    elif isinstance(data, list):
        items = [(_name_of(each), each) for each in data]
    else:
        return
    for name, item in items:
        numbers = _pose(item)
        if numbers:
            yield name, numbers


def _name_of(item: Any) -> str:
    return next((str(item[key]) for key in _NAME if key in item), "") if isinstance(item, Mapping) else ""


def _pose(item: Any) -> list[float]:
    """Return the numbers of one pose, none where it is none."""
    if isinstance(item, list):
        numbers = _flat(item)
        return numbers if len(numbers) in _COUNTS else []
    if not isinstance(item, Mapping):
        return []
    inner = next((item[key] for key in ("pose", "transform", "matrix", "T") if key in item), None)
    if inner is not None and (found := _pose(inner)):
        return found
    place, turn = (next((item[key] for key in keys if key in item), None) for keys in (_PLACE, _TURN))
    return [] if place is None or turn is None else _flat(_ordered(place)) + _flat(_ordered(turn))


def _ordered(item: Any) -> Any:
    """Return a mapping of x, y, z and w as a list in that order."""
    keys = [key for key in ("x", "y", "z", "w") if isinstance(item, Mapping) and key in item]
    return [item[key] for key in keys] if keys else item


def _flat(item: Any) -> list[float]:
    if isinstance(item, (int, float)) and not isinstance(item, bool):
        return [float(item)]
    return [number for each in item for number in _flat(each)] if isinstance(item, list) else []


def _is_numbers(item: Sequence[Any]) -> bool:
    return all(isinstance(each, (int, float)) for each in item)
