"""The pose of one view as a least-squares problem: six shared parameters, tx ty tz rx ry rz, and no groups."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.geometry.pose import Pose, point_jacobian
from camcal.solve.losses import Loss
from camcal.solve.steps import Block, Jacobian, Step


@dataclass(frozen=True, eq=False)
class PoseProblem:
    """The residuals, in pixels, of points of an object seen by a known camera; the state is camera_T_object.

    points: (N, 3) in the object frame. pixels: (N, 2). whitening: (N, 2, 2) with Wᵀ W the inverse covariance of a
    pixel up to a common scale, or None.
    """

    camera: Camera
    points: Array
    pixels: Array
    whitening: Array | None = None
    loss: Loss | None = None

    @property
    def shared(self) -> int:
        return 6

    @property
    def groups(self) -> tuple[int, int]:
        return 0, 0

    def take(self, chosen: Array) -> "PoseProblem":
        """Return the problem of some of the points."""
        whitening = None if self.whitening is None else self.whitening[chosen]
        return replace(self, points=self.points[chosen], pixels=self.pixels[chosen], whitening=whitening)

    def residuals(self, camera_T_object: Pose) -> Array:
        """Return projected minus observed pixels (N, 2), not whitened, NaN outside the lens's domain."""
        return self.camera.project(camera_T_object.apply(self.points)).pixels - self.pixels

    def squared(self, camera_T_object: Pose) -> Array:
        """Return the squared lengths (N,) of the whitened residuals, infinite outside the lens's domain."""
        residuals = self.residuals(camera_T_object)
        if self.whitening is not None:
            residuals = np.einsum("nij,nj->ni", self.whitening, residuals)
        return np.asarray(np.nan_to_num(np.einsum("ni,ni->n", residuals, residuals), nan=np.inf))

    def blocks(self, camera_T_object: Pose) -> Sequence[Block] | None:
        """Return the observations, or None where a point leaves the lens's domain."""
        rotated = self.points @ camera_T_object.rotation.T
        in_camera = rotated + camera_T_object.translation
        projected = self.camera.model.project_with_jacobians(self.camera.parameters, in_camera)
        if not projected.valid.all():
            return None
        residuals = projected.pixels - self.pixels
        by_pose = projected.d_point @ point_jacobian(rotated)
        if self.whitening is not None:
            residuals = np.einsum("nij,nj->ni", self.whitening, residuals)
            by_pose = self.whitening @ by_pose
        return [Block(residuals, (Jacobian(by_pose, np.arange(6)),), loss=self.loss)]

    def retract(self, camera_T_object: Pose, step: Step) -> Pose:
        """Return the pose moved by a step."""
        return camera_T_object.retract(step.shared)
