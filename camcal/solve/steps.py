"""The linear step: normal equations of residual blocks in arrow form, their Schur complement, triangular factors.

Parameters are either shared by every residual or belong to one of many small groups (one pose per view) that never
meet in a residual. With J = [J_g J_s] the normal matrix is an arrow; the groups are eliminated exactly, so a step
costs time linear in their number. Source: Triggs, McLauchlan, Hartley, Fitzgibbon, Bundle Adjustment — A Modern
Synthesis, 2000, section 6.

Symmetric block-tridiagonal matrices are blocks (K, n, n) on the diagonal and (K - 1, n, n) below it. Their banded
factor takes time proportional to K; nothing is inverted as a whole.
Source: Rue and Held, Gaussian Markov Random Fields, 2005, section 2.4.
"""

from functools import cached_property

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass, field, replace
from camcal.solve.losses import Loss

_SMALL = 24  # rows of a triangle that is inverted as a whole


class SingularError(Exception):
    """The normal matrix has no inverse: some parameters cannot be distinguished."""


@dataclass(frozen=True, eq=False)
class Jacobian:
    """Derivatives (M, D, L) by shared parameters: `columns` (L,) for all rows alike, or (M, L) row by row."""

    values: Array
    columns: Array


@dataclass(frozen=True, eq=False)
class Block:
    """Residuals (M, D) of one kind and their derivatives.

    shared: by shared parameters. group: (M, D, g) by the parameters of the row's own group, or None.
    The rows of a group are adjacent and `rows_per_group` in number (pad with weight 0); run i belongs to group i,
    or to groups[i] where given, each of which occurs once. group_columns: (g,) which parameters of a group these are,
    None for all. weights: (M,) inverse variances. loss: applied to the weighted squared residual.
    Arrays laid out with M last are the fast ones.
    """

    residuals: Array
    shared: tuple[Jacobian, ...] = ()
    group: Array | None = None
    rows_per_group: int = 0
    groups: Array | None = None
    group_columns: Array | None = None
    weights: Array | None = None
    loss: Loss | None = None

    def weighed(self) -> tuple[float, Array]:
        """Return the cost ½ Σ ρ of the rows, and their weights (M,), those of the loss included."""
        squared = np.einsum("md,md->m", self.residuals, self.residuals)
        weights = np.ones(len(squared)) if self.weights is None else self.weights
        squared = squared * weights
        if self.loss is None:
            return 0.5 * float(squared.sum()), weights
        return 0.5 * float(self.loss.cost(squared).sum()), np.asarray(weights * self.loss.weight(squared))


@dataclass(frozen=True, eq=False)
class Step:
    """A change of the shared parameters (S,) and of every group (G, g)."""

    shared: Array
    groups: Array

    def dot(self, other: "Step") -> float:
        """Return the inner product with another step."""
        return float(self.shared @ other.shared + np.sum(self.groups * other.groups))


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """The quadratic model of the cost ½ Σ ρ: cost, gradient and the arrow of JᵀWJ.

    group_group (G, g, g), group_shared (G, g, S), shared_shared (S, S), gradient as a Step,
    group_gradients (G, S): each group's own part of the shared gradient. group_products (G, D, D): each group's own
    part of shared_shared for the first D shared parameters, those on which all rows of a group depend.
    """

    cost: float
    gradient: Step
    group_group: Array
    group_shared: Array
    shared_shared: Array
    group_gradients: Array
    group_products: Array

    def damped(self, damping: float) -> "NormalEquations":
        """Return the equations with every diagonal element enlarged by the share `damping` (Marquardt's scaling)."""
        groups, shared = self.group_group.copy(), self.shared_shared.copy()
        for matrix in (groups, shared):
            diagonal = np.einsum("...ii->...i", matrix)
            # a parameter no residual depends on must not make the damped matrix singular
            diagonal += damping * np.maximum(diagonal, 1e-12 * (diagonal.max(initial=0.0) or 1.0))
        return replace(self, group_group=groups, shared_shared=shared)

    def restricted(self, columns: Array) -> "NormalEquations":
        """Return the equations of a subset of the shared parameters, the others held."""
        dense = columns[columns < self.group_products.shape[-1]]
        return NormalEquations(
            self.cost,
            Step(self.gradient.shared[columns], self.gradient.groups),
            group_group=self.group_group,
            group_shared=self.group_shared[:, :, columns],
            shared_shared=self.shared_shared[np.ix_(columns, columns)],
            group_gradients=self.group_gradients[:, columns],
            group_products=self.group_products[:, dense[:, None], dense],
        )

    def without_first(self, count: int) -> "NormalEquations":
        """Return the equations of what is left of the groups when their first `count` parameters are eliminated."""
        first, last = slice(0, count), slice(count, None)
        root = np.linalg.cholesky(self.group_group[:, first, first])
        size = self.group_group.shape[-1] - count
        right = [self.group_group[:, first, last], self.group_shared[:, first], self.gradient.groups[:, first, None]]
        gone = lower_inverse(root) @ np.concatenate(right, axis=2)
        gram = gone.transpose(0, 2, 1) @ gone
        own, others, dense = slice(0, size), slice(size, -1), self.group_products.shape[-1]
        return NormalEquations(
            self.cost - 0.5 * float(gram[:, -1, -1].sum()),
            Step(
                self.gradient.shared - gram[:, others, -1].sum(axis=0), self.gradient.groups[:, last] - gram[:, own, -1]
            ),
            group_group=self.group_group[:, last, last] - gram[:, own, own],
            group_shared=self.group_shared[:, last] - gram[:, own, others],
            shared_shared=self.shared_shared - gram[:, others, others].sum(axis=0),
            group_gradients=self.group_gradients - gram[:, others, -1],
            group_products=self.group_products - gram[:, others, others][:, :dense, :dense],
        )


