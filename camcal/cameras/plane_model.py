"""Base of lens models that map rays to a plane, distort the plane and scale it to pixels.

The work goes in parts of PART points, whose temporaries stay in the processor's cache. The distortion is inverted by
the tilt in closed form, the radius by bracketed Newton steps, the rest by damped Newton steps in two dimensions.
Fixed-point iteration, which does for narrow lenses, diverges on wide ones.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import ClassVar, NamedTuple, Self

import numpy as np

from camcal.arrays import Array, require_shape
from camcal.cameras.distortion import Distorted, Distortion, Gradient, Limit, Roles
from camcal.cameras.lens import Domain, Parameter, Projection, ProjectionJacobians, Rays, staged
from camcal.dataclass import dataclass, replace
from camcal.errors import InvalidInput

CORE = (
    Parameter("fx", stage=1, colour_stage=1),
    Parameter("fy", stage=1, colour_stage=1),
    Parameter("cx", stage=2, colour_stage=1),
    Parameter("cy", stage=2, colour_stage=1),
)
TILT = tuple(
    Parameter(name, "tilt", growth=0, typical=typical, limits=(-math.pi / 2, math.pi / 2))
    for name, typical in (("tau_x", 0.03), ("tau_y", -0.02))
)
TILTED = "_tilted"  # behind the name of a lens on a tilted sensor
PART = 8192
Values = Sequence[float]
FAR = 1e6  # the largest radius searched for on an unbounded plane: 1e-6 rad from 90° for a pinhole
# Residuals on the plane, relative to 1 + |target|: where to stop, and what still counts as solved when rounding
# stops the steps earlier (1e-12 is far below a micropixel).
ENOUGH, SOLVED = 1e-14, 1e-12
SMALLEST_STEP = 1e-4


class Flat(NamedTuple):
    """Points on the plane: x, y (n,), their size (n,) per unit of X, Y, and the mask (n,) of points in front."""

    x: Array
    y: Array
    scale: Array
    front: Array


class Slopes(NamedTuple):
    """Where derivatives of the pixels go: by the points (2, 3, n) and by the S parameters of the plane (2, S, n)."""

    d_point: Array
    d_plane: Array


class Lens(NamedTuple):
    """The parameters of one camera, sorted."""

    focal: list[float]
    centre: list[float]
    plane: list[float]
    distortion: Distortion


@dataclass(frozen=True)
class PlaneModel(ABC):
    """A model with the parameters fx fy cx cy, those of its plane, and distortion coefficients.

    A subclass says which plane it uses. `plane` is the values of the plane's own parameters, empty where it has none.
    """

    name: str
    coefficients: tuple[Parameter, ...] = ()
    summary: str = ""
    aliases: tuple[str, ...] = ()
    opencv: str = ""

    plane_parameters: ClassVar[tuple[Parameter, ...]] = ()
    is_view: ClassVar[bool] = False
    is_central: ClassVar[bool] = True
    # The largest radius at which priors are taken: with the high powers of a larger one they would be tighter than the
    # coefficients of real lenses need, and the corner of an image may lie outside the image circle of a wide lens.
    prior_reach: ClassVar[float] = math.inf

    @abstractmethod
    def _flatten(self, points: Array, plane: Values) -> Flat:
        """Return points (n, 3) on the plane, NaN where they have no place on it."""

    @abstractmethod
    def _chain(
        self, points: Array, flat: Flat, distorted: Distorted, focal: Values, plane: Values, slopes: Slopes
    ) -> None:
        """Write the derivatives of the pixels by the points and by the parameters of the plane."""

    @abstractmethod
    def _lift(self, x: Array, y: Array, plane: Values) -> Array:
        """Return the unit rays (3, n) of places on the plane (n,)."""

    @abstractmethod
    def _angle(self, radius: float, plane: Values) -> float:
        """Return the angle (rad) from the axis at a radius on the plane, which may be inf."""

    def _reach(self, plane: Values) -> float:  # noqa: ARG002
        """Return the largest radius on the plane."""
        return math.inf

    @property
    def configuration(self) -> Mapping[str, object]:
        """What a model is besides its name, empty for most."""
        return {}

    def configured(self, configuration: Mapping[str, object]) -> Self:
        """Return the model of its kind with another configuration; raises InvalidInput where there is no such."""
        if configuration:
            raise InvalidInput(f"model {self.name!r} has no configuration; leave it out")
        return self

    @cached_property
    def tilted(self) -> Self | None:
        """This lens on a tilted sensor, whose two angles follow its coefficients; None where that is no other lens, or
        the sensor is sheared already.
        """
        if self.is_view or self.configuration or self._roles.tilt or self._roles.shear:
            return None
        summary = f"{self.summary}, on a tilted sensor"
        coefficients = (*self.coefficients, *TILT)
        return replace(self, name=self.name + TILTED, coefficients=coefficients, summary=summary, aliases=(), opencv="")

    def is_pinhole(self, parameters: Array) -> bool:  # noqa: ARG002
        """Return whether a camera of these parameters (K,) is a pinhole without distortion."""
        return False

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        return CORE + self.plane_parameters + self.coefficients

    @cached_property
    def parameter_names(self) -> tuple[str, ...]:
        return tuple(own.name for own in self.parameters)

    @cached_property
    def stages(self) -> tuple[tuple[str, ...], ...]:
        """The parameters that a calibration's start frees: the stiffest ones, then more; all are free in the end."""
        return staged({own.name: own.stage for own in self.parameters})

    @cached_property
    def colour_stages(self) -> tuple[tuple[str, ...], ...]:
        """The parameters that may differ between the colours of one lens: few, then more; all in the end."""
        return staged({own.name: own.colour_stage for own in self.parameters})

    @cached_property
    def other_start(self) -> Mapping[str, float]:
        """The parameters that estimates start from a second value of, and that value."""
        return {own.name: own.other for own in self.parameters if own.other is not None}

    @cached_property
    def typical(self) -> Mapping[str, float]:
        """The parameters that are not zero in an ordinary lens, for simulations."""
        return {own.name: own.typical for own in self.parameters if own.typical}

    @cached_property
    def limits(self) -> Mapping[str, tuple[float, float]]:
        """The smallest and largest values that parameters may have in a file."""
        return {own.name: own.limits for own in self.parameters}

    def project(self, parameters: Array, points: Array) -> Projection:
        """Return the pixels (N, 2) of points (N, 3) in the camera frame."""
        points = require_shape(points, (None, 3), "points")
        focal, centre, plane, distortion = self._read(parameters)
        limit = distortion.limit(self._reach(plane))
        pixels, valid = np.empty((2, len(points))), np.empty(len(points), dtype=bool)
        with np.errstate(all="ignore"):
            for part in parts_of(len(points)):
                flat = self._flatten(points[part], plane)
                distorted = distortion.apply(flat.x, flat.y)
                to_pixels(distorted, focal, centre, pixels[:, part])
                blank(flat.front & limit.holds(distorted), valid[part], pixels[:, part])
        return Projection(pixels.T, valid)

    def project_with_jacobians(
        self, parameters: Array, points: Array, *, within_domain: bool = True
    ) -> ProjectionJacobians:
        """Return the pixels of points (N, 3) with d/dpoint (N, 2, 3) and d/dparameters (N, 2, K)."""
        points = require_shape(points, (None, 3), "points")
        focal, centre, plane, distortion = self._read(parameters)
        reach, first = self._reach(plane), len(CORE) + len(plane)
        limit = distortion.limit(reach) if within_domain else Limit(reach, math.inf)
        count = len(points)
        pixels, valid = np.empty((2, count)), np.empty(count, dtype=bool)
        d_point, d_parameters = np.empty((2, 3, count)), np.empty((2, len(self.parameter_names), count))
        with np.errstate(all="ignore"):
            for part in parts_of(count):
                flat = self._flatten(points[part], plane)
                rows = d_parameters[:, :, part]
                distorted = distortion.apply(flat.x, flat.y, Gradient(rows[:, first:], focal))
                to_pixels(distorted, focal, centre, pixels[:, part])
                fill_core(distorted, rows)
                slopes = Slopes(d_point[:, :, part], rows[:, len(CORE) : first])
                self._chain(points[part], flat, distorted, focal, plane, slopes)
                sound = limit.holds(distorted) if within_domain else np.isfinite(distorted.x + distorted.y)
                inside = flat.front & sound
                blank(inside, valid[part], pixels[:, part], d_point[:, :, part], rows)
        return ProjectionJacobians(pixels.T, valid, d_point.transpose(2, 0, 1), d_parameters.transpose(2, 0, 1))

    def unproject(self, parameters: Array, pixels: Array) -> Rays:
        """Return the unit rays (N, 3) of pixels (N, 2)."""
        pixels = require_shape(pixels, (None, 2), "pixels")
        focal, centre, plane, distortion = self._read(parameters)
        limit = distortion.limit(self._reach(plane))
        directions, valid = np.empty((3, len(pixels))), np.empty(len(pixels), dtype=bool)
        with np.errstate(all="ignore"):
            for part in parts_of(len(pixels)):
                x_d, y_d = ((pixels[part, axis] - centre[axis]) / focal[axis] for axis in (0, 1))
                x, y, solved = undistort(distortion, x_d, y_d, limit)
                directions[:, part] = self._lift(x, y, plane)
                blank(solved & np.isfinite(directions[0, part]), valid[part], directions[:, part])
        return Rays(directions.T, valid)

    def domain(self, parameters: Array) -> Domain:
        """Return where the model is one-to-one; the radius is that of the radial part, without the other terms."""
        focal, _, plane, distortion = self._read(parameters)
        limit = distortion.limit(self._reach(plane))
        return Domain(self._angle(limit.radius, plane), min(focal) * limit.distorted)

    def rescale(self, parameters: Array, scale: tuple[float, float], offset: tuple[float, float]) -> Array:
        """Return the parameters (K,) for an image resized by `scale` (x, y), then cropped at `offset` (x, y) px."""
        result = require_shape(parameters, (len(self.parameter_names),), "parameters").copy()
        result[:2] *= scale
        # Resizing keeps the corner of the image, which lies half a pixel before the centre of pixel 0.
        result[2:4] = (result[2:4] + 0.5) * scale - 0.5 - np.asarray(offset)
        return result

    def start(self, image_size: tuple[int, int], focal: float) -> Array:
        """Return parameters (K,) without distortion, centred in an image (width, height), of one focal length (px)."""
        result = self.prior_mean
        plane = result[len(CORE) : len(CORE) + len(self.plane_parameters)].tolist()
        with np.errstate(all="ignore"):
            on_axis = float(self._flatten(np.array([[0.0, 0.0, 1.0]]), plane).scale[0])  # of a small angle
        result[:4] = focal / on_axis, focal / on_axis, (image_size[0] - 1) / 2, (image_size[1] - 1) / 2
        return result

    @property
    def prior_mean(self) -> Array:
        """The means (K,) of the weak priors, where estimates start; 0 for parameters that have none."""
        return np.array([own.mean for own in self.parameters])

    def prior_std(self, image_size: tuple[int, int], focal: float) -> Array:
        """Return the standard deviations (K,) of the weak priors, inf for parameters that have none.

        The change of the radius by a coefficient's term alone, at the image corner, is taken to be 0 ± 100 %, which is
        more than most lenses have: coefficients that the data cannot distinguish stay finite. focal: px.
        """
        corner = min(math.hypot(*image_size) / 2 / focal, self.prior_reach)
        return np.array([own.prior_std(corner) for own in self.parameters])

    def _read(self, parameters: Array) -> Lens:
        """Return the named values of parameters (K,)."""
        values = require_shape(parameters, (len(self.parameters),), "parameters").tolist()
        first = len(CORE) + len(self.plane_parameters)
        return Lens(values[:2], values[2:4], values[4:first], Distortion(tuple(values[first:]), self._roles))

    @cached_property
    def _roles(self) -> Roles:
        """Which of the coefficients, by their indices, play which role."""
        roles = [own.role for own in self.coefficients]
        return Roles(**{role: tuple(index for index, own in enumerate(roles) if own == role) for role in set(roles)})


