"""The linear step: normal equations of residual blocks in arrow form, their Schur complement and its factors.

Parameters are either shared by every residual or belong to one of many small groups (one pose per view) that never
meet in a residual. With J = [J_g J_s] the normal matrix is an arrow; the groups are eliminated exactly, so a step
costs time linear in their number. Source: Triggs, McLauchlan, Hartley, Fitzgibbon, Bundle Adjustment — A Modern
Synthesis, 2000, section 6.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from camcal.arrays import Array
from camcal.solve.losses import Loss
from camcal.solve.triangles import cholesky_solve, lower_solve, upper_solve


class SingularError(Exception):
    """The normal matrix has no inverse: some parameters cannot be told apart."""


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
    or to groups[i] where given. weights: (M,) inverse variances. loss: applied to the weighted squared residual.
    Arrays laid out with M last are the fast ones.
    """

    residuals: Array
    shared: tuple[Jacobian, ...] = ()
    group: Array | None = None
    rows_per_group: int = 0
    groups: Array | None = None
    weights: Array | None = None
    loss: Loss | None = None


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
            self.group_group,
            self.group_shared[:, :, columns],
            self.shared_shared[np.ix_(columns, columns)],
            self.group_gradients[:, columns],
            self.group_products[:, dense[:, None], dense],
        )

    def without_first(self, count: int) -> "NormalEquations":
        """Return the equations of what is left of the groups when their first `count` parameters are eliminated."""
        first, last = slice(0, count), slice(count, None)
        root = np.linalg.cholesky(self.group_group[:, first, first])
        size = self.group_group.shape[-1] - count
        right = [self.group_group[:, first, last], self.group_shared[:, first], self.gradient.groups[:, first, None]]
        gone = lower_solve(root, np.concatenate(right, axis=2))
        gram = gone.transpose(0, 2, 1) @ gone
        own, others, dense = slice(0, size), slice(size, -1), self.group_products.shape[-1]
        return NormalEquations(
            self.cost - 0.5 * float(gram[:, -1, -1].sum()),
            Step(
                self.gradient.shared - gram[:, others, -1].sum(axis=0), self.gradient.groups[:, last] - gram[:, own, -1]
            ),
            self.group_group[:, last, last] - gram[:, own, own],
            self.group_shared[:, last] - gram[:, own, others],
            self.shared_shared - gram[:, others, others].sum(axis=0),
            self.group_gradients - gram[:, others, -1],
            self.group_products - gram[:, others, others][:, :dense, :dense],
        )


@dataclass(frozen=True, eq=False)
class Factors:
    """Factors of the normal matrix: group_root (G, g, g) and shared_root (S, S) are lower Cholesky factors of the
    groups' blocks and of the Schur complement; reduced (G, g, S) is group_root⁻¹ · group_shared.
    """

    group_root: Array
    reduced: Array
    shared_root: Array
    equations: NormalEquations = field(repr=False)

    @cached_property
    def _eliminated(self) -> Array:
        return lower_solve(self.group_root, self.equations.gradient.groups[..., None])[..., 0]

    def reduced_gradient(self) -> Array:
        """Return the gradient (S,) of the cost by the shared parameters when every group follows them."""
        return np.asarray(self.equations.gradient.shared - np.einsum("gis,gi->s", self.reduced, self._eliminated))

    def solve(self) -> Step:
        """Return the step that minimises the quadratic model."""
        eliminated = self._eliminated
        shared = -cholesky_solve(self.shared_root, self.reduced_gradient())
        groups = -upper_solve(self.group_root, (eliminated + self.reduced @ shared)[..., None])[..., 0]
        return Step(shared, groups)

    @cached_property
    def _shared_covariance(self) -> Array:
        return cholesky_solve(self.shared_root, np.eye(len(self.shared_root)))

    def shared_covariance(self) -> Array:
        """Return the inverse of the Schur complement (S, S): the covariance of the shared parameters."""
        return self._shared_covariance

    def group_covariances(self, count: int | None = None, shared: Array | None = None) -> Array:
        """Return the covariances (G, n, n) of the groups' first `count` parameters, the uncertainty of the shared
        parameters included; shared: (D, D) that of the first D of them, where it is not what these equations say.
        """
        shared = self.shared_covariance() if shared is None else shared
        by_root = self.inverse_group_root()[:, :, :count].transpose(0, 2, 1)
        coupling = by_root @ self.reduced[:, :, : len(shared)]
        return np.asarray(by_root @ by_root.transpose(0, 2, 1) + coupling @ shared @ coupling.transpose(0, 2, 1))

    def log_determinant(self) -> float:
        """Return the logarithm of the determinant of the normal matrix."""
        roots = np.einsum("gii->gi", self.group_root), np.diag(self.shared_root)
        return float(sum(2 * np.log(root).sum() for root in roots))

    def inverse_group_root(self) -> Array:
        """Return the inverses (G, g, g) of the groups' Cholesky factors."""
        identity = np.broadcast_to(np.eye(self.group_root.shape[-1]), self.group_root.shape)
        return lower_solve(self.group_root, identity)

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
        """Return by how much the quadratic model says the cost can fall: ½ gᵀ H⁻¹ g."""
        return -0.5 * self.solve().dot(self.equations.gradient)


