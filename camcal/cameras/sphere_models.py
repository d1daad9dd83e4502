"""Central lenses by way of a sphere: ucm, eucm, double_sphere and mei.

A ray meets a sphere, or an ellipsoid, and is projected from a point on its axis. Exact identities: ucm is eucm with
β = 1, and mei with ξ = α / (1 - α); double_sphere with ξ = 0 is ucm, with α = 0 mei.
Sources: Geyer & Daniilidis, ECCV 2000; Mei & Rives, ICRA 2007; Khomutenko, Garcia & Martinet, An enhanced unified
camera model, RA-L 2016; Usenko, Demmel & Cremers, The double sphere camera model, 3DV 2018.
"""

import math
from typing import ClassVar

import numpy as np

from camcal.arrays import Array
from camcal.cameras.lens import Parameter
from camcal.cameras.plane_model import CORE, Values
from camcal.cameras.short_models import AxialPlane, of_denominator
from camcal.dataclass import dataclass
from camcal.records import Brief

ALPHA = Parameter("alpha", spread=0.5, mean=0.5, typical=0.55, limits=(0.0, 1.0), stage=1)
BETA = Parameter("beta", spread=1.0, mean=1.0, typical=1.1, limits=(1e-6, 1e6), stage=2)
XI = Parameter("xi", spread=0.5, mean=-0.2, other=0.3, typical=-0.25, limits=(-1.0, 1.0))
MIRROR = Parameter("xi", spread=1.0, mean=1.0, typical=1.1, limits=(0.0, 1e6), stage=2)
COEFFICIENTS = (
    Parameter("k1", "numerator", growth=2, typical=-0.05, stage=2, colour_stage=2),
    Parameter("k2", "numerator", growth=4, typical=0.01),
    Parameter("p1", "tangential", growth=1, typical=0.0008, stage=2, colour_stage=2),
    Parameter("p2", "tangential", growth=1, typical=-0.0005, stage=2, colour_stage=2),
)


@dataclass(frozen=True)
class Ucm(Brief, AxialPlane):
    """s = 1 / (α d + (1 - α) Z) with d = √(β (X² + Y²) + Z²), β = 1 where the model has none."""

    plane_parameters: ClassVar[tuple[Parameter, ...]] = (ALPHA,)
    prior_reach: ClassVar[float] = 1.0

    def _scale(self, square: Array, z: Array, plane: Values) -> tuple[Array, Array]:
        alpha, beta = _with_beta(plane)
        apart = np.sqrt(beta * square + z * z)
        return 1.0 / (alpha * apart + (1.0 - alpha) * z), z > -_least(alpha) * apart

    def _bend(self, square: Array, z: Array, scale: Array, plane: Values) -> tuple[Array, ...]:
        alpha, beta = _with_beta(plane)
        apart = np.sqrt(beta * square + z * z)
        half = 0.5 * alpha / apart
        slopes = (beta * half, 2.0 * half * z + (1.0 - alpha), apart - z, half * square)
        return of_denominator(scale, *slopes[: 2 + len(plane)])

    def _lift(self, x: Array, y: Array, plane: Values) -> Array:
        alpha, beta = _with_beta(plane)
        square = x * x + y * y
        z = _height(alpha, beta * square)
        return np.asarray(np.stack([x, y, z]) / np.sqrt(square + z * z))

    def is_pinhole(self, parameters: Array) -> bool:
        """Return whether α is zero, and the sensor is not tilted."""
        return not parameters[len(CORE)] and not np.any(parameters[len(CORE) + len(self.plane_parameters) :])

    def _reach(self, plane: Values) -> float:
        alpha, beta = _with_beta(plane)
        return _fold(alpha) / math.sqrt(beta) if beta > 0 else 0.0


@dataclass(frozen=True)
class Eucm(Ucm):
    """The same with a β of its own."""

    plane_parameters: ClassVar[tuple[Parameter, ...]] = (ALPHA, BETA)


