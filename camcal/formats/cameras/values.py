"""The values of a camera file below one key, each checked, and what a family of files calls its lenses.

What is wrong is said with file, line and key. A family's lens models and their parameters are one declaration that is
read and written. A line is a lens as the family has it: its word for it, camcal's lens model, and the parameters in the
family's order, by camcal's names, KEY=NAME where the family names one otherwise. NAME? may be left out and is 0 then.
KEY=0 is one that camcal's model does not have: it has to be 0. f is one focal length for both axes; fx-fy what fx has
more than fy. * stands for all parameters of a model, in camcal's order.
A lens model that camcal does not have (yet) is declared alike, and refused by its word.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.cameras.catalogue import MODELS
from camcal.cameras.model import Camera
from camcal.dataclass import dataclass
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

Size = tuple[int, int]


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


class Key(NamedTuple):
    """A parameter: the family's key, camcal's name ("0" for none), and whether it may be left out."""

    key: str
    name: str
    optional: bool


ALL = Key("*", "*", optional=False)


class Lens(NamedTuple):
    """A lens: the family's word for it, camcal's model, its parameters in the family's order."""

    word: str
    model: str
    keys: tuple[Key, ...]

    @property
    def whole(self) -> bool:
        """Whether the family has all parameters of camcal's model, in its order."""
        return self.keys == (ALL,)

    @property
    def counts(self) -> tuple[int, int]:
        """The smallest and the largest number of parameters."""
        return sum(not each.optional for each in self.keys), len(self.keys)


