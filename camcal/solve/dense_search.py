"""Least squares of a few hundred parameters by orthogonal factors: the solver of curve fits.

Source: Moré 1978 (scaling by the largest column norms met); Transtrum & Sethna, Improvements to the Levenberg–Marquardt
Algorithm for Nonlinear Least-Squares Minimization, 2012 (geodesic acceleration).
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar

import numpy as np

from camcal.arrays import Array
from camcal.solve.dense import DenseEquations, DenseFactors, assemble_dense
from camcal.solve.descent import STOPPING, Descent, Observer, Proposal, Stopping, descend, gauss_newton, unobserved
from camcal.solve.least_squares import Problem
from camcal.solve.steps import SingularError, Step

State = TypeVar("State")
Room = Callable[[State], tuple[Array, Array]]

_PROBE = 0.1  # of a step, over which its curvature is measured (Transtrum & Sethna 2012, section 3)
_STRAIGHT, _FAINT = 1e-8, 1e5  # of the cost and its rounding error: a decrease too small to tell curvature from noise
_BEND = 0.75  # an acceleration of more than this share of the velocity: the step is too long to be trusted


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

    def propose(self, state: State, equations: DenseEquations, damping: float) -> Proposal:
        self._follow(equations)
        low, high = self._room(state)
        free = ~((low >= 0) & (equations.gradient > 0) | (high <= 0) & (equations.gradient < 0))
        step, free = self._bounded(equations, damping, free, low, high)
        # at a minimum the difference of two equal numbers, of either sign
        promised = float(-step @ equations.gradient - 0.5 * np.sum((equations.jacobian @ step) ** 2))
        if promised < -self.stopping.unseen(equations.cost):
            raise SingularError("the bounds leave no way down")
        visible = promised > _STRAIGHT * equations.cost + _FAINT * self.stopping.rounding
        if self.method.geodesic and not self.method.full and visible:
            step = np.clip(step + self._bend(state, equations, step, damping, free), low, high)
        return Proposal(Step(step, np.zeros((0, 0))), max(promised, 0.0))

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
        """Return half the acceleration (n,) along a step; raises SingularError where it is too large to be believed."""
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
