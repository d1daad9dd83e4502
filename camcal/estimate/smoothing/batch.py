"""All states of a linear system at once: maximum likelihood by one banded Cholesky factorisation.

The normal equations couple a state with its neighbours only: blocks on the diagonal and beside it. The factor gives
the states, their covariances and the likelihood in time proportional to their number; nothing is inverted as a whole.
Measurements that do not fit get smaller weights; the smoothed system says which are outliers, and whether the rest is
as consistent as its noise claims.
Source: Barfoot, State Estimation for Robotics, 2017, section 3.2; Rue and Held, Gaussian Markov Random Fields, 2005.
"""

import numpy as np

from camcal.arrays import Array, BoolArray, FloatArray
from camcal.dataclass import dataclass, replace
from camcal.errors import InsufficientData, InvalidInput, NotConverged
from camcal.estimate.smoothing.kalman import Consistency, consistency, gate, successive
from camcal.estimate.smoothing.linear_system import Filtered, LinearSystem, kalman_filter, rts
from camcal.solve.losses import Huber
from camcal.solve.steps import banded, blocks_of

_LOST = 1e-14  # a pivot this much smaller than its diagonal is rounding
_SMALL_STATE = 3  # up to this size all covariances come from one banded triangle, above it from a loop
_UNOBSERVED = "not all states are determined by the measurements"
_HIDDEN = "q and sigma differ too much in magnitude (rounding errors): check their units"

OUTLIER_CONFIDENCE = 0.999
_GOOD = 0.8214  # share of good measurements within Huber's bound; for one number the usual 1.345 σ
_SETTLED = 1e-3  # of a weight: far less than the weights matter
_ITERATIONS = 100
METHODS = ("rts", "batch")
LARGEST = 1e50  # of measurements and of noise: their squares, and products of these, are numbers


@dataclass(frozen=True, eq=False)
class BatchSolution:
    """The most likely states (K, n), and the lower factor of the normal equations.

    diagonal: (K, n, n) the factor's blocks on the diagonal. below: (K - 1, n, n) those under them.
    squares: all squared residuals in units of their noise, and degrees_of_freedom: their expected sum.
    log_likelihood: of the measurements, all states integrated out and nothing assumed of the first.
    """

    means: Array
    diagonal: Array
    below: Array
    squares: float
    degrees_of_freedom: int
    log_likelihood: float

    def smoothed(self) -> tuple[Array, Array]:
        """Return the states (K, n) with their covariances (K, n, n), the blocks on the diagonal of the inverse of L Lᵀ.

        Given the next state, a state has covariance C = (L Lᵀ)⁻¹ of its own block, and follows the next with the gain
        G = -L⁻ᵀ Bᵀ, B the block below: P = C + G P_next Gᵀ, the smoother's recursion.
        """
        inverse = np.linalg.inv(self.diagonal)
        own = np.swapaxes(inverse, 1, 2) @ inverse
        gains = -np.swapaxes(self.below @ inverse[:-1], 1, 2)
        if own.shape[1] <= _SMALL_STATE:
            result = _recursion_as_triangle(own, gains)
        else:
            result = own.copy()
            for k in reversed(range(len(gains))):
                result[k] += gains[k] @ result[k + 1] @ gains[k].T
        return self.means, np.asarray((result + np.swapaxes(result, 1, 2)) / 2)


def solve_batch(system: LinearSystem) -> BatchSolution:
    """Return the most likely states given all measurements.

    Raises InsufficientData if a state is not observed, InvalidInput if process noise has no inverse.
    """
    from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded

    if system.unobserved():
        raise InsufficientData(_UNOBSERVED)
    process, log_process = _process_precision(system)
    measured, log_noise = _measured_precision(system)
    blocks, beside, right = _normal_equations(system, process, measured)
    band = banded(blocks, beside)
    before = band[0].copy()
    try:
        factor = cholesky_banded(band, overwrite_ab=True, lower=True, check_finite=False)
    except LinAlgError as error:
        raise InsufficientData(_HIDDEN) from error
    if not (factor[0] ** 2 > _LOST * before).all():
        raise InsufficientData(_HIDDEN)
    means = cho_solve_banded((factor, True), right.ravel(), check_finite=False).reshape(right.shape)
    diagonal, below = blocks_of(factor, right.shape[1])
    moved = means[1:] - np.einsum("kij,kj->ki", system.transitions, means[:-1]) - system.controls
    off = np.nan_to_num(system.measurements - means @ system.observation.T)
    squares = float(np.einsum("ki,kij,kj->", moved, process, moved) + np.einsum("ki,kij,kj->", off, measured, off))
    degrees_of_freedom = int(system.present.sum() - right.shape[1] * (1 + np.sum(~system.linked)))
    # ln ∫ p(y, x) dx: the integrand at its peak and the curvature there; all is Gaussian, so this is exact.
    volume = (
        0.5 * (squares + log_process + log_noise + degrees_of_freedom * np.log(2 * np.pi)) + np.log(factor[0]).sum()
    )
    return BatchSolution(means, diagonal, below, squares, degrees_of_freedom, -float(volume))


