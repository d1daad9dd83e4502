"""All states of a linear system at once: maximum likelihood by one banded Cholesky factorisation.

The normal equations couple a state with its neighbours only: blocks on the diagonal and beside it. The factor gives
the states, their covariances and the likelihood in time proportional to their number; nothing is inverted as a whole.
Source: Barfoot, State Estimation for Robotics, 2017, section 3.2; Rue and Held, Gaussian Markov Random Fields, 2005.
"""

from dataclasses import dataclass, replace

import numpy as np

from camcal.arrays import Array
from camcal.errors import InsufficientData, InvalidInput
from camcal.estimate.smoothing.linear_system import LinearSystem, Smoothed
from camcal.solve.triangles import banded, blocks_of

_LOST = 1e-14  # a pivot this much smaller than its diagonal is rounding
_SMALL_STATE = 3  # up to this size all covariances come from one banded triangle, above it from a loop


@dataclass(frozen=True, eq=False)
class BatchSolution:
    """The most likely states (K, n), and the lower factor of the normal equations.

    diagonal: (K, n, n) the factor's blocks on the diagonal. below: (K - 1, n, n) those under them.
    squares: all squared residuals in units of their noise, and freedom: their expected sum. log_likelihood: of the
    measurements, all states integrated out and nothing assumed of the first.
    """

    means: Array
    diagonal: Array
    below: Array
    squares: float
    freedom: int
    log_likelihood: float

    def smoothed(self) -> Smoothed:
        """Return the states with their covariances (K, n, n)."""
        return Smoothed(self.means, _covariances(self.diagonal, self.below))


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
    squares = _squares(system, process, measured, means)
    freedom = int(system.present.sum() - right.shape[1] * (1 + np.sum(~system.linked)))
    # ln ∫ p(y, x) dx: the integrand at its peak and the curvature there; all is Gaussian, so this is exact.
    volume = 0.5 * (squares + log_process + log_noise + freedom * np.log(2 * np.pi)) + np.log(factor[0]).sum()
    return BatchSolution(means, diagonal, below, squares, freedom, -float(volume))


def invertible(system: LinearSystem) -> LinearSystem:
    """Return the system with a millionth of the variances added to its process noise: noise of rank 1 has no inverse.

    Weights of measurements, and which noise is most likely, do not feel it.
    """
    variances = np.einsum("kii->ki", system.process)
    return replace(system, process=system.process + 1e-6 * variances[:, :, None] * np.eye(variances.shape[1]))


_UNOBSERVED = "not all states are determined by the measurements"
_HIDDEN = "q and sigma are so unlike in size that rounding hides what was measured; are their units right?"


def _process_precision(system: LinearSystem) -> tuple[Array, float]:
    """Return Q⁻¹ (K - 1, n, n), zero where a chain ends, and the sum of ln |Q|."""
    linked = system.linked[:, None, None]
    try:
        precision, log_determinant = _inverted(np.where(linked, system.process, np.eye(system.process.shape[-1])))
    except np.linalg.LinAlgError as error:
        raise InvalidInput("process noise without inverse (discrete noise has rank 1): smooth with rts") from error
    return np.where(linked, precision, 0.0), log_determinant


def _measured_precision(system: LinearSystem) -> tuple[Array, float]:
    """Return R⁻¹ (K, m, m) of what was measured, zero for what was not, and the sum of ln |R|."""
    present = system.present
    both = present[:, :, None] & present[:, None, :]
    try:
        precision, log_determinant = _inverted(np.where(both, system.noise, np.eye(present.shape[1])))
    except np.linalg.LinAlgError as error:
        raise InvalidInput("a measurement's covariance is not positive definite; is a sigma 0?") from error
    return np.where(both, precision, 0.0), log_determinant


def _inverted(matrices: Array) -> tuple[Array, float]:
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


def _squares(system: LinearSystem, process: Array, measured: Array, means: Array) -> float:
    """Return the sum of all squared residuals, in units of their noise."""
    moved = means[1:] - np.einsum("kij,kj->ki", system.transitions, means[:-1]) - system.controls
    off = np.nan_to_num(system.measurements - means @ system.observation.T)
    return float(np.einsum("ki,kij,kj->", moved, process, moved) + np.einsum("ki,kij,kj->", off, measured, off))


def _covariances(diagonal: Array, below: Array) -> Array:
    """Return the blocks (K, n, n) on the diagonal of the inverse of L Lᵀ.

    Given the next state, a state has covariance C = (L Lᵀ)⁻¹ of its own block, and follows the next with the gain
    G = -L⁻ᵀ Bᵀ, B the block below: P = C + G P_next Gᵀ, the smoother's recursion.
    """
    inverse = np.linalg.inv(diagonal)
    own = np.swapaxes(inverse, 1, 2) @ inverse
    gains = -np.swapaxes(below @ inverse[:-1], 1, 2)
    result = _recursion_as_triangle(own, gains) if own.shape[1] <= _SMALL_STATE else _recursion(own, gains)
    return np.asarray((result + np.swapaxes(result, 1, 2)) / 2)


def _recursion(own: Array, gains: Array) -> Array:
    result = own.copy()
    for k in reversed(range(len(gains))):
        result[k] += gains[k] @ result[k + 1] @ gains[k].T
    return result


def _recursion_as_triangle(own: Array, gains: Array) -> Array:
    """Return what `_recursion` does: it is linear in the entries of P, a banded triangle that LAPACK solves."""
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
