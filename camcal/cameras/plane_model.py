"""What lens models share that map rays to a plane, distort the plane and scale it to pixels.

The work goes in parts of PART points, whose temporaries stay in the processor's cache.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np

from camcal.arrays import Array, require_shape
from camcal.cameras.distortion import Distorted, Distortion, Gradient, Limit, Roles
from camcal.cameras.model import Domain, Projection, ProjectionJacobians, Rays
from camcal.cameras.undistortion import undistort

CORE = ("fx", "fy", "cx", "cy")
PART = 8192


class Flat(NamedTuple):
    """Points on the plane: x, y (n,), their size (n,) per unit of X, Y, and the mask (n,) of points in front."""

    x: Array
    y: Array
    scale: Array
    front: Array


@dataclass(frozen=True)
class PlaneModel(ABC):
    """A model with the parameters fx fy cx cy and distortion coefficients; a subclass says which plane it uses."""

    name: str
    coefficients: tuple[str, ...]

    reach: ClassVar[float]  # the largest radius on the plane
    kinds: ClassVar[dict[str, tuple[str, ...]]]  # the coefficients of each of the Roles
    # By which power of the radius on the plane each coefficient's term grows relative to the radius itself.
    orders: ClassVar[dict[str, int]]
    # The largest radius at which priors are taken: with the high powers of a larger one they would be tighter than the
    # coefficients of real lenses need, and the corner of an image may lie outside the image circle of a wide lens.
    prior_reach: ClassVar[float]

    @abstractmethod
    def _flatten(self, points: Array) -> Flat:
        """Return points (n, 3) on the plane, NaN where they have no place on it."""

    @abstractmethod
    def _chain(self, points: Array, flat: Flat, distorted: Distorted, focal: list[float], d_point: Array) -> None:
        """Write the derivatives (2, 3, n) of the pixels by the points."""

    @abstractmethod
    def _lift(self, x: Array, y: Array) -> Array:
        """Return the unit rays (3, n) of places on the plane (n,)."""

    @abstractmethod
    def _angle(self, radius: float) -> float:
        """Return the angle (rad) from the axis at a radius on the plane."""

    @property
    def parameter_names(self) -> tuple[str, ...]:
        return CORE + self.coefficients

    def project(self, parameters: Array, points: Array) -> Projection:
        """Return the pixels (N, 2) of points (N, 3) in the camera frame."""
        points = require_shape(points, (None, 3), "points")
        focal, centre, distortion = self._read(parameters)
        limit = distortion.limit(self.reach)
        pixels, valid = np.empty((2, len(points))), np.empty(len(points), dtype=bool)
        with np.errstate(all="ignore"):
            for part in _parts(len(points)):
                flat = self._flatten(points[part])
                distorted = distortion.apply(flat.x, flat.y)
                _to_pixels(distorted, focal, centre, pixels[:, part])
                _blank(flat.front & limit.holds(distorted), valid[part], pixels[:, part])
        return Projection(pixels.T, valid)

    def project_with_jacobians(
        self, parameters: Array, points: Array, *, within_domain: bool = True
    ) -> ProjectionJacobians:
        """Return the pixels of points (N, 3) with d/dpoint (N, 2, 3) and d/dparameters (N, 2, K)."""
        points = require_shape(points, (None, 3), "points")
        focal, centre, distortion = self._read(parameters)
        limit = distortion.limit(self.reach) if within_domain else Limit(self.reach, math.inf)
        count = len(points)
        pixels, valid = np.empty((2, count)), np.empty(count, dtype=bool)
        d_point, d_parameters = np.empty((2, 3, count)), np.empty((2, len(self.parameter_names), count))
        with np.errstate(all="ignore"):
            for part in _parts(count):
                flat = self._flatten(points[part])
                rows = d_parameters[:, :, part]
                distorted = distortion.apply(flat.x, flat.y, Gradient(rows[:, len(CORE) :], focal))
                _to_pixels(distorted, focal, centre, pixels[:, part])
                _fill_core(distorted, rows)
                self._chain(points[part], flat, distorted, focal, d_point[:, :, part])
                sound = limit.holds(distorted) if within_domain else np.isfinite(distorted.x + distorted.y)
                inside = flat.front & sound
                _blank(inside, valid[part], pixels[:, part], d_point[:, :, part], rows)
        return ProjectionJacobians(pixels.T, valid, d_point.transpose(2, 0, 1), d_parameters.transpose(2, 0, 1))

    def unproject(self, parameters: Array, pixels: Array) -> Rays:
        """Return the unit rays (N, 3) of pixels (N, 2)."""
        pixels = require_shape(pixels, (None, 2), "pixels")
        focal, centre, distortion = self._read(parameters)
        limit = distortion.limit(self.reach)
        directions, valid = np.empty((3, len(pixels))), np.empty(len(pixels), dtype=bool)
        with np.errstate(all="ignore"):
            for part in _parts(len(pixels)):
                x_d, y_d = ((pixels[part, axis] - centre[axis]) / focal[axis] for axis in (0, 1))
                x, y, solved = undistort(distortion, x_d, y_d, limit)
                directions[:, part] = self._lift(x, y)
                _blank(solved, valid[part], directions[:, part])
        return Rays(directions.T, valid)

    def domain(self, parameters: Array) -> Domain:
        """Return where the model is one-to-one; the radius is that of the radial part, without the other terms."""
        focal, _, distortion = self._read(parameters)
        limit = distortion.limit(self.reach)
        return Domain(self._angle(limit.radius), min(focal) * limit.distorted)

    def rescale(self, parameters: Array, scale: tuple[float, float], offset: tuple[float, float]) -> Array:
        """Return the parameters (K,) for an image resized by `scale` (x, y), then cropped at `offset` (x, y) px."""
        result = require_shape(parameters, (len(self.parameter_names),), "parameters").copy()
        result[:2] *= scale
        # Resizing keeps the corner of the image, which lies half a pixel before the centre of pixel 0.
        result[2:4] = (result[2:4] + 0.5) * scale - 0.5 - np.asarray(offset)
        return result

    def start(self, image_size: tuple[int, int], focal: float) -> Array:
        """Return parameters (K,) without distortion, centred in an image (width, height), of one focal length (px)."""
        result = np.zeros(len(self.parameter_names))
        result[:4] = focal, focal, (image_size[0] - 1) / 2, (image_size[1] - 1) / 2
        return result

    def prior_std(self, image_size: tuple[int, int], focal: float) -> Array:
        """Return the standard deviations (K,) of weak priors about zero, inf for parameters that have none.

        The change of the radius by a coefficient's term alone, at the image corner, is taken to be 0 ± 100 %, which is
        more than most lenses have: coefficients that the data cannot tell apart stay finite. focal: px.
        """
        corner = min(math.hypot(*image_size) / 2 / focal, self.prior_reach)
        stds = [corner ** -self.orders[name] for name in self.coefficients]
        return np.array([math.inf] * len(CORE) + stds)

    def _read(self, parameters: Array) -> tuple[list[float], list[float], Distortion]:
        """Return the focal lengths, the principal point and the distortion of parameters (K,)."""
        values = require_shape(parameters, (len(self.parameter_names),), "parameters").tolist()
        return values[:2], values[2:4], Distortion(tuple(values[4:]), self._roles)

    @cached_property
    def _roles(self) -> Roles:
        """Which of the coefficients, by their indices, play which role."""
        indices = {name: index for index, name in enumerate(self.coefficients)}
        return Roles(
            **{role: tuple(indices[name] for name in names if name in indices) for role, names in self.kinds.items()}
        )


def _parts(count: int) -> Iterator[slice]:
    return (slice(start, start + PART) for start in range(0, count, PART))


def _to_pixels(distorted: Distorted, focal: list[float], centre: list[float], pixels: Array) -> None:
    for row, value, scale, origin in zip(pixels, (distorted.x, distorted.y), focal, centre, strict=True):
        np.multiply(value, scale, out=row)
        np.add(row, origin, out=row)


def _fill_core(distorted: Distorted, rows: Array) -> None:
    """Write the derivatives by fx fy cx cy, the first four of rows (2, K, n)."""
    rows[0, 1:4:2] = rows[1, 0:3:2] = 0.0
    rows[0, 0], rows[1, 1] = distorted.x, distorted.y
    rows[0, 2] = rows[1, 3] = 1.0


def _blank(inside: Array, valid: Array, *results: Array) -> None:
    """Write the mask (n,) and NaN into the results (..., n) where it is False."""
    valid[:] = inside
    if not inside.all():
        for result in results:
            result[..., ~inside] = np.nan
