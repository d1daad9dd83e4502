"""Steps of problems whose groups form a chain: every residual depends on a few adjacent nodes, as those of a spline.

A problem names its spans as groups: span k has the parameters of the nodes k … k + WIDTH - 1, so that adjacent groups
have nodes in common; the groups of a step are the nodes (K, n). The nodes are eliminated by a banded factor in time
proportional to their number; what is left is the Schur complement of the shared parameters. The loop is that of
`descent`.
Source: Furgale, Barfoot, Sibley, Continuous-time batch estimation using temporal basis functions, ICRA 2012.
"""

from typing import Generic, TypeVar

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass, replace
from camcal.solve.descent import STOPPING, Stopping, descend
from camcal.solve.least_squares import Problem, assemble
from camcal.solve.steps import NormalEquations, SingularError, Step

State = TypeVar("State")

WIDTH = 4  # nodes of a span: those of a cubic spline
_HELD = 1e-6  # of the typical diagonal element: what holds nodes that no residual depends on


@dataclass(frozen=True, eq=False)
class ChainEquations:
    """The quadratic model of the cost: the nodes' lower band (b, K n), their products with the shared parameters
    (K n, S), those of the shared parameters (S, S), and both gradients.
    """

    cost: float
    band: Array
    node_shared: Array
    shared_shared: Array
    node_gradient: Array
    shared_gradient: Array
    size: int

    @classmethod
    def of(cls, spans: NormalEquations) -> "ChainEquations":
        """Return the equations of the nodes from those of the spans, which have nodes in common."""
        count, width = spans.gradient.groups.shape
        size, shared = width // WIDTH, len(spans.gradient.shared)
        total = (count + WIDTH - 1) * size
        band, by_shared, gradient = np.zeros((width, total)), np.zeros((total, shared)), np.zeros(total)
        held = np.array([np.eye(width)])
        group = np.where((spans.group_group == held).all(axis=(1, 2))[:, None, None], 0.0, spans.group_group)
        for column in range(width):
            places = slice(column, column + count * size, size)
            by_shared[places] += spans.group_shared[:, column]
            gradient[places] += spans.gradient.groups[:, column]
            for row in range(column, width):
                band[row - column, places] += group[:, row, column]
        typical = band[0].reshape(-1, size).mean(axis=0)
        band[0] += np.tile(_HELD * np.where(typical > 0, typical, 1.0), total // size)
        return cls(spans.cost, band, by_shared, spans.shared_shared, gradient, spans.gradient.shared, size)

    def damped(self, damping: float) -> "ChainEquations":
        """Return the equations with every diagonal element enlarged by the share `damping`."""
        band, shared = self.band.copy(), self.shared_shared.copy()
        band[0] *= 1 + damping
        np.einsum("ii->i", shared)[:] *= 1 + damping
        return replace(self, band=band, shared_shared=shared)


@dataclass(frozen=True, eq=False)
class ChainFactors:
    """What solves the equations: followed (K n, S + 1), the nodes' inverse times their products and gradient; and the
    covariance (S, S) of the shared parameters.
    """

    equations: ChainEquations
    followed: Array
    shared_covariance: Array

    @classmethod
    def of(cls, equations: ChainEquations) -> "ChainFactors":
        """Return the factors; raises SingularError where parameters cannot be distinguished."""
        from scipy.linalg import cho_solve_banded, cholesky_banded

        right = np.column_stack([equations.node_shared, equations.node_gradient])
        try:
            root = cholesky_banded(equations.band, lower=True, check_finite=False)
            followed = cho_solve_banded((root, True), right, check_finite=False)
            schur = equations.shared_shared - equations.node_shared.T @ followed[:, :-1]
            scale = np.sqrt(np.maximum(np.diag(equations.shared_shared), np.finfo(float).tiny))
            inverse = np.linalg.inv(np.linalg.cholesky(schur / np.outer(scale, scale))) / scale
        except np.linalg.LinAlgError as error:
            raise SingularError(str(error)) from error
        return cls(equations, followed, inverse.T @ inverse)

    def solve(self) -> Step:
        """Return the step that minimises the quadratic model; its groups are the nodes (K, n)."""
        own = self.equations
        reduced = own.shared_gradient - own.node_shared.T @ self.followed[:, -1]
        shared = -self.shared_covariance @ reduced
        nodes = -self.followed[:, -1] - self.followed[:, :-1] @ shared
        return Step(shared, nodes.reshape(-1, own.size))


@dataclass(frozen=True, eq=False)
class ChainSolution(Generic[State]):
    """A minimum, or where the search ended: `converged`: which."""

    state: State
    cost: float
    converged: bool
    factors: ChainFactors


def minimise_chain(problem: Problem[State], state: State, stopping: Stopping = STOPPING) -> ChainSolution[State]:
    """Return the state that minimises the cost, starting at `state`; raises SingularError."""
    end = descend(_ChainSearch(problem), state, stopping)
    return ChainSolution(end.state, end.equations.cost, end.converged, ChainFactors.of(end.equations))


@dataclass(frozen=True)
class _ChainSearch(Generic[State]):
    problem: Problem[State]

    def linearise(self, state: State) -> ChainEquations | None:
        blocks = self.problem.blocks(state)
        return (
            None if blocks is None else ChainEquations.of(assemble(blocks, self.problem.shared, *self.problem.groups))
        )

    def propose(self, _: State, equations: ChainEquations, damping: float) -> tuple[Step, float]:
        step = ChainFactors.of(equations.damped(damping)).solve()
        gradient = Step(equations.shared_gradient, equations.node_gradient.reshape(step.groups.shape))
        return step, -0.5 * step.dot(gradient)

    def retract(self, state: State, step: Step) -> State:
        return self.problem.retract(state, step)
