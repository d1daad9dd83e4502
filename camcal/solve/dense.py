"""Least squares by orthogonal factors of the weighted Jacobian itself, whose condition JᵀJ would square: curve fits.

For problems of a few hundred parameters without groups. Columns are scaled before anything is decided about rank.
Source: Björck, Numerical Methods for Least Squares Problems, 1996, sections 2.7 and 9.2; Moré 1978 (scaling by the
largest column norms met); Transtrum & Sethna, Improvements to the Levenberg–Marquardt Algorithm for Nonlinear
Least-Squares Minimization, 2012 (geodesic acceleration).
"""

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from itertools import product
from typing import Generic, TypeVar

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass, field, replace
from camcal.solve.descent import STOPPING, Descent, Observer, Stopping, descend, gauss_newton, unobserved
from camcal.solve.least_squares import Problem
from camcal.solve.steps import Block, SingularError, Step

_NEGLIGIBLE = 0.05  # parts of a null vector below this share of its largest one are left out of its description
State = TypeVar("State")
Room = Callable[[State], tuple[Array, Array]]
_PROBE = 0.1  # of a step, over which its curvature is measured (Transtrum & Sethna 2012, section 3)
_STRAIGHT, _FAINT = 1e-8, 1e5  # of the cost and its rounding error: a decrease too small to tell curvature from noise
_BEND = 0.75  # an acceleration of more than this share of the velocity: the step is too long to be trusted


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

        columns: (n,) which of them to take, by default all. LAPACK's singular values of a tall matrix are those of the
        triangle of its QR factors. Raises SingularError.
        """
        chosen = slice(None) if columns is None else columns
        scale = (self.column_norms if scale is None else scale)[chosen]
        try:
            left, singular, right = np.linalg.svd(self.jacobian[:, chosen] / scale, full_matrices=False)
        except np.linalg.LinAlgError as error:
            raise SingularError(str(error)) from error
        return DenseFactors(left, singular, right, scale)


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
        """Which parameters (d, n) have a part in each of them that is large enough to be named."""
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


def assemble_dense(blocks: Sequence[Block], count: int) -> DenseEquations:
    """Return the equations of residual blocks over `count` shared parameters; blocks with groups are refused."""
    cost, residuals, jacobians, weights = 0.0, [np.zeros(0)], [np.zeros((0, count))], [np.zeros(0)]
    for block in blocks:
        if block.group is not None:
            raise ValueError("a dense step has no eliminated groups")
        part, row_weights = block.weighed()
        cost += part
        root = np.repeat(np.sqrt(row_weights), block.residuals.shape[1])
        weights.append(root)
        residuals.append(root * block.residuals.ravel())
        jacobians.append(root[:, None] * _widened(block, count))
    return DenseEquations(cost, np.concatenate(residuals), np.concatenate(jacobians), np.concatenate(weights))


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


@dataclass(frozen=True)
class DenseMethod(Generic[State]):
    """How steps are found.

    running_scale: scale parameters by the longest column of the Jacobian met so far, not by the present one.
    geodesic: follow the curvature to second order. full: undamped full steps, plain Gauss–Newton.
    room: the least and greatest step (n,) that bounds allow at a state. residuals: those of all blocks (R,) alone, for
    problems that have them for less than with their derivatives.
    """

    running_scale: bool = True
    geodesic: bool = True
    full: bool = False
    room: Room[State] | None = None
    residuals: Callable[[State], Array] | None = None


def minimise_nonnegative(matrix: Array, vector: Array) -> Array:
    """Return the minimum (n,) of ½ xᵀ A x - bᵀ x over x ≥ 0, A (n, n) positive definite and n small: the lowest of
    those with some of the unknowns at 0 and the others where they would be alone.
    """
    best = np.linalg.solve(matrix, vector)
    if (best >= 0).all():
        return best
    best, lowest = np.zeros(len(vector)), 0.0
    for chosen in product((False, True), repeat=len(vector)):
        free = np.flatnonzero(chosen)
        values = np.linalg.solve(matrix[np.ix_(free, free)], vector[free])
        cost = -0.5 * float(values @ vector[free])
        if cost < lowest and (values >= 0).all():
            best, lowest = np.zeros(len(vector)), cost
            best[free] = values
    return best


def minimise_dense(
    problem: Problem[State],
    state: State,
    method: DenseMethod[State],
    stopping: Stopping = STOPPING,
    observe: Observer = unobserved,
) -> Descent[State, DenseEquations]:
    """Return the state that minimises ½ Σ ρ(‖r‖²), starting at `state`, which must be inside the domain and bounds."""
    loop = gauss_newton if method.full else descend
    with np.errstate(over="ignore", invalid="ignore"):  # a step too far ends in infinity, and is not taken
        return loop(_DenseSearch(problem, method, stopping), state, stopping, observe)


def linearise_dense(problem: Problem[State], state: State) -> DenseEquations | None:
    """Return the dense equations at a state, None outside the domain; their cost is infinite if a number in them is."""
    with np.errstate(over="ignore", invalid="ignore"):
        blocks = problem.blocks(state)
        if blocks is None:
            return None
        equations = assemble_dense(blocks, problem.shared)
    finite = np.isfinite(equations.cost) and np.isfinite(equations.jacobian).all()
    return equations if finite else replace(equations, cost=np.inf)


@dataclass
class _DenseSearch(Generic[State]):
    """Damped steps on the factors of the Jacobian; remembers the scale of the parameters."""

    problem: Problem[State]
    method: DenseMethod[State]
    stopping: Stopping
    scale: Array = field(default_factory=lambda: np.zeros(0))
    factored: tuple[DenseEquations, Array, DenseFactors] | None = None

    def linearise(self, state: State) -> DenseEquations | None:
        return linearise_dense(self.problem, state)

    def retract(self, state: State, step: Step) -> State:
        return self.problem.retract(state, step)

    def propose(self, state: State, equations: DenseEquations, damping: float) -> tuple[Step, float]:
        self._follow(equations)
        low, high = self._room(state)
        free = ~((low >= 0) & (equations.gradient > 0) | (high <= 0) & (equations.gradient < 0))
        step, free = self._bounded(equations, damping, free, low, high)
        # at a minimum the difference of two equal numbers, of either sign
        promised = float(-step @ equations.gradient - 0.5 * np.sum((equations.jacobian @ step) ** 2))
        if promised < -self.stopping.unseen(equations.cost):
            raise SingularError("no descent within the bounds")
        visible = promised > _STRAIGHT * equations.cost + _FAINT * self.stopping.rounding
        if self.method.geodesic and not self.method.full and visible:
            step = np.clip(step + self._bend(state, equations, step, damping, free), low, high)
        return Step(step, np.zeros((0, 0))), max(promised, 0.0)

    def _follow(self, equations: DenseEquations) -> None:
        norms = equations.column_norms
        self.scale = np.maximum(self.scale, norms) if self.method.running_scale and len(self.scale) else norms

    def _room(self, state: State) -> tuple[Array, Array]:
        if self.method.room is not None:
            return self.method.room(state)
        limit = np.full(self.problem.shared, np.inf)
        return -limit, limit

    def _factors(self, equations: DenseEquations, free: Array) -> DenseFactors:
        """Return the factors of the columns that may move; those of the last call where nothing has changed."""
        known = self.factored
        if known is None or known[0] is not equations or not np.array_equal(known[1], free):
            known = equations, free, equations.factors(self.scale, free)
            self.factored = known
        return known[2]

    def _bounded(
        self, equations: DenseEquations, damping: float, free: Array, low: Array, high: Array
    ) -> tuple[Array, Array]:
        """Return the damped step (n,) inside its bounds and which of its elements no bound holds."""
        step = np.zeros(len(free))
        while free.any():
            remaining = equations.residuals + equations.jacobian[:, ~free] @ step[~free]
            step[free] = self._factors(equations, free).solve(-remaining, damping)
            outside = free & ((step < low) | (step > high))
            if not outside.any():
                break
            step = np.clip(step, low, high)
            free = free & ~outside
        return step, free

    def _bend(self, state: State, equations: DenseEquations, step: Array, damping: float, free: Array) -> Array:
        """Return half the acceleration (n,) along a step; raises SingularError where it is too large to be used."""
        probe = self._residuals(self.problem.retract(state, Step(_PROBE * step, np.zeros((0, 0)))))
        if probe is None or not free.any():
            return np.zeros_like(step)
        moved = equations.root_weights * probe
        second = 2 / _PROBE * ((moved - equations.residuals) / _PROBE - equations.jacobian @ step)
        if not np.isfinite(second).all():
            return np.zeros_like(step)
        acceleration = np.zeros_like(step)
        acceleration[free] = self._factors(equations, free).solve(-second, damping)
        lengths = [float(np.linalg.norm(self.scale * vector)) for vector in (acceleration, step)]
        if 2 * lengths[0] > _BEND * lengths[1]:
            raise SingularError("too bent")
        return 0.5 * acceleration

    def _residuals(self, state: State) -> Array | None:
        if self.method.residuals is not None:
            return self.method.residuals(state)
        blocks = self.problem.blocks(state)
        return None if blocks is None else np.concatenate([block.residuals.ravel() for block in blocks])