@dataclass(frozen=True)
class DoubleSphere(Brief, AxialPlane):
    """s = 1 / (α d + (1 - α) w) with w = ξ R + Z, d = √(X² + Y² + w²), R = √(X² + Y² + Z²)."""

    plane_parameters: ClassVar[tuple[Parameter, ...]] = (XI, ALPHA)
    prior_reach: ClassVar[float] = 1.0

    def _scale(self, square: Array, z: Array, plane: Values) -> tuple[Array, Array]:
        xi, alpha = plane
        distance = np.sqrt(square + z * z)
        shifted = xi * distance + z
        scale = 1.0 / (alpha * np.sqrt(square + shifted * shifted) + (1.0 - alpha) * shifted)
        return scale, z > _lowest(xi, alpha) * distance

    def _bend(self, square: Array, z: Array, scale: Array, plane: Values) -> tuple[Array, ...]:
        xi, alpha = plane
        distance = np.sqrt(square + z * z)
        shifted = xi * distance + z
        apart = np.sqrt(square + shifted * shifted)
        by_shift = alpha * shifted / apart + (1.0 - alpha)
        outwards = xi / distance
        slopes = (0.5 * (alpha / apart + by_shift * outwards), by_shift * (1.0 + outwards * z))
        return of_denominator(scale, *slopes, by_shift * distance, apart - shifted)

    def _lift(self, x: Array, y: Array, plane: Values) -> Array:
        xi, alpha = plane
        square = x * x + y * y
        z = _height(alpha, square)
        along = (z * xi + np.sqrt(z * z + (1.0 - xi * xi) * square)) / (z * z + square)
        return np.stack([along * x, along * y, along * z - xi])

    def _reach(self, plane: Values) -> float:
        xi, alpha = plane
        z = _lowest(xi, alpha)
        across = math.sqrt(max(1.0 - z * z, 0.0))
        depth = alpha * math.hypot(across, xi + z) + (1.0 - alpha) * (xi + z)
        return min(across / depth, _fold(alpha)) if across > 0 and depth > 0 else _fold(alpha)


@dataclass(frozen=True)
class Mei(Brief, AxialPlane):
    """s = 1 / (Z + ξ R), R = √(X² + Y² + Z²); the distortion is that of opencv4."""

    plane_parameters: ClassVar[tuple[Parameter, ...]] = (MIRROR,)
    prior_reach: ClassVar[float] = 1.0

    def _scale(self, square: Array, z: Array, plane: Values) -> tuple[Array, Array]:
        [xi] = plane
        distance = np.sqrt(square + z * z)
        return 1.0 / (z + xi * distance), z > -min(xi, 1.0 / xi if xi > 0 else math.inf) * distance

    def _bend(self, square: Array, z: Array, scale: Array, plane: Values) -> tuple[Array, ...]:
        [xi] = plane
        distance = np.sqrt(square + z * z)
        outwards = xi / distance
        return of_denominator(scale, 0.5 * outwards, 1.0 + outwards * z, distance)

    def _lift(self, x: Array, y: Array, plane: Values) -> Array:
        [xi] = plane
        square = x * x + y * y
        along = (xi + np.sqrt(1.0 + (1.0 - xi * xi) * square)) / (1.0 + square)
        return np.stack([along * x, along * y, along - xi])

    def _reach(self, plane: Values) -> float:
        [xi] = plane
        return 1.0 / math.sqrt(xi * xi - 1.0) if xi > 1 else math.inf


def _with_beta(plane: Values) -> tuple[float, float]:
    return plane[0], plane[1] if len(plane) > 1 else 1.0


def _least(alpha: float) -> float:
    """Return -cos of the angle, as the last sphere sees it, at which a lens with this α ends."""
    return (1.0 - alpha) / alpha if alpha > 0.5 else alpha / (1.0 - alpha)


def _fold(alpha: float) -> float:
    """Return the radius at which a lens with this α folds."""
    return 1.0 / math.sqrt(2.0 * alpha - 1.0) if alpha > 0.5 else math.inf


def _lowest(xi: float, alpha: float) -> float:
    """Return the least Z / R of a double sphere: at the fold, or just before it (Usenko et al., eq. 43 to 45)."""
    least = _least(alpha)
    squared = 2.0 * least * xi + xi * xi + 1.0
    return -(least + xi) / math.sqrt(squared) if squared > 0 else 1.0


def _height(alpha: float, square: Array) -> Array:
    """Return z (n,) of the rays (x, y, z) through places of the plane with x² + y² = `square` (n,)."""
    root = np.sqrt(1.0 - (2.0 * alpha - 1.0) * square)
    return np.asarray((1.0 - alpha * alpha * square) / (alpha * root + 1.0 - alpha))


MODELS = (
    Ucm("ucm", (), "unified: through one sphere"),
    Eucm("eucm", (), "enhanced unified: through an ellipsoid"),
    DoubleSphere("double_sphere", (), "through two spheres", ("ds",)),
    Mei("mei", COEFFICIENTS, "through one sphere, with distortion", ("omni", "omnidir")),
)
