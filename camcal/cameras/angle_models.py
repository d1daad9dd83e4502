"""Lenses by a polynomial of every power: ftheta, radius of the angle; ftheta_inverse, angle of the radius; ptlens,
radius of a pinhole's radius; ocam, depth of the radius.

Sources: Scaramuzza, Martinelli & Siegwart, A flexible technique for accurate omnidirectional camera calibration, ICVS
2006 (ocam); NVIDIA DriveWorks, rig file format (ftheta, polynomials in both directions); lensfun's manual,
lens distortion models (ptlens).
"""

import math
from abc import abstractmethod
from collections.abc import Callable
from typing import ClassVar

import numpy as np

from camcal.arrays import Array
from camcal.cameras.distortion import first_root
from camcal.cameras.lens import Parameter
from camcal.cameras.plane_model import FAR, Values, find_increasing
from camcal.cameras.short_models import AxialPlane
from camcal.dataclass import dataclass
from camcal.records import Brief

_TABLE = 257  # places of a function whose inverse is begun from its table
_OUTERMOST = 100.0  # focal lengths: half a degree from 90° of a pinhole


def _powers(typical: dict[int, float]) -> tuple[Parameter, ...]:
    return tuple(
        Parameter(f"a{power}", growth=power - 1, typical=typical.get(power, 0.0), stage=3 - (power == 3))
        for power in range(2, 6)
    )


@dataclass(frozen=True)
class AnglePlane(AxialPlane):
    """A plane on which a point θ from the axis stands r from the centre, along its direction."""

    prior_reach: ClassVar[float] = math.pi / 2

    @abstractmethod
    def _radius(self, theta: Array, plane: Values) -> Array:
        """Return r (n,) of θ (n,)."""

    @abstractmethod
    def _slopes(self, theta: Array, radius: Array, plane: Values) -> tuple[Array, ...]:
        """Return the derivatives (n,) of r by θ and by each parameter."""

    @abstractmethod
    def _edge(self, plane: Values) -> tuple[float, float]:
        """Return θ and r where the lens ends."""

    def is_pinhole(self, parameters: Array) -> bool:  # noqa: ARG002
        """Return that it is none: without further terms r = θ."""
        return False

    def _scale(self, square: Array, z: Array, plane: Values) -> tuple[Array, Array]:
        across = np.sqrt(square)
        theta = np.arctan2(across, z)
        scale = self._radius(theta, plane) / across
        ahead = np.flatnonzero((across == 0) & (z > 0))
        scale[ahead] = 1.0 / z[ahead]
        return scale, theta < self._edge(plane)[0]

    def _bend(self, square: Array, z: Array, scale: Array, plane: Values) -> tuple[Array, ...]:
        across, distance = np.sqrt(square), square + z * z
        along, *by_plane = self._slopes(np.arctan2(across, z), scale * across, plane)
        inverse = np.divide(1.0, across, out=np.zeros_like(across), where=across > 0)  # on the axis all vanish with x
        by_square = 0.5 * inverse * inverse * (along * z / distance - scale)
        return by_square, -along / distance, *(slope * inverse for slope in by_plane)

    def _reach(self, plane: Values) -> float:
        return self._edge(plane)[1]

    def _angle(self, radius: float, plane: Values) -> float:
        theta, reach = self._edge(plane)
        if radius >= reach:
            return theta
        x, _, z = self._lift(np.array([radius]), np.zeros(1), plane)[:, 0].tolist()
        return math.atan2(x, z)


@dataclass(frozen=True)
class Ftheta(Brief, AnglePlane):
    """r = θ + a2 θ² + a3 θ³ + a4 θ⁴ + a5 θ⁵."""

    plane_parameters: ClassVar[tuple[Parameter, ...]] = _powers({3: -0.02, 4: 0.002})

    def _radius(self, theta: Array, plane: Values) -> Array:
        return _polynomial(theta, plane)[0]

    def _slopes(self, theta: Array, radius: Array, plane: Values) -> tuple[Array, ...]:  # noqa: ARG002
        return _polynomial(theta, plane)[1], *(theta**power for power in range(2, len(plane) + 2))

    def _edge(self, plane: Values) -> tuple[float, float]:
        end = min(first_root(np.array([1.0, *(power * own for power, own in enumerate(plane, 2))])), math.pi)
        return end, float(_polynomial(np.array([end]), plane)[0][0])

    def _lift(self, x: Array, y: Array, plane: Values) -> Array:
        radius = np.sqrt(x * x + y * y)
        theta = _inverse(lambda angle: _polynomial(angle, plane), radius, self._edge(plane)[0])
        scale = np.divide(np.sin(theta), radius, out=np.ones_like(radius), where=radius > 0)
        return np.stack([x * scale, y * scale, np.cos(theta)])


