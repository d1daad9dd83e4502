"""The fisheye of Kannala & Brandt, beyond 90° from the axis as well: with four coefficients as in OpenCV, and with five
radial and two tangential terms for decentred lenses.

Sources: Kannala & Brandt, A generic camera model and calibration method, PAMI 2006, eq. 6 without its asymmetric terms;
the tangential terms are Brown's, see distortion.py.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from camcal.arrays import Array
from camcal.cameras.distortion import Distorted
from camcal.cameras.plane_model import Flat, PlaneModel

SERIES_ANGLE = 1e-4
# The powers of θ by which each coefficient's term grows relative to θ.
RADIAL = {"k1": 2, "k2": 4, "k3": 6, "k4": 8, "k5": 10}
TANGENTIAL = {"p1": 1, "p2": 1}


@dataclass(frozen=True)
class KannalaBrandt(PlaneModel):
    """The plane is equidistant: a point stands θ from its centre, θ = atan2(√(X² + Y²), Z).

    Distorted, that is θ (1 + k1 θ² + k2 θ⁴ + …), and the tangential terms are those of the point moved so.
    """

    reach: ClassVar[float] = math.pi
    kinds: ClassVar[dict[str, tuple[str, ...]]] = {"numerator": tuple(RADIAL), "decentring": tuple(TANGENTIAL)}
    orders: ClassVar[dict[str, int]] = RADIAL | TANGENTIAL
    prior_reach: ClassVar[float] = math.pi / 2

    def _flatten(self, points: Array) -> Flat:
        x, y, z = points.T
        radius = np.sqrt(x * x + y * y)
        scale = np.arctan2(radius, z) / radius
        near = np.flatnonzero(radius < SERIES_ANGLE * z)
        if near.size:
            scale[near] = (1.0 - (radius[near] / z[near]) ** 2 / 3.0) / z[near]
        # On the axis behind the camera, and at its centre, the scale is not finite: no place on the plane.
        return Flat(x * scale, y * scale, scale, np.isfinite(scale))

    def _chain(self, points: Array, flat: Flat, distorted: Distorted, focal: list[float], d_point: Array) -> None:
        x, y, z = points.T
        square = x * x + y * y
        inverse = 1.0 / (square + z * z)
        # d(scale)/dX = bend X, and likewise for Y
        bend = (z * inverse - flat.scale) / square
        near = np.flatnonzero(square < (SERIES_ANGLE * z) ** 2)
        if near.size:
            bend[near] = -2.0 / 3.0 / z[near] ** 3
        across = bend * x * y
        along_x, along_y = flat.scale + bend * x * x, flat.scale + bend * y * y
        slopes = ((distorted.x_x, distorted.x_y), (distorted.y_x, distorted.y_y))
        for axis, (by_x, by_y), length in zip(d_point, slopes, focal, strict=True):
            np.multiply(by_x * along_x + by_y * across, length, out=axis[0])
            np.multiply(by_x * across + by_y * along_y, length, out=axis[1])
            np.multiply((by_x * x + by_y * y) * inverse, -length, out=axis[2])

    def _lift(self, x: Array, y: Array) -> Array:
        angle = np.sqrt(x * x + y * y)
        scale = np.sinc(angle / np.pi)
        return np.stack([x * scale, y * scale, np.cos(angle)])

    def _angle(self, radius: float) -> float:
        return radius


MODELS = (
    KannalaBrandt("kannala_brandt4", ("k1", "k2", "k3", "k4")),
    KannalaBrandt("kannala_brandt5t", (*RADIAL, *TANGENTIAL)),
)
