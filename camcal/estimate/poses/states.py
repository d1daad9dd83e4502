"""Poses as an array of states (S, 3, 4), each [R t], for the solver of many problems; how points spread.

The spread says which other pose a plane is mistaken for.
"""

from collections.abc import Sequence

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.geometry import pose as se3
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose

IN_PLANE = 1e-4  # third spread over the first: below, points count as a plane
NEAR_PLANE = 0.1  # below, a plane's second pose may be near a minimum too
_IDENTITY = np.eye(3)
_SMALL = 1e-6  # rad², below which the series is used
_NEAR_HALF_TURN = -0.9  # cosine of an angle; there the sine says little


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


def steps_from(
    rotations: Array, translations: Array, middle_rotations: Array, middle_translations: Array
) -> tuple[Array, Array]:
    """Return the steps (..., 6) from middles to poses and how they change (..., 6, 6) with a step of the pose."""
    turn = rotation_vectors(rotations @ middle_rotations.swapaxes(-1, -2))
    square = np.einsum("...i,...i->...", turn, turn)
    half = np.sqrt(np.maximum(square, _SMALL)) / 2
    factor = np.where(square < _SMALL, 1 / 12, (1 - half / np.tan(half)) / (4 * half**2))
    skew = so3.hat(turn)
    slope = np.zeros((*turn.shape[:-1], 6, 6))
    slope[..., :3, :3] = _IDENTITY
    # The inverse of the left Jacobian: Log(Exp(δ) Exp(v)) ≈ v + J⁻¹ δ.
    slope[..., 3:, 3:] = _IDENTITY - skew / 2 + factor[..., None, None] * (skew @ skew)
    return np.concatenate([translations - middle_translations, turn], axis=-1), slope


def rotation_vectors(rotations: Array) -> Array:
    """Return what so3.log returns for rotations (..., 3, 3), in less time where none is near a half turn."""
    flat = rotations.reshape(*rotations.shape[:-2], 9)
    axes = (flat[..., [7, 2, 3]] - flat[..., [5, 6, 1]]) / 2
    sine = np.sqrt(np.einsum("...i,...i->...", axes, axes))
    cosine = (flat[..., 0] + flat[..., 4] + flat[..., 8] - 1) / 2
    if (cosine < _NEAR_HALF_TURN).any():
        return so3.log(rotations)
    small = sine < so3.SERIES_ANGLE
    scale = np.where(small, 1 + sine**2 / 6, np.arctan2(sine, cosine) / np.where(small, 1.0, sine))
    return np.asarray(scale[..., None] * axes)


@dataclass(frozen=True, eq=False)
class Extents:
    """How the points of W views spread: plane_T_object (W, 3, 4) takes their mean to the origin and their best plane
    to z = 0; spread (W, 3) are the root sums of squares along x, y and z there, largest first.
    """

    plane_T_object: Array
    spread: Array

    @classmethod
    def of(cls, points: Array, mask: Array) -> "Extents":
        """Return the extents of points (3, W, N) where the mask (W, N) is True."""
        count = np.maximum(mask.sum(axis=1), 1)
        centre = np.where(mask, points, 0.0).sum(axis=2) / count
        offsets = np.where(mask, points - centre[:, :, None], 0.0).transpose(1, 0, 2)
        values, axes = np.linalg.eigh(offsets @ offsets.transpose(0, 2, 1))
        rotation = axes[:, :, ::-1].transpose(0, 2, 1).copy()
        rotation[:, 2] *= np.linalg.det(rotation)[:, None]
        spread = np.sqrt(np.maximum(values[:, ::-1], 0.0))
        return cls(stacked(rotation, -np.einsum("wij,jw->wi", rotation, centre)), spread)

    def take(self, chosen: Array) -> "Extents":
        """Return the extents of some of the views."""
        return Extents(self.plane_T_object[chosen], self.spread[chosen])

    @property
    def flatness(self) -> Array:
        """The third spread over the first (W,), 0 for a plane."""
        return np.asarray(self.spread[:, 2] / np.maximum(self.spread[:, 0], np.finfo(float).tiny))

    @property
    def narrowness(self) -> Array:
        """The second spread over the first (W,), 0 for a line."""
        return np.asarray(self.spread[:, 1] / np.maximum(self.spread[:, 0], np.finfo(float).tiny))

    def in_plane(self, points: Array) -> Array:
        """Return points (3, W, N) in the frames of the planes."""
        moved = self.plane_T_object[:, :, :3] @ points.transpose(1, 0, 2) + self.plane_T_object[:, :, 3:]
        return np.ascontiguousarray(moved.transpose(1, 0, 2))

    def sight_and_normal(self, states: Array, view: Array, eye: Array) -> tuple[Array, Array]:
        """Return the vectors (S, 3) from the eye (3,) to the middle of the points, and the planes' unit normals (S, 3),
        at states (S, 3, 4), frame_T_object, of the views (S,).
        """
        frame_T_plane = compose(states, inverse(self.plane_T_object[view]))
        return frame_T_plane[:, :, 3] - eye, frame_T_plane[:, :, 2]

    def reflected(self, states: Array, view: Array, eye: Array) -> Array:
        """Return states (S, 3, 4) with the planes' normals reflected about the lines of sight from the eye (3,).

        Seen from afar both poses show the same image; near by, the other minimum of the error lies close to it.
        Source: Oberkampf, DeMenthon & Davis, Iterative Pose Estimation Using Coplanar Feature Points, 1996.
        """
        packed, _ = self.sight_and_normal(states, view, eye)
        middle = packed + eye
        in_object = self.plane_T_object[view, 2, :3]
        line = packed / np.linalg.norm(packed, axis=1, keepdims=True)
        rotation = _mirrors(line) @ states[:, :, :3] @ _mirrors(in_object)
        centre = inverse(self.plane_T_object[view])[:, :, 3]
        return stacked(rotation, middle - np.einsum("sij,sj->si", rotation, centre))

    def tilt(self, states: Array, view: Array, eye: Array) -> Array:
        """Return the angles (S,), rad, between the lines of sight and the planes' normals, at most π/2."""
        packed, normal = self.sight_and_normal(states, view, eye)
        across = np.linalg.norm((so3.hat(packed) @ normal[..., None])[..., 0], axis=1)
        return np.asarray(np.arctan2(across, np.abs(np.einsum("si,si->s", packed, normal))))


def _mirrors(normals: Array) -> Array:
    """Return the reflections (S, 3, 3) at the planes through the origin with unit normals (S, 3)."""
    return np.asarray(_IDENTITY - 2 * normals[:, :, None] * normals[:, None, :])
