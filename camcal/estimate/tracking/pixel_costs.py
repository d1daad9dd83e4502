"""Cost, gradient and curvature of poses given the pixels of single frames, for many poses at once.

A pixel is compared with its point on the plane that touches the unit sphere at the pixel's ray, so that any lens is a
pinhole there: e = A p / (r · p), A = L⁻¹ D B, B two directions across the ray r, D what a pixel moves per step along
them, L the root of the pixel's covariance. Wrong pixels are uniform over the image:
cost = -2 ln[(1 - ε) exp(-e²/2) + ε 2π |C|^½ / area], 0 for e = 0.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Protocol, Self

import numpy as np

from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.cameras.observations import Observations
from camcal.estimate.poses.records import Correspondences
from camcal.geometry import rotation as so3

WRONG = 0.02  # share of corners that belong to something else
_LEAST_DEPTH = 1e-9
_REFINED = 6  # steps to a minimum
_TINY = 1e-12
_BEHIND = 1e3  # squared deviations of a point behind the camera


class FrameCosts(Protocol):
    """What N frames say of their poses, in up to P parts each: the pixels of points, or one pose.

    coordinates: the numbers that a part measures.
    overstated: by how much -2 ln of the evidence is too large, 1 where the likelihood is that of the measurement.
    """

    coordinates: ClassVar[int]
    overstated: ClassVar[float]

    @property
    def there(self) -> Array:
        """The mask (N, P) of the parts that frames have."""

    def __len__(self) -> int: ...
    def at(self, frames: Array | int) -> Self:
        """Return some of the frames, or one without the first axis."""

    def with_noise(self, factor: float) -> Self:
        """Return the frames with the standard deviations of what they measure times a factor."""

    def squares(self, rotations: Array, translations: Array) -> Array:
        """Return the squared deviations (..., P) of the parts of frames from what poses (...) predict."""

    def inlier_probabilities(self, squared: Array) -> Array:
        """Return the probabilities (..., P) that parts belong to the object, by squared deviations; 0 where none is."""

    def linearised(self, rotations: Array, translations: Array, temper: float = 1.0) -> tuple[Array, Array, Array]:
        """Return the cost (...) of poses, half its gradient (..., 6) and half its curvature (..., 6, 6).

        Steps are tx ty tz rx ry rz with R ← Exp(δr) R. The curvature is that of Gauss and Newton, wrong parts left out
        by their weights. temper: more than 1 gives weight to parts that are so many times farther off (squared), to
        begin with; the cost is not changed by it.
        """


@dataclass(frozen=True, eq=False)
class PixelFrames:
    """The points of an object and their pixels in N frames of up to P points, zeros where a frame has fewer.

    points: (N, P, 3). projections: (N, P, 2, 3) A of the module, with a noise of 1. rays: (N, P, 3) unit.
    there: (N, P) which points a frame has. floors: (N, P) likelihood of a wrong pixel over that of a perfect one.
    """

    points: Array
    projections: Array
    rays: Array
    there: Array
    floors: Array
    coordinates: ClassVar[int] = 2
    overstated: ClassVar[float] = 1.0

    @classmethod
    def of(cls, camera: Camera, views: Sequence[Correspondences | None], sigma: float) -> "PixelFrames":
        """Return the frames of views, None for frames without the object.

        sigma: standard deviation of a pixel coordinate, px; of covariances the root of their factor.
        """
        table = Observations.of(views, unknown=np.eye(2))
        shape, there = table.ids.shape, table.present.copy()
        points = table.padded([None if view is None else view.points for view in views], 3).transpose(1, 2, 0)
        pixels = table.pixels.transpose(1, 2, 0)
        covariance = np.tile(np.eye(2), (*shape, 1, 1)) if table.covariance is None else table.covariance
        roots = np.linalg.cholesky(covariance)
        rays = np.tile([0.0, 0.0, 1.0], (*shape, 1))
        projections = np.zeros((*shape, 2, 3))
        found = camera.unproject(pixels[there])
        there[there] = found.valid
        rays[there] = found.directions[found.valid]
        across = _across(rays[there])
        seen = camera.model.project_with_jacobians(camera.parameters, rays[there], within_domain=False)
        per_step = seen.d_point @ across.swapaxes(-1, -2)
        whitening = np.linalg.inv(roots[there] * sigma)
        projections[there] = whitening @ per_step @ across
        usable = np.isfinite(projections).all(axis=(-1, -2))
        there &= usable
        projections[~usable] = 0.0
        area = float(np.prod(camera.image_size))
        spread = 2 * np.pi * sigma**2 * np.sqrt(np.linalg.det(roots @ roots.swapaxes(-1, -2)))
        return cls(points, projections, rays, there, WRONG / (1 - WRONG) * spread / area)

    def __len__(self) -> int:
        return len(self.points)

    @property
    def counts(self) -> Array:
        """The number (N,) of points in every frame."""
        return np.asarray(self.there.sum(axis=1))

    def at(self, frames: Array | int) -> "PixelFrames":
        """Return some of the frames, or one without the first axis."""
        return PixelFrames(
            self.points[frames], self.projections[frames], self.rays[frames], self.there[frames], self.floors[frames]
        )

    def with_noise(self, factor: float) -> "PixelFrames":
        """Return the frames with the standard deviations of their pixels times a factor."""
        return replace(self, projections=self.projections / factor, floors=self.floors * factor**2)

    def squares(self, rotations: Array, translations: Array) -> Array:
        """Return the squared deviations (..., P) of the pixels of frames from what poses (...) predict."""
        seen = self.points @ rotations.swapaxes(-1, -2) + translations[..., None, :]
        depth = (seen * self.rays).sum(axis=-1)
        off = (self.projections @ seen[..., None])[..., 0]
        front = depth > _LEAST_DEPTH
        result = (off**2).sum(axis=-1) / np.where(front, depth, 1.0) ** 2
        return np.asarray(np.where(front, result, _BEHIND) * self.there)

    def inlier_probabilities(self, squared: Array) -> Array:
        """Return the probabilities (..., P) that pixels belong to their points, 0 without one."""
        near = np.exp(-squared / 2)
        return np.asarray(np.where(self.there, near / (near + self.floors), 0.0))

    def linearised(self, rotations: Array, translations: Array, temper: float = 1.0) -> tuple[Array, Array, Array]:
        """Return the cost of poses with its derivatives, see FrameCosts."""
        turned = self.points @ rotations.swapaxes(-1, -2)
        seen = turned + translations[..., None, :]
        depth = (seen * self.rays).sum(axis=-1)
        front = (depth > _LEAST_DEPTH) & self.there
        depth = np.where(front, depth, 1.0)
        off = (self.projections @ seen[..., None])[..., 0] / depth[..., None]
        squared = np.where(front, (off**2).sum(axis=-1), _BEHIND * self.there)
        floors = self.floors
        near = np.exp(-squared / 2)
        cost = np.where(self.there, -2 * np.log((near + floors) / (1 + floors)), 0.0).sum(axis=-1)
        if temper != 1.0:
            near = np.exp(-squared / (2 * temper))
        root = np.sqrt(np.where(front, near / (near + floors), 0.0))
        slopes = (self.projections - off[..., None] * self.rays[..., None, :]) * (root / depth)[..., None, None]
        jacobian = np.empty((*slopes.shape[:-1], 6))
        jacobian[..., :3] = slopes
        arm = turned[..., None, :]
        for axis, (one, other) in enumerate(((1, 2), (2, 0), (0, 1))):
            jacobian[..., 3 + axis] = arm[..., one] * slopes[..., other] - arm[..., other] * slopes[..., one]
        rows = jacobian.reshape(*jacobian.shape[:-3], -1, 6)
        weighted = (off * root[..., None]).reshape(*rows.shape[:-1], 1)
        across = rows.swapaxes(-1, -2)
        return cost, (across @ weighted)[..., 0], across @ rows


def _across(rays: Array) -> Array:
    """Return two unit directions (M, 2, 3) across each ray (M, 3) and each other."""
    helper = np.where(np.abs(rays[:, :1]) < 0.7, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    first = np.cross(rays, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(rays, first)], axis=1)


def minimised(frames: FrameCosts, rotations: Array, translations: Array) -> tuple[Array, Array, Array]:
    """Return the poses (N, 3, 3), (N, 3) of the minima of frames next to some poses, and their costs (N)."""
    best = frames.linearised(rotations, translations)
    damping = np.full(len(rotations), 1e-3)
    for temper in (16.0, 4.0, *(1.0,) * _REFINED):
        gradient, curvature = best[1:] if temper == 1.0 else frames.linearised(rotations, translations, temper)[1:]
        every = np.arange(6)
        curvature = curvature.copy()
        curvature[:, every, every] *= 1 + damping[:, None]
        curvature[:, every, every] += _TINY * np.trace(curvature, axis1=1, axis2=2)[:, None] + _TINY
        step = -np.linalg.solve(curvature, gradient[..., None])[..., 0]
        tried = so3.exp(step[:, 3:]) @ rotations, translations + step[:, :3]
        after = frames.linearised(*tried)
        better = after[0] < best[0]
        rotations = np.where(better[:, None, None], tried[0], rotations)
        translations = np.where(better[:, None], tried[1], translations)
        best = (
            np.where(better, after[0], best[0]),
            np.where(better[:, None], after[1], best[1]),
            np.where(better[:, None, None], after[2], best[2]),
        )
        damping = np.where(better, damping / 5, damping * 10)
    return rotations, translations, best[0]
