"""Homographies: maps from plane to plane that keep straight lines straight, as (3, 3) matrices up to their scale."""

import numpy as np

from camcal.arrays import Array

_LEAST_SIZE = 1e-12  # of points that lie in one place, so that nothing is divided by 0


def apply_homography(homography: Array, points: Array) -> Array:
    """Return where a homography (3, 3) takes points (N, 2)."""
    moved = points @ homography[:, :2].T + homography[:, 2]
    return np.asarray(moved[:, :2] / moved[:, 2:])


def homography_of(points: Array, seen: Array) -> Array:
    """Return the homography (3, 3) of least algebraic error from points (N, 2) to where they are seen (N, 2).

    N is 4 or more; its last entry is 1.
    Source: Hartley, In Defense of the Eight-Point Algorithm, 1997 (why both are normalised).
    """
    onto, back = _normalising(points), _normalising(seen)
    (x, y), (u, v) = apply_homography(onto, points).T, apply_homography(back, seen).T
    one, zero = np.ones_like(x), np.zeros_like(x)
    upper = np.stack([x, y, one, zero, zero, zero, -u * x, -u * y, -u], axis=1)
    lower = np.stack([zero, zero, zero, x, y, one, -v * x, -v * y, -v], axis=1)
    design = np.concatenate([upper, lower])
    entries = np.linalg.eigh(design.T @ design)[1][:, 0]
    result = np.linalg.inv(back) @ entries.reshape(3, 3) @ onto
    return np.asarray(result / result[2, 2])


def _normalising(points: Array) -> Array:
    """Return the similarity (3, 3) that brings points (N, 2) around the origin and to unit size."""
    middle = points.mean(axis=0)
    scale = 1 / max(float(np.abs(points - middle).mean()), _LEAST_SIZE)
    return np.array([[scale, 0, -scale * middle[0]], [0, scale, -scale * middle[1]], [0, 0, 1]])
