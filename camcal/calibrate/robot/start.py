"""Closed forms of hand and eye from pairs of poses: where an estimate starts, and by which ways to read them are told.

Of world_T_carrier (the robot's) and camera_T_board of the same moments, world_T_carrier · carrier_T_camera ·
camera_T_board = world_T_board for all of them. The motions between two moments, A of the carrier and B of the camera,
are conjugate, A X = X B: turned by the same angle, about axes that X takes into each other (Park & Martin, IEEE
Transactions on Robotics and Automation, 1994). All steps are reweighted, so that a few wrong poses do not matter.
"""

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose

_MOST_PAIRS = 4000
_LEAST_TURN = 0.0524  # rad, of a pair whose axis counts
_ROUNDS = 20
_SCALE = 1.4826  # of a median, to a standard deviation
_REACH = 2.0  # standard deviations at which a Cauchy weight has fallen to a half
_FLOOR = 1e-9


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses (N,) as rotations (N, 3, 3) and translations (N, 3)."""

    rotations: Array
    translations: Array

    def inverse(self) -> "Poses":
        """Return the inverses."""
        back = self.rotations.transpose(0, 2, 1)
        return Poses(back, -(back @ self.translations[..., None])[..., 0])

    def __matmul__(self, other: "Poses") -> "Poses":
        """Return the poses a_T_c from a_T_b @ b_T_c."""
        moved = (self.rotations @ other.translations[..., None])[..., 0] + self.translations
        return Poses(self.rotations @ other.rotations, moved)

    def take(self, rows: Array) -> "Poses":
        """Return some of the poses."""
        return Poses(self.rotations[rows], self.translations[rows])


@dataclass(frozen=True, eq=False)
class HandEye:
    """A closed form: carrier_T_camera, world_T_board, and of every pose how far world_T_carrier is from what these say,
    m and rad (N,). boards: (N, 3) where each pose says that the board is. reach: m, RMS of what the poses move by.
    """

    carrier_T_camera: Pose
    world_T_board: Pose
    shifts: Array
    turns: Array
    boards: Array
    reach: float

    @property
    def score(self) -> float:
        """How badly poses fit: the median distance and angle, the distance as a share of what the poses move by."""
        return float(np.median(self.shifts) / self.reach + np.median(self.turns))


def pairs_of(count: int) -> tuple[Array, Array]:
    """Return the places (P,), (P,) of pairs of poses: all of them, or as many as are worth their time."""
    first, second = np.triu_indices(count, 1)
    step = max(1, len(first) // _MOST_PAIRS)
    return first[::step], second[::step]


def motions(poses: Poses, pairs: tuple[Array, Array]) -> Poses:
    """Return the motions (P,) poses[i]⁻¹ poses[j] of pairs i, j."""
    first, second = pairs
    return poses.take(first).inverse() @ poses.take(second)


def turn_angles(poses: Poses) -> Array:
    """Return the angles (P,) rad by which poses turn between two moments: the same for both directions of poses."""
    return np.asarray(np.linalg.norm(so3.log(motions(poses, pairs_of(len(poses.rotations))).rotations), axis=1))


def angle_mismatch(robot: Poses, camera: Poses) -> float:
    """Return the median difference (rad) of the angles by which carrier and camera turn between two moments.

    The same for both directions of the robot's poses, whatever hand and eye are. camera: camera_T_board.
    """
    return float(np.median(np.abs(turn_angles(robot) - turn_angles(camera.inverse()))))


def closed_form(robot: Poses, camera: Poses) -> HandEye:
    """Return hand and eye of world_T_carrier and camera_T_board of the same moments."""
    pairs = pairs_of(len(robot.rotations))
    hand, eye = motions(robot, pairs), motions(camera.inverse(), pairs)
    rotation = _rotation(so3.log(hand.rotations), so3.log(eye.rotations))
    # (R_A - 1) t_X = R_X t_B - t_A
    matrices = hand.rotations - np.eye(3)
    targets = eye.translations @ rotation.T - hand.translations
    translation = _solve(matrices, targets)
    X = Pose(rotation, translation)
    moved = Poses(rotation[None], translation[None])
    board = robot @ moved @ camera
    Z = centre(board)
    predicted = Poses(Z.rotation[None], Z.translation[None]) @ (moved @ camera).inverse()
    shifts = np.linalg.norm(predicted.translations - robot.translations, axis=1)
    turned = robot.rotations.transpose(0, 2, 1) @ predicted.rotations
    spread = robot.translations - np.median(robot.translations, axis=0)
    reach = float(np.sqrt(np.mean(np.sum(spread**2, axis=1)))) or 1.0
    return HandEye(X, Z, shifts, np.linalg.norm(so3.log(turned), axis=1), board.translations, reach)


def _rotation(hand: Array, eye: Array) -> Array:
    """Return the rotation (3, 3) that takes rotation vectors (P, 3) of the camera's motions to those of the carrier."""
    usable = np.minimum(np.linalg.norm(hand, axis=1), np.linalg.norm(eye, axis=1)) > _LEAST_TURN
    hand, eye = (each[usable] if usable.sum() > 3 else each for each in (hand, eye))
    weights = np.ones(len(hand))
    rotation = np.eye(3)
    for _ in range(_ROUNDS):
        left, _, right = np.linalg.svd((hand * weights[:, None]).T @ eye)
        rotation = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
        weights = _weights(np.linalg.norm(hand - eye @ rotation.T, axis=1))
    return so3.nearest(rotation)


def _solve(matrices: Array, targets: Array) -> Array:
    """Return the t (3,) with matrices (P, 3, 3) t = targets (P, 3), as nearly as most of them can have it."""
    weights, found = np.ones(len(matrices)), np.zeros(3)
    for _ in range(_ROUNDS):
        root = np.sqrt(weights)[:, None, None]
        found = np.linalg.lstsq((root * matrices).reshape(-1, 3), (root[..., 0] * targets).ravel(), rcond=1e-9)[0]
        weights = _weights(np.linalg.norm(matrices @ found - targets, axis=1))
    return np.asarray(found)


def centre(poses: Poses) -> Pose:
    """Return the pose that most of some poses are near."""
    rotation, translation = poses.rotations[0], np.median(poses.translations, axis=0)
    weights = np.ones(len(poses.rotations))
    for _ in range(_ROUNDS):
        rotation = so3.nearest(np.einsum("n,nij->ij", weights, poses.rotations))
        translation = weights @ poses.translations / weights.sum()
        apart = np.linalg.norm(so3.log(rotation.T @ poses.rotations), axis=1)
        away = np.linalg.norm(poses.translations - translation, axis=1)
        weights = np.minimum(_weights(apart), _weights(away))
    return Pose(rotation, translation)


def _weights(residuals: Array) -> Array:
    """Return the Cauchy weights (P,) of residuals (P,), whose scale is their median."""
    scale = max(_SCALE * float(np.median(residuals)), _FLOOR)
    return np.asarray(1.0 / (1.0 + (residuals / (_REACH * scale)) ** 2))
