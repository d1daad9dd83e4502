"""Epipolar error of a calibrated rig at the corners that two cameras saw."""

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.noise import REJECTED
from camcal.calibrate.rigs.problem import RigProblem, RigState

_LEAST = 1e-30  # of squares, px²: exact corners


def epipolar_by_capture(problem: RigProblem, state: RigState) -> tuple[Array, Array]:
    """Return the sums of squares (G,), px², and the numbers (G,) of the epipolar errors of corners that two cameras saw
    in each capture.

    The error of two rays is f Δφ sin θ: φ the angle of a ray about the baseline, θ that between the first ray and the
    baseline, f the focal length of the first camera. In a rectified pair it is the difference of rows.
    """
    squares, counts = np.zeros(problem.count), np.zeros(problem.count, np.intp)
    for captures, errors in _of_pairs(problem, state):
        squares += np.bincount(captures, errors**2, problem.count)
        counts += np.bincount(captures, minlength=problem.count)
    return squares, counts


def between_captures(problem: RigProblem, state: RigState) -> float:
    """Return how much epipolar errors differ between captures over how much within them: the RMS of their medians over
    that of the errors about these; the largest of all pairs of cameras, 0 without any.
    """
    largest = 0.0
    for captures, errors in _of_pairs(problem, state):
        groups = [errors[captures == capture] for capture in np.unique(captures)]
        medians = np.array([np.median(own) for own in groups])
        within = np.concatenate([own - median for own, median in zip(groups, medians, strict=True)])
        largest = max(largest, float(np.sqrt(np.mean(medians**2) / max(np.mean(within**2), _LEAST))))
    return largest


def _of_pairs(problem: RigProblem, state: RigState) -> Iterator[tuple[Array, Array]]:
    """Yield of each pair of cameras the captures (n,) of the corners that both saw, and their errors (n,), px."""
    rays = [_rays(problem, state, camera) for camera in range(len(problem.parts))]
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


def _rays(problem: RigProblem, state: RigState, camera: int) -> tuple[Array, Array]:
    """Return numbers (n,) of capture and corner of what a camera saw and counts, and the unit rays (n, 3)."""
    part = problem.parts[camera]
    table = part.observations
    rays = part.model.unproject(state.lenses[camera], table.pixels.reshape(2, -1).T)
    counts = (table.weights.ravel() >= REJECTED) & rays.valid
    numbers = problem.captures[camera][:, None] * problem.board.count + table.ids
    return numbers.ravel()[counts], rays.directions[counts]
