"""The pinhole with Brown's distortion, as OpenCV counts its coefficients: pinhole and opencv4, 5, 8, 12, 14.

Sources: see distortion.py; the order of the coefficients is OpenCV's.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from camcal.arrays import Array
from camcal.cameras.distortion import Distorted
from camcal.cameras.plane_model import Flat, PlaneModel

# The coefficients in OpenCV's order, each with the power of the radius by which its term grows relative to the radius.
ORDERS = {
    "k1": 2, "k2": 4, "p1": 1, "p2": 1, "k3": 6, "k4": 2, "k5": 4, "k6": 6,
    "s1": 1, "s2": 3, "s3": 1, "s4": 3, "tau_x": 0, "tau_y": 0,
}  # fmt: skip
COEFFICIENTS = tuple(ORDERS)


@dataclass(frozen=True)
class Brown(PlaneModel):
    """A perspective camera: the plane is Z = 1, points in front have Z > 0."""

    reach: ClassVar[float] = math.inf
    kinds: ClassVar[dict[str, tuple[str, ...]]] = {
        "numerator": ("k1", "k2", "k3"),
        "denominator": ("k4", "k5", "k6"),
        "tangential": ("p1", "p2"),
        "prism": ("s1", "s2", "s3", "s4"),
        "tilt": ("tau_x", "tau_y"),
    }
    orders: ClassVar[dict[str, int]] = ORDERS
    prior_reach: ClassVar[float] = 1.0

    def _flatten(self, points: Array) -> Flat:
        depth = points[:, 2]
        scale = 1.0 / depth
        return Flat(points[:, 0] * scale, points[:, 1] * scale, scale, depth > 0)

    def _chain(self, points: Array, flat: Flat, distorted: Distorted, focal: list[float], d_point: Array) -> None:
        del points  # the plane says it all
        minus_x, minus_y = -flat.x, -flat.y
        slopes = ((distorted.x_x, distorted.x_y), (distorted.y_x, distorted.y_y))
        for axis, (by_x, by_y), length in zip(d_point, slopes, focal, strict=True):
            scale = flat.scale * length
            np.multiply(scale, by_x, out=axis[0])
            np.multiply(scale, by_y, out=axis[1])
            np.add(minus_x * axis[0], minus_y * axis[1], out=axis[2])

    def _lift(self, x: Array, y: Array) -> Array:
        depth = 1.0 / np.sqrt(1.0 + x * x + y * y)
        return np.stack([x * depth, y * depth, depth])

    def _angle(self, radius: float) -> float:
        return math.atan(radius)


MODELS = tuple(
    Brown(name, COEFFICIENTS[:count])
    for name, count in (
        ("pinhole", 0), ("opencv4", 4), ("opencv5", 5), ("opencv8", 8), ("opencv12", 12), ("opencv14", 14),
    )
)  # fmt: skip