@dataclass(frozen=True)
class FthetaInverse(Brief, AnglePlane):
    """θ = r + a2 r² + a3 r³ + a4 r⁴ + a5 r⁵."""

    plane_parameters: ClassVar[tuple[Parameter, ...]] = _powers({3: 0.02, 4: -0.002})

    def _radius(self, theta: Array, plane: Values) -> Array:
        return _inverse(lambda radius: _polynomial(radius, plane), theta, self._edge(plane)[1])

    def _slopes(self, theta: Array, radius: Array, plane: Values) -> tuple[Array, ...]:  # noqa: ARG002
        along = 1.0 / _polynomial(radius, plane)[1]
        return along, *(-along * radius**power for power in range(2, len(plane) + 2))

    def _edge(self, plane: Values) -> tuple[float, float]:
        terms = np.array([1.0, *plane])
        end = first_root(np.array([1.0, *(power * own for power, own in enumerate(plane, 2))]))
        whole = first_root(np.concatenate([[1.0], -terms / math.pi]))  # where θ = π
        return (math.pi, whole) if whole <= end else (float(_polynomial(np.array([end]), plane)[0][0]), end)

    def _lift(self, x: Array, y: Array, plane: Values) -> Array:
        radius = np.sqrt(x * x + y * y)
        theta = _polynomial(radius, plane)[0]
        scale = np.divide(np.sin(theta), radius, out=np.ones_like(radius), where=radius > 0)
        return np.stack([x * scale, y * scale, np.cos(theta)])


@dataclass(frozen=True)
class Ptlens(Brief, AnglePlane):
    """r = t + a2 t² + a3 t³ + a4 t⁴ with t = tan θ, the radius of a pinhole's plane."""

    plane_parameters: ClassVar[tuple[Parameter, ...]] = _powers({3: -0.02, 4: 0.002})[:3]
    prior_reach: ClassVar[float] = 1.0
    farthest: ClassVar[float] = FAR  # t where the plane ends

    @staticmethod
    def _ideal(theta: Array) -> tuple[Array, Array]:
        """Return t and its derivative at θ (n,)."""
        tangent = np.tan(theta)
        return tangent, 1.0 + tangent * tangent

    @staticmethod
    def _theta(ideal: Array) -> Array:
        """Return θ at t (n,)."""
        return np.arctan(ideal)

    def is_pinhole(self, parameters: Array) -> bool:
        """Return whether no term moves a point, and the plane is a pinhole's."""
        return type(self) is Ptlens and not np.any(parameters[4:])

    def _radius(self, theta: Array, plane: Values) -> Array:
        return _polynomial(self._ideal(theta)[0], plane)[0]

    def _slopes(self, theta: Array, radius: Array, plane: Values) -> tuple[Array, ...]:  # noqa: ARG002
        ideal, slope = self._ideal(theta)
        return _polynomial(ideal, plane)[1] * slope, *(ideal**power for power in (2, 3, 4))

    def _end(self, plane: Values) -> float:
        """Return t where the lens ends."""
        return min(first_root(np.array([1.0, *(power * own for power, own in enumerate(plane, 2))])), self.farthest)

    def _edge(self, plane: Values) -> tuple[float, float]:
        end = np.array([self._end(plane)])
        return float(self._theta(end)[0]), float(_polynomial(end, plane)[0][0])

    def _lift(self, x: Array, y: Array, plane: Values) -> Array:
        radius = np.sqrt(x * x + y * y)
        theta = self._theta(_inverse(lambda place: _polynomial(place, plane), radius, self._end(plane)))
        scale = np.divide(np.sin(theta), radius, out=np.ones_like(radius), where=radius > 0)
        return np.stack([x * scale, y * scale, np.cos(theta)])


@dataclass(frozen=True)
class PtlensEquisolid(Ptlens):
    """Ptlens with t = 2 sin(θ/2)."""

    farthest: ClassVar[float] = 2.0

    @staticmethod
    def _ideal(theta: Array) -> tuple[Array, Array]:
        return 2.0 * np.sin(theta / 2), np.cos(theta / 2)

    @staticmethod
    def _theta(ideal: Array) -> Array:
        return np.asarray(2.0 * np.arcsin(ideal / 2))


