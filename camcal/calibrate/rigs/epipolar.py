"""Epipolar error of a calibrated rig at the corners that two cameras saw."""

from itertools import combinations

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.noise import REJECTED
from camcal.calibrate.rigs.fit import RigFit


def epipolar_by_capture(result: RigFit, captures: int) -> tuple[Array, Array]:
    """Return the sums of squares (C,), px², and the numbers (C,) of the epipolar errors of corners that two cameras saw
    in each of `captures` captures.

    The error of two rays is f Δφ sin θ: φ the angle of a ray about the baseline, θ that between the first ray and the
    baseline, f the focal length of the first camera. In a rectified pair it is the difference of rows.
    """
    rays = [_rays(result, camera) for camera in range(len(result.plain.parts))]
    squares, counts = np.zeros(captures), np.zeros(captures, np.intp)
    for a, b in combinations(range(len(rays)), 2):
        common, of_a, of_b = np.intersect1d(rays[a][0], rays[b][0], return_indices=True)
        state = result.state
        rotation = state.camera_rotations[b] @ state.camera_rotations[a].T
        translation = state.camera_translations[b] - rotation @ state.camera_translations[a]
        errors = epipolar_errors(rays[a][1][of_a], rays[b][1][of_b], rotation, translation)
        focal = float(state.lenses[a][0])
        capture = common // result.problem.board.count
        squares += np.bincount(capture, (focal * errors) ** 2, captures)
        counts += np.bincount(capture, minlength=captures)
    return squares, counts


def epipolar_errors(rays_a: Array, rays_b: Array, rotation: Array, translation: Array) -> Array:
    """Return Δφ sin θ (n,), rad, of unit rays (n, 3) of a and b; rotation, translation: b_T_a."""
    baseline = -rotation.T @ translation  # from a to b, in a
    baseline = baseline / np.linalg.norm(baseline)
    one, other = np.cross(baseline, rays_a), np.cross(baseline, rays_b @ rotation)
    angle = np.arctan2(np.cross(one, other) @ baseline, np.sum(one * other, axis=1))
    return np.asarray(angle * np.linalg.norm(one, axis=1))


def _rays(result: RigFit, camera: int) -> tuple[Array, Array]:
    """Return numbers (n,) of capture and corner of what a camera saw and counts, and the unit rays (n, 3)."""
    part, lens = result.plain.parts[camera].problem, result.state.lenses[camera]
    table = part.observations
    rays = part.model.unproject(lens, table.pixels.reshape(2, -1).T)
    counts = (table.weights.ravel() >= REJECTED) & rays.valid
    numbers = result.problem.captures[camera][:, None] * part.board.count + table.ids
    return numbers.ravel()[counts], rays.directions[counts]
