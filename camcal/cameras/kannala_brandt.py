"""The fisheye of Kannala & Brandt, beyond 90° from the axis as well: with four coefficients as in OpenCV, with five
radial and two tangential terms for decentred lenses, on a tilted sensor, and with the further terms of other programs.

Sources: Kannala & Brandt, A generic camera model and calibration method, PAMI 2006, eq. 6 without its asymmetric terms;
the other terms are Brown's and OpenCV's, see distortion.py. What they are applied to, and how they are counted: COLMAP,
src/colmap/sensor/models.h; OpenSfM, camera_distortions_functions.h; Project Aria, FisheyeRadTanThinPrism.
"""

import math
from functools import cached_property
from typing import ClassVar

import numpy as np

from camcal.arrays import Array
from camcal.cameras.distortion import Distorted, Roles
from camcal.cameras.lens import FISHEYE, Parameter
from camcal.cameras.plane_model import TILT, Flat, PlaneModel, Slopes, Values
from camcal.dataclass import dataclass, replace
from camcal.records import Brief

SERIES_ANGLE = 1e-4
# θ grows by k1 θ³ and so on.
RADIAL = (
    Parameter("k1", "numerator", growth=2, typical=-0.02, stage=1, colour_stage=2),
    Parameter("k2", "numerator", growth=4, typical=0.003, stage=2),
    Parameter("k3", "numerator", growth=6),
    Parameter("k4", "numerator", growth=8),
    Parameter("k5", "numerator", growth=10),
    Parameter("k6", "numerator", growth=12),
)
TANGENTIAL = (
    Parameter("p1", "decentring", growth=1, typical=0.0008, stage=2, colour_stage=2),
    Parameter("p2", "decentring", growth=1, typical=-0.0005, stage=2, colour_stage=2),
)
EARLY = tuple(replace(own, role="tangential") for own in TANGENTIAL)
PRISM = tuple(Parameter(name, "prism", growth=growth) for name, growth in (("s0", 1), ("s1", 3), ("s2", 1), ("s3", 3)))
# Project Aria counts from 0, and its first tangential coefficient is that of x.
ARIA = (
    *(replace(own, name=f"k{index}") for index, own in enumerate(RADIAL)),
    *(replace(own, name=f"p{index}", typical=own.typical) for index, own in enumerate(TANGENTIAL[::-1])),
    *(replace(own, role="late_prism") for own in PRISM),
)


@dataclass(frozen=True)
class KannalaBrandt(Brief, PlaneModel):
    """The plane is equidistant: a point stands θ from its centre, θ = atan2(√(X² + Y²), Z).

    Distorted, that is θ (1 + k1 θ² + k2 θ⁴ + …), and the tangential terms are those of the point moved so.
    """

    prior_reach: ClassVar[float] = math.pi / 2

    def _flatten(self, points: Array, plane: Values) -> Flat:  # noqa: ARG002
        x, y, z = points.T
        radius = np.sqrt(x * x + y * y)
        scale = np.arctan2(radius, z) / radius
        near = np.flatnonzero(radius < SERIES_ANGLE * z)
        if near.size:
            scale[near] = (1.0 - (radius[near] / z[near]) ** 2 / 3.0) / z[near]
        # On the axis behind the camera, and at its centre, the scale is not finite: no place on the plane.
        return Flat(x * scale, y * scale, scale, np.isfinite(scale))

    def _chain(
        self, points: Array, flat: Flat, distorted: Distorted, focal: Values, plane: Values, slopes: Slopes
    ) -> None:
        del plane
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
        by_place = ((distorted.x_x, distorted.x_y), (distorted.y_x, distorted.y_y))
        for axis, (by_x, by_y), length in zip(slopes.d_point, by_place, focal, strict=True):
            np.multiply(by_x * along_x + by_y * across, length, out=axis[0])
            np.multiply(by_x * across + by_y * along_y, length, out=axis[1])
            np.multiply((by_x * x + by_y * y) * inverse, -length, out=axis[2])

    def _lift(self, x: Array, y: Array, plane: Values) -> Array:  # noqa: ARG002
        angle = np.sqrt(x * x + y * y)
        scale = np.sinc(angle / np.pi)
        return np.stack([x * scale, y * scale, np.cos(angle)])

    def _angle(self, radius: float, plane: Values) -> float:  # noqa: ARG002
        return radius

    def _reach(self, plane: Values) -> float:  # noqa: ARG002
        return math.pi


@dataclass(frozen=True)
class Early(KannalaBrandt):
    """Tangential and prism terms of the place before the radial terms."""


@dataclass(frozen=True)
class Aria(KannalaBrandt):
    """Tangential and prism terms of the place after the radial terms, the tangential ones in their own order."""

    @cached_property
    def _roles(self) -> Roles:
        roles = super()._roles
        return replace(roles, decentring=roles.decentring[::-1])


MODELS = (
    KannalaBrandt(
        "kannala_brandt4", RADIAL[:4], "wide lenses, beyond 180° as well", ("fisheye", "equidistant"), FISHEYE
    ),
    KannalaBrandt("kannala_brandt5t", (*RADIAL[:5], *TANGENTIAL), "wide lenses with decentred elements"),
    KannalaBrandt("kannala_brandt4_tilted", (*RADIAL[:4], *TILT), "wide lenses with a tilted sensor"),
    Early("fisheye62", (*RADIAL, *EARLY), "six radial terms, two tangential of the angle"),
    Early("opensfm_fisheye624", (*RADIAL, *EARLY, *PRISM), "OpenSfM's fisheye624, with prism terms of the angle"),
    Early(
        "thin_prism_fisheye",
        (*RADIAL[:2], *EARLY, *RADIAL[2:4], *(replace(PRISM[index], name=f"s{'xy'[index // 2]}1") for index in (0, 2))),
        "COLMAP's, tangential and prism terms of the angle",
    ),
    Aria("fisheye624", ARIA, "Project Aria's, tangential and prism terms of the radius"),
)
