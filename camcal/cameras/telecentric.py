"""A telecentric lens: every ray is parallel to the axis, so that a thing is as large from near as from afar.

(x, y) = (X, Y), in the unit of the points: fx and fy are pixels per unit, k1 and k2 per unit² and per unit⁴. Without
distortion a principal point elsewhere is a camera elsewhere, which a weak prior about the middle of the image decides.
There are no tangential terms: with k1 alone they, fx, fy and a shift of the camera do just what a principal point
elsewhere along x or y does. Points are in front; how far away, no image says.
Source: Steger, A comprehensive and versatile camera model for cameras with tilt lenses, IJCV 2017, section 3.
"""

import math
from typing import ClassVar

import numpy as np

from camcal.arrays import Array
from camcal.cameras.brown import COEFFICIENTS
from camcal.cameras.distortion import Distorted
from camcal.cameras.lens import Rays
from camcal.cameras.plane_model import Flat, PlaneModel, Slopes, Values
from camcal.dataclass import dataclass
from camcal.records import Brief

_OFF_CENTRE = 1 / 8  # of the image's diagonal, the standard deviation of the principal point from the middle


@dataclass(frozen=True)
class Telecentric(Brief, PlaneModel):
    """Parallel projection: a ray has the direction of the axis and an origin of its own, in the plane Z = 0."""

    is_central: ClassVar[bool] = False

    def unproject(self, parameters: Array, pixels: Array) -> Rays:
        """Return the rays of pixels (N, 2), all of them along the axis, with their origins."""
        found = super().unproject(parameters, pixels)
        along = np.where(found.valid[:, None], [0.0, 0.0, 1.0], np.nan)
        return Rays(along, found.valid, found.directions - along)

    @property
    def tilted(self) -> None:
        """None: where rays are parallel the tilt of a sensor is a stretch of its image."""
        return

    def prior_std(self, image_size: tuple[int, int], focal: float) -> Array:
        """Return the standard deviations (K,) of the weak priors, the principal point's among them."""
        result = super().prior_std(image_size, focal)
        result[2:4] = _OFF_CENTRE * math.hypot(*image_size)
        return result

    def _flatten(self, points: Array, plane: Values) -> Flat:  # noqa: ARG002
        x, y, z = points.T
        return Flat(x, y, np.ones_like(z), (z > 0) & np.isfinite(x + y))

    def _chain(
        self, points: Array, flat: Flat, distorted: Distorted, focal: Values, plane: Values, slopes: Slopes
    ) -> None:
        del points, flat, plane  # a shift is as large on the plane
        by_place = ((distorted.x_x, distorted.x_y), (distorted.y_x, distorted.y_y))
        for axis, (by_x, by_y), length in zip(slopes.d_point, by_place, focal, strict=True):
            axis[0], axis[1], axis[2] = length * by_x, length * by_y, 0.0

    def _lift(self, x: Array, y: Array, plane: Values) -> Array:  # noqa: ARG002
        return np.stack([x, y, np.ones_like(x)])  # the points at distance 1

    def _angle(self, radius: float, plane: Values) -> float:  # noqa: ARG002
        return math.asin(min(radius, 1.0))  # of points at distance 1 from the origin


MODELS = (Telecentric("telecentric", COEFFICIENTS[:2], "parallel rays: size in px per m, whatever the distance"),)
