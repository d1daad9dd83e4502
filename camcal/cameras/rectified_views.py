"""Views about the horizontal axis: what rectified images of wide lenses side by side are drawn to, fx fy cx cy only.

Cylinder and equirectangular view with x and y exchanged: a plane through the x axis is a row of the image, so that two
cameras that stand beside each other along x see every point in one row.
"""

import numpy as np

from camcal.arrays import Array
from camcal.cameras.distortion import Distorted
from camcal.cameras.panoramic import Panorama
from camcal.cameras.plane_model import Flat, Slopes, Values
from camcal.dataclass import dataclass


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


MODELS = (CylinderX(), LatlonX())
