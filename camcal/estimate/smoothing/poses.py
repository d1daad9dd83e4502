"""Poses over time, smoothed on SO(3) × R³: rotation and translation move by the same model, each with its own noise.

A state is a pose and as many of its derivatives as the motion model has: translation and rotation (3 numbers each),
their velocities, their accelerations. The rotation's numbers are its error, R ← Exp(δ) R, linear for small steps;
everything else is itself. All poses are solved for together, as a linear system about the rotations found so far, until
they no longer change. Rotation and translation do not drive each other: on SE(3) an object that turns and moves would
follow a helix about the origin.
Source: Barfoot, State Estimation for Robotics, 2017, sections 8.2 and 4.3 (Gauss–Newton on states over time);
Solà, Quaternion kinematics for the error-state Kalman filter, 2017.
"""

from collections.abc import Callable
from math import factorial

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass, field, replace
from camcal.errors import InsufficientData, NotConverged
from camcal.estimate.smoothing.batch import (
    MeasurementFit,
    invertible,
    require_size,
    robust_weights,
    smooth_system,
    solve_batch,
)
from camcal.estimate.smoothing.linear_system import LinearSystem, MotionModel, kalman_filter, rts
from camcal.estimate.smoothing.series import (
    SmootherNoise,
    likeliest_noise,
    measured_noise,
    strength,
)
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Trajectory
from camcal.records import Brief