def chained(distorted: Distorted, focal: Values, by_x: Array, by_y: Array, slopes: Array) -> None:
    """Write the derivatives (2, P, n) of the pixels, given those of the places on the plane, by_x, by_y (P, n).

    What a plane's `_chain` needs, and for most planes all that it needs.
    """
    for axis, along_x, along_y, length in zip(
        slopes, (distorted.x_x, distorted.y_x), (distorted.x_y, distorted.y_y), focal, strict=True
    ):
        np.multiply(by_x, length * along_x, out=axis)
        np.add(axis, by_y * (length * along_y), out=axis)


def parts_of(count: int) -> Iterator[slice]:
    return (slice(start, start + PART) for start in range(0, count, PART))


def to_pixels(distorted: Distorted, focal: Values, centre: Values, pixels: Array) -> None:
    for row, value, scale, origin in zip(pixels, (distorted.x, distorted.y), focal, centre, strict=True):
        np.multiply(value, scale, out=row)
        np.add(row, origin, out=row)


def fill_core(distorted: Distorted, rows: Array) -> None:
    """Write the derivatives by fx fy cx cy, the first four of rows (2, K, n)."""
    rows[0, 1:4:2] = rows[1, 0:3:2] = 0.0
    rows[0, 0], rows[1, 1] = distorted.x, distorted.y
    rows[0, 2] = rows[1, 3] = 1.0


