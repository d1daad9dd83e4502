"""Measurements that do not fit: what weight they get, and which of them are outliers."""

import numpy as np

from camcal.arrays import Array
from camcal.errors import NotConverged
from camcal.estimate.smoothing.batch import invertible, solve_batch
from camcal.estimate.smoothing.kalman import gate
from camcal.estimate.smoothing.linear_system import LinearSystem, Smoothed
from camcal.solve.losses import Huber

OUTLIER_CONFIDENCE = 0.999

_GOOD = 0.8214  # share of good measurements within Huber's bound; for one number the usual 1.345 σ
_SETTLED = 1e-3  # of a weight: far less than the weights matter
_ITERATIONS = 100


def huber(numbers: int) -> Huber:
    """Return the loss of measurements of so many numbers each, in units of their noise.

    Its bound leaves 95 % of the efficiency of least squares where noise is normal. Source: Huber 1981, section 4.
    """
    return Huber(float(np.sqrt(gate(numbers, _GOOD))))


def robust_weights(system: LinearSystem, start: Array | None = None, settled: float = _SETTLED) -> Array:
    """Return the weights (K,) of the measurements at the minimum of Huber's loss, by reweighted least squares.

    start: (K,) a first guess. settled: change of a weight that is none. Raises NotConverged if they go on changing.
    """
    system = invertible(system)
    loss = huber(system.measurements.shape[1])
    weights = np.ones(len(system)) if start is None else start
    for _ in range(_ITERATIONS):
        before = weights
        weights = loss.weight(squared_residuals(system, solve_batch(system.weighted(weights)).means))
        if np.abs(weights - before).max() < settled:
            return weights
    raise NotConverged(f"the weights of measurements did not settle in {_ITERATIONS} iterations; try without --robust")


def squared_residuals(system: LinearSystem, means: Array) -> Array:
    """Return the squared residuals (K,) of measurements in units of their noise, 0 where nothing was measured."""
    off, noise, _ = _residuals(system, means)
    return np.asarray(np.einsum("km,km->k", off, np.linalg.solve(noise, off[:, :, None])[..., 0]))


def disagreement(system: LinearSystem, weights: Array, smoothed: Smoothed) -> Array:
    """Return how far each measurement lies from what all others say, squared, in units of both uncertainties (K,).

    It is χ² of as many degrees of freedom as the measurement has numbers, if that one is good. NaN where the others
    say nothing, or nothing was measured. weights: (K,) with which the states were smoothed.
    Source: Cook and Weisberg, Residuals and Influence in Regression, 1982, section 2.2 (deletion residuals).
    """
    off, noise, present = _residuals(system, smoothed.means)
    H = system.observation
    both = present[:, :, None] & present[:, None, :]
    used = noise / weights[:, None, None]
    spare = used - np.where(both, H @ smoothed.covariances @ H.T, 0.0)
    redundant = np.linalg.eigvalsh(spare)[:, 0] > 1e-9 * np.einsum("kmm->km", used).max(axis=1)
    leverage = used @ np.linalg.inv(np.where(redundant[:, None, None], spare, np.eye(len(H))))
    deleted = np.einsum("kij,kj->ki", leverage, off)
    variance = np.where(redundant[:, None, None], leverage @ used - used + noise, np.eye(len(H)))
    squares = np.einsum("km,km->k", deleted, np.linalg.solve(variance, deleted[:, :, None])[..., 0])
    return np.where(redundant & present.any(axis=1), squares, np.nan)


def is_outlier(squares: Array, numbers: Array) -> Array:
    """Return which measurements disagree more than one good one in a thousand does; (K,) bool.

    squares: (K,) of `disagreement`. numbers: (K,) how many numbers each measurement has.
    """
    limits = {number: gate(max(number, 1), OUTLIER_CONFIDENCE) for number in np.unique(numbers).tolist()}
    return np.asarray(np.nan_to_num(squares) > [limits[number] for number in numbers.tolist()])


def _residuals(system: LinearSystem, means: Array) -> tuple[Array, Array, Array]:
    """Return residuals (K, m), 0 where missing, their covariances with 1 in place of the missing, and what is there."""
    present = system.present
    both = present[:, :, None] & present[:, None, :]
    off = np.nan_to_num(system.measurements - means @ system.observation.T)
    return off, np.where(both, system.noise, np.eye(present.shape[1])), present
