"""Poses as an array of states (S, 3, 4), each [R t], for the solver of many problems."""

from collections.abc import Sequence

import numpy as np

from camcal.arrays import Array
from camcal.geometry import pose as se3
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose


def stacked(rotations: Array, translations: Array) -> Array:
    """Return the states of rotations (S, 3, 3) and translations (S, 3)."""
    return np.concatenate([rotations, translations[..., None]], axis=-1)


def of_poses(poses: Sequence[Pose]) -> Array:
    """Return the states of poses."""
    return np.array([pose.matrix()[:3] for pose in poses]).reshape(-1, 3, 4)


def retract(states: Array, steps: Array) -> Array:
    """Return the states moved by steps (S, 6)."""
    return stacked(*se3.retract(states[:, :, :3], states[:, :, 3], steps))


def compose(first: Array, second: Array) -> Array:
    """Return a_T_c of states a_T_b (..., 3, 4) and b_T_c (..., 3, 4)."""
    rotation = first[..., :3]
    moved = (rotation @ second[..., 3:])[..., 0] + first[..., 3]
    return stacked(rotation @ second[..., :3], moved)


def inverse(states: Array) -> Array:
    """Return b_T_a (..., 3, 4) of a_T_b."""
    rotation = np.swapaxes(states[..., :3], -1, -2)
    return stacked(rotation, -(rotation @ states[..., 3:])[..., 0])


def shifted(states: Array, offsets: Array) -> Array:
    """Return a_T_c of states a_T_b, where c has the axes of b and its origin at offsets (S, 3)."""
    return stacked(states[..., :3], states[..., 3] + (states[..., :3] @ offsets[..., None])[..., 0])


def shift_jacobians(states: Array, offsets: Array) -> Array:
    """Return d(step of a_T_c)/d(step of a_T_b) as (S, 6, 6), for states a_T_b and a shift of their origin."""
    result = np.zeros((len(states), 6, 6))
    result[:] = np.eye(6)
    result[:, :3, 3:] = -so3.hat((states[:, :, :3] @ offsets[..., None])[..., 0])
    return result


def near(first: Array, second: Array, tolerance: Array | float) -> Array:
    """Return the mask (...) of pairs that agree to an angle (rad) and to a share of the distance."""
    # ‖R1 - R2‖ = 2 √2 sin(angle/2)
    apart = np.sum((first - second) ** 2, axis=-2)
    turn, shift, distance = apart[..., :3].sum(axis=-1) / 2, apart[..., 3], np.sum(first[..., 3] ** 2, axis=-1)
    return np.asarray((turn < tolerance**2) & (shift <= tolerance**2 * distance))