def factorise(equations: NormalEquations) -> Factors:
    """Return the factors of the normal equations; raises SingularError if they have no unique solution."""
    try:
        group_root = np.linalg.cholesky(equations.group_group)
        if equations.group_shared.shape[2] > group_root.shape[2]:
            identity = np.broadcast_to(np.eye(group_root.shape[2]), group_root.shape)
            reduced = lower_solve(group_root, identity) @ equations.group_shared
        else:
            reduced = lower_solve(group_root, equations.group_shared)
        rows = reduced.reshape(reduced.shape[0] * reduced.shape[1], reduced.shape[2])
        schur = equations.shared_shared - rows.T @ rows
        # Jacobi scaling first: pixels, radians and lens coefficients differ by many orders of magnitude
        scale = np.sqrt(np.maximum(np.diag(equations.shared_shared), np.finfo(float).tiny))
        root = np.linalg.cholesky(schur / np.outer(scale, scale)) * scale[:, None]
    except np.linalg.LinAlgError as error:
        raise SingularError(str(error)) from error
    return Factors(group_root, reduced, root, equations)


def assemble(blocks: Sequence[Block], shared: int, groups: int, group_size: int) -> NormalEquations:
    """Return the normal equations of residual blocks over `shared` parameters and `groups` groups of `group_size`."""
    grouped = [part.columns for block in blocks if block.group is not None for part in block.shared]
    dense = max((int(columns.max(initial=-1)) + 1 for columns in grouped if columns.ndim == 1), default=0)
    total = _Sums(
        0.0,
        np.zeros(shared),
        np.zeros((groups, group_size)),
        np.zeros((groups, group_size, group_size)),
        np.zeros((groups, group_size, shared)),
        np.zeros((shared, shared)),
        np.zeros((groups, shared)),
        np.zeros((groups, dense, dense)),
    )
    for block in blocks:
        total.add(block)
    # a group that no residual depends on stays where it is
    total.group_group[~total.group_group.any(axis=(1, 2))] = np.eye(group_size)
    return NormalEquations(
        total.cost,
        Step(total.shared_gradient, total.group_gradient),
        total.group_group,
        total.group_shared,
        total.shared_shared,
        total.group_gradients,
        total.group_products,
    )


