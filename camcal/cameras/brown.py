"""The pinhole with Brown's distortion, as OpenCV counts its coefficients: pinhole and opencv4, 5, 8, 12, 14.

Sources: see distortion.py; the order of the coefficients is OpenCV's.
"""

import math
from typing import ClassVar

import numpy as np

from camcal.arrays import Array
from camcal.cameras.distortion import Distorted
from camcal.cameras.lens import OPENCV, Parameter
from camcal.cameras.plane_model import CORE, Flat, PlaneModel, Slopes, Values
from camcal.dataclass import dataclass
from camcal.records import Brief

# In OpenCV's order. The typical barrel stays one-to-one at any field of view.
COEFFICIENTS = (
    Parameter("k1", "numerator", growth=2, typical=-0.2, stage=1, colour_stage=2),
    Parameter("k2", "numerator", growth=4, typical=0.05, stage=2),
    Parameter("p1", "tangential", growth=1, typical=0.0008, stage=2, colour_stage=2),
    Parameter("p2", "tangential", growth=1, typical=-0.0005, stage=2, colour_stage=2),
    Parameter("k3", "numerator", growth=6),
    Parameter("k4", "denominator", growth=2),
    Parameter("k5", "denominator", growth=4),
    Parameter("k6", "denominator", growth=6),
    Parameter("s1", "prism", growth=1),
    Parameter("s2", "prism", growth=3),
    Parameter("s3", "prism", growth=1),
    Parameter("s4", "prism", growth=3),
    Parameter("tau_x", "tilt", growth=0, limits=(-math.pi / 2, math.pi / 2)),
    Parameter("tau_y", "tilt", growth=0, limits=(-math.pi / 2, math.pi / 2)),
)


@dataclass(frozen=True)
class Brown(Brief, PlaneModel):
    """A perspective camera: the plane is Z = 1, points in front have Z > 0."""

    prior_reach: ClassVar[float] = 1.0

    def is_pinhole(self, parameters: Array) -> bool:
        """Return whether all coefficients are zero."""
        return not np.any(parameters[len(CORE) :])

    def _flatten(self, points: Array, plane: Values) -> Flat:  # noqa: ARG002
        depth = points[:, 2]
        scale = 1.0 / depth
        return Flat(points[:, 0] * scale, points[:, 1] * scale, scale, depth > 0)

    def _chain(
        self, points: Array, flat: Flat, distorted: Distorted, focal: Values, plane: Values, slopes: Slopes
    ) -> None:
        del points, plane  # the places on the plane say it all
        minus_x, minus_y = -flat.x, -flat.y
        by_place = ((distorted.x_x, distorted.x_y), (distorted.y_x, distorted.y_y))
        for axis, (by_x, by_y), length in zip(slopes.d_point, by_place, focal, strict=True):
            scale = flat.scale * length
            np.multiply(scale, by_x, out=axis[0])
            np.multiply(scale, by_y, out=axis[1])
            np.add(minus_x * axis[0], minus_y * axis[1], out=axis[2])

    def _lift(self, x: Array, y: Array, plane: Values) -> Array:  # noqa: ARG002
        depth = 1.0 / np.sqrt(1.0 + x * x + y * y)
        return np.stack([x * depth, y * depth, depth])

    def _angle(self, radius: float, plane: Values) -> float:  # noqa: ARG002
        return math.atan(radius)


MODELS = (
    Brown("pinhole", (), "perspective, without distortion", opencv=OPENCV),
    Brown("opencv4", COEFFICIENTS[:4], "two radial terms, two tangential", ("radtan",), opencv=OPENCV),
    Brown("opencv5", COEFFICIENTS[:5], "three radial terms, two tangential", ("plumb_bob",), opencv=OPENCV),
    Brown("opencv8", COEFFICIENTS[:8], "rational in the radius", ("rational_polynomial",), opencv=OPENCV),
    Brown("opencv12", COEFFICIENTS[:12], "with thin prism terms", opencv=OPENCV),
    Brown("opencv14", COEFFICIENTS[:14], "with a tilted sensor", opencv=OPENCV),
)
