"""One Levenberg–Marquardt loop over residual blocks: the solver of the whole package.

Source: Marquardt 1963 (scaling of the damping); Nielsen, Damping Parameter in Marquardt's Method, 1999 (its update).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from camcal.solve.steps import Block, Factors, NormalEquations, SingularError, Step, assemble, factorise

State = TypeVar("State")


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


@dataclass(frozen=True)
class Stopping:
    """When to stop: the decrease that the quadratic model still promises, relative to the cost; the iterations."""

    relative_decrease: float = 1e-9
    iterations: int = 100
    damping: float = 1e-6


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


STOPPING = Stopping()
_MAX_DAMPING = 1e12
_BLOCKED, _CRAWL = 5, 1e-4  # so many steps out of the domain, and this small a relative decrease: held at its edge
_GAUSS_NEWTON = 1e-3  # below this damping a step is all but the full one


def linearise(problem: Problem[State], state: State) -> NormalEquations | None:
    """Return the normal equations at a state, or None where it is outside the problem's domain."""
    blocks = problem.blocks(state)
    return None if blocks is None else assemble(blocks, problem.shared, *problem.groups)


def minimise(problem: Problem[State], state: State, stopping: Stopping = STOPPING) -> Solution[State]:
    """Return the state that minimises ½ Σ ρ(‖r‖²), starting at `state`, which must be inside the domain.

    A minimum that lies on the edge of the domain counts as converged; its reason says so.
    """
    equations = linearise(problem, state)
    if equations is None:
        raise ValueError("the start is outside the domain of the problem")
    damping, growth, blocked = stopping.damping, 2.0, 0
    for iteration in range(stopping.iterations):
        try:
            factors = factorise(equations.damped(damping))
        except SingularError:
            if damping > _MAX_DAMPING:
                return Solution(state, equations.cost, iteration, False, "singular", equations)
            damping, growth = max(damping, 1e-9) * growth, growth * 2
            continue
        step = factors.solve()
        promised = -0.5 * step.dot(equations.gradient)
        trial_state = problem.retract(state, step)
        trial = linearise(problem, trial_state)
        blocked += trial is None
        if trial is not None and trial.cost <= equations.cost:
            fall = equations.cost - trial.cost
            # a step cut short by damping promises little and proves nothing
            settled = damping < _GAUSS_NEWTON and promised <= stopping.relative_decrease * max(trial.cost, 1e-300)
            held = blocked >= _BLOCKED and fall <= _CRAWL * trial.cost
            state, equations, growth = trial_state, trial, 2.0
            damping *= max(0.1, 1 - (2 * min(fall / promised if promised > 0 else 1.0, 1.0) - 1) ** 3)
            if settled or held:
                reason = "the step promises no decrease" if settled else "held at the edge of the domain"
                return Solution(state, equations.cost, iteration + 1, True, reason, equations)
        elif promised <= 1e-13 * equations.cost:
            return Solution(state, equations.cost, iteration + 1, True, "the cost is at its rounding error", equations)
        elif damping > _MAX_DAMPING:
            return Solution(state, equations.cost, iteration + 1, False, "no step lowers the cost", equations)
        else:
            damping, growth = max(damping, 1e-9) * growth * 5, growth * 2
    return Solution(state, equations.cost, stopping.iterations, False, "too many iterations", equations)
