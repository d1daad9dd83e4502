"""The robot's own noise as variance components, and hand and eye under it.

The corners' noise and weights are those of the rig's estimate. Each pass solves for everything with the robot's noise
as it is known, then takes the noise from the residuals of the robot's poses and what they have left (REML). Poses that
do not fit count less, by a Student distribution. In the end it is tested whether lengths or times are wrong.
Source: Patterson & Thompson, Biometrika 58, 1971; Lange, Little & Taylor, JASA 84, 1989.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.problem import POSE
from camcal.calibrate.rigs.problem import RigProblem
from camcal.calibrate.robot.problem import (
    LEAST_STD,
    OWN,
    SYSTEMATIC,
    HandEye,
    Poses,
    RobotPoses,
    RobotProblem,
    RobotState,
    SeenPoses,
)
from camcal.dataclass import dataclass, field, replace
from camcal.errors import InsufficientData
from camcal.geometry.pose import Pose
from camcal.solve.descent import Stopping
from camcal.solve.least_squares import minimise
from camcal.solve.steps import Factors, SingularError

_DOF = 4.0  # of the Student distribution
_INFORMATION = (_DOF + POSE + 2) / (_DOF + POSE)  # of a Gaussian pose over one of the Student distribution
_NODES, _SHARES = np.polynomial.hermite_e.hermegauss(16)
_PASSES, _SETTLED = 100, 1e-3
_UPPER = 0.975  # of a distribution, where its 95 % interval ends
_FEWEST_DOF = 3.0  # that an interval is taken to be of: noise with fewer is hardly any beside that of the camera
_LEAST = (1e-7, 1e-7)  # m and rad: a robot that is exact
_LEFT = 0.05  # of the coordinates of a pose, however many were spent
_HIDDEN = 0.1  # of them: a robot whose noise cannot be told from none
_STOPPING = Stopping(relative_decrease=1e-9, iterations=30)
_SCALE = 1.4826


@dataclass(frozen=True, eq=False)
class RobotEstimate:
    """Hand and eye.

    carrier_T_rig, world_T_board: see RobotProblem. joint: (S, S) the covariance of the shared parameters. sigmas: the
    robot's noise of a coordinate, m and rad; dof: the degrees of freedom that they were estimated with. residuals:
    (N, 6) of base_T_hand, m and rad. weights: (N,). scatter: the variance from pose to pose over what the noise says.
    systematic: by the names in SYSTEMATIC, what was estimated or could be tested, with its standard deviation.
    """

    problem: RobotProblem
    state: RobotState
    joint: Array
    sigmas: tuple[float, float]
    dof: tuple[float, float]
    residuals: Array
    weights: Array
    scatter: float
    passes: int
    converged: bool
    systematic: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def covariance(self) -> Array:
        """The covariance (12, 12) of the steps of both poses."""
        start = self.problem.rig.shared
        return self.joint[start : start + OWN, start : start + OWN]

    @property
    def carrier_T_rig(self) -> Pose:  # noqa: N802 - a_T_b
        """Where the rig's frame stands in its carrier's."""
        return Pose(self.state.fixed.rotations[0], self.state.fixed.translations[0])

    @property
    def world_T_board(self) -> Pose:  # noqa: N802
        """Where the board stands in the world."""
        return Pose(self.state.fixed.rotations[1], self.state.fixed.translations[1])


def estimate_robot(
    rig: RigProblem | SeenPoses, seen: Any, robot: RobotPoses, start: HandEye, free: tuple[int, ...] = ()
) -> RobotEstimate:
    """Return hand and eye from a closed form on; raises InsufficientData where the poses leave them undetermined.

    seen: the state of the rig. free: the places in SYSTEMATIC of what is estimated as well.
    """
    if isinstance(rig, RigProblem):
        rig = rig.with_parts([replace(part, offsets=False) for part in rig.parts])
    fixed = [start.carrier_T_camera, start.world_T_board]
    poses = Poses(np.stack([each.rotation for each in fixed]), np.stack([each.translation for each in fixed]))
    sigmas = tuple(
        max(_SCALE * float(np.median(own)) / np.sqrt(3), least)
        for own, least in zip((start.shifts, start.turns), _LEAST, strict=True)
    )
    if isinstance(rig, SeenPoses):
        rig = replace(rig, turn_std=max(sigmas[1], LEAST_STD))
    problem = RobotProblem(rig, replace(robot, sigmas=(sigmas[0], sigmas[1])), free)
    try:
        found = _estimate(problem, RobotState(seen, poses))
        return replace(found, systematic=_systematic(found))
    except (SingularError, np.linalg.LinAlgError) as error:
        raise InsufficientData(
            "the robot's poses leave the place of the camera open: turn the hand about two axes, by 30° and more"
        ) from error


def _estimate(problem: RobotProblem, state: RobotState) -> RobotEstimate:
    count = len(problem.robot.captures)
    converged, passes = False, 0
    dof = np.full(2, 3.0 * count)
    for done in range(1, _PASSES + 1):
        passes = done
        solution = minimise(problem, state, _STOPPING)
        state, factors = solution.state, solution.factors()
        residuals, spent = _residuals_and_spent(problem, state, factors)
        weights, before = problem.robot.weights, np.array(problem.robot.sigmas)
        squares = np.stack([np.sum(residuals[:, :3] ** 2, axis=1), np.sum(residuals[:, 3:] ** 2, axis=1)])
        dof = np.maximum(3.0 * count - spent.sum(axis=1), 3.0 * _LEFT * count)
        # what corners and the other poses leave of a pose's coordinates is smaller than its noise
        left = np.maximum(POSE - spent.sum(axis=0), POSE * _LEFT)
        sigmas = np.maximum(np.sqrt((weights / _consistency(left) * squares).sum(axis=1) / dof), _LEAST)
        weights = _student_weights((squares / sigmas[:, None] ** 2).sum(axis=0), left)
        robot = replace(problem.robot, sigmas=(float(sigmas[0]), float(sigmas[1])), weights=weights)
        problem = replace(problem, rig=_with_noise(problem.rig, state, factors), robot=robot)
        # noise counts by its share of the degrees of freedom; far below what the corners leave open it falls for ever
        share = dof / (3.0 * count)
        settled = (np.abs(np.log(sigmas / before)) * share < _SETTLED) | (share <= _HIDDEN)
        converged = bool(settled.all())
        if converged:
            break
    solution = minimise(problem, state, _STOPPING)
    joint, scatter = _covariance(problem, solution.state, solution.factors(), dof)
    return RobotEstimate(
        problem,
        solution.state,
        joint,
        sigmas=problem.robot.sigmas,
        dof=(float(dof[0]), float(dof[1])),
        residuals=problem.robot_rows(solution.state)[0],
        weights=problem.robot.weights,
        scatter=scatter,
        passes=passes,
        converged=converged and solution.converged,
    )


def _student_weights(squares: Array, dof: Array) -> Array:
    """Return the weights of poses (N,) by what is as likely of χ² with 6 degrees of freedom as their squares of it with
    so many (N,).

    Source: Wilson & Hilferty, Proceedings of the National Academy of Sciences 17, 1931.
    """
    spread, of_six = 2 / (9 * dof), 2 / (9 * POSE)
    deviations = (np.cbrt(squares / dof) - 1 + spread) / np.sqrt(spread)
    return np.asarray((_DOF + POSE) / (_DOF + POSE * np.maximum(1 - of_six + deviations * np.sqrt(of_six), 0.0) ** 3))


def _consistency(dof: Array) -> Array:
    """Return the mean of Gaussian squares of so many degrees of freedom (N,) times their weights, over that without."""
    spread = 2 / (9 * dof[:, None])
    squares = dof[:, None] * np.maximum(1 - spread + np.sqrt(spread) * _NODES, 0.0) ** 3
    weighted = squares * _student_weights(squares, np.broadcast_to(dof[:, None], squares.shape))
    return np.asarray((weighted @ _SHARES) / (squares @ _SHARES))


def _with_noise(rig: Any, state: RobotState, factors: Factors) -> Any:
    """Return the problem of the captures with the noise of poses that were given without one."""
    if not isinstance(rig, SeenPoses) or rig.covariances is not None:
        return rig
    residuals, derivatives = rig.rows(state.rig)
    own = derivatives @ factors.group_covariances() @ derivatives.transpose(0, 2, 1)
    spent = float(np.einsum("nii->", own[:, 3:, 3:])) / rig.turn_std**2
    left = max(3.0 * len(residuals) - spent, 3.0 * _LEFT * len(residuals))
    return replace(rig, turn_std=max(float(np.sqrt(np.sum(residuals[:, 3:] ** 2) / left)), LEAST_STD))


def _systematic(found: RobotEstimate) -> dict[str, tuple[float, float]]:
    """Return what is systematically wrong with the robot's poses, as it was estimated or would be, and its standard
    deviation, with the noise that is left then.
    """
    problem, state = found.problem, found.state
    known = () if problem.robot.velocities is None else (1,)
    tested = replace(problem, free=tuple(sorted({0, *known, *problem.free})))
    if len(tested.robot.captures) * POSE < 3 * tested.own:
        return {}
    try:
        other = found if tested.free == problem.free else _estimate(tested, state)
    except (SingularError, np.linalg.LinAlgError):
        return {}  # poses that leave it open
    std = np.sqrt(np.diag(other.joint))[-len(tested.free) :]
    return {
        SYSTEMATIC[place]: (float(other.state.systematic[place]), float(own))
        for place, own in zip(tested.free, std, strict=True)
    }


def _residuals_and_spent(problem: RobotProblem, state: RobotState, factors: Factors) -> tuple[Array, Array]:
    """Return the residuals (N, 6) of the robot's poses, and the degrees of freedom (2, N) that translations and
    rotations have spent.
    """
    residuals, by_fixed, by_group = problem.robot_rows(state)
    captures, shared = problem.robot.captures, factors.shared_covariance()
    groups = factors.group_covariances()[captures]
    coupling = factors.group_inverse.transpose(0, 2, 1) @ factors.reduced
    across = -(coupling[captures] @ shared)[:, :, -problem.own :]  # of group and own parameters
    mixed = by_group @ across @ by_fixed.transpose(0, 2, 1)
    own = by_group @ groups @ by_group.transpose(0, 2, 1)
    own += (
        mixed
        + mixed.transpose(0, 2, 1)
        + by_fixed @ shared[-problem.own :, -problem.own :] @ by_fixed.transpose(0, 2, 1)
    )
    variances = np.einsum("nii->ni", own).reshape(-1, 2, 3).sum(axis=2)
    spent = problem.robot.weights[:, None] * variances / np.array(problem.robot.sigmas) ** 2
    return residuals, np.minimum(spent, 3.0).T


def _widening(dof: Array) -> Array:
    """Return by how much an interval of Student's distribution is wider than a Gaussian one, for degrees of freedom."""
    from scipy.special import stdtrit

    return np.asarray(stdtrit(np.maximum(dof, _FEWEST_DOF), _UPPER) / stdtrit(np.inf, _UPPER))