@dataclass(frozen=True)
class PtlensStereographic(Ptlens):
    """Ptlens with t = 2 tan(θ/2)."""

    @staticmethod
    def _ideal(theta: Array) -> tuple[Array, Array]:
        tangent = np.tan(theta / 2)
        return 2.0 * tangent, 1.0 + tangent * tangent

    @staticmethod
    def _theta(ideal: Array) -> Array:
        return np.asarray(2.0 * np.arctan(ideal / 2))


@dataclass(frozen=True)
class Ocam(Brief, AnglePlane):
    """The ray through a place is (x, y, P) with P = 1 + a2 r² + a3 r³ + a4 r⁴; then u = fx (x + shear_x y) + cx and v
    = fy (y + shear_y x) + cy. A turn of the sensor is a turn of the camera: the weak priors of the shears share it out.
    """

    plane_parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("a2", spread=0.5, mean=-1 / 3, typical=-0.3, stage=1),
        Parameter("a3", spread=0.5, typical=-0.01),
        Parameter("a4", spread=0.5, typical=-0.02),
    )

    def is_pinhole(self, parameters: Array) -> bool:
        """Return whether nothing but the focal lengths and the principal point is other than zero."""
        return not np.any(parameters[4:])

    def _radius(self, theta: Array, plane: Values) -> Array:
        return _inverse(lambda radius: _seen(radius, plane), theta, self._edge(plane)[1])

    def _slopes(self, theta: Array, radius: Array, plane: Values) -> tuple[Array, ...]:  # noqa: ARG002
        along = 1.0 / _seen(radius, plane)[1]
        common = along * radius / (radius * radius + _depth(radius, plane)[0] ** 2)
        return along, *(common * radius**power for power in (2, 3, 4))

    def _edge(self, plane: Values) -> tuple[float, float]:
        a2, a3, a4 = plane
        end = min(first_root(np.array([1.0, 0.0, -a2, -2.0 * a3, -3.0 * a4])), _OUTERMOST)
        return float(_seen(np.array([end]), plane)[0][0]), end

    def _lift(self, x: Array, y: Array, plane: Values) -> Array:
        square = x * x + y * y
        depth, _ = _depth(np.sqrt(square), plane)
        return np.asarray(np.stack([x, y, depth]) / np.sqrt(square + depth * depth))


def _polynomial(value: Array, plane: Values) -> tuple[Array, Array]:
    """Return v + a2 v² + … and its derivative at v = `value` (n,)."""
    total, slope = np.zeros_like(value), np.zeros_like(value)
    for power in range(len(plane), -1, -1):
        own = plane[power - 1] if power else 1.0
        total = (total + own) * value
        slope = slope * value + (power + 1) * own
    return total, slope


def _depth(radius: Array, plane: Values) -> tuple[Array, Array]:
    """Return P of ocam and its derivative by r (n,)."""
    a2, a3, a4 = plane
    square = radius * radius
    return 1.0 + square * (a2 + radius * (a3 + radius * a4)), radius * (2 * a2 + radius * (3 * a3 + radius * 4 * a4))


def _seen(radius: Array, plane: Values) -> tuple[Array, Array]:
    """Return θ of ocam and its derivative by r (n,)."""
    depth, slope = _depth(radius, plane)
    return np.arctan2(radius, depth), (depth - radius * slope) / (radius * radius + depth * depth)


def _inverse(function: Callable[[Array], tuple[Array, Array]], target: Array, end: float) -> Array:
    """Return where an increasing function, which returns values and slopes, takes a value (n,) between 0 and `end`."""
    places = np.tan(np.linspace(0.0, math.atan(end), _TABLE))
    start = np.interp(target, function(places)[0], places)
    return find_increasing(function, target, start, end)


SHEAR = (Parameter("shear_x", "shear", spread=0.01), Parameter("shear_y", "shear", spread=0.01))
MODELS = (
    Ftheta("ftheta", (), "fisheye: the radius is a polynomial of the angle"),
    FthetaInverse("ftheta_inverse", (), "fisheye: the angle is a polynomial of the radius"),
    Ptlens("ptlens", (), "PTLens and lensfun: three powers of the radius"),
    PtlensEquisolid("ptlens_equisolid", (), "lensfun's fisheye: three powers of 2 sin(θ/2)"),
    PtlensStereographic("ptlens_stereographic", (), "lensfun's fisheye: three powers of 2 tan(θ/2)"),
    Ocam("ocam", SHEAR, "Scaramuzza's: the ray's depth is a polynomial of the radius", ("scaramuzza",)),
)
