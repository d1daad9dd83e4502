"""The dense linear step: orthogonal factors of the weighted Jacobian itself, whose condition JᵀJ would square.

For problems of a few hundred parameters without groups. Columns are scaled before anything is decided about rank.
Source: Björck, Numerical Methods for Least Squares Problems, 1996, sections 2.7 and 9.2.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from camcal.arrays import Array
from camcal.solve.steps import Block, SingularError

_NEGLIGIBLE = 0.05  # parts of a null vector below this share of its largest one are left out of its description


@dataclass(frozen=True, eq=False)
class DenseEquations:
    """The linearised problem: cost ½ Σ ρ, weighted residuals (R,) and their Jacobian (R, n).

    root_weights: (R,) what residuals and Jacobian were multiplied by, the weights of the loss included.
    """

    cost: float
    residuals: Array
    jacobian: Array
    root_weights: Array

    @cached_property
    def gradient(self) -> Array:
        """The gradient Jᵀ r (n,) of the cost."""
        return np.asarray(self.jacobian.T @ self.residuals)

    @cached_property
    def column_norms(self) -> Array:
        """The lengths (n,) of the columns of the Jacobian; 1 for a column of zeros."""
        lengths = np.linalg.norm(self.jacobian, axis=0)
        return np.where(lengths > 0, lengths, 1.0)

    def factors(self, scale: Array | None = None, columns: Array | None = None) -> "DenseFactors":
        """Return the factors of the Jacobian with its columns divided by `scale` (n,), by default their lengths.

        columns: (n,) which of them to take, by default all.
        """
        chosen = slice(None) if columns is None else columns
        return factorise_dense(self.jacobian[:, chosen], (self.column_norms if scale is None else scale)[chosen])


@dataclass(frozen=True, eq=False)
class DenseFactors:
    """J = left · diag(singular) · right · diag(scale): left (R, k), singular (k,) falling, right (k, n), scale (n,)."""

    left: Array
    singular: Array
    right: Array
    scale: Array

    @cached_property
    def rank(self) -> int:
        """How many combinations of parameters the residuals depend on."""
        if not len(self.singular):
            return 0
        limit = max(self.left.shape[0], len(self.scale)) * np.finfo(float).eps * self.singular[0]
        return int(np.count_nonzero(self.singular > limit))

    @property
    def condition(self) -> float:
        """The largest by the smallest singular value of the scaled Jacobian; infinite if its rank is deficient."""
        if self.rank < len(self.scale):
            return np.inf
        return float(self.singular[0] / self.singular[-1]) if len(self.singular) else 1.0

    def solve(self, right_side: Array, damping: float = 0.0) -> Array:
        """Return the x (n,) that minimises ‖J x - b‖² + damping · ‖diag(scale) x‖²; raises SingularError."""
        if damping == 0 and self.rank < len(self.scale):
            raise SingularError(f"rank {self.rank} of {len(self.scale)}")
        filtered = self.singular / (self.singular**2 + damping) * (self.left.T @ right_side)
        return np.asarray(self.right.T @ filtered / self.scale)

    def covariance(self) -> Array:
        """Return (JᵀJ)⁻¹ (n, n), without damping; NaN where a parameter is part of what cannot be observed."""
        inverse = self.right[: self.rank].T / self.singular[: self.rank]
        with np.errstate(over="ignore"):  # the variance of what hardly matters may be beyond all numbers
            result = inverse @ inverse.T / np.outer(self.scale, self.scale)
        result[self.unobserved] = np.nan
        result[:, self.unobserved] = np.nan
        return np.asarray(result)

    def leverage(self) -> Array:
        """Return how much each residual (R,) pulls its own prediction, 0 … 1; they sum to the rank."""
        return np.asarray(np.sum(self.left[:, : self.rank] ** 2, axis=1))

    @cached_property
    def _missing(self) -> Array:
        """Independent changes (d, n) of the scaled parameters that change no residual, each of as few as can be."""
        if len(self.right) == len(self.scale):
            return _sparse(self.right[self.rank :])
        return _sparse(np.linalg.svd(self.right[: self.rank], full_matrices=True)[2][self.rank :])

    @cached_property
    def _involved(self) -> Array:
        """Which parameters (d, n) have a part in each of them that is worth naming."""
        shares = np.abs(self._missing)
        return np.asarray(shares > _NEGLIGIBLE * shares.max(axis=1, keepdims=True, initial=0))

    @property
    def unobserved(self) -> Array:
        """Which parameters (n,) are part of a combination that changes no residual."""
        return np.asarray(self._involved.any(axis=0))

    def null_space(self, names: Sequence[str]) -> list[Mapping[str, float]]:
        """Return the changes that change no residual, by name: {a: 1, b: -1} means a up by as much as b goes down."""
        found: list[Mapping[str, float]] = []
        for vector, involved in zip(self._missing / self.scale, self._involved, strict=True):
            parts = vector / vector[involved][np.argmax(np.abs(vector[involved]))]
            found.append({names[int(index)]: float(parts[index]) for index in np.flatnonzero(involved)})
        return found


def _sparse(vectors: Array) -> Array:
    """Return a basis of the same space as rows (d, n) in echelon form, so that unrelated changes are not mixed."""
    from scipy.linalg import qr

    if len(vectors) < 2:
        return vectors
    pivots = qr(vectors, mode="r", pivoting=True)[1][: len(vectors)]
    return np.asarray(np.linalg.solve(vectors[:, pivots], vectors))


def factorise_dense(jacobian: Array, scale: Array) -> DenseFactors:
    """Return the factors of a Jacobian (R, n) with columns divided by scale (n,).

    LAPACK's singular values of a tall matrix are those of the triangle of its QR factors.
    """
    try:
        left, singular, right = np.linalg.svd(jacobian / scale, full_matrices=False)
    except np.linalg.LinAlgError as error:
        raise SingularError(str(error)) from error
    return DenseFactors(left, singular, right, scale)


def assemble_dense(blocks: Sequence[Block], count: int) -> DenseEquations:
    """Return the equations of residual blocks over `count` shared parameters; blocks with groups are refused."""
    cost, residuals, jacobians, weights = 0.0, [np.zeros(0)], [np.zeros((0, count))], [np.zeros(0)]
    for block in blocks:
        if block.group is not None:
            raise ValueError("a dense step has no eliminated groups")
        part, root = _weigh(block)
        cost += part
        root = np.repeat(root, block.residuals.shape[1])
        weights.append(root)
        residuals.append(root * block.residuals.ravel())
        jacobians.append(root[:, None] * _widened(block, count))
    return DenseEquations(cost, np.concatenate(residuals), np.concatenate(jacobians), np.concatenate(weights))


def _weigh(block: Block) -> tuple[float, Array]:
    """Return the cost of a block, and the root (M,) of each row's weight with the loss's."""
    squared = np.einsum("md,md->m", block.residuals, block.residuals)
    weights = np.ones(len(squared)) if block.weights is None else block.weights
    squared = squared * weights
    if block.loss is None:
        return 0.5 * float(squared.sum()), np.sqrt(weights)
    return 0.5 * float(block.loss.cost(squared).sum()), np.sqrt(weights * block.loss.weight(squared))


def _widened(block: Block, count: int) -> Array:
    """Return the Jacobian (M·D, count) of a block by all shared parameters."""
    length, dimension = block.residuals.shape
    wide = np.zeros((length, dimension, count))
    for part in block.shared:
        if part.columns.ndim == 1:
            wide[:, :, part.columns] += part.values
        else:
            for column, values in zip(part.columns.T, np.moveaxis(part.values, 2, 0), strict=True):
                wide[np.arange(length), :, column] += values
    return wide.reshape(length * dimension, count)