def blank(inside: Array, valid: Array, *results: Array) -> None:
    """Write the mask (n,) and NaN into the results (..., n) where it is False."""
    valid[:] = inside
    if not inside.all():
        for result in results:
            result[..., ~inside] = np.nan


def undistort(distortion: Distortion, x_d: Array, y_d: Array, limit: Limit) -> tuple[Array, Array, Array]:
    """Return the undistorted coordinates x, y (n,) and the mask (n,) of those found inside the limit."""
    tilt = distortion.tilt()
    target = np.stack([x_d, y_d] if tilt is None else tilt.undo(x_d, y_d))
    if not distortion.values:
        return target[0], target[1], (target**2).sum(axis=0) < limit.radius * limit.radius
    radius_d = np.sqrt(target[0] ** 2 + target[1] ** 2)
    radius = _undistort_radius(distortion, radius_d, limit)
    start = target * (radius / np.where(radius_d > 0, radius_d, 1.0))
    found, solved = refine(distortion, np.stack([x_d, y_d]), start, limit)
    return found[0], found[1], solved


def _undistort_radius(distortion: Distortion, target: Array, limit: Limit) -> Array:
    """Return the r (n,) with r c(r²) = target (n,).

    A target past the fold is taken just inside: the other terms may still bring the point within reach.
    """

    def distorted(radius: Array) -> tuple[Array, Array]:
        square = radius * radius
        ratio, slope = distortion.radial(square)
        return radius * ratio, ratio + 2.0 * square * slope

    end = min(limit.radius, FAR)
    target = np.minimum(target, 0.9999 * limit.distorted)
    return find_increasing(distorted, target, np.where(target < end, target, 0.5 * end), end)