@dataclass(frozen=True)
class Lenses:
    """The lenses of a family. text: the lines, the simplest first.

    origin: what the family counts at the centre of the top-left pixel: 0, 0.5 or 1. centred: cx, cy are counted from
    the middle of the image. of_longer_side: lengths are in units of the longer side. instead: what to do with a lens
    that camcal does not have.
    """

    text: str
    origin: float = 0.0
    centred: bool = False
    of_longer_side: bool = False
    instead: str = "calibrate with one of these, or undistort the images there and give the pinhole of the result"

    @cached_property
    def rows(self) -> tuple[Lens, ...]:
        """All lenses, those included that camcal does not have."""
        lines = (line.split() for line in self.text.splitlines() if line.strip())
        return tuple(Lens(word, model, tuple(map(_key, keys))) for word, model, *keys in lines)

    @cached_property
    def models(self) -> tuple[str, ...]:
        """The lens models of camcal among them."""
        return tuple(dict.fromkeys(row.model for row in self.rows if row.model in MODELS))

    def of(self, values: Values, key: str, word: str) -> tuple[Lens, ...]:
        """Return the lenses with a word that stands under a key; raises InvalidInput if camcal has none of them."""
        named = tuple(row for row in self.rows if row.word.lower() == word.lower())
        found = tuple(row for row in named if row.model in MODELS)
        if not found:
            what = "among camcal's lens models" if named else "a lens of this program"
            words = ", ".join(dict.fromkeys(row.word for row in self.rows if row.model in MODELS))
            raise values.wrong(key, f"{word[:40]!r} is not {what}; read are {words}: {self.instead}")
        return found

    def keyed(self, values: Values, lenses: Sequence[Lens], size: Size, prefix: str = "") -> Camera:
        """Return the camera whose parameters stand under keys; of several lenses that with the most of these."""
        lens = max(lenses, key=lambda each: sum(prefix + own.key in values for own in each.keys))
        numbers = [
            0.0 if own.optional and prefix + own.key not in values else values.number(prefix + own.key)
            for own in lens.keys
        ]
        return self._camera(lens, numbers, size, lambda key, text: values.wrong(prefix + key, text))

    def listed(self, values: Values, key: str, lenses: Sequence[Lens], size: Size, numbers: Array) -> Camera:
        """Return the camera whose parameters (N,) stand in a list; of several lenses that with so many."""
        count = len(numbers)
        lens = next((each for each in lenses if each.counts[0] <= count <= each.counts[1]), None)
        if lens is None:
            needed = " or ".join(dict.fromkeys(str(side) for each in lenses for side in each.counts))
            raise values.wrong(key, f"{count} numbers; {lenses[0].word} has {needed}")
        padded = [*numbers.tolist(), *(0.0,) * (len(lens.keys) - count)]
        return self._camera(lens, padded, size, lambda name, text: values.wrong(key, f"{name}: {text}"))

    def matrix(self, values: Values, matrix: str, coefficients: str, lenses: Sequence[Lens], size: Size) -> Camera:
        """Return the camera of a camera matrix (3, 3) and a list of coefficients, which may be missing."""
        core = values.camera_matrix(matrix)
        numbers = values.numbers(coefficients) if coefficients in values else np.zeros(0)
        return self.listed(values, coefficients, lenses, size, np.concatenate([core, numbers]))

    def _camera(
        self, lens: Lens, numbers: Sequence[float], size: Size, wrong: Callable[[str, str], InvalidInput]
    ) -> Camera:
        for own, value in zip(lens.keys, numbers, strict=True):
            if own.name == "0" and value:
                raise wrong(own.key, f"{value:.4g} is of a lens that camcal does not have: {self.instead}")
        found = {own.name: value for own, value in zip(lens.keys, numbers, strict=True)}
        if "f" in found:
            found["fx"] = found["fy"] = found["f"]
        if "fx-fy" in found:
            found["fx"] = found["fy"] + found["fx-fy"]
        side = max(size) if self.of_longer_side else 1.0
        for axis, name in enumerate(("cx", "cy")):
            middle = (size[axis] - 1) / 2 if self.centred else -self.origin
            found[name] = found.get(name, 0.0) * side + middle
            focal = found[f"f{name[1]}"] = found[f"f{name[1]}"] * side
            for fault in FOCAL_LENGTH(focal, ""):
                raise wrong(next(own.key for own in lens.keys if own.name[0] == "f"), fault.text)
        model = MODELS[lens.model]
        for own in lens.keys:
            low, high = model.limits.get(own.name, (-math.inf, math.inf))
            if own.name[0] not in "fc" and not low <= found[own.name] <= high:
                raise wrong(own.key, f"{found[own.name]:.4g} is outside [{low:.4g}, {high:.4g}]")
        return Camera(model, size, np.array([found.get(name, 0.0) for name in model.parameter_names]))

    def row(self, camera: Camera) -> Lens | None:
        """Return the first lens that a camera is exactly, None if there is none."""
        values = self._values(camera)
        given = {name for name in camera.model.parameter_names[2:] if values[name]} | {"fx", "fy"}
        for row in self.rows:
            held = {own.name for own in row.keys}
            held |= {"fx", "fy"} if "f" in held and values["fx-fy"] == 0 else set()
            held |= {"fx"} if "fx-fy" in held else set()
            same = row.model in MODELS and type(MODELS[row.model]) is type(camera.model)
            if same and (row.whole or held >= given):
                return row
        return None

    def written(self, camera: Camera, row: Lens | None = None) -> tuple[Lens, dict[str, float]]:
        """Return the lens that a camera is written as, and its parameters by their keys, in the family's order."""
        lens = row or self.row(camera)
        if lens is None:
            raise ValueError("a camera is written as a lens that the family has")
        values = self._values(camera)
        if lens.whole:
            return lens, {name: values[name] for name in camera.model.parameter_names}
        return lens, {own.key: values.get(own.name, 0.0) for own in lens.keys if not (own.name == "0" and own.optional)}

    def jacobian(self, camera: Camera, lens: Lens, keys: Sequence[str]) -> Array:
        """Return the derivatives (K, N) of a camera's parameters by the family's under these keys."""
        side = max(camera.image_size) if self.of_longer_side else 1.0
        names = {own.key: own.name for own in lens.keys}
        rows = {name: row for row, name in enumerate(camera.model.parameter_names)}
        result = np.zeros((len(rows), len(keys)))
        for column, key in enumerate(keys):
            name = names.get(key, "0")
            moved = {"f": ("fx", "fy"), "fx-fy": ("fx",), "fy": ("fx", "fy") if "fx-fy" in names.values() else ("fy",)}
            for each in moved.get(name, (name,)):
                if each in rows:
                    result[rows[each], column] = side if rows[each] < 4 else 1.0
        return result

    def _values(self, camera: Camera) -> dict[str, float]:
        """Return the parameters by camcal's names as the family counts them."""
        values = dict(zip(camera.model.parameter_names, camera.parameters.tolist(), strict=True))
        side = max(camera.image_size) if self.of_longer_side else 1.0
        for axis, name in enumerate(("cx", "cy")):
            middle = (camera.image_size[axis] - 1) / 2 if self.centred else -self.origin
            values[name] = (values[name] - middle) / side
            values[f"f{name[1]}"] /= side
        return values | {"f": values["fx"], "fx-fy": values["fx"] - values["fy"]}


def _key(token: str) -> Key:
    key, _, name = token.rstrip("?").partition("=")
    return Key(key, name or key, token.endswith("?"))


_OPENCV = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tau_x", "tau_y")
OPENCV_LENSES = "\n".join(
    [
        "opencv opencv5 fx fy cx cy k1? k2? p1? p2? k3?",
        *(f"opencv opencv{count} fx fy cx cy {' '.join(_OPENCV[:count])}" for count in (8, 12, 14)),
        "fisheye kannala_brandt4 fx fy cx cy k1 k2 k3 k4",
    ]
)


def order(lenses: Lenses) -> Mapping[str, str]:
    """Return the parameters of every lens that is read, in the family's order, by its word."""
    return {row.word: " ".join(own.key for own in row.keys if own.key) for row in lenses.rows if row.model in MODELS}
