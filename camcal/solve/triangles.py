"""Solving with triangular factors: of many small matrices, of one large matrix, and of a block-tridiagonal one.

Symmetric block-tridiagonal matrices are blocks (K, n, n) on the diagonal and (K - 1, n, n) below it. Their banded
factor takes time proportional to K; nothing is inverted as a whole.
Source: Rue and Held, Gaussian Markov Random Fields, 2005, section 2.4.
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array


def lower_solve(root: Array, right: Array) -> Array:
    """Return root⁻¹ · right for many small lower triangles (G, g, g), by substitution over the g rows."""
    result = np.empty_like(right, dtype=float)
    for i in range(root.shape[-1]):
        known = root[:, i, None, :i] @ result[:, :i]
        result[:, i] = (right[:, i] - known[:, 0]) / root[:, i, i, None]
    return result


def upper_solve(root: Array, right: Array) -> Array:
    """Return root⁻ᵀ · right for many small lower triangles (G, g, g)."""
    result = np.empty_like(right, dtype=float)
    for i in reversed(range(root.shape[-1])):
        known = root[:, i + 1 :, i][:, None, :] @ result[:, i + 1 :]
        result[:, i] = (right[:, i] - known[:, 0]) / root[:, i, i, None]
    return result


def cholesky_solve(root: Array, right: Array) -> Array:
    """Return A⁻¹ · right for A = root · rootᵀ, root lower triangular."""
    from scipy.linalg import cho_solve

    return np.asarray(cho_solve((root, True), right)) if len(root) else np.zeros_like(right)


@dataclass(frozen=True, eq=False)
class TridiagonalFactor:
    """The lower banded Cholesky factor (2 n, K n) of a matrix with blocks of size n."""

    band: Array
    size: int

    def solve(self, right: Array) -> Array:
        """Return the solution (K, n) for a right side (K, n)."""
        from scipy.linalg import cho_solve_banded

        return np.asarray(cho_solve_banded((self.band, True), right.ravel(), check_finite=False).reshape(right.shape))

    def log_determinants(self) -> Array:
        """Return what each block (K,) adds to the logarithm of the determinant."""
        return np.asarray(2 * np.log(self.band[0]).reshape(-1, self.size).sum(axis=1))

    def blocks(self) -> tuple[Array, Array]:
        """Return the factor's blocks (K, n, n) on the diagonal and (K - 1, n, n) below it."""
        return blocks_of(self.band, self.size)

    def covariances(self) -> tuple[Array, Array]:
        """Return the blocks of the inverse: (K, n, n) on the diagonal and (K - 1, n, n) to the right of it.

        Given the next state, a state has the covariance C of its own block of the factor, and follows the next with the
        gain G: P = C + G P_next Gᵀ, the smoother's recursion; Cov(x, x_next) = G P_next.
        """
        diagonal, below = self.blocks()
        inverse = np.linalg.inv(diagonal)
        result = np.swapaxes(inverse, 1, 2) @ inverse
        gains = -np.swapaxes(below @ inverse[:-1], 1, 2)
        beside = np.empty_like(gains)
        for k in reversed(range(len(gains))):
            beside[k] = gains[k] @ result[k + 1]
            result[k] += beside[k] @ gains[k].T
        return (result + np.swapaxes(result, 1, 2)) / 2, beside


def factorise(blocks: Array, beside: Array) -> TridiagonalFactor:
    """Return the factor of a positive definite matrix; raises scipy's LinAlgError if it is not."""
    from scipy.linalg import cholesky_banded

    return TridiagonalFactor(
        cholesky_banded(banded(blocks, beside), overwrite_ab=True, lower=True, check_finite=False), blocks.shape[1]
    )


def banded(blocks: Array, beside: Array) -> Array:
    """Return the lower band (2 n, K n) of a symmetric matrix."""
    count, size, _ = blocks.shape
    band = np.zeros((2 * size, count, size))
    for row in range(size):
        for column in range(size):
            if row >= column:
                band[row - column, :, column] = blocks[:, row, column]
            band[size + row - column, :-1, column] = beside[:, row, column]
    return band.reshape(2 * size, count * size)


def blocks_of(band: Array, size: int) -> tuple[Array, Array]:
    """Return the blocks (K, n, n) on the diagonal and (K - 1, n, n) below it of a lower triangular band (2 n, K n)."""
    band = band.reshape(2 * size, -1, size)
    diagonal = np.zeros((band.shape[1], size, size))
    below = np.zeros((band.shape[1] - 1, size, size))
    for row in range(size):
        for column in range(size):
            if row >= column:
                diagonal[:, row, column] = band[row - column, :, column]
            below[:, row, column] = band[size + row - column, :-1, column]
    return diagonal, below