_SETTLED = 1e-7  # rad
_ITERATIONS = 50
Pair = tuple[float, float]


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
        # rotations turn evenly between measured ones
        after = np.minimum(before + 1, len(poses) - 1)
        span = poses.stamps[after] - poses.stamps[before]
        share = np.clip((everything - poses.stamps[before]) / np.where(span > 0, span, 1.0), 0.0, 1.0)
        return cls(
            everything,
            so3.between(poses.rotations[before], poses.rotations[after], share),
            translations=poses.translations[before],
            covariances=measured_covariances(poses, sigma)[before],
            measured=measured,
            linked=np.diff(segments[before]) == 0,
            motion=motion,
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
        return LinearSystem(
            transitions,
            controls,
            process=process,
            linked=self.linked,
            observation=np.eye(6, 6 * order),
            measurements=measurements,
            noise=noise,
        )

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


@dataclass(frozen=True)
class PosesOptions(Brief):
    """How to smooth poses.

    q: strengths of the process noise of translation and rotation, None: the most likely. sigma: standard deviations of
    the measured translations (m) and rotations (rad), None: the poses' covariances, or the most likely without them.
    """

    motion: MotionModel = field(default_factory=MotionModel)
    q: tuple[float, float] | None = None
    sigma: tuple[float, float] | None = None
    method: str = "rts"
    robust: bool = False


@dataclass(frozen=True, eq=False)
class SmoothedPoses(MeasurementFit):
    """Poses given all measurements, with covariances and (but for rw) velocities, and how the measured ones (K,) fit.

    q: strengths of the process noise of translation and rotation. sigma: of the measurements, None if they have
    covariances. The filter is one about the smoothed poses; its innovations are of six numbers each.
    """

    trajectory: Trajectory
    q: tuple[float, float]
    sigma: tuple[float, float] | None


def smooth_poses(measured: Trajectory, options: PosesOptions = PosesOptions()) -> SmoothedPoses:
    """Return poses smoothed, each segment by itself.

    Raises InsufficientData if a segment has too few poses, NotConverged if the rotations do not settle, InvalidInput
    for translations too large to compute with.
    """
    require_size(measured.translations, "translations")
    problem = PoseProblem.of(measured, options.motion, options.sigma)
    _require_observed(problem)
    known = options.sigma is not None or measured.covariances is not None
    noises = _noise(problem, options, known)
    problem = problem.with_noise(*noises)
    guess = _relinearise(problem, problem.first_guess(), _robust if options.robust else _likeliest)
    means, covariances, fit = smooth_system(problem.system(guess), options.method, options.robust)
    return SmoothedPoses(
        **vars(fit),
        trajectory=_trajectory(measured, problem, guess, means, covariances),
        q=noises[0],
        sigma=options.sigma if known else noises[1],
    )


def poses_at(measured: Trajectory, smoothed: SmoothedPoses, options: PosesOptions, stamps: Array) -> Trajectory:
    """Return smoothed poses at other stamps (M,), with what the motion model says of them there.

    measured, options: what `smooth_poses` had. In a gap between segments the earlier one goes on.
    """
    covariances = measured_covariances(measured, smoothed.sigma) / smoothed.weights[:, None, None]
    problem = PoseProblem.of(replace(measured, covariances=covariances), options.motion, None, stamps)
    problem = problem.with_noise(smoothed.q, (1.0, 1.0))
    start = PoseProblem.of(smoothed.trajectory, options.motion, None, stamps).first_guess()
    # By filter: stamps may lie so near each other that a batch would lose its digits.
    guess = _relinearise(problem, start, lambda system: rts(system, kalman_filter(system))[0])
    system = problem.system(guess)
    everything = _trajectory(measured, problem, guess, *rts(system, kalman_filter(system)))
    return everything.rows(np.searchsorted(everything.stamps, stamps))


def _noise(problem: PoseProblem, options: PosesOptions, known: bool) -> tuple[Pair, Pair]:
    """Return q and sigma of translation and rotation, sigma 1 if it is known: as given, or the most likely.

    The two do not drive each other, so each is found by itself, about rotations smoothed with an initial value.
    """
    if options.q is not None and known:
        return options.q, (1.0, 1.0)
    # the turns from one rotation to the next, summed up: enough to see their noise
    turns = so3.log(problem.rotations[1:] @ np.swapaxes(problem.rotations[:-1], 1, 2))
    measured = {"translations": problem.translations, "rotations": np.vstack([np.zeros(3), np.cumsum(turns, axis=0)])}
    guesses = [_guess(problem, values, known, name) for name, values in measured.items()]
    start = problem.with_noise(
        (guesses[0].q, guesses[1].q), (1.0, 1.0) if known else (guesses[0].sigma, guesses[1].sigma)
    )
    system = problem.system(_relinearise(start, start.first_guess(), _robust if options.robust else _likeliest))
    found = []
    for index, guess in enumerate(guesses):
        states = np.flatnonzero(np.arange(system.observation.shape[1]) % 6 // 3 == index)
        part = system.part(states, states[:3])
        q, sigma = None if options.q is None else options.q[index], 1.0 if known else None
        found.append(likeliest_noise(part, q, sigma, guess, options.robust))
    return (found[0].q, found[1].q), (found[0].sigma, found[1].sigma)


def _guess(problem: PoseProblem, values: Array, known: bool, what: str) -> SmootherNoise:
    """Return an initial value of noise from translations or rotations (K, 3), `what`, that were measured."""
    values = values[problem.measured]
    sigma = measured_noise(values, len(problem.motion.states) + 1, what)
    q = strength(problem.motion, problem.stamps[problem.measured], sigma)
    return SmootherNoise(q, 1.0 if known else sigma)


def _relinearise(problem: PoseProblem, guess: PoseGuess, means_of: Callable[[LinearSystem], Array]) -> PoseGuess:
    """Return the rotations and their rates at the minimum: Gauss–Newton, all poses at once.

    means_of: the states (K, n) of a linear system.
    """
    for _ in range(_ITERATIONS):
        means = means_of(problem.system(guess))
        guess = guess.moved(means)
        if np.abs(means[:, 3:6]).max() < _SETTLED:
            return guess
    raise NotConverged(f"rotations not converged after {_ITERATIONS} iterations: check for outliers, or use --robust")


def _likeliest(system: LinearSystem) -> Array:
    return solve_batch(invertible(system)).means


def _robust(system: LinearSystem) -> Array:
    return _likeliest(system.weighted(robust_weights(system)))


def _require_observed(problem: PoseProblem) -> None:
    system = problem.system(problem.first_guess())
    for chain in system.unobserved():
        count = int(problem.measured[system.chains == chain].sum())
        model = problem.motion
        raise InsufficientData(
            f"not observed: {', '.join(model.states[1:] or model.states)} of segment {chain} ({count} poses, "
            f"model {model.name} needs {len(model.states)})"
        )


def _trajectory(
    measured: Trajectory, problem: PoseProblem, guess: PoseGuess, means: Array, covariances: Array
) -> Trajectory:
    return Trajectory(
        measured.frames,
        problem.stamps,
        rotations=so3.exp(means[:, 3:6]) @ guess.rotations,
        translations=means[:, :3],
        covariances=covariances[:, :6, :6],
        velocities=means[:, 6:12] if means.shape[1] > 6 else None,
        segments=None if measured.segments is None else np.concatenate([[0], np.cumsum(~problem.linked)]),
    )
