"""Epipolar error of a calibrated rig at the corners that two cameras saw."""

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.noise import REJECTED
from camcal.calibrate.problem import POSE
from camcal.calibrate.rigs.problem import RigProblem, RigState
from camcal.solve.steps import Step

_LEAST = 1e-30  # of squares, px²: exact corners


def epipolar_by_capture(problem: RigProblem, state: RigState) -> tuple[Array, Array]:
    """Return the sums of squares (G,), px², and the numbers (G,) of the epipolar errors of corners that two cameras saw
    in each capture.

    The error of two rays is f Δφ sin θ: φ the angle of a ray about the baseline, θ that between the first ray and the
    baseline, f the focal length of the first camera. In a rectified pair it is the difference of rows.
    """
    squares, counts = np.zeros(problem.count), np.zeros(problem.count, np.intp)
    for captures, errors in _of_pairs(problem, state):
        known = np.isfinite(errors)
        squares += np.bincount(captures[known], errors[known] ** 2, problem.count)
        counts += np.bincount(captures[known], minlength=problem.count)
    return squares, counts


def between_captures(problem: RigProblem, state: RigState) -> float:
    """Return how much epipolar errors differ between captures over how much within them: the RMS of their medians over
    that of the errors about these; the largest of all pairs of cameras, 0 without any.
    """
    largest = 0.0
    for captures, errors in _of_pairs(problem, state):
        known = np.isfinite(errors)
        groups = [errors[known & (captures == capture)] for capture in np.unique(captures[known])]
        medians = np.array([np.median(own) for own in groups])
        within = np.concatenate([own - median for own, median in zip(groups, medians, strict=True)])
        largest = max(largest, float(np.sqrt(np.mean(medians**2) / max(np.mean(within**2), _LEAST))))
    return largest


def left_out_errors(problem: RigProblem, state: RigState, left_out: Array) -> tuple[Array, Array]:
    """Return the captures (n,) of corners that two cameras saw, and their epipolar errors (n,), px, by what all other
    captures say of lenses and poses of cameras; NaN where a lens has no ray.

    left_out: (G, D) changes of the shared parameters before the offsets when each of the captures is left out.
    """
    result = []
    for capture, change in enumerate(left_out):
        shared = np.zeros(problem.shared)
        shared[: len(change)] = change
        others = problem.retract(state.take(np.zeros(0, np.intp)), Step(shared, np.zeros((0, POSE))))
        result += list(_of_pairs(problem, others, capture))
    if not result:
        return np.zeros(0, np.intp), np.zeros(0)
    captures, errors = zip(*result, strict=True)
    return np.concatenate(captures), np.concatenate(errors)


def _of_pairs(problem: RigProblem, state: RigState, capture: int | None = None) -> Iterator[tuple[Array, Array]]:
    """Yield of each pair of cameras the captures (n,) of the corners that both saw, and their errors (n,), px, NaN
    where a lens has no ray; of one capture or of all.
    """
    rays = [_rays(problem, state, camera, capture) for camera in range(len(problem.parts))]
    for a, b in combinations(range(len(rays)), 2):
        common, of_a, of_b = np.intersect1d(rays[a][0], rays[b][0], return_indices=True)
        if not len(common):
            continue
        rotation = state.camera_rotations[b] @ state.camera_rotations[a].T
        translation = state.camera_translations[b] - rotation @ state.camera_translations[a]
        errors = epipolar_errors(rays[a][1][of_a], rays[b][1][of_b], rotation, translation)
        yield common // problem.board.count, float(state.lenses[a][0]) * errors


def epipolar_errors(rays_a: Array, rays_b: Array, rotation: Array, translation: Array) -> Array:
    """Return Δφ sin θ (n,), rad, of unit rays (n, 3) of a and b; rotation, translation: b_T_a."""
    baseline = -rotation.T @ translation  # from a to b, in a
    baseline = baseline / np.linalg.norm(baseline)
    one, other = np.cross(baseline, rays_a), np.cross(baseline, rays_b @ rotation)
    angle = np.arctan2(np.cross(one, other) @ baseline, np.sum(one * other, axis=1))
    return np.asarray(angle * np.linalg.norm(one, axis=1))


def _rays(problem: RigProblem, state: RigState, camera: int, capture: int | None) -> tuple[Array, Array]:
    """Return numbers (n,) of capture and corner of what a camera saw and counts, and unit rays (n, 3), NaN without."""
    part, captures = problem.parts[camera], problem.captures[camera]
    rows = slice(None) if capture is None else captures == capture
    table, captures = part.observations, captures[rows]
    rays = part.model.unproject(state.lenses[camera], table.pixels[:, rows].reshape(2, -1).T)
    counts = table.weights[rows].ravel() >= REJECTED
    numbers = captures[:, None] * part.board.count + table.ids[rows]
    return numbers.ravel()[counts], rays.directions[counts]