def invertible(system: LinearSystem) -> LinearSystem:
    """Return the system with a millionth of the variances added to its process noise: noise of rank 1 has no inverse.

    Weights of measurements, and which noise is most likely, do not feel it.
    """
    variances = np.einsum("kii->ki", system.process)
    return replace(system, process=system.process + 1e-6 * variances[:, :, None] * np.eye(variances.shape[1]))


def _process_precision(system: LinearSystem) -> tuple[Array, float]:
    """Return Q⁻¹ (K - 1, n, n), zero where a chain ends, and the sum of ln |Q|."""
    linked = system.linked[:, None, None]
    try:
        precision, log_determinant = _invert(np.where(linked, system.process, np.eye(system.process.shape[-1])))
    except np.linalg.LinAlgError as error:
        raise InvalidInput("process noise without inverse (discrete noise has rank 1): smooth with rts") from error
    return np.where(linked, precision, 0.0), log_determinant


def _measured_precision(system: LinearSystem) -> tuple[Array, float]:
    """Return R⁻¹ (K, m, m) of what was measured, zero for what was not, and the sum of ln |R|."""
    present = system.present
    both = present[:, :, None] & present[:, None, :]
    try:
        precision, log_determinant = _invert(np.where(both, system.noise, np.eye(present.shape[1])))
    except np.linalg.LinAlgError as error:
        raise InvalidInput("a measurement's covariance is not positive definite: check for sigma = 0") from error
    return np.where(both, precision, 0.0), log_determinant


def _invert(matrices: Array) -> tuple[Array, float]:
    """Return the inverses (K, n, n) of covariances and the sum of their log-determinants; raises LinAlgError."""
    variances = np.einsum("kii->ki", matrices)
    if not (variances > 0).all():
        raise np.linalg.LinAlgError
    if matrices.shape[1] == 1:
        return 1 / matrices, float(np.log(matrices).sum())
    scale = np.sqrt(variances)  # noise of a position and of a velocity differ by dt²: balance them
    outer = scale[:, :, None] * scale[:, None, :]
    factor = np.linalg.cholesky(matrices / outer)
    pivots = np.einsum("kii->ki", factor)
    if (pivots**2 < _LOST).any():
        raise np.linalg.LinAlgError
    inverse = np.linalg.inv(factor)
    return np.swapaxes(inverse, 1, 2) @ inverse / outer, float(2 * np.log(pivots * scale).sum())


def _normal_equations(system: LinearSystem, process: Array, measured: Array) -> tuple[Array, Array, Array]:
    """Return the blocks on the diagonal (K, n, n), those below it (K - 1, n, n) and the right side (K, n)."""
    F, H = system.transitions, system.observation
    weighted = np.swapaxes(F, 1, 2) @ process  # Fᵀ Q⁻¹
    blocks = H.T @ measured @ H
    blocks[:-1] += weighted @ F
    blocks[1:] += process
    right = np.einsum("mn,kml,kl->kn", H, measured, np.nan_to_num(system.measurements))
    right[:-1] -= np.einsum("kij,kj->ki", weighted, system.controls)
    right[1:] += np.einsum("kij,kj->ki", process, system.controls)
    return blocks, -np.swapaxes(weighted, 1, 2), right


