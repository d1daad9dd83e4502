"""Least squares over residual blocks by the arrow's normal equations: the solver of calibrations and poses.

The equations are summed up in arrow form: group by group, and what all of them share.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import Generic, NamedTuple, Protocol, TypeVar

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass, replace
from camcal.solve.descent import STOPPING, Observer, Stopping, descend, unobserved
from camcal.solve.steps import Block, Factors, Jacobian, NormalEquations, Step, factorise

State = TypeVar("State")

_PART_ROWS = 4000  # of a block at a time


class Problem(Protocol[State]):
    """What the solver requires of a problem; it never sees what the state is made of."""

    @property
    def shared(self) -> int:
        """The number of shared parameters."""
        ...

    @property
    def groups(self) -> tuple[int, int]:
        """The number of eliminated groups and the parameters of each."""
        ...

    def blocks(self, state: State) -> Sequence[Block] | None:
        """Return the residual blocks at a state, or None where the state is outside the problem's domain."""
        ...

    def retract(self, state: State, step: Step) -> State:
        """Return the state moved by a step."""
        ...


@dataclass(frozen=True, eq=False)
class Solution(Generic[State]):
    """A minimum, or where the search ended: `converged`: which, `reason`: why."""

    state: State
    cost: float
    iterations: int
    converged: bool
    reason: str
    equations: NormalEquations

    def factors(self) -> Factors:
        """Return the factors of the undamped equations; raises SingularError."""
        return factorise(self.equations)


def linearise(problem: Problem[State], state: State, *, products: bool = True) -> NormalEquations | None:
    """Return the normal equations at a state, or None where it is outside the problem's domain; products: as of
    `assemble`.
    """
    blocks = problem.blocks(state)
    return None if blocks is None else assemble(blocks, problem.shared, *problem.groups, products=products)


def minimise(
    problem: Problem[State], state: State, stopping: Stopping = STOPPING, observe: Observer = unobserved
) -> Solution[State]:
    """Return the state that minimises ½ Σ ρ(‖r‖²), starting at `state`, which must be inside the domain.

    A minimum that lies on the edge of the domain counts as converged; its reason says so.
    """
    end = descend(_ArrowSearch(problem), state, stopping, observe)
    return Solution(end.state, end.equations.cost, end.iterations, end.converged, end.reason, end.equations)


@dataclass(frozen=True)
class _ArrowSearch(Generic[State]):
    """Steps by the Schur complement; every diagonal element of the normal matrix is enlarged by the damping."""

    problem: Problem[State]

    def linearise(self, state: State) -> NormalEquations | None:
        return linearise(self.problem, state, products=False)

    def propose(self, _: State, equations: NormalEquations, damping: float) -> tuple[Step, float]:
        step = factorise(equations.damped(damping)).solve()
        return step, -0.5 * step.dot(equations.gradient)

    def retract(self, state: State, step: Step) -> State:
        return self.problem.retract(state, step)


def assemble(
    blocks: Sequence[Block], shared: int, groups: int, group_size: int, *, products: bool = True
) -> NormalEquations:
    """Return the normal equations of residual blocks over `shared` parameters and `groups` groups of `group_size`.

    products: whether with each group's own part of the products of shared parameters; steps do without, and sums over
    all groups at once take half the time.
    """
    grouped = [part.columns for block in blocks if block.group is not None for part in block.shared]
    dense = max((int(columns.max(initial=-1)) + 1 for columns in grouped if columns.ndim == 1 and products), default=0)
    total = NormalEquations(
        0.0,
        Step(np.zeros(shared), np.zeros((groups, group_size))),
        group_group=np.zeros((groups, group_size, group_size)),
        group_shared=np.zeros((groups, group_size, shared)),
        shared_shared=np.zeros((shared, shared)),
        group_gradients=np.zeros((groups, shared)),
        group_products=np.zeros((groups, dense, dense)),
    )
    cost = sum((_add(total, part, where) for block in blocks for part, where in _parts(block)), 0.0)
    # a group that no residual depends on stays where it is
    total.group_group[~total.group_group.any(axis=(1, 2))] = np.eye(group_size)
    return replace(total, cost=cost)


