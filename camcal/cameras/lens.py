"""What a lens model is, and what is known of one before any image of it."""

import math
from collections.abc import Mapping
from typing import Protocol

import numpy as np

from camcal.arrays import Array, BoolArray, FloatArray, IntArray
from camcal.dataclass import dataclass
from camcal.parsing import LARGEST
from camcal.records import Brief

LAST = 3
OPENCV, FISHEYE = "cv2", "cv2.fisheye"


@dataclass(frozen=True, eq=False)
class Projection(Brief):
    """Pixels (N, 2), NaN where not valid, and the mask (N,) of points inside the model's domain."""

    pixels: FloatArray
    valid: BoolArray


@dataclass(frozen=True, eq=False)
class ProjectionJacobians:
    """A projection with its derivatives, NaN where not valid.

    d_point: (N, 2, 3) pixels per unit of the point. d_parameters: (N, 2, K) pixels per unit of each parameter;
    columns: None when the K columns are all parameters in order, else (N, K) parameter indices per row.
    Both are views of arrays laid out (2, 3, N) and (2, K, N), the fast order for the solver's sums over points.
    """

    pixels: FloatArray
    valid: BoolArray
    d_point: FloatArray
    d_parameters: FloatArray
    columns: IntArray | None = None

    def by_parameters(self, count: int) -> FloatArray:
        """Return the derivatives (N, 2, count) by all parameters, in order, of a model with so many."""
        if self.columns is None:
            return self.d_parameters
        found = np.zeros((2, count, len(self.valid)))
        by_columns = self.d_parameters.transpose(1, 2, 0)
        np.put_along_axis(found, np.broadcast_to(self.columns.T, by_columns.shape), by_columns, axis=1)
        return found.transpose(2, 0, 1)


@dataclass(frozen=True, eq=False)
class Rays(Brief):
    """Unit directions (N, 3) in the camera frame, NaN where not valid, and the mask (N,).

    origins: (N, 3) where the rays of a lens begin that is not central; None for the origin of the camera frame.
    """

    directions: FloatArray
    valid: BoolArray
    origins: FloatArray | None = None

    def at(self, distance: Array | float = 1.0) -> FloatArray:
        """Return the points (N, 3) on the rays at a distance, or at distances (N, 1), from where they begin."""
        points = self.directions * distance
        return points if self.origins is None else points + self.origins


@dataclass(frozen=True)
class Domain:
    """Where a model is one-to-one: the largest angle from the axis (rad) and the largest radius.

    max_radius_px: distance from the principal point in the image, along its smallest axis (inf: no limit).
    """

    max_theta: float
    max_radius_px: float


class CameraModel(Protocol):
    """A lens model: a frozen value without state, so that one instance serves every camera of its kind.

    It owns all that is known of its kind. aliases: other names people have for it. summary: what it is, in a few words.
    is_view: whether images are undistorted to it, rather than taken with it. is_central: whether all rays go through
    the origin; else they have origins, and how far away a point is makes no difference to its image. opencv: the part
    of OpenCV that has this model, its coefficients in the same order, "cv2" or "cv2.fisheye"; empty for none. stages:
    which parameters a calibration frees first, which then; colour_stages: in which parameters the colours of one lens
    are let differ first, and then. prior_std, prior_mean: the weak priors, inf for none; `start` has the same means,
    and those of the principal point. typical: the parameters that are not zero in an ordinary lens. limits: what values
    a parameter may have in a file. configuration: what it is besides its name, such as the knots of a spline;
    `configured` makes it another of its kind.

    Points are in the camera frame (x right, y down, z forward, any unit); pixels have (0, 0) at the centre of the
    top-left pixel. Nothing raises on a point it cannot take: it is marked invalid and its numbers are NaN.
    within_domain=False lets the formula run on where it is no longer one-to-one: a solver on its way to a sound lens
    may have to pass through one that is not.
    """

    @property
    def name(self) -> str: ...
    @property
    def aliases(self) -> tuple[str, ...]: ...
    @property
    def summary(self) -> str: ...
    @property
    def is_view(self) -> bool: ...
    @property
    def is_central(self) -> bool: ...
    @property
    def opencv(self) -> str: ...
    @property
    def parameter_names(self) -> tuple[str, ...]: ...
    @property
    def stages(self) -> tuple[tuple[str, ...], ...]: ...
    @property
    def colour_stages(self) -> tuple[tuple[str, ...], ...]: ...
    @property
    def prior_mean(self) -> FloatArray: ...
    @property
    def typical(self) -> Mapping[str, float]: ...
    @property
    def limits(self) -> Mapping[str, tuple[float, float]]: ...

    @property
    def configuration(self) -> Mapping[str, object]: ...

    def configured(self, configuration: Mapping[str, object]) -> "CameraModel": ...
    def project(self, parameters: Array, points: Array) -> Projection: ...
    def project_with_jacobians(
        self, parameters: Array, points: Array, *, within_domain: bool = True
    ) -> ProjectionJacobians: ...
    def unproject(self, parameters: Array, pixels: Array) -> Rays: ...
    def domain(self, parameters: Array) -> Domain: ...
    def is_pinhole(self, parameters: Array) -> bool: ...
    def rescale(self, parameters: Array, scale: tuple[float, float], offset: tuple[float, float]) -> FloatArray: ...
    def start(self, image_size: tuple[int, int], focal: float) -> FloatArray: ...
    def prior_std(self, image_size: tuple[int, int], focal: float) -> FloatArray: ...


@dataclass(frozen=True)
class Parameter:
    """One parameter of a lens model and what is known of it beforehand.

    role: the part that a coefficient plays in the distortion, one of the fields of distortion.Roles.
    growth: of a coefficient: the power of the radius by which its term grows relative to the radius, from which the
    standard deviation of its weak prior follows; spread: that standard deviation where there is no growth, inf for no
    prior. mean: of the prior, and where an estimate starts. typical: the value in an ordinary lens, to simulate one.
    limits: the values that a camera file may have.
    stage: when a calibration's start frees it, in 1, in 2, or with all others in LAST: the stiffest parameters first.
    colour_stage: likewise when it may differ between the colours of one lens, what differs in most lenses first.
    """

    name: str
    role: str = ""
    growth: int | None = None
    spread: float = math.inf
    mean: float = 0.0
    other: float | None = None
    typical: float = 0.0
    limits: tuple[float, float] = (-LARGEST, LARGEST)
    stage: int = LAST
    colour_stage: int = LAST

    def prior_std(self, radius: float) -> float:
        """Return the standard deviation of the weak prior; radius: of the image's corner, in the model's plane."""
        return self.spread if self.growth is None else float(radius**-self.growth)


def staged(stages: dict[str, int]) -> tuple[tuple[str, ...], ...]:
    """Return the names of all parameters freed by each stage before LAST, given every parameter's stage."""
    return tuple(tuple(name for name, own in stages.items() if own <= stage) for stage in range(1, LAST))