def find_increasing(function: Callable[[Array], tuple[Array, Array]], target: Array, start: Array, end: float) -> Array:
    """Return where a function, which returns values and slopes (n,), takes values (n,) as it increases from 0 to `end`.

    Newton steps from `start` (n,), bisection where they leave the bracket.
    """
    low, high, place = np.zeros_like(target), np.full_like(target, end), start
    for _ in range(100):
        value, slope = function(place)
        excess = value - target
        low, high = np.where(excess < 0, place, low), np.where(excess < 0, high, place)
        trial = place - excess / slope
        trial = np.where((trial >= low) & (trial <= high), trial, 0.5 * (low + high))
        change = np.abs(trial - place)
        place = trial
        if not np.any(change > 1e-8 * place):  # its square is the error left
            break
    return place


def refine(distortion: Distortion, target: Array, start: Array, limit: Limit) -> tuple[Array, Array]:
    """Return the points (2, n) that the distortion takes to target (2, n), and the mask (n,) of success.

    A step that does not bring a point nearer by its share, or leaves the domain, is halved; after one that does the
    next is doubled, up to a full step.
    """
    point = start.copy()
    error, step = _newton_step(distortion, point, target, limit)
    factor = np.ones_like(error)
    size = 1.0 + np.abs(target).max(axis=0)
    for _ in range(50):
        if not np.any((error > ENOUGH * size) & (factor > SMALLEST_STEP)):
            break
        trial = point + factor * step
        trial_error, trial_step = _newton_step(distortion, trial, target, limit)
        better = trial_error < (1.0 - 0.1 * factor) * error  # Armijo's rule: crawling towards the fold ends early
        factor = np.where(better, np.minimum(1.0, 2.0 * factor), 0.5 * factor)
        for kept, new in ((point, trial), (step, trial_step), (error, trial_error)):
            np.copyto(kept, new, where=better)
    return point, error < SOLVED * size


def _newton_step(distortion: Distortion, point: Array, target: Array, limit: Limit) -> tuple[Array, Array]:
    """Return the distance (n,) left to the target, inf outside the domain, and the Newton step (2, n)."""
    here = distortion.apply(point[0], point[1])
    left_x, left_y = target[0] - here.x, target[1] - here.y
    determinant = here.determinant()
    step = np.stack([here.y_y * left_x - here.x_y * left_y, here.x_x * left_y - here.y_x * left_x]) / determinant
    error = np.where(limit.holds(here), np.maximum(np.abs(left_x), np.abs(left_y)), np.inf)
    return error, step
