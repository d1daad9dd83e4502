"""The pose of a plane from rays, and the second pose that a plane almost always has.

Rays in place of pixels serve every lens, also for points beyond 90° from its axis.
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose


@dataclass(frozen=True, eq=False)
class Extent:
    """How points (N, 3) spread: object_T_plane puts their mean at the origin and their best plane at z = 0.

    spread: (3,) root sums of squares along x, y and z of that frame, largest first.
    """

    object_T_plane: Pose
    spread: Array

    @classmethod
    def of(cls, points: Array) -> "Extent":
        """Return the extent of points (N, 3), N at least 3."""
        centre = points.mean(axis=0)
        _, spread, axes = np.linalg.svd(points - centre, full_matrices=False)
        rotation = axes.T * [1.0, 1.0, np.sign(np.linalg.det(axes))]
        return cls(Pose(rotation, centre), spread)


def pose_of_plane(rays: Array, points: Array, extent: Extent) -> Pose:
    """Return camera_T_object from unit rays (N, 3) of points (N, 3) that lie in or near their best plane.

    The rays d and places p in the plane obey d × (H p) = 0; the 3 × 3 matrix H of least algebraic error holds the
    first two columns of the rotation and the translation.
    Source: Hartley & Zisserman, Multiple View Geometry, 2nd ed., section 4.1, with rays in place of pixels.
    """
    scale = extent.spread[0] / np.sqrt(len(points))
    places = extent.object_T_plane.inverse().apply(points) / scale
    places[:, 2] = 1.0
    columns = smallest_solution(rays, places)
    columns = columns / np.linalg.norm(columns[:, :2], axis=0).mean()
    third = np.cross(columns[:, 0], columns[:, 1])
    rotation = so3.nearest(np.column_stack([columns[:, :2], third]))
    camera_T_plane = Pose(rotation, columns[:, 2] * scale)
    return camera_T_plane @ extent.object_T_plane.inverse()


def smallest_solution(rays: Array, coordinates: Array) -> Array:
    """Return the matrix M (3, D) of unit norm with the least Σ ‖d × (M x)‖², for rays d (N, 3) and x (N, D).

    Its sign puts the points M x on the side the rays point to.
    """
    equations = np.einsum("nij,na->nija", so3.hat(rays), coordinates).reshape(3 * len(rays), -1)
    solution = np.linalg.svd(equations, full_matrices=False)[2][-1].reshape(3, -1)
    facing = np.einsum("ni,ij,nj->", rays, solution, coordinates)
    return np.asarray(-solution if facing < 0 else solution)


def reflected(camera_T_object: Pose, extent: Extent) -> Pose:
    """Return the pose with the plane's normal reflected about the line of sight to the points' mean.

    Seen from afar both poses show the same image; near by, the other minimum of the error lies close to it.
    Source: Oberkampf, DeMenthon & Davis, Iterative Pose Estimation Using Coplanar Feature Points, 1996.
    """
    centre = extent.object_T_plane.translation
    sight = camera_T_object.apply(centre)
    normal = extent.object_T_plane.rotation[:, 2]
    rotation = _mirror(sight / np.linalg.norm(sight)) @ camera_T_object.rotation @ _mirror(normal)
    return Pose(rotation, sight - rotation @ centre)


def _mirror(normal: Array) -> Array:
    """Return the reflection (3, 3) at the plane through the origin with this unit normal."""
    return np.asarray(np.eye(3) - 2 * np.outer(normal, normal))
