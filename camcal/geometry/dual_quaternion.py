"""Unit dual quaternions: a rotation and a translation in eight numbers, q + ε ½ t q.

Source: Kavan, Collins, Žára, O'Sullivan, Geometric Skinning with Approximate Dual Quaternion Blending, 2008.
"""

import numpy as np

from camcal.arrays import Array
from camcal.geometry import rotation as so3


def to_dual_quaternion(rotation: Array, translation: Array) -> Array:
    """Return the dual quaternions (..., 8) of poses: the rotation's w x y z with w ≥ 0, then the dual part's.

    rotation: (..., 3, 3). translation: (..., 3), the dual part has half its unit.
    """
    real = so3.to_quaternion(rotation)
    return np.concatenate([real, 0.5 * _product(_pure(translation), real)], axis=-1)


def from_dual_quaternion(dual: Array) -> tuple[Array, Array]:
    """Return the rotations (..., 3, 3) and translations (..., 3) of dual quaternions (..., 8) of any length but zero.

    What of the dual part lies along the real one is no motion and is left out.
    """
    dual = np.asarray(dual, dtype=float)
    length = np.linalg.norm(dual[..., :4], axis=-1, keepdims=True)
    real, moved = dual[..., :4] / length, dual[..., 4:] / length
    return so3.from_quaternion(real), 2 * _product(moved, _conjugate(real))[..., 1:]


def dual_quaternion_error(dual: Array) -> Array:
    """Return how far the parts of dual quaternions (..., 8) are from at right angles: 0 for a motion."""
    real, moved = dual[..., :4], dual[..., 4:]
    return np.asarray(np.abs(np.sum(real * moved, axis=-1)))


def _pure(vector: Array) -> Array:
    vector = np.asarray(vector, dtype=float)
    return np.concatenate([np.zeros((*vector.shape[:-1], 1)), vector], axis=-1)


def _conjugate(quaternion: Array) -> Array:
    return np.asarray(quaternion * np.array([1.0, -1, -1, -1]))


def _product(left: Array, right: Array) -> Array:
    """Return the Hamilton products (..., 4) of quaternions w x y z."""
    scalar = left[..., :1] * right[..., :1] - np.sum(left[..., 1:] * right[..., 1:], axis=-1, keepdims=True)
    vector = left[..., :1] * right[..., 1:] + right[..., :1] * left[..., 1:] + np.cross(left[..., 1:], right[..., 1:])
    return np.concatenate([scalar, vector], axis=-1)
