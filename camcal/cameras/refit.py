"""The nearest camera of another lens model, fitted over the image area."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.cameras.lens import CameraModel
from camcal.cameras.model import Camera
from camcal.errors import InsufficientData
from camcal.solve.dense import DenseMethod, minimise_dense
from camcal.solve.least_squares import minimise
from camcal.solve.steps import Block, Jacobian, Step

_FITTED, _CHECKED = 31, 101  # rays a side of the image
_BESIDE = 0.5  # px from the edges of the image that still belong to it


@dataclass(frozen=True, eq=False)
class Refit:
    """A camera of another model and how far its pixels are from those of the first, over the image: RMS and largest.

    Where one of the two has no ray for a pixel, the largest is infinite.
    """

    camera: Camera
    rms_px: float
    max_px: float


def refit(camera: Camera, model: CameraModel) -> Refit:
    """Return the camera of `model` whose pixels come nearest to those of `camera` for rays through the whole image.

    The axes stay: focal lengths and principal point are fitted, no rotation. Raises InsufficientData if the camera has
    too few rays.
    """
    rays, pixels = _samples(camera, _FITTED)
    if 2 * len(rays) < len(model.parameter_names):
        raise InsufficientData(f"the lens has a ray for {len(rays)} of {_FITTED**2} pixels; none can be fitted to it")
    values = dict(zip(camera.model.parameter_names, camera.parameters.tolist(), strict=True))
    start = np.array([values.get(name, 0.0) for name in model.parameter_names])
    found = minimise_dense(_Refit(model, rays, pixels), start, DenseMethod())
    return _judged(camera, Camera(model, camera.image_size, found.state))


def fit_lens(model: CameraModel, rays: Array, pixels: Array, start: Array) -> Array | None:
    """Return the parameters (K,) of a lens whose pixels come nearest to those (N, 2) of rays (N, 3), None where the
    lens has no image of one of them at the start (K,).
    """
    problem = _Refit(model, rays, pixels)
    return None if problem.blocks(start) is None else minimise(problem, start).state


def _judged(camera: Camera, fitted: Camera) -> Refit:
    """Return a fitted camera with its differences on rays that it was not fitted to."""
    rays, pixels = _samples(camera, _CHECKED)
    projection = fitted.project(rays)
    apart = np.linalg.norm(projection.pixels - pixels, axis=1)
    there = apart[projection.valid]
    if not len(there):
        return Refit(fitted, np.inf, np.inf)
    whole = len(there) == _CHECKED**2
    return Refit(fitted, float(np.sqrt(np.mean(there**2))), float(there.max()) if whole else np.inf)


def _samples(camera: Camera, side: int) -> tuple[Array, Array]:
    """Return rays (N, 3) through a grid over the image, as far as the lens has them, and their pixels (N, 2)."""
    width, height = camera.image_size
    axes = (np.linspace(-_BESIDE, length - 1 + _BESIDE, side) for length in (width, height))
    pixels = np.column_stack([axis.ravel() for axis in np.meshgrid(*axes)])
    rays = camera.unproject(pixels)
    return np.asarray(rays.directions[rays.valid]), pixels[rays.valid]


@dataclass(frozen=True, eq=False)
class _Refit:
    """Residuals of the pixels (N, 2) that rays (N, 3) have in a lens model, by its parameters."""

    model: CameraModel
    rays: Array
    pixels: Array

    @property
    def shared(self) -> int:
        return len(self.model.parameter_names)

    @property
    def groups(self) -> tuple[int, int]:
        return 0, 0

    def blocks(self, state: Array) -> Sequence[Block] | None:
        projection = self.model.project_with_jacobians(state, self.rays, within_domain=False)
        if not projection.valid.all():
            return None
        every = np.arange(self.shared)
        columns = every if projection.columns is None else projection.columns
        return [Block(projection.pixels - self.pixels, (Jacobian(projection.d_parameters, columns),))]

    def retract(self, state: Array, step: Step) -> Array:
        return np.asarray(state + step.shared)
