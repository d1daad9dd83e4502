"""A linear system smoothed, with everything that is said of it: weights, outliers, likelihood, consistency."""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.estimate.smoothing.batch import solve_batch
from camcal.estimate.smoothing.consistency import Consistency, consistency, successive
from camcal.estimate.smoothing.linear_system import Filtered, LinearSystem, Smoothed, kalman_filter, rts
from camcal.estimate.smoothing.robust import disagreement, is_outlier, robust_weights

METHODS = ("rts", "batch")
LARGEST = 1e50  # of measurements and of noise: their squares, and products of these, are numbers


def require_size(values: Array, what: str) -> None:
    """Raise InvalidInput if a number among `values`, NaN aside, is too large to compute with."""
    if np.any(np.abs(values) > LARGEST):
        raise InvalidInput(f"{what} of more than {LARGEST:g} cannot be computed with; are the units right?")


@dataclass(frozen=True, eq=False)
class SmoothedSystem:
    """The states of a system given all measurements, and how these fit.

    weights: (K,) of the measurements, 1 unless smoothed robustly. outliers: (K,) bool. log_likelihood: of all
    measurements that earlier ones predict. nis: (K,) of the filter's innovations, NaN where there is none. Smoothed
    robustly, likelihood, nis and consistency are those without the outliers.
    """

    states: Smoothed
    weights: Array
    outliers: Array
    log_likelihood: float
    nis: Array
    consistency: Consistency


def smooth_system(system: LinearSystem, method: str = "rts", robust: bool = False) -> SmoothedSystem:
    """Return a system smoothed by a method of METHODS (both give the same states), robustly by Huber's loss.

    Raises InsufficientData if a state is not observed, InvalidInput if process noise has no inverse for the batch, or
    if it is so unlike measurement noise that rounding hides one of them.
    """
    try:
        return _smooth_system(system, method, robust)
    except np.linalg.LinAlgError as error:
        raise InvalidInput("q and sigma are too unlike in size to compute with; are their units right?") from error


def _smooth_system(system: LinearSystem, method: str, robust: bool) -> SmoothedSystem:
    weights = robust_weights(system) if robust else np.ones(len(system))
    judged = weighted = system.weighted(weights)
    filtered = kalman_filter(weighted)
    states = solve_batch(weighted).smoothed() if method == "batch" else rts(weighted, filtered)
    outliers = is_outlier(disagreement(system, weights, states), system.present.sum(axis=1))
    if robust:
        judged = system.without(outliers)
        filtered = kalman_filter(judged)
    report = _report(judged, filtered)
    return SmoothedSystem(states, weights, outliers, filtered.log_likelihood, filtered.nis, report)


def _report(system: LinearSystem, filtered: Filtered) -> Consistency:
    nis, numbers = filtered.nis, system.present.sum(axis=1)
    whitened = np.full(system.measurements.shape, np.nan)
    for k, step in enumerate(filtered.updates):
        if step is not None:
            whitened[k, : len(step.whitened)] = step.whitened
    known = np.isfinite(nis)
    return consistency(nis[known], numbers[known], successive(whitened, system.chains))
