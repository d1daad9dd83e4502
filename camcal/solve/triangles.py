"""Solving with triangular factors: of many small matrices at once, and of one large matrix."""

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
