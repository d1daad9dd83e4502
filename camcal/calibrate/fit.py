"""From a start to the maximum-likelihood solution: robust first, then outliers, board shape and orientation settled."""

from dataclasses import dataclass, replace

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.initialise import poses_from_pixels, sweep_focal, thinned
from camcal.calibrate.orientation import best_turns, opposed_views, renumbered, turned
from camcal.calibrate.outliers import CUT, robust_sigma, screen
from camcal.calibrate.problem import BoardProblem, Observations, State, lens_spread
from camcal.calibrate.shape import Verdict, judge, offsets_matter, with_terms
from camcal.cameras.model import CameraModel
from camcal.errors import InsufficientData
from camcal.solve.least_squares import Solution, Stopping, minimise
from camcal.solve.losses import Cauchy
from camcal.targets.board import Board

_FIRST_VIEWS = 40  # enough to find the lens; the rest then start next to their minimum
_FIRST_CORNERS = 40
_ROUGH = Stopping(relative_decrease=1e-4, iterations=50)
_SETTLING = Stopping(iterations=2)  # the lens is known, the poses are next to their minimum
_FINE = Stopping(relative_decrease=1e-8, iterations=60)
_ROUNDS = 8
_STAGES = (("fx", "fy", "k1"), ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"))
_LOSS = Cauchy(3.0)


@dataclass(frozen=True, eq=False)
class Fit:
    """A solution: the problem with its final σ and kept points, the tiers of the board's shape, the symmetry by
    which each view was turned (V,), the last solve, all iterations, and what was judged of the board's shape.
    """

    problem: BoardProblem
    tiers: tuple[str, ...]
    turns: Array
    solution: Solution[State]
    iterations: int
    verdict: Verdict | None

    @property
    def state(self) -> State:
        return self.solution.state


@dataclass(frozen=True)
class ShapeOptions:
    """How far the board's shape may be estimated: not at all, in smooth tiers, and point by point."""

    smooth: bool = True
    offsets: bool = True


def fit(
    model: CameraModel,
    board: Board,
    observations: Observations,
    image_size: tuple[int, int],
    held: Array,
    guess: Array | None,
    shape: ShapeOptions,
) -> Fit:
    """Return the solution of a data set.

    held: (K,) values of lens parameters that stay as they are, NaN where free. guess: (K,) a lens to start from.
    Raises InsufficientData where no start is found.
    """
    free = np.flatnonzero(np.isnan(held))
    count = len(observations.ids)
    chosen = np.unique(np.linspace(0, count - 1, min(count, _FIRST_VIEWS)).astype(np.intp))
    few = thinned(observations.take(chosen), _FIRST_CORNERS)
    problem, state = _robust(BoardProblem(model, board, few, free), image_size, held, guess)
    problem = replace(problem, observations=observations)
    if len(chosen) < count:
        state = _pose_all(problem, state)
        problem = replace(problem, sigma=_sigma(problem, state))
        state = minimise(problem.within_domain(state), state, _SETTLING).state
    result = _refine(problem, state, observations.weights > 0, shape)
    return _oriented(result, observations.weights > 0, shape)


def reweighted(result: Fit, covariances: Array, present: Array, shape: ShapeOptions) -> Fit:
    """Return the solution with points that count by their covariances (V, P, 2, 2) px², from the one where all count
    the same. present: (V, P) the points that there are, whether they were kept or not.
    """
    observations = result.problem.observations.weighted(covariances)
    problem = replace(result.problem, observations=observations, offsets=False)
    state = replace(result.state, offsets=0 * result.state.offsets)
    again = _refine(problem, state, present, shape)
    return replace(again, turns=result.turns, iterations=result.iterations + again.iterations)


def _start(problem: BoardProblem, image_size: tuple[int, int], held: Array, guess: Array | None) -> State:
    """Return a first state: from the guess, or from the focal length that explains the views best."""
    fixed = guess if guess is not None else held
    state = sweep_focal(problem.model, problem.board, problem.observations, image_size, fixed)
    if state is None:
        raise InsufficientData(
            f"no start was found for the lens model {problem.model.name}: its domain does not hold these corners; "
            "try another --model (kannala_brandt4 for wide lenses) or a --guess"
        )
    return state


def _sigma(problem: BoardProblem, state: State) -> float:
    return robust_sigma(problem.distances(problem.residuals(state)), problem.observations.weights > 0)


def _robust(
    problem: BoardProblem, image_size: tuple[int, int], held: Array, guess: Array | None
) -> tuple[BoardProblem, State]:
    """Return problem and state after robust solves at a falling σ, the stiffest lens parameters first.

    From a start without distortion the residuals are the distortion: principal point and higher coefficients would
    run after them before the poses have settled.
    """
    state = _start(problem, image_size, held, guess)
    spread = lens_spread(problem.model, image_size, float(state.parameters[0]))
    problem = replace(problem, lens_spread=spread)
    names = problem.model.parameter_names
    everything = problem.free
    stages = [np.array([i for i in everything if names[i] in stage], np.intp) for stage in _STAGES]
    for free in (*stages, everything, everything):
        problem = replace(problem, free=free, loss=_LOSS, sigma=_sigma(problem, state))
        state = minimise(problem.within_domain(state), state, _ROUGH).state
    return replace(problem, sigma=_sigma(problem, state)), state


def _pose_all(problem: BoardProblem, state: State) -> State:
    """Return the state with poses for every view of the problem, under the lens of `state`."""
    few = thinned(problem.observations)
    poses = poses_from_pixels(problem.model, state.parameters, problem.board, few)
    if poses is None:
        raise InsufficientData("a view has fewer than four corners inside the lens's domain")
    return replace(state, rotations=poses[0], translations=poses[1])


def _refine(problem: BoardProblem, state: State, present: Array, shape: ShapeOptions) -> Fit:
    """Return the solution with outliers and the board's shape settled together: each is judged under the other."""
    tiers: tuple[str, ...] = ()
    verdict: Verdict | None = None
    iterations = 0
    problem = _screened(problem, state, present)
    for attempt in range(_ROUNDS):
        solution = minimise(problem, state, _FINE)
        state, iterations = solution.state, iterations + solution.iterations
        if shape.smooth and not problem.offsets:
            verdict = judge(problem, state)
        if verdict:
            tiers = verdict.tiers
        following, state = with_terms(problem, state, verdict.terms if verdict else problem.terms)
        settled = following.terms == problem.terms
        if settled and shape.smooth and shape.offsets and not problem.offsets and offsets_matter(problem, state):
            following, settled = replace(problem, offsets=True), False
        following = _screened(following, state, present)
        settled = settled and np.array_equal(following.observations.weights, problem.observations.weights)
        if settled or attempt == _ROUNDS - 1:
            break
        problem = following
    return Fit(problem, tiers, np.zeros(len(present), np.intp), solution, iterations, verdict)


def _screened(problem: BoardProblem, state: State, present: Array) -> BoardProblem:
    """Return the problem with outliers at weight 0 and σ brought up to date."""
    count = 2 * int(present.sum())
    freedom = max(1 - (problem.shared + 6 * len(present)) / count, 0.05)
    screening = screen(problem.distances(problem.residuals(state)), present, freedom)
    observations = replace(problem.observations, weights=screening.kept.astype(float))
    return replace(problem, observations=observations, sigma=screening.sigma, loss=None)


def _oriented(result: Fit, present: Array, shape: ShapeOptions) -> Fit:
    """Return the solution with every view of a symmetric board numbered from the end that fits its shape best."""
    if not shape.smooth or len(result.problem.board.symmetries()) == 1:
        return result
    result = _sorted_apart(result, present, shape)
    for _ in range(_ROUNDS):
        turns, state = best_turns(result.problem, result.state, present)
        if not turns.any():
            break
        result = _restarted(result, renumbered(result.problem, turns), state, turns, present, shape)
    return result


def _restarted(
    result: Fit, problem: BoardProblem, state: State, turns: Array, present: Array, shape: ShapeOptions
) -> Fit:
    """Return the solution after some views were turned; points freed under the old numbering start anew."""
    problem = replace(problem, offsets=False)
    total = (result.turns + turns) % len(problem.board.symmetries())
    return replace(_refine(problem, replace(state, offsets=0 * state.offsets), present, shape), turns=total)


def _sorted_apart(result: Fit, present: Array, shape: ShapeOptions) -> Fit:
    """Return the better of the solution and the one with the views sorted by their pull on the odd terms."""
    if result.verdict is None:
        return result
    opposed = opposed_views(result.verdict.factors, result.verdict.names)
    if not opposed.any():
        return result
    turns = opposed * (len(result.problem.board.symmetries()) // 2)
    trial = _restarted(result, *turned(result.problem, result.state, turns), turns, present, shape)
    sigma = result.problem.sigma
    gain = _chi_square(result, present, sigma) - _chi_square(trial, present, sigma)
    return trial if gain > len(present) else result


def _chi_square(result: Fit, present: Array, sigma: float) -> float:
    """Return χ² of all present points, rejected ones counted at the cut, so that solutions can be compared."""
    squared = (
        np.nan_to_num(result.problem.distances(result.problem.residuals(result.state)), nan=np.inf) ** 2 / sigma**2
    )
    return float(np.minimum(squared[present], CUT**2).sum())
