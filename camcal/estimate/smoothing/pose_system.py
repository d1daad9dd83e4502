"""Measured poses as a linear system, about a guess of their rotations.

A state is a pose and as many of its derivatives as the motion model has: translation and rotation (3 numbers each),
their velocities, their accelerations. The rotation's numbers are its error, R ← Exp(δ) R; everything else is itself.
Source: Solà, Quaternion kinematics for the error-state Kalman filter, 2017; Barfoot 2017, section 8.2.
"""

from dataclasses import dataclass, replace
from math import factorial

import numpy as np

from camcal.arrays import Array
from camcal.estimate.smoothing.linear_system import LinearSystem
from camcal.estimate.smoothing.motion_models import MotionModel
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Trajectory


@dataclass(frozen=True, eq=False)
class PoseGuess:
    """Rotations (K, 3, 3), and derivatives (K, n - 1, 3) of a model of n numbers an axis: rad/s, rad/s²."""

    rotations: Array
    rates: Array

    def moved(self, means: Array) -> "PoseGuess":
        """Return the guess after states (K, 6 n) of the system about it."""
        rates = means[:, 6:].reshape(len(means), means.shape[1] // 6 - 1, 6)[:, :, 3:]
        return PoseGuess(so3.exp(means[:, 3:6]) @ self.rotations, rates)


@dataclass(frozen=True, eq=False)
class PoseProblem:
    """K poses, measured where `measured` (K,) says, and how they move.

    stamps: (K,) s. rotations: (K, 3, 3) and translations: (K, 3), m, of any value where nothing was measured.
    covariances: (K, 6, 6). linked: (K - 1,) False where a segment ends. q: of translation and rotation.
    """

    stamps: Array
    rotations: Array
    translations: Array
    covariances: Array
    measured: Array
    linked: Array
    motion: MotionModel
    q: tuple[float, float] = (1.0, 1.0)

    @classmethod
    def of(
        cls, poses: Trajectory, motion: MotionModel, sigma: tuple[float, float] | None, stamps: Array | None = None
    ) -> "PoseProblem":
        """Return the problem of measured poses; at further stamps (M,) poses are wanted but not measured.

        sigma: of all translations (m) and rotations (rad); None: their covariances, or 1 where they have none.
        """
        everything = poses.stamps if stamps is None else np.union1d(poses.stamps, stamps)
        rows = np.searchsorted(everything, poses.stamps)
        before = np.clip(np.searchsorted(poses.stamps, everything, side="right") - 1, 0, len(poses) - 1)
        segments = np.zeros(len(poses)) if poses.segments is None else poses.segments
        measured = np.zeros(len(everything), bool)
        measured[rows] = True
        return cls(
            everything,
            _interpolated(poses, everything, before),
            poses.translations[before],
            measured_covariances(poses, sigma)[before],
            measured,
            np.diff(segments[before]) == 0,
            motion,
        )

    def with_noise(self, q: tuple[float, float], sigma: tuple[float, float]) -> "PoseProblem":
        """Return the problem with process noise q, and measurement noise multiplied by sigma."""
        scale = np.repeat(sigma, 3)
        return replace(self, q=q, covariances=self.covariances * np.outer(scale, scale))

    def first_guess(self) -> PoseGuess:
        """Return the measured rotations, at rest."""
        return PoseGuess(self.rotations, np.zeros((len(self.stamps), len(self.motion.states) - 1, 3)))

    def system(self, guess: PoseGuess) -> LinearSystem:
        """Return the linear system of the errors about a guess."""
        order = len(self.motion.states)
        between = np.diff(self.stamps)
        transitions = np.kron(self.motion.transition(between), np.eye(6))
        process = np.kron(self.motion.noise(between), np.diag(np.repeat(self.q, 3)))
        controls = np.zeros((len(between), 6 * order))
        row, controls[:, 3:6] = self._turning(guess, between)
        for power, block in enumerate(row):
            transitions[:, 3:6, 6 * power + 3 : 6 * power + 6] = block
        off = so3.log(self.rotations @ np.swapaxes(guess.rotations, 1, 2))
        measurements = np.hstack([self.translations, off])
        measurements[~self.measured] = np.nan
        # Log(Exp(n) Exp(δ)) = off: the noise n stands left of the error, which turns it by the right Jacobian.
        turn = np.tile(np.eye(6), (len(off), 1, 1))
        turn[:, 3:, 3:] = so3.exp_jacobian(-off)
        noise = turn @ self.covariances @ np.swapaxes(turn, 1, 2)
        return LinearSystem(transitions, controls, process, self.linked, np.eye(6, 6 * order), measurements, noise)

    def _turning(self, guess: PoseGuess, between: Array) -> tuple[list[Array], Array]:
        """Return how a rotation's next error follows from its error and rates, blocks (K - 1, 3, 3), and an offset.

        With θ the turn that the rates make and e what is left of the turn that the guess makes: δ' = Exp(e) (Exp(θ) δ
        + J(θ) (θ_new - θ)) - e.
        """
        weights = [between**power / factorial(power) for power in range(1, len(self.motion.states))]
        rates = guess.rates[:-1]
        theta = sum((weight[:, None] * rates[:, k] for k, weight in enumerate(weights)), np.zeros((len(between), 3)))
        step = guess.rotations[1:] @ np.swapaxes(guess.rotations[:-1], 1, 2)
        left = so3.log(step @ so3.exp(-theta))
        turned = so3.exp(left)
        moved = turned @ so3.exp_jacobian(theta)
        offset = -np.einsum("kij,kj->ki", turned, theta) - left
        return [step, *(weight[:, None, None] * moved for weight in weights)], offset


def measured_covariances(poses: Trajectory, sigma: tuple[float, float] | None) -> Array:
    """Return the covariances (K, 6, 6) of measured poses: of sigma (m, rad), or their own, or 1 without any."""
    if poses.covariances is not None and sigma is None:
        return poses.covariances
    return np.tile(np.diag(np.repeat(np.square(sigma or (1.0, 1.0)), 3)), (len(poses), 1, 1))


def _interpolated(poses: Trajectory, stamps: Array, before: Array) -> Array:
    """Return rotations (M, 3, 3) at stamps, turning evenly between measured ones."""
    after = np.minimum(before + 1, len(poses) - 1)
    span = poses.stamps[after] - poses.stamps[before]
    share = np.clip((stamps - poses.stamps[before]) / np.where(span > 0, span, 1.0), 0.0, 1.0)
    turn = so3.log(poses.rotations[after] @ np.swapaxes(poses.rotations[before], 1, 2))
    return np.asarray(so3.exp(share[:, None] * turn) @ poses.rotations[before])
