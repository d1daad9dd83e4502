"""Projections of images that are drawn, with fx fy cx cy only: cylinder, equirectangular and stereographic.

They are what images are undistorted to when a lens sees 180° or more. fx, fy: pixels per radian at the image's middle.
Source: Snyder, Map projections: a working manual, USGS 1987 (perspective cylinder, plate carrée, stereographic).

Rectified images of wide lenses side by side are drawn to views about the horizontal axis: cylinder and equirectangular
view with x and y exchanged. A plane through the x axis is a row of the image, so that two cameras that stand beside
each other along x see every point in one row.
"""

import math
from typing import ClassVar

import numpy as np

from camcal.arrays import Array
from camcal.cameras.distortion import Distorted
from camcal.cameras.plane_model import Flat, PlaneModel, Slopes, Values, chained
from camcal.dataclass import dataclass


@dataclass(frozen=True)
class Panorama(PlaneModel):
    """A plane without distortion; a pixel beyond the seam behind the camera has no ray."""

    is_view: ClassVar[bool] = True
    widest_deg: ClassVar[float] = 360.0  # the largest field of view across that an image can have

    def half_width(self, fov: float) -> float:
        """Return how far from the middle the plane reaches across for a field of view (rad)."""
        return fov / 2

    def _angle(self, radius: float, plane: Values) -> float:  # noqa: ARG002
        return math.pi


@dataclass(frozen=True)
class Cylinder(Panorama):
    """Azimuth across, height on a cylinder of radius 1 down: upright lines stay straight."""

    name: str = "cylinder"
    summary: str = "view: u = fx·atan2(X, Z) + cx, v = fy·Y/√(X²+Z²) + cy"

    def _flatten(self, points: Array, plane: Values) -> Flat:  # noqa: ARG002
        x, y, z = points.T
        scale = 1.0 / np.hypot(x, z)
        height = y * scale
        return Flat(np.arctan2(x, z), height, scale, _has_a_place(x, z, scale, height))

    def _chain(
        self, points: Array, flat: Flat, distorted: Distorted, focal: Values, plane: Values, slopes: Slopes
    ) -> None:
        del distorted, plane
        d_point = slopes.d_point
        x, y, z = points.T
        _turn(x, z, flat.scale, focal[0], d_point[0])
        cubed = -focal[1] * y * flat.scale**3
        d_point[1] = x * cubed, focal[1] * flat.scale, z * cubed

    def _lift(self, x: Array, y: Array, plane: Values) -> Array:  # noqa: ARG002
        there = np.where(np.abs(x) < np.pi, 1.0, np.nan)
        across = there / np.sqrt(1.0 + y * y)
        return np.stack([np.sin(x) * across, y * across, np.cos(x) * across])


@dataclass(frozen=True)
class Equirectangular(Panorama):
    """Azimuth across, elevation down, both as angles."""

    name: str = "equirectangular"
    summary: str = "view: u = fx·atan2(X, Z) + cx, v = fy·atan2(Y, √(X²+Z²)) + cy"

    def _flatten(self, points: Array, plane: Values) -> Flat:  # noqa: ARG002
        x, y, z = points.T
        scale = 1.0 / np.hypot(x, z)
        height = y * scale
        return Flat(np.arctan2(x, z), np.arctan(height), scale, _has_a_place(x, z, scale, height))

    def _chain(
        self, points: Array, flat: Flat, distorted: Distorted, focal: Values, plane: Values, slopes: Slopes
    ) -> None:
        del distorted, plane
        d_point = slopes.d_point
        x, y, z = points.T
        _turn(x, z, flat.scale, focal[0], d_point[0])
        inverse = focal[1] / (x * x + y * y + z * z)
        leaning = -y * flat.scale * inverse
        d_point[1] = x * leaning, inverse / flat.scale, z * leaning

    def _lift(self, x: Array, y: Array, plane: Values) -> Array:  # noqa: ARG002
        there = np.where((np.abs(x) < np.pi) & (np.abs(y) < np.pi / 2), 1.0, np.nan)
        across = np.cos(y)
        return np.asarray(np.stack([np.sin(x) * across, np.sin(y), np.cos(x) * across]) * there)


