"""A rig and a robot as one least-squares problem: corners in pixels, the robot's poses in metres and radians.

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
from camcal.calibrate.robot.start import Poses
from camcal.dataclass import dataclass, field, replace
from camcal.geometry import rotation as so3
from camcal.geometry.pose import retract
from camcal.solve.least_squares import Problem
from camcal.solve.steps import Block, Jacobian, Step

OWN = 2 * POSE  # parameters of the two poses
SYSTEMATIC = ("scale", "delay")
LEAST_STD = 1e-6  # m and rad, of a pose that was measured


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