def _recursion_as_triangle(own: Array, gains: Array) -> Array:
    """Return P of P = own + G P_next Gᵀ: it is linear in the entries of P, a banded triangle that LAPACK solves."""
    from scipy.linalg.lapack import dtbtrs

    count, size, _ = own.shape
    entries = size * size
    band = np.zeros((2 * entries, count, entries))  # row 2 entries - 1 is the diagonal, above it what is to its right
    band[-1] = 1.0
    for row in range(entries):
        for column in range(entries):
            factor = gains[:, row // size, column // size] * gains[:, row % size, column % size]
            band[entries - 1 + row - column, 1:, column] = -factor
    solved, _ = dtbtrs(band.reshape(2 * entries, -1), own.reshape(-1, 1), uplo="U")
    return np.asarray(solved).reshape(own.shape)


def huber(numbers: int) -> Huber:
    """Return the loss of measurements of so many numbers each, in units of their noise.

    Its bound leaves 95 % of the efficiency of least squares where noise is normal. Source: Huber 1981, section 4.
    """
    return Huber(float(np.sqrt(gate(numbers, _GOOD))))


def robust_weights(system: LinearSystem, start: Array | None = None, settled: float = _SETTLED) -> Array:
    """Return the weights (K,) of the measurements at the minimum of Huber's loss, by reweighted least squares.

    start: (K,) an initial value. settled: change of a weight that is none. Raises NotConverged if they go on changing.
    """
    system = invertible(system)
    loss = huber(system.measurements.shape[1])
    weights = np.ones(len(system)) if start is None else start
    for _ in range(_ITERATIONS):
        before = weights
        weights = loss.weight(squared_residuals(system, solve_batch(system.weighted(weights)).means))
        if np.abs(weights - before).max() < settled:
            return weights
    raise NotConverged(f"robust weights not converged after {_ITERATIONS} iterations: try without --robust")


def squared_residuals(system: LinearSystem, means: Array) -> Array:
    """Return the squared residuals (K,) of measurements in units of their noise, 0 where nothing was measured."""
    off, noise, _ = _residuals(system, means)
    return np.asarray(np.einsum("km,km->k", off, np.linalg.solve(noise, off[:, :, None])[..., 0]))


def disagreement(system: LinearSystem, weights: Array, means: Array, covariances: Array) -> Array:
    """Return the squared deletion residual of each measurement, normalised by its covariance (K,).

    It is χ² of as many degrees of freedom as the measurement has numbers, if that one is good. NaN where the others
    say nothing, or nothing was measured. weights: (K,) with which the states were smoothed. means: (K, n) of the
    states. covariances: (K, n, n).
    Source: Cook and Weisberg, Residuals and Influence in Regression, 1982, section 2.2 (deletion residuals).
    """
    off, noise, present = _residuals(system, means)
    H = system.observation
    both = present[:, :, None] & present[:, None, :]
    used = noise / weights[:, None, None]
    spare = used - np.where(both, H @ covariances @ H.T, 0.0)
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


def require_size(values: Array, what: str) -> None:
    """Raise InvalidInput if a number among `values`, NaN aside, exceeds the numerical range."""
    if np.any(np.abs(values) > LARGEST):
        raise InvalidInput(f"{what} of more than {LARGEST:g} exceeds the numerical range: check the units")


@dataclass(frozen=True, eq=False)
class MeasurementFit:
    """How measurements fit what was smoothed; arrays are (K,), or (K, d) of d axes.

    weights: 1 unless smoothed robustly. outliers: bool. nis: normalised innovations squared of the filter, NaN where no
    measurement was predicted. log_likelihood: of the measurements, each given those before it. consistency: of the
    filter's innovations. Smoothed robustly, the last three are those without the outliers.
    """

    weights: FloatArray
    outliers: BoolArray
    nis: FloatArray
    log_likelihood: float
    consistency: Consistency


def smooth_system(
    system: LinearSystem, method: str = "rts", robust: bool = False
) -> tuple[Array, Array, MeasurementFit]:
    """Return the states of a system given all measurements, means (K, n) and covariances (K, n, n), and how these fit.

    method: of METHODS, both give the same states. robust: by Huber's loss.
    Raises InsufficientData if a state is not observed, InvalidInput if process noise has no inverse for the batch, or
    if it is so unlike measurement noise that rounding hides one of them.
    """
    try:
        weights = robust_weights(system) if robust else np.ones(len(system))
        judged = weighted = system.weighted(weights)
        filtered = kalman_filter(weighted)
        means, covariances = solve_batch(weighted).smoothed() if method == "batch" else rts(weighted, filtered)
        outliers = is_outlier(disagreement(system, weights, means, covariances), system.present.sum(axis=1))
        if robust:
            judged = system.without(outliers)
            filtered = kalman_filter(judged)
        report = _report(judged, filtered)
    except np.linalg.LinAlgError as error:
        raise InvalidInput("q and sigma are too different in magnitude: check their units") from error
    return means, covariances, MeasurementFit(weights, outliers, filtered.nis, filtered.log_likelihood, report)


def _report(system: LinearSystem, filtered: Filtered) -> Consistency:
    nis, numbers = filtered.nis, system.present.sum(axis=1)
    whitened = np.full(system.measurements.shape, np.nan)
    for k, step in enumerate(filtered.updates):
        if step is not None:
            whitened[k, : len(step.whitened)] = step.whitened
    known = np.isfinite(nis)
    return consistency(nis[known], numbers[known], successive(whitened, system.chains))
