"""Lenses of one formula with one parameter or none: fov, division, and the orthographic and equisolid fisheye.

On their planes a point stands along its own direction: (x, y) = s (X, Y), s by X² + Y² and Z. A subclass of the base of
such planes has s with its derivatives and its inverse; the chain to the pixels and the domain follow.
Sources: Devernay & Faugeras, Straight lines have to be straight, MVA 2001; Fitzgibbon, Simultaneous linear estimation
of multiple view geometry and lens distortion, CVPR 2001; Kingslake, Optics in photography, 1992 (the fisheyes).
"""

import math
from abc import abstractmethod
from typing import ClassVar

import numpy as np

from camcal.arrays import Array
from camcal.cameras.distortion import Distorted
from camcal.cameras.lens import Parameter
from camcal.cameras.plane_model import CORE, Flat, PlaneModel, Slopes, Values
from camcal.dataclass import dataclass
from camcal.records import Brief

# So far out a plane without an edge is as good as at its end: the angle there is exact to rounding.
_OUTERMOST = 1e12
_WITHIN = 1 - 1e-15  # of the edge of a plane, which has no inverse

_SERIES = 1e-3  # of an angle: the first three terms of its series in squares are exact to 1e-18


@dataclass(frozen=True)
class AxialPlane(PlaneModel):
    """A plane with (x, y) = s (X, Y)."""

    @abstractmethod
    def _scale(self, square: Array, z: Array, plane: Values) -> tuple[Array, Array]:
        """Return s (n,) of points with X² + Y² = `square` and Z = `z` (n,), and the mask (n,) of those it holds for."""

    @abstractmethod
    def _bend(self, square: Array, z: Array, scale: Array, plane: Values) -> tuple[Array, ...]:
        """Return the derivatives (n,) of s = `scale` by X² + Y², by Z and by each parameter of the plane."""

    def is_pinhole(self, parameters: Array) -> bool:
        """Return whether all that makes the lens another one is zero."""
        own = len(CORE) + len(self._roles.tilt)
        return len(parameters) > own and not np.any(parameters[len(CORE) :])

    def _flatten(self, points: Array, plane: Values) -> Flat:
        x, y, z = points.T
        scale, front = self._scale(x * x + y * y, z, plane)
        return Flat(x * scale, y * scale, scale, front & np.isfinite(scale))

    def _chain(
        self, points: Array, flat: Flat, distorted: Distorted, focal: Values, plane: Values, slopes: Slopes
    ) -> None:
        x, y, z = points.T
        by_square, *others = self._bend(x * x + y * y, z, flat.scale, plane)
        by_square += by_square
        by_place = ((distorted.x_x, distorted.x_y), (distorted.y_x, distorted.y_y))
        for axis, own, (by_x, by_y), length in zip(slopes.d_point, slopes.d_plane, by_place, focal, strict=True):
            outwards = length * (by_x * x + by_y * y)
            bent = outwards * by_square
            np.add(flat.scale * (length * by_x), bent * x, out=axis[0])
            np.add(flat.scale * (length * by_y), bent * y, out=axis[1])
            for row, slope in zip((axis[2], *own), others, strict=True):
                np.multiply(outwards, slope, out=row)

    def _angle(self, radius: float, plane: Values) -> float:
        inside = np.array([min(radius, self._reach(plane) * _WITHIN, _OUTERMOST)])
        x, _, z = self._lift(inside, np.zeros(1), plane)[:, 0].tolist()
        return math.atan2(x, z)


def of_denominator(scale: Array, *slopes: Array) -> tuple[Array, ...]:
    """Return the derivatives (n,) of s = 1 / d given those of d; scale: s (n,)."""
    minus = -scale * scale
    return tuple(minus * slope for slope in slopes)


@dataclass(frozen=True)
class Fov(Brief, AxialPlane):
    """A point r from the centre of a pinhole's plane stands atan(2 r tan(ω / 2)) / ω from it."""

    plane_parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("omega", spread=0.5, mean=0.9, typical=0.9, limits=(0.0, math.pi), stage=1),
    )

    def _scale(self, square: Array, z: Array, plane: Values) -> tuple[Array, Array]:
        ratio, _, opening = _of_opening(plane[0])
        return _arc(square * (opening / z) ** 2)[0] * ratio / z, z > 0

    def _bend(self, square: Array, z: Array, scale: Array, plane: Values) -> tuple[Array, ...]:
        ratio, slope, opening = _of_opening(plane[0])
        narrower = opening / z
        arc, bend = _arc(square * narrower * narrower)
        by_square = bend * narrower * narrower * ratio / z
        # of opening by ω: 1 + opening² / 4
        by_opening = 2.0 * bend * square * narrower * (1.0 + opening * opening / 4.0) * ratio / (z * z)
        return by_square, -(scale + 2.0 * by_square * square) / z, by_opening + arc * slope / z

    def _lift(self, x: Array, y: Array, plane: Values) -> Array:
        ratio, _, _ = _of_opening(plane[0])
        angle = plane[0] * np.sqrt(x * x + y * y)
        across = np.sinc(angle / np.pi)
        ray = np.stack([x * across, y * across, ratio * np.cos(angle)])
        return np.asarray(ray / np.sqrt((ray**2).sum(axis=0)))

    def _reach(self, plane: Values) -> float:
        return math.pi / (2.0 * abs(plane[0])) if plane[0] else math.inf