@dataclass(frozen=True)
class Stereographic(Panorama):
    """A point θ from the axis stands 2 tan(θ/2) from the middle: small shapes keep their form everywhere."""

    name: str = "stereographic"
    summary: str = "view: (u, v) = (fx·2X/(R+Z) + cx, fy·2Y/(R+Z) + cy), R = √(X²+Y²+Z²)"

    widest_deg: ClassVar[float] = 350.0

    def half_width(self, fov: float) -> float:
        """Return how far from the middle the plane reaches across for a field of view (rad)."""
        return 2 * math.tan(fov / 4)

    def _flatten(self, points: Array, plane: Values) -> Flat:  # noqa: ARG002
        x, y, z = points.T
        scale = 2.0 / (np.sqrt(x * x + y * y + z * z) + z)
        return Flat(x * scale, y * scale, scale, np.isfinite(scale))

    def _chain(
        self, points: Array, flat: Flat, distorted: Distorted, focal: Values, plane: Values, slopes: Slopes
    ) -> None:
        del plane
        x, y, z = points.T
        bend = -0.5 * flat.scale**2
        inverse = 1.0 / np.sqrt(x * x + y * y + z * z)
        across, inwards = bend * inverse * x * y, bend * (1.0 + z * inverse)
        by_x = np.stack([flat.scale + bend * inverse * x * x, across, x * inwards])
        by_y = np.stack([across, flat.scale + bend * inverse * y * y, y * inwards])
        chained(distorted, focal, by_x, by_y, slopes.d_point)

    def _lift(self, x: Array, y: Array, plane: Values) -> Array:  # noqa: ARG002
        quarter = 0.25 * (x * x + y * y)
        return np.asarray(np.stack([x, y, 1.0 - quarter]) / (1.0 + quarter))


def _has_a_place(x: Array, z: Array, scale: Array, height: Array) -> Array:
    """Return the mask (n,) of points off the upright axis and not straight behind, where left and right meet."""
    return np.asarray((scale > 0) & np.isfinite(height) & ((z > 0) | (x != 0)))


def _turn(x: Array, z: Array, scale: Array, focal: float, rows: Array) -> None:
    """Write the derivatives (3, n) of the azimuth, in pixels, by the point; scale: 1 / √(X² + Z²)."""
    square = focal * scale * scale
    rows[:] = z * square, np.zeros_like(square), -x * square


@dataclass(frozen=True)
class CylinderX(Panorama):
    """Position on a cylinder of radius 1 about the x axis across, angle about that axis down."""

    name: str = "cylinder_x"
    summary: str = "rectified view: u = fx·X/√(Y²+Z²) + cx, v = fy·atan2(Y, Z) + cy"

    def _flatten(self, points: Array, plane: Values) -> Flat:  # noqa: ARG002
        x, y, z = points.T
        scale = 1.0 / np.hypot(y, z)
        along = x * scale
        # of the seam only straight behind is refused: with y = 0 rays on it are common
        somewhere = (scale > 0) & np.isfinite(along) & ((z > 0) | (x != 0) | (y != 0))
        return Flat(along, np.arctan2(y, z), scale, np.asarray(somewhere))

    def _chain(
        self, points: Array, flat: Flat, distorted: Distorted, focal: Values, plane: Values, slopes: Slopes
    ) -> None:
        del distorted, plane
        x, y, z = points.T
        square = flat.scale**2
        across = -focal[0] * x * flat.scale * square
        slopes.d_point[0] = focal[0] * flat.scale, y * across, z * across
        slopes.d_point[1] = np.zeros_like(x), focal[1] * z * square, -focal[1] * y * square

    def _lift(self, x: Array, y: Array, plane: Values) -> Array:  # noqa: ARG002
        there = np.where(np.abs(y) < np.pi, 1.0, np.nan)
        around = there / np.sqrt(1.0 + x * x)
        return np.stack([x * around, np.sin(y) * around, np.cos(y) * around])


@dataclass(frozen=True)
class LatlonX(CylinderX):
    """Angle off the plane across the x axis across, angle about that axis down."""

    name: str = "latlon_x"
    summary: str = "rectified view: u = fx·atan2(X, √(Y²+Z²)) + cx, v = fy·atan2(Y, Z) + cy"

    def _flatten(self, points: Array, plane: Values) -> Flat:
        flat = super()._flatten(points, plane)
        return flat._replace(x=np.arctan(flat.x))

    def _chain(
        self, points: Array, flat: Flat, distorted: Distorted, focal: Values, plane: Values, slopes: Slopes
    ) -> None:
        super()._chain(points, flat, distorted, focal, plane, slopes)
        slopes.d_point[0] *= np.cos(flat.x) ** 2

    def _lift(self, x: Array, y: Array, plane: Values) -> Array:  # noqa: ARG002
        there = np.where((np.abs(x) < np.pi / 2) & (np.abs(y) < np.pi), 1.0, np.nan)
        around = np.cos(x)
        return np.asarray(np.stack([np.sin(x), np.sin(y) * around, np.cos(y) * around]) * there)


MODELS = (Cylinder(), Equirectangular(), Stereographic(), CylinderX(), LatlonX())
