"""Base of planes on which a point stands along its own direction: (x, y) = s (X, Y), s by X² + Y² and Z.

A subclass has s with its derivatives and its inverse; the chain to the pixels and the domain follow.
"""

import math
from abc import abstractmethod

import numpy as np

from camcal.arrays import Array
from camcal.cameras.distortion import Distorted
from camcal.cameras.plane_model import CORE, Flat, PlaneModel, Slopes, Values
from camcal.dataclass import dataclass

# So far out a plane without an edge is as good as at its end: the angle there is exact to rounding.
_OUTERMOST = 1e12
_WITHIN = 1 - 1e-15  # of the edge of a plane, which has no inverse


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
