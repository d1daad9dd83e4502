"""First poses for points that do not lie in a plane: from rays by our own linear solution and by OpenCV's solvers.

OpenCV takes normalised pixels and so nothing at 90° or more: the rays are first turned to lie around the optical axis.
EPNP and solvePnPRansac are not used: on boards they return poses that are wrong by tens of degrees without a word.
"""

from collections.abc import Iterator
from itertools import combinations

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.estimate.planar import smallest_solution
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose

_NEAR_AXIS = 0.17  # cosine of 80°: beyond it normalised pixels stretch without bound


def pose_from_matrix(rays: Array, points: Array) -> Pose:
    """Return camera_T_object from unit rays (N, 3) of at least six points (N, 3) that are in no plane.

    The 3 × 4 matrix [R t] of least algebraic error, made a rotation afterwards.
    Source: Hartley & Zisserman, Multiple View Geometry, 2nd ed., section 7.1, with rays in place of pixels.
    """
    centre = points.mean(axis=0)
    scale = np.linalg.norm(points - centre, axis=1).mean()
    matrix = smallest_solution(rays, np.column_stack([(points - centre) / scale, np.ones(len(points))]))
    rotation = so3.nearest(matrix[:, :3])
    size = np.linalg.svd(matrix[:, :3], compute_uv=False).mean()
    return Pose(rotation, matrix[:, 3] / size * scale - rotation @ centre)


def poses_from_afar(rays: Array, points: Array) -> list[Pose]:
    """Return the pose of at least four points (N, 3), in no plane, as if all were at one distance.

    Serves where noise leaves three points without any exact pose.
    Source: DeMenthon & Davis, Model-Based Object Pose in 25 Lines of Code, 1995 (scaled orthography).
    """
    axis_T_camera, normalised = _around_axis(rays)
    if normalised is None:
        return []
    centre, image_centre = points.mean(axis=0), normalised.mean(axis=0)
    rows = np.linalg.lstsq(points - centre, normalised - image_centre, rcond=None)[0].T
    size = np.linalg.norm(rows, axis=1).mean()
    if not size > 0:  # all pixels are one
        return []
    rotation = so3.nearest(np.vstack([rows / size, np.cross(*rows) / size**2]))
    axis_T_object = Pose(rotation, np.append(image_centre, 1.0) / size - rotation @ centre)
    return [axis_T_camera.inverse() @ axis_T_object]


def poses_from_all(rays: Array, points: Array) -> list[Pose]:
    """Return what SQPNP makes of at least four points (N, 3); nothing for rays beyond 80° from their mean."""
    return list(_solved(rays, points, cv2.SOLVEPNP_SQPNP))


def poses_from_triplets(rays: Array, points: Array) -> list[Pose]:
    """Return the poses, up to four each, that meet three of the points (N, 3) exactly, for every choice of three."""
    triplets = [list(triplet) for triplet in combinations(range(len(points)), 3)]
    return [pose for three in triplets for pose in _solved(rays[three], points[three], cv2.SOLVEPNP_AP3P)]


def _solved(rays: Array, points: Array, method: int) -> Iterator[Pose]:
    axis_T_camera, normalised = _around_axis(rays)
    if normalised is None:
        return
    try:
        _, rotations, translations, _ = cv2.solvePnPGeneric(points, normalised, np.eye(3), None, flags=method)
    except cv2.error:  # three points in a line and the like: no start from these
        return
    for rotation, translation in zip(rotations, translations, strict=True):
        if np.isfinite(rotation).all() and np.isfinite(translation).all():
            yield axis_T_camera.inverse() @ Pose.from_vector(rotation.ravel(), translation.ravel())


def _around_axis(rays: Array) -> tuple[Pose, Array | None]:
    """Return the smallest turn that takes the mean of the rays to the optical axis, and x/z, y/z (N, 2) of the rays
    so turned, None where one is too far from the axis for that.
    """
    x, y, z = rays.mean(axis=0)
    across = np.hypot(x, y)
    direction = np.array([y, -x, 0.0]) / across if across > 0 else np.array([1.0, 0.0, 0.0])
    turn = Pose.from_vector(np.arctan2(across, z) * direction, np.zeros(3))
    turned = turn.apply(rays)
    return turn, None if turned[:, 2].min() < _NEAR_AXIS else turned[:, :2] / turned[:, 2:]
