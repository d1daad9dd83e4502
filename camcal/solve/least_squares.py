"""Least squares over residual blocks by the arrow's normal equations: the solver of calibrations and poses."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from camcal.solve.assembly import assemble
from camcal.solve.descent import STOPPING, Observer, Proposal, Stopping, descend, unobserved
from camcal.solve.steps import Block, Factors, NormalEquations, Step, factorise

State = TypeVar("State")

__all__ = ["STOPPING", "Problem", "Solution", "Stopping", "linearise", "minimise"]


class Problem(Protocol[State]):
    """What the solver asks of a problem; it never sees what the state is made of."""

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
    """A minimum, or where the search ended: `converged` says which, `reason` says why."""

    state: State
    cost: float
    iterations: int
    converged: bool
    reason: str
    equations: NormalEquations

    def factors(self) -> Factors:
        """Return the factors of the undamped equations; raises SingularError."""
        return factorise(self.equations)


def linearise(problem: Problem[State], state: State) -> NormalEquations | None:
    """Return the normal equations at a state, or None where it is outside the problem's domain."""
    blocks = problem.blocks(state)
    return None if blocks is None else assemble(blocks, problem.shared, *problem.groups)


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
        return linearise(self.problem, state)

    def propose(self, _: State, equations: NormalEquations, damping: float) -> Proposal:
        step = factorise(equations.damped(damping)).solve()
        return Proposal(step, -0.5 * step.dot(equations.gradient))

    def retract(self, state: State, step: Step) -> State:
        return self.problem.retract(state, step)