def _covariance(problem: RobotProblem, state: RobotState, factors: Factors, dof: Array) -> tuple[Array, float]:
    """Return the covariance (S, S) of the shared parameters, of its own ones no less than the scatter from pose to pose
    says, and that scatter: its variance over what the noise says.

    Weights cost a part of what the robot's poses say, and nothing of what corners and priors do; noise that is itself
    estimated, with `dof` (2,) degrees of freedom, makes errors those of a t distribution.
    """
    claimed, size = factors.shared_covariance(), problem.own
    shift, turn = np.array(problem.robot.sigmas) * np.sqrt(_INFORMATION) * _widening(dof)
    less = replace(problem, robot=replace(problem.robot, sigmas=(float(shift), float(turn))))
    covariance = minimise(less, state, _STOPPING).factors().shared_covariance()
    own = covariance[-size:, -size:]
    count = len(problem.robot.captures)
    steps = factors.group_scores()[problem.robot.captures] @ claimed[:, -size:]
    scatter = steps.T @ steps * count / max(count - 2, 1)  # two poses' worth of six coordinates are spent
    root = np.linalg.inv(np.linalg.cholesky(own))
    ratio = float(np.trace(root @ scatter @ root.T) / size)
    wider = np.ones(len(claimed))
    wider[-size:] = np.sqrt(max(ratio, 1.0))
    return covariance * np.outer(wider, wider), ratio
