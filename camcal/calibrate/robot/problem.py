"""A rig and a robot as one least-squares problem, and the closed forms of hand and eye where it starts.

Of world_T_carrier (the robot's) and camera_T_board of the same moments, world_T_carrier · carrier_T_camera ·
camera_T_board = world_T_board for all of them. The motions between two moments, A of the carrier and B of the camera,
are conjugate, A X = X B: turned by the same angle, about axes that X takes into each other (Park & Martin, IEEE
Transactions on Robotics and Automation, 1994). All steps are reweighted, so that a few wrong poses do not matter. By
which ways to read them the closed forms explain the poses tells how they are to be read.

The problem is of corners in pixels, and of the robot's poses in metres and radians.
Shared parameters: those of the rig, then carrier_T_rig and world_T_board (tx ty tz rx ry rz each), then what is
systematically wrong with the robot's poses. The groups are the captures' poses rig_T_board. The carrier is what the
robot's poses place in the world: the hand, with a board that stands still; or, with a board in the hand, the base as
the hand sees it. In the place of a rig's corners there may be poses of the board that somebody else has measured.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.problem import POSE
from camcal.dataclass import dataclass, field, replace
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose, retract
from camcal.solve.least_squares import Problem
from camcal.solve.steps import Block, Jacobian, Step

_MOST_PAIRS = 4000
_LEAST_TURN = 0.0524  # rad, of a pair whose axis counts
_ROUNDS = 20
_SCALE = 1.4826  # of a median, to a standard deviation
_REACH = 2.0  # standard deviations at which a Cauchy weight has fallen to a half
_FLOOR = 1e-9

OWN = 2 * POSE  # parameters of the two poses
SYSTEMATIC = ("scale", "delay")
LEAST_STD = 1e-6  # m and rad, of a pose that was measured


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


@dataclass(frozen=True, eq=False)
class SeenPoses:
    """Poses rig_T_board (N,) that were measured, as a problem of captures without shared parameters.

    covariances: (N, 6, 6) of their steps, or None: the noise of their rotations is estimated, turn_std (rad), and that
    of their translations counts as the robot's, from which it cannot be told.
    """

    measured: Poses
    covariances: Array | None
    turn_std: float = 1e-3
    shared = 0

    @property
    def groups(self) -> tuple[int, int]:
        return len(self.measured.rotations), POSE

    def retract(self, state: Poses, step: Step) -> Poses:
        """Return the state moved by a step."""
        return Poses(*retract(state.rotations, state.translations, step.groups[:, :POSE]))

    def blocks(self, state: Poses) -> list[Block]:
        """Return the measured poses, in standard deviations."""
        residuals, derivatives = self.rows(state)
        if self.covariances is None:
            roots = np.diag(np.repeat([1 / LEAST_STD, 1 / self.turn_std], 3))[None]
        else:
            roots = np.linalg.inv(np.linalg.cholesky(self.covariances + np.eye(POSE) * LEAST_STD**2))
        whitened = (roots @ residuals[..., None])[..., 0]
        return [Block(whitened, group=roots @ derivatives, rows_per_group=1)]

    def rows(self, state: Poses) -> tuple[Array, Array]:
        """Return the steps (N, 6) from the measured poses to a state, and their derivatives (N, 6, 6) by its own."""
        turned = so3.log(state.rotations @ self.measured.rotations.transpose(0, 2, 1))
        derivatives = np.tile(np.eye(POSE), (len(turned), 1, 1))
        derivatives[:, 3:, 3:] = np.linalg.inv(so3.exp_jacobian(turned))
        return np.concatenate([state.translations - self.measured.translations, turned], axis=1), derivatives


@dataclass(frozen=True, eq=False)
class RobotState:
    """The state of a rig, a RigState or Poses; fixed: carrier_T_rig and world_T_board, as Poses of two. systematic:
    (2,) by how much of itself a length is longer than the robot says, and by how many s its poses are late.
    """

    rig: Any
    fixed: Poses
    systematic: Array = field(default_factory=lambda: np.zeros(len(SYSTEMATIC)))


@dataclass(frozen=True, eq=False)
class RobotPoses:
    """What a robot says of captures.

    base_T_hand: (N,) of the `captures` (N,). in_hand: whether the camera is, and not the board. sigmas: m and rad.
    weights: (N,). velocities: (N, 6) of the hand, m/s in the base and rad/s in its own frame, where times are known.
    """

    base_T_hand: Poses
    captures: Array
    in_hand: bool
    sigmas: tuple[float, float]
    weights: Array
    velocities: Array | None = None

    @property
    def world_T_carrier(self) -> Poses:  # noqa: N802 - a_T_b
        """The poses of what carries the camera in what the board stands still in."""
        return self.base_T_hand if self.in_hand else self.base_T_hand.inverse()


@dataclass(frozen=True, eq=False)
class RobotProblem:
    """The least-squares problem. rig: a RigProblem or SeenPoses. free: the places in SYSTEMATIC of what is free."""

    rig: Problem[Any]
    robot: RobotPoses
    free: tuple[int, ...] = ()

    @property
    def own(self) -> int:
        """The number of shared parameters that are not the rig's."""
        return OWN + len(self.free)

    @property
    def shared(self) -> int:
        return self.rig.shared + self.own

    @property
    def groups(self) -> tuple[int, int]:
        return self.rig.groups

    def retract(self, state: RobotState, step: Step) -> RobotState:
        """Return the state moved by a step."""
        rig = self.rig.retract(state.rig, replace(step, shared=step.shared[: self.rig.shared]))
        own = step.shared[self.rig.shared : self.rig.shared + OWN].reshape(2, POSE)
        systematic = state.systematic.copy()
        systematic[list(self.free)] += step.shared[self.rig.shared + OWN :]
        return RobotState(rig, Poses(*retract(state.fixed.rotations, state.fixed.translations, own)), systematic)

    def blocks(self, state: RobotState) -> Sequence[Block] | None:
        """Return the observations, the robot's poses and the priors, or None where a point has no image."""
        found = self.rig.blocks(state.rig)
        return None if found is None else [*found, *self.robot_blocks(state)]

    def robot_blocks(self, state: RobotState) -> list[Block]:
        """Return the robot's poses as blocks, of translations and of rotations."""
        residuals, by_fixed, by_group = self.robot_rows(state)
        columns = np.arange(self.rig.shared, self.shared)
        return [
            Block(
                residuals[:, rows],
                (Jacobian(by_fixed[:, rows], columns),),
                by_group[:, rows],
                rows_per_group=1,
                groups=self.robot.captures,
                weights=self.robot.weights / sigma**2,
            )
            for rows, sigma in zip((slice(0, 3), slice(3, 6)), self.robot.sigmas, strict=True)
        ]

    def robot_rows(self, state: RobotState) -> tuple[Array, Array, Array]:
        """Return what the state says of base_T_hand less what the robot says (N, 6), m and rad, and its derivatives by
        the `own` shared parameters (N, 6, own) and by the captures' poses (N, 6, 6).
        """
        captures = self.robot.captures
        rig_T_board = Poses(state.rig.rotations[captures], state.rig.translations[captures])
        carrier, world = state.fixed.take(np.array([0])), state.fixed.take(np.array([1]))
        seen = carrier @ rig_T_board  # carrier_T_board
        back = seen.inverse()
        found = world @ back  # world_T_carrier
        by_seen = by_factors(world, back)[1] @ by_inverse(seen)
        by_carrier, by_group = (by_seen @ own for own in by_factors(carrier, rig_T_board))
        derivatives = np.concatenate([by_carrier, by_factors(world, back)[0], by_group], axis=2)
        if not self.robot.in_hand:
            derivatives = by_inverse(found) @ derivatives
            found = found.inverse()
        known, (scale, delay) = self.robot.base_T_hand, state.systematic
        speeds = np.zeros((len(captures), POSE)) if self.robot.velocities is None else self.robot.velocities
        places = known.translations + delay * speeds[:, :3]
        rotations = known.rotations @ so3.exp(delay * speeds[:, 3:])
        turned = so3.log(rotations.transpose(0, 2, 1) @ found.rotations)
        derivatives[:, 3:] = (
            np.linalg.inv(so3.exp_jacobian(-turned)) @ found.rotations.transpose(0, 2, 1) @ derivatives[:, 3:]
        )
        systematic = np.zeros((len(captures), POSE, len(SYSTEMATIC)))
        systematic[:, :3, 0], systematic[:, :3, 1] = -places, -(1 + scale) * speeds[:, :3]
        systematic[:, 3:, 1] = -np.linalg.solve(so3.exp_jacobian(turned), speeds[:, 3:, None])[..., 0]
        residuals = np.concatenate([found.translations - (1 + scale) * places, turned], axis=1)
        by_own = np.concatenate([derivatives[:, :, :OWN], systematic[:, :, list(self.free)]], axis=2)
        return residuals, by_own, derivatives[:, :, OWN:]


def by_factors(a_T_b: Poses, b_T_c: Poses) -> tuple[Array, Array]:
    """Return the derivatives (N, 6, 6) of the step of a_T_c by those of a_T_b and b_T_c."""
    arms = (a_T_b.rotations @ b_T_c.translations[..., None])[..., 0]
    first, second = np.tile(np.eye(POSE), (len(arms), 1, 1)), np.zeros((len(arms), POSE, POSE))
    first[:, :3, 3:] = -so3.hat(arms)
    second[:, :3, :3] = second[:, 3:, 3:] = a_T_b.rotations
    return first, second


def by_inverse(a_T_b: Poses) -> Array:
    """Return the derivatives (N, 6, 6) of the step of b_T_a by that of a_T_b."""
    back = -a_T_b.rotations.transpose(0, 2, 1)
    result = np.zeros((len(back), POSE, POSE))
    result[:, :3, :3] = result[:, 3:, 3:] = back
    result[:, :3, 3:] = back @ so3.hat(a_T_b.translations)
    return result