@dataclass(frozen=True)
class Division(Brief, AxialPlane):
    """A pinhole's place is (x, y) / (1 + λ r²), so that s = 2 / (Z + √(Z² - 4 λ (X² + Y²)))."""

    plane_parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("lambda", growth=2, typical=-0.2, stage=1, colour_stage=2),
    )
    prior_reach: ClassVar[float] = 1.0

    def _scale(self, square: Array, z: Array, plane: Values) -> tuple[Array, Array]:
        inside = z * z - 4.0 * plane[0] * square
        return 2.0 / (z + np.sqrt(inside)), (z > 0) & (inside > 0)

    def _bend(self, square: Array, z: Array, scale: Array, plane: Values) -> tuple[Array, ...]:
        root = np.sqrt(z * z - 4.0 * plane[0] * square)
        return of_denominator(scale, -plane[0] / root, 0.5 + 0.5 * z / root, -square / root)

    def _lift(self, x: Array, y: Array, plane: Values) -> Array:
        square = x * x + y * y
        z = 1.0 + plane[0] * square
        return np.asarray(np.stack([x, y, z]) / np.sqrt(square + z * z))

    def _reach(self, plane: Values) -> float:
        return 1.0 / math.sqrt(abs(plane[0])) if plane[0] else math.inf


@dataclass(frozen=True)
class Orthographic(Brief, AxialPlane):
    """A point θ from the axis stands sin θ from the centre, up to 90°."""

    def _scale(self, square: Array, z: Array, plane: Values) -> tuple[Array, Array]:  # noqa: ARG002
        return 1.0 / np.sqrt(square + z * z), z > 0

    def _bend(self, square: Array, z: Array, scale: Array, plane: Values) -> tuple[Array, ...]:  # noqa: ARG002
        return of_denominator(scale, 0.5 * scale, z * scale)

    def _lift(self, x: Array, y: Array, plane: Values) -> Array:  # noqa: ARG002
        return np.stack([x, y, np.sqrt(1.0 - x * x - y * y)])

    def _reach(self, plane: Values) -> float:  # noqa: ARG002
        return 1.0


@dataclass(frozen=True)
class Equisolid(Brief, AxialPlane):
    """A point θ from the axis stands 2 sin(θ / 2) from the centre: equal solid angles have equal areas."""

    def _scale(self, square: Array, z: Array, plane: Values) -> tuple[Array, Array]:  # noqa: ARG002
        distance = np.sqrt(square + z * z)
        ahead = np.where(z > 0, distance + z, square / (distance - z))  # R + Z, without loss behind the camera
        scale = np.sqrt(2.0 / (distance * ahead))
        return scale, np.isfinite(scale)

    def _bend(self, square: Array, z: Array, scale: Array, plane: Values) -> tuple[Array, ...]:  # noqa: ARG002
        distance = np.sqrt(square + z * z)
        half = 0.25 * scale / distance  # of 1/s² = R (R + Z) / 2
        return of_denominator(scale, half * (distance + 0.5 * z), half * (distance + z) ** 2)

    def _lift(self, x: Array, y: Array, plane: Values) -> Array:  # noqa: ARG002
        square = x * x + y * y
        across = np.sqrt(1.0 - 0.25 * square)
        return np.stack([x * across, y * across, 1.0 - 0.5 * square])

    def _angle(self, radius: float, plane: Values) -> float:  # noqa: ARG002
        return 2.0 * math.asin(min(radius / 2.0, 1.0))

    def _reach(self, plane: Values) -> float:  # noqa: ARG002
        return 2.0


def _of_opening(omega: float) -> tuple[float, float, float]:
    """Return c / ω with c = 2 tan(ω / 2), its derivative by ω, and c."""
    opening = 2.0 * math.tan(omega / 2.0)
    if abs(omega) < _SERIES:
        return 1.0 + omega**2 / 12.0, omega / 6.0 + omega**3 / 30.0, opening
    return opening / omega, (1.0 + opening * opening / 4.0 - opening / omega) / omega, opening


def _arc(square: Array) -> tuple[Array, Array]:
    """Return atan(v) / v and its derivative by v² at v² = `square` (n,)."""
    size = np.sqrt(square)
    arc = np.arctan(size) / size
    bend = (1.0 / (1.0 + square) - arc) / (2.0 * square)
    near = np.flatnonzero(square < _SERIES)
    if near.size:
        # 1 - v²/3 + v⁴/5 - …
        terms = np.array([(-1) ** power / (2 * power + 1) for power in range(8)])
        arc[near] = np.polynomial.polynomial.polyval(square[near], terms)
        bend[near] = np.polynomial.polynomial.polyval(square[near], terms[1:] * np.arange(1, 8))
    return arc, bend


MODELS = (
    Fov("fov", (), "one angle that opens a pinhole: less than 180°"),
    Division("division", (), "one term that divides: less than 180°"),
    Orthographic("orthographic", (), "fisheye: r = f sin θ, less than 180°"),
    Equisolid("equisolid", (), "fisheye: r = 2 f sin(θ/2)"),
)
