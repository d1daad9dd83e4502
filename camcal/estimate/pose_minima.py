"""The minima of the reprojection error of one view: starts by several ways, each refined through the solver."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from camcal.arrays import Array
from camcal.estimate.planar import Extent, pose_of_plane, reflected
from camcal.estimate.pose_problem import PoseProblem
from camcal.estimate.start_points import pose_from_matrix, poses_from_afar, poses_from_all, poses_from_triplets
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.solve.least_squares import Solution, minimise

MIN_POINTS = 4
ROUNDING = 1e-9  # px: what smaller residuals tell is the rounding of numbers, not noise
_IN_PLANE = 1e-4  # third spread over the first: no 3 × 4 matrix can be had below
_NEAR_PLANE = 0.1  # and above, the pose of the best plane is no start
_FEW = 5  # points for which one solver's start may lie in a wrong valley
_STARTS = 4
_SAME_START = 0.1  # rad, and share of the distance: starts this near lead to one minimum
_SAME_MINIMUM = 1e-3


def pose_minima(problem: PoseProblem, rays: Array, extent: Extent) -> list[Solution[Pose]]:
    """Return the different minima that the starts lead to, lowest first."""
    starts = sorted(_starts(problem.points, rays, extent), key=lambda pose: float(problem.squared(pose).sum()))
    chosen = _distinct(starts, _SAME_START)[:_STARTS]
    minima = [solution for index in chosen if (solution := _refined(problem, starts[index]))]
    if minima and extent.spread[2] < _NEAR_PLANE * extent.spread[0]:
        best = min(minima, key=lambda solution: solution.cost)
        mirrored = _refined(problem, reflected(best.state, extent))
        minima += [mirrored] if mirrored else []
    minima.sort(key=lambda solution: solution.cost)
    return [minima[index] for index in _distinct([solution.state for solution in minima], _SAME_MINIMUM)]


def _starts(points: Array, rays: Array, extent: Extent) -> Iterator[Pose]:
    flatness = extent.spread[2] / extent.spread[0]
    if flatness < _NEAR_PLANE:
        yield pose_of_plane(rays, points, extent)
    if flatness > _IN_PLANE:
        yield from poses_from_all(rays, points)
        yield from poses_from_afar(rays, points) if len(points) <= _FEW else [pose_from_matrix(rays, points)]
    if len(points) <= _FEW:
        yield from poses_from_triplets(rays, points)


def _refined(problem: PoseProblem, camera_T_object: Pose) -> Solution[Pose] | None:
    """Return the minimum a start leads to, or None if that leaves points outside the lens's domain."""
    inside = np.isfinite(problem.squared(camera_T_object))
    if not inside.all():
        if inside.sum() < MIN_POINTS:
            return None
        camera_T_object = minimise(problem.take(inside), camera_T_object).state
        if not np.isfinite(problem.squared(camera_T_object)).all():
            return None
    solution = minimise(problem, camera_T_object)
    if solution.cost < len(problem.points) * ROUNDING**2:
        return replace(solution, converged=True, reason="the points are met exactly")
    return solution


def _distinct(poses: Sequence[Pose], tolerance: float) -> list[int]:
    """Return the indices of the poses that no earlier one is near to, by angle (rad) and by share of the distance."""
    kept: list[int] = []
    for index, pose in enumerate(poses):
        if not any(_near(poses[other], pose, tolerance) for other in kept):
            kept.append(index)
    return kept


def _near(first: Pose, second: Pose, tolerance: float) -> bool:
    angle = np.linalg.norm(so3.log(first.rotation @ second.rotation.T))
    shift = np.linalg.norm(first.translation - second.translation)
    return bool(angle < tolerance and shift < tolerance * np.linalg.norm(first.translation))
