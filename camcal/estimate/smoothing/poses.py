"""Poses over time, smoothed on SO(3) × R³: rotation and translation move by the same model, each with its own noise.

The rotation's error is linear for small steps. All poses are solved for together, as a linear system about the
rotations found so far, until they no longer change. Rotation and translation do not drive each other: on SE(3) an
object that turns and moves would follow a helix about the origin.
Source: Barfoot, State Estimation for Robotics, 2017, sections 8.2 and 4.3 (Gauss–Newton on states over time).
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from camcal.arrays import Array
from camcal.errors import InsufficientData, NotConverged
from camcal.estimate.smoothing.batch import invertible, solve_batch
from camcal.estimate.smoothing.consistency import Consistency
from camcal.estimate.smoothing.linear_system import LinearSystem, Smoothed, kalman_filter, rts
from camcal.estimate.smoothing.motion_models import MotionModel
from camcal.estimate.smoothing.pose_system import PoseGuess, PoseProblem, measured_covariances
from camcal.estimate.smoothing.robust import robust_weights
from camcal.estimate.smoothing.smooth import require_size, smooth_system
from camcal.estimate.smoothing.tuning import KnownNoise, Noise, likeliest_noise, measured_noise, strength
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Trajectory

_SETTLED = 1e-7  # rad
_ITERATIONS = 50

Pair = tuple[float, float]


@dataclass(frozen=True)
class PosesOptions:
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
class SmoothedPoses:
    """Poses given all measurements, with covariances and (but for rw) velocities.

    q: strengths of the process noise of translation and rotation. sigma: of the measurements, None if they have
    covariances. weights: (K,) of the measured poses. outliers: (K,) bool. nis: (K,) normalised innovations
    squared of a filter about the smoothed poses, of six numbers each, NaN where no pose was predicted. log_likelihood:
    of the measurements, each given those before it. consistency: of the filter's innovations. Smoothed robustly, the
    last three are those without the outliers.
    """

    trajectory: Trajectory
    q: tuple[float, float]
    sigma: tuple[float, float] | None
    weights: Array
    outliers: Array
    nis: Array
    log_likelihood: float
    consistency: Consistency


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
    guess = _settled(problem, problem.first_guess(), _robust if options.robust else _likeliest)
    found = smooth_system(problem.system(guess), options.method, options.robust)
    return SmoothedPoses(
        _trajectory(measured, problem, guess, found.states),
        noises[0],
        options.sigma if known else noises[1],
        found.weights,
        found.outliers,
        found.nis,
        found.log_likelihood,
        found.consistency,
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
    guess = _settled(problem, start, _filtered)
    system = problem.system(guess)
    everything = _trajectory(measured, problem, guess, rts(system, kalman_filter(system)))
    return everything.rows(np.searchsorted(everything.stamps, stamps))


def _noise(problem: PoseProblem, options: PosesOptions, known: bool) -> tuple[Pair, Pair]:
    """Return q and sigma of translation and rotation, sigma 1 if it is known: as given, or the most likely.

    The two do not drive each other, so each is found by itself, about rotations smoothed with a first guess.
    """
    if options.q is not None and known:
        return options.q, (1.0, 1.0)
    measured = {"translations": problem.translations, "rotations": _way_of(problem.rotations)}
    guesses = [_guess(problem, values, known, name) for name, values in measured.items()]
    start = problem.with_noise(
        (guesses[0].q, guesses[1].q), (1.0, 1.0) if known else (guesses[0].sigma, guesses[1].sigma)
    )
    system = problem.system(_settled(start, start.first_guess(), _robust if options.robust else _likeliest))
    found = []
    for index, guess in enumerate(guesses):
        states = np.flatnonzero(np.arange(system.observation.shape[1]) % 6 // 3 == index)
        part = system.part(states, states[:3])
        noise = KnownNoise(None if options.q is None else options.q[index], 1.0 if known else None)
        found.append(likeliest_noise(part, noise, guess, options.robust))
    return (found[0].q, found[1].q), (found[0].sigma, found[1].sigma)


def _guess(problem: PoseProblem, values: Array, known: bool, what: str) -> Noise:
    """Return a first guess of noise from translations or rotations (K, 3), `what`, that were measured."""
    values = values[problem.measured]
    sigma = measured_noise(values, len(problem.motion.states) + 1, what)
    q = strength(problem.motion, problem.stamps[problem.measured], sigma)
    return Noise(q, 1.0 if known else sigma)


def _way_of(rotations: Array) -> Array:
    """Return the turns from one rotation to the next, summed up (K, 3): enough to see their noise."""
    turns = so3.log(rotations[1:] @ np.swapaxes(rotations[:-1], 1, 2))
    return np.vstack([np.zeros(3), np.cumsum(turns, axis=0)])


def _settled(problem: PoseProblem, guess: PoseGuess, means_of: Callable[[LinearSystem], Array]) -> PoseGuess:
    """Return the rotations and their rates at the minimum: Gauss–Newton, all poses at once.

    means_of: the states (K, n) of a linear system.
    """
    for _ in range(_ITERATIONS):
        means = means_of(problem.system(guess))
        guess = guess.moved(means)
        if np.abs(means[:, 3:6]).max() < _SETTLED:
            return guess
    raise NotConverged(f"rotations did not settle in {_ITERATIONS} iterations; are there gross outliers? try --robust")


def _likeliest(system: LinearSystem) -> Array:
    return solve_batch(invertible(system)).means


def _robust(system: LinearSystem) -> Array:
    return _likeliest(system.weighted(robust_weights(system)))


def _filtered(system: LinearSystem) -> Array:
    return rts(system, kalman_filter(system)).means


def _require_observed(problem: PoseProblem) -> None:
    system = problem.system(problem.first_guess())
    for chain in system.unobserved():
        count = int(problem.measured[system.chains == chain].sum())
        model = problem.motion
        raise InsufficientData(
            f"not observed: {', '.join(model.states[1:] or model.states)} of segment {chain} ({count} poses, "
            f"model {model.name} needs {len(model.states)})"
        )


def _trajectory(measured: Trajectory, problem: PoseProblem, guess: PoseGuess, states: Smoothed) -> Trajectory:
    means = states.means
    return Trajectory(
        measured.frames,
        problem.stamps,
        so3.exp(means[:, 3:6]) @ guess.rotations,
        means[:, :3],
        states.covariances[:, :6, :6],
        means[:, 6:12] if means.shape[1] > 6 else None,
        None if measured.segments is None else np.concatenate([[0], np.cumsum(~problem.linked)]),
    )