@dataclass(frozen=True, eq=False)
class Factors:
    """Factors of the normal matrix: group_root (G, g, g) and shared_root (S, S) are lower Cholesky factors of the
    groups' blocks and of the Schur complement, group_inverse (G, g, g) is group_root⁻¹; reduced (G, g, S) is
    group_inverse · group_shared.
    """

    group_root: Array
    group_inverse: Array
    reduced: Array
    shared_root: Array
    equations: NormalEquations = field(repr=False)

    @cached_property
    def _eliminated(self) -> Array:
        return (self.group_inverse @ self.equations.gradient.groups[..., None])[..., 0]

    def reduced_gradient(self) -> Array:
        """Return the gradient (S,) of the cost by the shared parameters when every group follows them."""
        return np.asarray(self.equations.gradient.shared - np.einsum("gis,gi->s", self.reduced, self._eliminated))

    def solve(self) -> Step:
        """Return the step that minimises the quadratic model."""
        eliminated = self._eliminated
        shared = -self._shared_inverse.T @ (self._shared_inverse @ self.reduced_gradient())
        followed = (eliminated + self.reduced @ shared)[..., None]
        groups = -(self.group_inverse.transpose(0, 2, 1) @ followed)[..., 0]
        return Step(shared, groups)

    @cached_property
    def _shared_inverse(self) -> Array:
        return np.asarray(lower_inverse(self.shared_root[None])[0])

    @cached_property
    def _shared_covariance(self) -> Array:
        return np.asarray(self._shared_inverse.T @ self._shared_inverse)

    def shared_covariance(self) -> Array:
        """Return the inverse of the Schur complement (S, S): the covariance of the shared parameters."""
        return self._shared_covariance

    def group_covariances(self, count: int | None = None, shared: Array | None = None) -> Array:
        """Return the covariances (G, n, n) of the groups' first `count` parameters, the uncertainty of the shared
        parameters included; shared: (D, D) that of the first D of them, where it is not what these equations say.
        """
        shared = self.shared_covariance() if shared is None else shared
        by_root = self.group_inverse[:, :, :count].transpose(0, 2, 1)
        coupling = by_root @ self.reduced[:, :, : len(shared)]
        return np.asarray(by_root @ by_root.transpose(0, 2, 1) + coupling @ shared @ coupling.transpose(0, 2, 1))

    def log_determinant(self) -> float:
        """Return the logarithm of the determinant of the normal matrix."""
        roots = np.einsum("gii->gi", self.group_root), np.diag(self.shared_root)
        return float(sum(2 * np.log(root).sum() for root in roots))

    def group_information(self) -> Array:
        """Return each group's part (G, D, D) of the Schur complement of the first D shared parameters, on which all
        rows of a group depend.
        """
        reduced = self.reduced[:, :, : self.equations.group_products.shape[-1]]
        return np.asarray(self.equations.group_products - reduced.transpose(0, 2, 1) @ reduced)

    def group_scores(self) -> Array:
        """Return each group's part (G, S) of the reduced gradient; at a minimum they sum to zero."""
        own = np.einsum("gis,gi->gs", self.reduced, self._eliminated)
        return np.asarray(self.equations.group_gradients - own)

    def decrease(self) -> float:
        """Return the decrease of the cost predicted by the quadratic model: ½ gᵀ H⁻¹ g."""
        return -0.5 * self.solve().dot(self.equations.gradient)


def factorise(equations: NormalEquations) -> Factors:
    """Return the factors of the normal equations; raises SingularError if they have no unique solution."""
    try:
        group_root = np.linalg.cholesky(equations.group_group)
        group_inverse = lower_inverse(group_root)
        reduced = group_inverse @ equations.group_shared
        rows = reduced.reshape(reduced.shape[0] * reduced.shape[1], reduced.shape[2])
        schur = equations.shared_shared - rows.T @ rows
        # Jacobi scaling first: pixels, radians and lens coefficients differ by many orders of magnitude
        scale = np.sqrt(np.maximum(np.diag(equations.shared_shared), np.finfo(float).tiny))
        root = np.linalg.cholesky(schur / np.outer(scale, scale)) * scale[:, None]
    except np.linalg.LinAlgError as error:
        raise SingularError(str(error)) from error
    return Factors(group_root, group_inverse, reduced, root, equations)


def lowest_along(promised: float, share: float, change: float) -> float:
    """Return the share of a step at which the cost along it is lowest, by the parabola through two of its places.

    promised: by how much the cost falls over the whole step if it is quadratic, half the slope at its start. change: of
    the cost after `share` of the step. The share itself where the cost curves downwards.
    """
    rise = change + 2 * promised * share
    return promised * share**2 / rise if rise > 0 else share


def lower_inverse(root: Array) -> Array:
    """Return the inverses of many lower triangles (G, g, g), by halves until these are small.

    Rows count by their diagonal, as parameters have different units.
    """
    size = root.shape[-1]
    if size <= _SMALL:
        scale = np.einsum("gii->gi", root)
        return np.asarray(np.tril(np.linalg.inv(root / scale[:, :, None])) / scale[:, None, :])
    result, half = np.zeros(root.shape), size // 2
    result[:, :half, :half] = first = lower_inverse(root[:, :half, :half])
    result[:, half:, half:] = last = lower_inverse(root[:, half:, half:])
    result[:, half:, :half] = -last @ (root[:, half:, :half] @ first)
    return result


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


def factorise_tridiagonal(blocks: Array, beside: Array) -> TridiagonalFactor:
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
