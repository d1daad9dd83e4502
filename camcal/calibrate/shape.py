"""How much of the board's shape the data can tell: tiers of terms are added only while they are significant."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from camcal.arrays import Array
from camcal.calibrate.problem import BoardProblem, State
from camcal.solve.least_squares import linearise
from camcal.solve.steps import Block, Factors, SingularError, assemble, factorise
from camcal.targets.surface import TIERS, Surface, basis

SIGNIFICANCE = 1e-3  # a flat board gains a needless tier in less than one of 250 calibrations
NEGLIGIBLE = 2.0  # σ; leaving out more would bias the lens by more than it calms it
SEEN = 10  # a point is freed only when this many views hold it
ALL_TERMS = tuple(term for terms in TIERS.values() for term in terms)


@dataclass(frozen=True, eq=False)
class Verdict:
    """The tiers that are significant, in that order, the terms to keep of them, and the factors of the problem with
    every term: `names` are its shared parameters.
    """

    tiers: tuple[str, ...]
    terms: tuple[str, ...]
    factors: Factors
    names: tuple[str, ...]


def with_terms(problem: BoardProblem, state: State, terms: tuple[str, ...]) -> tuple[BoardProblem, State]:
    """Return problem and state with other shape terms; the coefficients of terms in both are kept."""
    old = dict(zip(problem.terms, state.shape, strict=True))
    return replace(problem, terms=terms), replace(state, shape=np.array([old.get(term, 0.0) for term in terms]))


def judge(problem: BoardProblem, state: State) -> Verdict | None:
    """Return the significant tiers at a minimum of `problem`, or None where nothing can be said.

    One linearisation with every term, then a forward search on its reduced quadratic model: the tier with the least
    probable gain under a flat board comes first, and the search ends where that probability passes SIGNIFICANCE.
    Terms that a tier brought along without need go again: a bow nobody sees would loosen the focal length.
    """
    full, full_state = with_terms(problem, state, ALL_TERMS)
    equations = linearise(full, full_state)
    if equations is None:
        return None
    try:
        factors = factorise(equations)
    except SingularError:
        return None
    start = len(full.free)
    columns = {tier: start + np.array([ALL_TERMS.index(term) for term in TIERS[tier]]) for tier in TIERS}
    model = _Reduced.of(factors, full_state.shape, start)
    tiers: tuple[str, ...] = ()
    lowest = model.cost(_columns(columns, tiers))
    while len(tiers) < len(TIERS):
        trials = [(tier, model.cost(_columns(columns, (*tiers, tier)))) for tier in TIERS if tier not in tiers]
        chances = [float(chi2.logsf(2 * (lowest - cost), len(columns[tier]))) for tier, cost in trials]
        best = int(np.argmin(chances))
        if chances[best] > np.log(SIGNIFICANCE):
            break
        tiers, lowest = (*tiers, trials[best][0]), trials[best][1]
    used = _pruned(model, _columns(columns, tiers))
    return Verdict(tiers, tuple(ALL_TERMS[column - start] for column in used), factors, full.shared_names)


def _pruned(model: "_Reduced", used: Array) -> Array:
    """Return the columns without those whose coefficient is within NEGLIGIBLE σ of zero, the least needed first."""
    while len(used):
        costs = [model.cost(np.delete(used, index)) for index in range(len(used))]
        least = int(np.argmin(costs))
        if 2 * (costs[least] - model.cost(used)) > NEGLIGIBLE**2:
            break
        used = np.delete(used, least)
    return used


def _columns(columns: dict[str, Array], tiers: tuple[str, ...]) -> Array:
    return np.sort(np.concatenate([columns[tier] for tier in tiers])) if tiers else np.zeros(0, np.intp)


@dataclass(frozen=True, eq=False)
class _Reduced:
    """The cost as a quadratic in the shared parameters alone, around the state with shape `shape` (S,)."""

    matrix: Array
    gradient: Array
    shape: Array
    start: int

    @classmethod
    def of(cls, factors: Factors, shape: Array, start: int) -> "_Reduced":
        return cls(factors.shared_root @ factors.shared_root.T, factors.reduced_gradient(), shape, start)

    def cost(self, used: Array) -> float:
        """Return the least cost, relative to the state's, when only the shape terms in columns `used` may differ
        from zero.
        """
        held = np.setdiff1d(np.arange(self.start, self.start + len(self.shape)), used)
        moving = np.setdiff1d(np.arange(len(self.gradient)), held)
        step = -self.shape[held - self.start]
        pull = self.gradient[moving] + self.matrix[np.ix_(moving, held)] @ step
        fall = 0.5 * pull @ np.linalg.solve(self.matrix[np.ix_(moving, moving)], pull)
        return float(self.gradient[held] @ step + 0.5 * step @ self.matrix[np.ix_(held, held)] @ step - fall)


def offsets_matter(problem: BoardProblem, state: State) -> bool:
    """Return whether freeing every point of the board lowers the cost by more than chance would."""
    observations = problem.observations
    seen = np.bincount(observations.ids.ravel(), observations.weights.ravel() > 0, problem.board.count)
    freed = replace(problem, offsets=True)
    blocks = freed.blocks(state) if seen.min() >= SEEN else None
    if blocks is None:
        return False
    # a rigid motion and the scale are not the board's own: seven of the offsets' freedoms cost nothing
    freedom = 3 * problem.board.count - 7
    gain = _gain_with_poses_held(blocks[0], len(problem.free) + len(problem.terms), problem.board.count)
    if chi2.sf(gain, freedom) > 0.05:
        return False  # the poses and the lens following cannot make much of so little
    try:
        gain = 2 * factorise(assemble(blocks, freed.shared, *freed.groups)).decrease()
    except SingularError:
        return False
    return bool(chi2.logsf(gain, freedom) < np.log(SIGNIFICANCE))


def _gain_with_poses_held(block: Block, start: int, points: int) -> float:
    """Return the fall of χ² when each point moves on its own and nothing follows: one 3 × 3 solve a point."""
    offsets, weights = block.shared[-1], block.weights
    point = (offsets.columns[:, 0] - start) // 3
    weighted = offsets.values if weights is None else offsets.values * weights[:, None, None]
    gradient = np.einsum("mda,md->am", weighted, block.residuals)
    products = np.einsum("mda,mdb->abm", weighted, offsets.values).reshape(9, -1)
    slopes = np.stack([np.bincount(point, row, points) for row in gradient], axis=-1)
    matrices = np.stack([np.bincount(point, row, points) for row in products], axis=-1).reshape(points, 3, 3)
    return float(np.einsum("ca,ca->", slopes, np.linalg.solve(matrices, slopes[..., None])[..., 0]))


def surface_of(problem: BoardProblem, state: State, tiers: tuple[str, ...], covariance: Array) -> Surface:
    """Return the record of the board's shape from a solution and the covariance of its shared parameters."""
    lens, count = len(problem.free), len(problem.terms)
    heights = _heights_by_parameters(problem)
    parameters = np.concatenate([np.zeros(lens), state.shape, state.offsets.ravel() if problem.offsets else []])
    height = heights @ parameters
    span = heights[np.argmax(height)] - heights[np.argmin(height)]
    return Surface(
        problem.board,
        tiers,
        problem.terms,
        state.shape,
        covariance[lens : lens + count, lens : lens + count],
        state.offsets if problem.offsets else None,
        float(span @ parameters),
        float(np.sqrt(max(span @ covariance @ span, 0.0))),
    )


def _heights_by_parameters(problem: BoardProblem) -> Array:
    """Return each point's height over the board's mean plane per unit of every shared parameter (C, shared).

    The plane is taken out because a pose can take it: offsets know it only through their prior.
    """
    points = problem.board.count
    parts = [np.zeros((points, len(problem.free))), basis(problem.board, problem.terms)[:, 2]]
    if problem.offsets:
        upwards = np.zeros((points, points, 3))
        upwards[np.arange(points), np.arange(points), 2] = 1.0
        parts.append(upwards.reshape(points, -1))
    heights = np.concatenate(parts, axis=1)
    drawn = problem.board.points()
    plane = np.column_stack([np.ones(points), drawn[:, :2] / problem.board.pitch])
    return np.asarray(heights - plane @ np.linalg.lstsq(plane, heights, rcond=None)[0])