class _Common(NamedTuple):
    """What all rows of a block depend on, weighted: the derivatives by their group's `size` parameters, those by the
    shared parameters `columns`, and the residuals, side by side as (D, size + columns + 1, M).
    """

    rows: Array
    size: int
    columns: Array


def _add(total: NormalEquations, block: Block, where: slice | Array) -> float:
    """Return the cost of a block whose runs of rows belong to the groups `where`, the rest of it added to a total."""
    cost, weights = block.weighed()
    dense = [jacobian for jacobian in block.shared if jacobian.columns.ndim == 1]
    sparse = [jacobian for jacobian in block.shared if jacobian.columns.ndim == 2]
    columns = np.concatenate([jacobian.columns for jacobian in dense] or [np.zeros(0, np.intp)])
    parts = [jacobian.values for jacobian in dense]
    if block.group is not None:
        parts.insert(0, block.group)
    rows = _rows([*parts, block.residuals[..., None]], np.sqrt(weights))
    common = _Common(rows, 0 if block.group is None else block.group.shape[-1], columns)
    if block.rows_per_group:
        _add_grouped(total, block, where, common)
    else:
        gram = np.einsum("dim,djm->ij", rows, rows)
        total.gradient.shared[columns] += gram[:-1, -1]
        total.shared_shared[np.ix_(columns, columns)] += gram[:-1, :-1]
    for jacobian in sparse:
        _add_sparse(total, block, where, jacobian, common, weights)
    for first, second in combinations(sparse, 2):
        _add_cross(total, first, second, weights)
    return cost


