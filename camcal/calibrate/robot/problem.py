"""A rig and a robot as one least-squares problem: corners in pixels, the robot's poses in metres and radians.

Shared parameters: those of the rig, then carrier_T_rig and world_T_board (tx ty tz rx ry rz each). The groups are the
captures' poses rig_T_board. The carrier is what the robot's poses place in the world: the hand, with a board that
stands still; or, with a board in the hand, the base as the hand sees it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.problem import POSE
from camcal.calibrate.rigs.problem import RigProblem, RigState
from camcal.calibrate.robot.start import Poses
from camcal.geometry import rotation as so3
from camcal.geometry.pose import retract
from camcal.solve.steps import Block, Jacobian, Step

OWN = 2 * POSE  # parameters of the two poses


@dataclass(frozen=True, eq=False)
class RobotState:
    """The state of a rig; fixed: carrier_T_rig and world_T_board, as Poses of two."""

    rig: RigState
    fixed: Poses


@dataclass(frozen=True, eq=False)
class RobotPoses:
    """What a robot says of captures.

    base_T_hand: (N,) of the `captures` (N,). in_hand: whether the camera is, and not the board. sigmas: m and rad.
    weights: (N,).
    """

    base_T_hand: Poses
    captures: Array
    in_hand: bool
    sigmas: tuple[float, float]
    weights: Array

    @property
    def world_T_carrier(self) -> Poses:  # noqa: N802 - a_T_b
        """The poses of what carries the camera in what the board stands still in."""
        return self.base_T_hand if self.in_hand else self.base_T_hand.inverse()


@dataclass(frozen=True, eq=False)
class RobotProblem:
    """The least-squares problem."""

    rig: RigProblem
    robot: RobotPoses

    @property
    def shared(self) -> int:
        return self.rig.shared + OWN

    @property
    def groups(self) -> tuple[int, int]:
        return self.rig.groups

    def retract(self, state: RobotState, step: Step) -> RobotState:
        """Return the state moved by a step."""
        rig = self.rig.retract(state.rig, replace(step, shared=step.shared[: self.rig.shared]))
        own = step.shared[self.rig.shared :].reshape(2, POSE)
        return RobotState(rig, Poses(*retract(state.fixed.rotations, state.fixed.translations, own)))

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
        the two fixed poses (N, 6, 12) and by the captures' poses (N, 6, 6).
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
        known = self.robot.base_T_hand
        turned = so3.log(known.rotations.transpose(0, 2, 1) @ found.rotations)
        derivatives[:, 3:] = (
            np.linalg.inv(so3.exp_jacobian(-turned)) @ found.rotations.transpose(0, 2, 1) @ derivatives[:, 3:]
        )
        residuals = np.concatenate([found.translations - known.translations, turned], axis=1)
        return residuals, derivatives[:, :, :OWN], derivatives[:, :, OWN:]


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