@dataclass
class _Sums:
    """The running sums of `assemble`."""

    cost: float
    shared_gradient: Array
    group_gradient: Array
    group_group: Array
    group_shared: Array
    shared_shared: Array
    group_gradients: Array
    group_products: Array

    def add(self, block: Block) -> None:
        weights = self._weigh(block)
        dense = [jacobian for jacobian in block.shared if jacobian.columns.ndim == 1]
        sparse = [jacobian for jacobian in block.shared if jacobian.columns.ndim == 2]
        columns = np.concatenate([jacobian.columns for jacobian in dense] or [np.zeros(0, np.intp)])
        parts = [jacobian.values for jacobian in dense]
        if block.group is not None:
            parts.insert(0, block.group)
        rows = _rows([*parts, block.residuals[..., None]], np.sqrt(weights))
        size = 0 if block.group is None else block.group.shape[-1]
        if block.rows_per_group:
            self._add_grouped(block, rows, size, columns)
        else:
            self._add_ungrouped(rows, columns)
        for jacobian in sparse:
            self._add_sparse(block, jacobian, rows, size, columns, weights)
        for first, second in combinations(sparse, 2):
            self._add_cross(first, second, weights)

    def _weigh(self, block: Block) -> Array:
        """Return the total weight of each row and add the block's cost."""
        squared = np.einsum("md,md->m", block.residuals, block.residuals)
        weights = np.ones(len(squared)) if block.weights is None else block.weights
        squared = squared * weights
        if block.loss is None:
            self.cost += 0.5 * float(squared.sum())
            return np.asarray(weights)
        self.cost += 0.5 * float(block.loss.cost(squared).sum())
        return np.asarray(weights * block.loss.weight(squared))

    def _add_grouped(self, block: Block, rows: Array, size: int, columns: Array) -> None:
        dimension, count, length = rows.shape
        runs = rows.reshape(dimension, count, length // block.rows_per_group, block.rows_per_group)
        stacked = runs.transpose(0, 2, 1, 3)
        gram = np.asarray(sum(run @ run.transpose(0, 2, 1) for run in stacked))
        where = slice(None) if block.groups is None else block.groups
        group, shared, residual = slice(0, size), slice(size, count - 1), count - 1
        gradients = gram[:, shared, residual]
        _add_at(self.group_group, where, gram[:, group, group])
        _add_at(self.group_gradient, where, gram[:, group, residual])
        if isinstance(where, slice):
            span = _span(columns)
            self.group_shared[:, :, span] += gram[:, group, shared]
            self.group_gradients[:, span] += gradients
        else:
            np.add.at(
                self.group_shared, (where[:, None, None], np.arange(size)[:, None], columns), gram[:, group, shared]
            )
            np.add.at(self.group_gradients, (where[:, None], columns), gradients)
        self.shared_gradient[columns] += gradients.sum(axis=0)
        self.shared_shared[np.ix_(columns, columns)] += gram[:, shared, shared].sum(axis=0)
        products = np.zeros((len(gram), *self.group_products.shape[1:]))
        products[:, columns[:, None], columns] = gram[:, shared, shared]
        _add_at(self.group_products, where, products)

    def _add_ungrouped(self, rows: Array, columns: Array) -> None:
        gram = np.einsum("dim,djm->ij", rows, rows)
        self.shared_gradient[columns] += gram[:-1, -1]
        self.shared_shared[np.ix_(columns, columns)] += gram[:-1, :-1]

    def _add_sparse(
        self, block: Block, jacobian: Jacobian, rows: Array, size: int, columns: Array, weights: Array
    ) -> None:
        """Add a Jacobian whose columns differ from row to row."""
        own = _rows([jacobian.values], np.sqrt(weights))
        places = _repeated(block, jacobian)
        if places is None:
            self._add_scattered(block, jacobian, own, rows, size, columns)
        else:
            self._add_repeated(places, own, rows, size, columns)

    def _add_repeated(self, places: Sequence[slice], own: Array, rows: Array, size: int, columns: Array) -> None:
        """Add a Jacobian whose rows have the same columns in every run: of each derivative (L,) those of all rows."""
        shape = len(self.group_shared), -1
        own, rows = own.reshape(*own.shape[:2], *shape), rows.reshape(*rows.shape[:2], *shape)
        for axis, place in enumerate(places):
            products = sum(first * second for first, second in zip(own[:, axis], rows, strict=True))
            total = products.sum(axis=1)
            self.shared_gradient[place] += total[-1]
            self.shared_shared[place, columns] += total[size:-1].T
            self.shared_shared[columns, place] += total[size:-1]
            self.group_gradients[:, place] += products[-1]
            self.group_shared[:, :, place] += products[:size].swapaxes(0, 1)
            for other, across in zip(np.einsum("dgp,dlgp->lp", own[:, axis], own), places, strict=True):
                np.einsum("ii->i", self.shared_shared[place, across])[:] += other

    def _add_scattered(
        self, block: Block, jacobian: Jacobian, own: Array, rows: Array, size: int, columns: Array
    ) -> None:
        """Add a Jacobian with any columns, by scattered sums."""
        at, shared = jacobian.columns.T, len(self.shared_gradient)
        products = np.einsum("dlm,djm->ljm", own, rows)
        _scatter(self.shared_gradient, at, products[:, -1])
        _scatter(self.shared_shared, at[:, None] * shared + at[None, :], np.einsum("dlm,dkm->lkm", own, own))
        cross = np.zeros((shared, shared))
        index = at[:, None] * shared + columns[None, :, None]
        _scatter(cross, index, products[:, size:-1])
        self.shared_shared += cross + cross.T
        if block.rows_per_group:
            runs = np.arange(own.shape[-1]) // block.rows_per_group
            group = runs if block.groups is None else block.groups[runs]
            _scatter(self.group_gradients, group * shared + at, products[:, -1])
            index = (group * size + np.arange(size)[:, None])[None] * shared + at[:, None]
            _scatter(self.group_shared, index, products[:, :size])

    def _add_cross(self, first: Jacobian, second: Jacobian, weights: Array) -> None:
        """Add the products of two Jacobians whose columns differ from row to row."""
        root, shared = np.sqrt(weights), len(self.shared_gradient)
        products = np.einsum("dlm,dkm->lkm", _rows([first.values], root), _rows([second.values], root))
        cross = np.zeros((shared, shared))
        _scatter(cross, first.columns.T[:, None] * shared + second.columns.T[None, :], products)
        self.shared_shared += cross + cross.T


def _span(columns: Array) -> slice | Array:
    """Return consecutive columns as a slice, which is faster."""
    if len(columns) and (np.diff(columns) == 1).all():
        return slice(columns[0], columns[-1] + 1)
    return columns


def _repeated(block: Block, jacobian: Jacobian) -> list[slice] | None:
    """Return which columns each derivative of a Jacobian has in a run of rows, where these are evenly spaced and the
    same in every run, else None.
    """
    length = block.rows_per_group
    if length < 2 or block.groups is not None:
        return None
    run = jacobian.columns[:length]
    steps = np.diff(run, axis=0)
    if (steps != steps[0, 0]).any() or steps[0, 0] < 1 or (jacobian.columns.reshape(-1, *run.shape) != run).any():
        return None
    return [slice(first, last + 1, steps[0, 0]) for first, last in zip(run[0], run[-1], strict=True)]


def _rows(parts: Sequence[Array], root_weights: Array) -> Array:
    """Return parts (M, D, L_i) side by side, weighted, laid out (D, ΣL, M)."""
    length, dimension = parts[0].shape[:2]
    result = np.empty((dimension, sum(part.shape[-1] for part in parts), length))
    start = 0
    for part in parts:
        np.multiply(part.transpose(1, 2, 0), root_weights, out=result[:, start : start + part.shape[-1]])
        start += part.shape[-1]
    return result


def _scatter(target: Array, index: Array, values: Array) -> None:
    """Add values to the flat positions `index` of a contiguous array; repeated positions add up."""
    index = np.broadcast_to(index, values.shape)
    target += np.bincount(index.ravel(), values.ravel(), target.size).reshape(target.shape)


def _add_at(target: Array, where: slice | Array, values: Array) -> None:
    if isinstance(where, slice):
        target[where] += values
    else:
        np.add.at(target, where, values)