def _add_grouped(total: NormalEquations, block: Block, where: slice | Array, common: _Common) -> None:
    rows, size, columns = common
    dimension, count, length = rows.shape
    runs = rows.reshape(dimension, count, length // block.rows_per_group, block.rows_per_group)
    stacked = runs.transpose(0, 2, 1, 3)
    group, shared, residual = slice(0, size), slice(size, count - 1), count - 1
    whole = total.group_products.shape[-1] > 0
    first = stacked if whole else stacked[:, :, [*range(size), residual]]
    gram = np.asarray(sum(own @ run.transpose(0, 2, 1) for own, run in zip(first, stacked, strict=True)))
    gradients = gram[:, -1, shared]
    span = _span(columns)
    if isinstance(where, slice) and block.group_columns is None:
        total.group_group[where] += gram[:, group, group]
        total.gradient.groups[where] += gram[:, group, residual]
        total.group_shared[where, :, span] += gram[:, group, shared]
        total.group_gradients[where, span] += gradients
    else:
        groups, own = _indices(where), _group_columns(block, size)
        total.group_group[np.ix_(groups, own, own)] += gram[:, group, group]
        total.gradient.groups[np.ix_(groups, own)] += gram[:, group, residual]
        total.group_shared[np.ix_(groups, own, columns)] += gram[:, group, shared]
        total.group_gradients[np.ix_(groups, columns)] += gradients
    total.gradient.shared[columns] += gradients.sum(axis=0)
    if whole:
        products = gram[:, shared, shared]
        total.shared_shared[np.ix_(columns, columns)] += products.sum(axis=0)
        if isinstance(where, slice) and isinstance(span, slice):
            total.group_products[where, span, span] += products
        else:
            total.group_products[np.ix_(_indices(where), columns, columns)] += products
    else:
        total.shared_shared[np.ix_(columns, columns)] += sum(each @ each.T for each in rows[:, shared])


def _add_sparse(
    total: NormalEquations, block: Block, where: slice | Array, jacobian: Jacobian, common: _Common, weights: Array
) -> None:
    """Add a Jacobian whose columns differ from row to row."""
    own = _rows([jacobian.values], np.sqrt(weights))
    places = _repeated(block, jacobian)
    if places is None:
        _add_scattered(total, block, where, jacobian, own, common)
    else:
        _add_repeated(total, block, where, places, own, common)


def _add_repeated(
    total: NormalEquations,
    block: Block,
    where: slice | Array,
    places: Sequence[slice],
    own: Array,
    common: _Common,
) -> None:
    """Add a Jacobian whose rows have the same columns in every run: of each derivative (L,) those of all rows."""
    rows, size, columns = common
    shape = len(block.residuals) // block.rows_per_group, -1
    own, rows = own.reshape(*own.shape[:2], *shape), rows.reshape(*rows.shape[:2], *shape)
    groups, group_columns = _indices(where)[:, None], _group_columns(block, size)
    for axis, place in enumerate(places):
        products = sum(first * second for first, second in zip(own[:, axis], rows, strict=True))
        summed = products.sum(axis=1)
        total.gradient.shared[place] += summed[-1]
        total.shared_shared[place, columns] += summed[size:-1].T
        total.shared_shared[columns, place] += summed[size:-1]
        total.group_gradients[where, place] += products[-1]
        total.group_shared[groups, group_columns, place] += products[:size].swapaxes(0, 1)
        for other, across in zip(np.einsum("dgp,dlgp->lp", own[:, axis], own), places, strict=True):
            np.einsum("ii->i", total.shared_shared[place, across])[:] += other


def _add_scattered(
    total: NormalEquations, block: Block, where: slice | Array, jacobian: Jacobian, own: Array, common: _Common
) -> None:
    """Add a Jacobian with any columns, by scattered sums."""
    rows, size, columns = common
    at, shared = jacobian.columns.T, len(total.gradient.shared)
    products = np.einsum("dlm,djm->ljm", own, rows)
    _scatter(total.gradient.shared, at, products[:, -1])
    _scatter(total.shared_shared, at[:, None] * shared + at[None, :], np.einsum("dlm,dkm->lkm", own, own))
    cross = np.zeros((shared, shared))
    index = at[:, None] * shared + columns[None, :, None]
    _scatter(cross, index, products[:, size:-1])
    total.shared_shared[:] += cross + cross.T
    if block.rows_per_group:
        runs = np.arange(own.shape[-1]) // block.rows_per_group
        group = runs + where.start if isinstance(where, slice) else where[runs]
        _scatter(total.group_gradients, group * shared + at, products[:, -1])
        places = group * total.group_shared.shape[1] + _group_columns(block, size)[:, None]
        index = places[None] * shared + at[:, None]
        _scatter(total.group_shared, index, products[:, :size])


def _add_cross(total: NormalEquations, first: Jacobian, second: Jacobian, weights: Array) -> None:
    """Add the products of two Jacobians whose columns differ from row to row."""
    root, shared = np.sqrt(weights), len(total.gradient.shared)
    products = np.einsum("dlm,dkm->lkm", _rows([first.values], root), _rows([second.values], root))
    cross = np.zeros((shared, shared))
    _scatter(cross, first.columns.T[:, None] * shared + second.columns.T[None, :], products)
    total.shared_shared[:] += cross + cross.T


def _parts(block: Block) -> Iterator[tuple[Block, slice | Array]]:
    """Return a block in parts of whole groups that fit the processor's caches, and the groups of each."""
    length = block.rows_per_group
    if not length:
        yield block, slice(0, 0)
        return
    groups = len(block.residuals) // length
    step = max(_PART_ROWS // length, 1)
    for first in range(0, groups, step):
        where = slice(first, min(first + step, groups))
        yield part_of(block, where), where if block.groups is None else block.groups[where]


def part_of(block: Block, runs: slice | Array) -> Block:
    """Return some runs of a block; their groups are those of the whole one."""
    length, rows = block.rows_per_group, runs
    if isinstance(runs, slice):
        rows = slice(runs.start * length, runs.stop * length)
    else:
        rows = (runs[:, None] * length + np.arange(length)).ravel()
    return replace(
        block,
        residuals=block.residuals[rows],
        shared=tuple(_rows_of(jacobian, rows) for jacobian in block.shared),
        group=None if block.group is None else block.group[rows],
        weights=None if block.weights is None else block.weights[rows],
    )


def _indices(where: slice | Array) -> Array:
    """Return groups as indices."""
    return np.arange(where.start, where.stop) if isinstance(where, slice) else where


def _group_columns(block: Block, size: int) -> Array:
    """Return the parameters of a group that the `size` derivatives of a block's rows are by."""
    return np.arange(size) if block.group_columns is None else block.group_columns


def _rows_of(jacobian: Jacobian, rows: slice | Array) -> Jacobian:
    columns = jacobian.columns if jacobian.columns.ndim == 1 else jacobian.columns[rows]
    return Jacobian(jacobian.values[rows], columns)


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
    if length < 2:
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
