"""What a family of camera files calls its lens models and their parameters: one declaration that is read and written.

A line is a lens as the family has it: its word for it, camcal's lens model, and the parameters in the family's order,
by camcal's names, KEY=NAME where the family names one otherwise. NAME? may be left out and is 0 then. KEY=0 is one that
camcal's model does not have: it has to be 0. f is one focal length for both axes; fx-fy what fx has more than fy.
* stands for all parameters of a model, in camcal's order.
A lens model that camcal does not have (yet) is declared alike, and refused by its word.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.cameras.catalogue import MODELS
from camcal.cameras.model import Camera
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.formats.cameras.values import Values
from camcal.formats.schema import FOCAL_LENGTH

Size = tuple[int, int]


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
