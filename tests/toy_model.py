"""A lens model that the package has not: it shows that a model needs one file and one line, and nothing elsewhere.

It has two parameters of the plane itself and two of the distortion. (x, y) = (X, Y) / (α d + (1 - α) Z) with
d = √(β (X² + Y²) + Z²). Source: Khomutenko, Garcia & Martinet, An enhanced unified camera model, RA-L 2016.
"""

import math
from dataclasses import dataclass

import numpy as np

from camcal.cameras.lens import Parameter
from camcal.cameras.plane_model import Flat, PlaneModel, chained


@dataclass(frozen=True)
class Enhanced(PlaneModel):
    plane_parameters = (
        Parameter("alpha", spread=0.5, mean=0.5, typical=0.55, limits=(0.0, 1.0), stage=1),
        Parameter("beta", spread=1.0, mean=1.0, typical=1.1, limits=(0.0, 100.0), stage=2),
    )
    prior_reach = 1.0

    def _flatten(self, points, plane):
        alpha, beta = plane
        x, y, z = points.T
        apart = np.sqrt(beta * (x * x + y * y) + z * z)
        scale = 1.0 / (alpha * apart + (1 - alpha) * z)
        least = (1 - alpha) / alpha if alpha > 0.5 else alpha / (1 - alpha)
        return Flat(x * scale, y * scale, scale, z > -least * apart)

    def _chain(self, points, flat, distorted, focal, plane, slopes):
        alpha, beta = plane
        x, y, z = points.T
        square = x * x + y * y
        apart = np.sqrt(beta * square + z * z)
        # derivatives of the denominator by X, Y, Z, α, β
        below = alpha * beta * x / apart, alpha * beta * y / apart, alpha * z / apart + 1 - alpha
        below = np.stack([*below, apart - z, alpha * square / (2 * apart)])
        by_x, by_y = -flat.x * flat.scale * below, -flat.y * flat.scale * below
        by_x[0] += flat.scale
        by_y[1] += flat.scale
        chained(distorted, focal, by_x[:3], by_y[:3], slopes.d_point)
        chained(distorted, focal, by_x[3:], by_y[3:], slopes.d_plane)

    def _lift(self, x, y, plane):
        alpha, beta = plane
        square = x * x + y * y
        root = np.sqrt(1 - (2 * alpha - 1) * beta * square)
        z = (1 - beta * alpha**2 * square) / (alpha * root + 1 - alpha)
        return np.stack([x, y, z]) / np.sqrt(square + z * z)

    def _reach(self, plane):
        alpha, beta = plane
        return 1 / math.sqrt(beta * (2 * alpha - 1)) if alpha > 0.5 else math.inf

    def _angle(self, radius, plane):
        alpha, beta = plane
        if radius == math.inf:  # there the denominator is zero: Z = -w d
            ratio = alpha / (1 - alpha)
            return math.atan2(math.sqrt((1 - ratio**2) / beta), -ratio)
        x, _, z = self._lift(np.array([min(radius, self._reach(plane) * (1 - 1e-15))]), np.zeros(1), plane)[:, 0]
        return math.atan2(x, z)


TOY = Enhanced(
    "toy",
    (
        Parameter("k1", "numerator", growth=2, typical=-0.01, stage=2, colour_stage=2),
        Parameter("k2", "numerator", growth=4),
    ),
    "a model of the tests",
    ("plaything",),
)
MODELS = (TOY,)
