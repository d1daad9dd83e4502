"""The mean of several estimates of one pose, on SO(3) × R³: minimises the sum of squared steps.

Without covariances every estimate counts alike and the mean of the rotations is Karcher's; with them it is the most
likely pose. Source: Karcher, Riemannian Center of Mass and Mollifier Smoothing, 1977; Hartley, Trumpf, Dai, Li,
Rotation Averaging, 2013.
"""

from collections.abc import Sequence

import numpy as np

from camcal.arrays import Array, FloatArray
from camcal.dataclass import dataclass
from camcal.errors import InsufficientData, InvalidInput, NotConverged
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.solve.least_squares import minimise
from camcal.solve.losses import Cauchy, Loss
from camcal.solve.steps import Block, Jacobian, Step

_SCALE = 3.55  # standard deviations: what 95 % of steps in six dimensions stay within
_MEDIAN_LENGTH = 1.538  # of normal vectors in three dimensions, in standard deviations
_LEAST_SIGMA = 1e-12  # m and rad: estimates that agree to the last digit are no reason to divide by nothing
_STARTS = 200  # estimates tried as the start
_FULL = 7  # estimates needed before their scatter says how six numbers go together
_UNIQUE = np.pi / 2  # rad; if rotations are farther from their mean than this there may be another one


@dataclass(frozen=True, eq=False)
class PoseAverage:
    """A mean pose and how the estimates lie about it.

    covariance: (6, 6) of the mean's step: from the estimates' covariances, otherwise from their scatter (its diagonal
    alone below 7 estimates). weights: (N,) up to 1 by the robust loss. offsets: (N,) m. angles: (N,) rad.
    chi_square: of the steps against the covariances, None without; degrees_of_freedom: its degrees of freedom.
    """

    pose: Pose
    covariance: FloatArray
    weights: FloatArray
    offsets: FloatArray
    angles: FloatArray
    chi_square: float | None
    degrees_of_freedom: int

    @property
    def unique(self) -> bool:
        """Whether no other mean is possible: rotations all within 90° of this one."""
        return bool(self.angles.max() < _UNIQUE)


def average_poses(
    poses: Sequence[Pose], covariances: Sequence[Array] | None = None, *, robust: bool = False
) -> PoseAverage:
    """Return the mean of two or more poses a_T_b of the same a and b, weighted by covariances (6, 6) where given.

    robust: estimates far from the others, by the covariances or by the median of their distances, count little.
    Raises InsufficientData for fewer than two, InvalidInput for a covariance that is singular, NotConverged.
    """
    if len(poses) < 2:
        raise InsufficientData(f"{len(poses)} poses; a mean needs two or more")
    rotations = np.array([pose.rotation for pose in poses])
    translations = np.array([pose.translation for pose in poses])
    # it starts at the median of the translations, with the rotation of those given that is nearest to all others
    quaternions = so3.to_quaternion(rotations)
    tried = np.unique(np.linspace(0, len(rotations) - 1, _STARTS).astype(int))
    half_angles = np.arccos(np.clip(np.abs(quaternions[tried] @ quaternions.T), 0, 1))
    start = Pose(rotations[tried[np.argmin(half_angles.sum(axis=1))]], np.median(translations, axis=0))
    if covariances is not None:
        try:
            whitening = np.linalg.inv(np.linalg.cholesky(np.array(covariances)))
        except np.linalg.LinAlgError as error:
            raise InvalidInput("singular covariance: leave the pose out") from error
    else:
        sigma = _spread(_steps(start, rotations, translations)) if robust else np.ones(6)
        whitening = np.broadcast_to(np.diag(1 / sigma), (len(poses), 6, 6))
    problem = _MeanProblem(rotations, translations, whitening, Cauchy(_SCALE) if robust else None)
    solution = minimise(problem, start)
    if not solution.converged:
        raise NotConverged(f"the mean of {len(poses)} poses did not converge: {solution.reason}")
    squared = problem.squared(solution.state)
    weights = np.ones(len(poses)) if problem.loss is None else problem.loss.weight(squared)
    steps = _steps(solution.state, rotations, translations)
    return PoseAverage(
        solution.state,
        _scatter(steps, weights) if covariances is None else solution.factors().shared_covariance(),
        weights=weights,
        offsets=np.linalg.norm(steps[:, :3], axis=1),
        angles=np.linalg.norm(steps[:, 3:], axis=1),
        chi_square=None if covariances is None else float(squared.sum()),
        degrees_of_freedom=6 * (len(poses) - 1),
    )


@dataclass(frozen=True, eq=False)
class _MeanProblem:
    """The whitened steps (N, 6) from a mean, the state, to the estimates."""

    rotations: Array
    translations: Array
    whitening: Array
    loss: Loss | None

    @property
    def shared(self) -> int:
        """How many parameters there are: the step of the mean."""
        return 6

    @property
    def groups(self) -> tuple[int, int]:
        """No parameters belong to single estimates."""
        return 0, 0

    def squared(self, mean: Pose) -> Array:
        """Return the squared lengths (N,) of the whitened steps."""
        return np.asarray(np.sum(self._whitened(_steps(mean, self.rotations, self.translations)) ** 2, axis=1))

    def blocks(self, mean: Pose) -> Sequence[Block]:
        """Return the steps and their derivatives by that of the mean."""
        steps = _steps(mean, self.rotations, self.translations)
        by_mean = np.zeros((len(steps), 6, 6))
        by_mean[:, :3, :3] = -np.eye(3)
        # Log(Exp(v) Exp(-δ)) ≈ v - J(-v)⁻¹ δ, where J is the left Jacobian.
        by_mean[:, 3:, 3:] = -np.linalg.inv(so3.exp_jacobian(-steps[:, 3:]))
        jacobian = Jacobian(self.whitening @ by_mean, np.arange(6))
        return [Block(self._whitened(steps), (jacobian,), loss=self.loss)]

    def retract(self, mean: Pose, step: Step) -> Pose:
        """Return the mean moved by a step."""
        return mean.retract(step.shared)

    def _whitened(self, steps: Array) -> Array:
        return np.asarray(np.einsum("nij,nj->ni", self.whitening, steps))


def _steps(mean: Pose, rotations: Array, translations: Array) -> Array:
    """Return the steps (N, 6) that take the mean to the estimates."""
    turns = so3.log(rotations @ mean.rotation.T)
    return np.concatenate([translations - mean.translation, turns], axis=1)


def _spread(steps: Array) -> Array:
    """Return the standard deviations (6,) of steps (N, 6), one for metres and one for radians, outliers or not."""
    parts = [np.median(np.linalg.norm(part, axis=1)) / _MEDIAN_LENGTH for part in (steps[:, :3], steps[:, 3:])]
    return np.repeat(np.maximum(parts, _LEAST_SIGMA), 3)


def _scatter(steps: Array, weights: Array) -> Array:
    """Return the covariance (6, 6) of the mean of steps (N, 6) about it; source: Huber 1967, the sandwich."""
    weighted = weights[:, None] * steps
    count = len(steps)
    covariance = weighted.T @ weighted / weights.sum() ** 2 * count / (count - 1)
    return covariance if count >= _FULL else np.diag(np.diag(covariance))
