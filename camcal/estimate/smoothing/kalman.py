"""The steps of a Kalman filter and of its smoother, on vectors or on the error of a state that is none.

A linear filter keeps its state in `Gaussian.mean`. One on rotations keeps poses outside and lets the mean be the error
of the pose, zero after every correction: the same steps serve both. What innovations say about the noise that was
assumed is in `consistency`; whole series are in `linear_system` and `extended`.
Source: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, ch. 5 and 8.
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array, readonly
from camcal.errors import InvalidInput

_LOG_2PI = float(np.log(2 * np.pi))


@dataclass(frozen=True, eq=False)
class Gaussian:
    """A mean (n,) and a covariance (n, n), in the units of the state."""

    mean: Array
    covariance: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "mean", readonly(self.mean, (None,), "mean"))
        size = len(self.mean)
        object.__setattr__(self, "covariance", readonly(self.covariance, (size, size), "covariance"))


@dataclass(frozen=True, eq=False)
class Updated:
    """A state after a measurement, and how the measurement fits what was expected of it.

    nis: normalised innovation squared, χ² of m degrees of freedom if all noise is as assumed. whitened: (m,) the
    innovation in units of its own noise. log_likelihood: of the measurement, given all before it.
    innovation_covariance: (m, m).
    """

    state: Gaussian
    nis: float
    log_likelihood: float
    innovation_covariance: Array
    whitened: Array


def predict(state: Gaussian, F: Array, Q: Array, control: Array | None = None) -> Gaussian:
    """Return the state a step later: F x + control, with covariance F P Fᵀ + Q.

    F: (n, n), of a non-linear motion its Jacobian (then give the mean by `control`). Q: (n, n). control: (n,).
    """
    mean = F @ state.mean if control is None else F @ state.mean + control
    return Gaussian(mean, _symmetric(F @ state.covariance @ F.T + Q))


def update(state: Gaussian, innovation: Array, H: Array, R: Array) -> Updated:
    """Return the state corrected by a measurement.

    innovation: (m,) measured minus expected; where the measurement is no vector, its difference as one (an angle
    wrapped, a rotation's logarithm). H: (m, n) = d expected / d state. R: (m, m), the sensor's covariance.
    The covariance is Joseph's, (I - K H) P (I - K H)ᵀ + K R Kᵀ: P - K H P loses symmetry and is true of one gain only.
    Raises InvalidInput if the innovation has no proper covariance.
    """
    cross = H @ state.covariance
    S = _symmetric(cross @ H.T + R)
    whitener = _whitener(S)
    whitened = whitener @ innovation
    gain = cross.T @ (whitener.T @ whitener)
    keep = np.eye(len(state.mean)) - gain @ H
    covariance = _symmetric(keep @ state.covariance @ keep.T + gain @ R @ gain.T)
    nis = float(whitened @ whitened)
    log_likelihood = np.log(whitener.diagonal()).sum() - 0.5 * (nis + len(innovation) * _LOG_2PI)
    return Updated(Gaussian(state.mean + gain @ innovation, covariance), nis, float(log_likelihood), S, whitened)


def smoother_gain(filtered: Gaussian, predicted: Gaussian, F: Array) -> Array:
    """Return the gain (n, n) that takes what later measurements changed one step back: P Fᵀ P⁻¹.

    filtered: the state at this step. predicted: of the next one, before its measurement. F: between them.
    """
    return np.linalg.solve(predicted.covariance, F @ filtered.covariance).T


def smooth_back(filtered: Gaussian, predicted: Gaussian, smoothed: Gaussian, F: Array) -> Gaussian:
    """Return the state at a step given all measurements, from the smoothed state of the next step.

    Source: Rauch, Tung, Striebel 1965.
    """
    gain = smoother_gain(filtered, predicted, F)
    mean = filtered.mean + gain @ (smoothed.mean - predicted.mean)
    change = gain @ (smoothed.covariance - predicted.covariance) @ gain.T
    return Gaussian(mean, _symmetric(filtered.covariance + change))


def gate(freedom: float, confidence: float = 0.999) -> float:
    """Return what the NIS of a good measurement stays below, with this probability: the quantile of χ²."""
    from scipy.special import gammaincinv  # χ² without scipy.stats, which takes a second to import

    return float(2 * gammaincinv(freedom / 2, confidence))


def _symmetric(matrix: Array) -> Array:
    return np.asarray(0.5 * (matrix + matrix.T))


def _whitener(S: Array) -> Array:
    """Return W with W S Wᵀ = 1, of a covariance of few numbers."""
    try:
        # Most measurements are one number: its root is ten times faster than LAPACK's.
        if len(S) == 1 and S[0, 0] > 0:
            return np.asarray(S**-0.5)
        return np.linalg.inv(np.linalg.cholesky(S))
    except np.linalg.LinAlgError as error:
        raise InvalidInput("a measurement's covariance is not positive definite; is a sigma 0?") from error
