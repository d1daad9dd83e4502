"""Time offsets, clock rates and readout times of cameras before which a board moves.

Knots of the motion stand closer and closer until closer ones explain no more than noise, or until frames do not hold
them; what the last step has moved says how much is left, which the covariance includes. Each camera's noise and which
of its corners count are taken from the residuals. The covariance is no less than the scatter from stretch to stretch of
the recording says.
"""

from collections.abc import Sequence

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.problem import POSE
from camcal.calibrate.timing.problem import OFFSET, RATE, READOUT, TimedCorners, TimeProblem, TimeState, with_weights
from camcal.calibrate.timing.spline import Knots, motion_through
from camcal.calibrate.timing.start import Alignment, Track
from camcal.dataclass import dataclass, replace
from camcal.solve.chains import ChainFactors, ChainSolution, minimise_chain
from camcal.solve.descent import Stopping
from camcal.solve.losses import Cauchy
from camcal.targets.board import CLASSES, Surface, basis, scale_unit

_LOSS = Cauchy(3.0)
_STOPPING = Stopping(relative_decrease=1e-6, iterations=40)
_COARSEST, _FINEST = 4.0, 0.8  # frame intervals of a span
_LEFT = 1 / 15  # of what the last step has moved: errors fall with the fourth power of a span's length
_CERTAIN = 3.0  # standard deviations of what closer knots gain by chance
_REJECTED = 4.5  # standard deviations of a corner that does not count
_ROUNDS = 3  # of noise and weights
_STRETCHES = 40  # of the recording, whose scatter is looked at
_LEAST_NOISE = 1e-4  # px


@dataclass(frozen=True, eq=False)
class TimeEstimate:
    """Where cameras and board were. references: (N,) the stamps, s, at which the offsets hold.

    covariance: (S, S) of the shared parameters, see TimeProblem. free_sigmas: px of each camera, the noise that its
    views have with poses of their own. interval: s, between frames. alignments: of all cameras. stiff: whether closer
    knots would still explain more. unresolved: (3, N) s, what knots that are too far apart leave of the times' errors.
    """

    problem: TimeProblem
    state: TimeState
    references: Array
    covariance: Array
    factors: ChainFactors
    scatter: float
    interval: float
    alignments: tuple[Alignment, ...]
    stiff: bool
    unresolved: Array
    converged: bool

    def std(self, which: int, camera: int) -> float:
        """Return the standard deviation of a camera's offset, rate or readout time, 0 where it was held."""
        column = self.problem.time_columns[which, camera]
        return float(np.sqrt(self.covariance[column, column])) if column >= 0 else 0.0

    def middle_offset(self, camera: int) -> tuple[float, float] | None:
        """Return by how much the offset of a camera's middle row against the first camera's exceeds that of the first
        rows, s, and the standard deviation of the former; None where not all of its times are free.
        """
        columns = self.problem.time_columns[[OFFSET, READOUT, READOUT], [camera, camera, 0]]
        if (columns < 0).any():
            return None
        weights, readouts = np.array([1.0, 0.5, -0.5]), self.state.times[READOUT]
        variance = weights @ self.covariance[np.ix_(columns, columns)] @ weights
        return float(readouts[camera] - readouts[0]) / 2, float(np.sqrt(variance))


def estimate_times(
    surface: Surface,
    cameras: Sequence[TimedCorners],
    lenses: Sequence[Array],
    tracks: Sequence[Track],
    alignments: Sequence[Alignment],
    *,
    offsets: bool,
    shutter: bool,
) -> TimeEstimate:
    """Return the times of cameras, from the poses of their views and how their clocks are apart.

    surface: the board, whose terms are estimated again. cameras: with stamps as they are. tracks: the poses (V,) of
    views, by their stamps. alignments: of all cameras with the first. Raises SingularError.
    """
    count = len(cameras)
    references = np.array([(own.times[0] + own.times[-1]) / 2 for own in tracks])
    times = np.zeros((3, count))
    times[OFFSET] = [own.offset for own in alignments] + references - references[0]
    free = np.zeros((3, count), bool)
    free[: RATE + 1, 1:] = offsets
    free[READOUT] = shutter
    cameras = [replace(own, stamps=own.stamps - reference) for own, reference in zip(cameras, references, strict=True)]
    interval = min(own.interval for own in tracks)
    rotations = np.stack([own.link.rotation for own in alignments])
    translations = np.stack([own.link.translation for own in alignments])
    moments, turned, moved = [], [], []
    for camera, track in enumerate(tracks):
        back = rotations[camera].T
        moments.append(track.times - references[camera] + times[OFFSET, camera])
        turned.append(back @ track.rotations)
        moved.append((track.translations - translations[camera]) @ rotations[camera])
    stamps = np.concatenate(moments)
    order = np.argsort(stamps, kind="stable")
    margin = 2 * interval
    knots = Knots.over(stamps.min() - margin, stamps.max() + margin, _COARSEST * interval)
    motion = motion_through(knots, stamps[order], np.concatenate(turned)[order], np.concatenate(moved)[order])
    state = TimeState(tuple(lenses), rotations, translations, times, np.array(surface.coefficients), motion)
    points = surface.board.points() if surface.offsets is None else surface.board.points() + surface.offsets
    terms = basis(surface.board, surface.terms)
    problem = TimeProblem(tuple(cameras), points, terms, _term_std(surface), free, knots.spans, _LOSS)
    solution, problem, stiff, change = _refine(problem, state, interval)
    for _ in range(_ROUNDS):
        problem = _weigh(replace(problem, loss=None), solution.state)
        solution = minimise_chain(problem, solution.state, _STOPPING)
    covariance, scatter = _covariance(problem, solution)
    columns, left = problem.time_columns[free], _LEFT * change[free]
    by_times = covariance[:, columns] @ np.linalg.solve(covariance[np.ix_(columns, columns)], left)
    return TimeEstimate(
        problem,
        solution.state,
        references,
        covariance=covariance + np.outer(by_times, by_times),
        factors=solution.factors,
        scatter=scatter,
        interval=interval,
        alignments=tuple(alignments),
        stiff=stiff,
        unresolved=_LEFT * np.abs(change),
        converged=solution.converged,
    )


def _term_std(surface: Surface) -> Array:
    """Return the standard deviations (S,) of the terms of a board's shape before the data, in its unit."""
    scales = {
        term: max(known.median, surface.classes.get(name, (0.0, 0.0))[0])
        for name, known in CLASSES.items()
        for term in known.terms
    }
    return np.array([scales[term] * scale_unit(surface.board, term) for term in surface.terms])


def _refine(
    problem: TimeProblem, state: TimeState, interval: float
) -> tuple[ChainSolution[TimeState], TimeProblem, bool, Array]:
    """Return the solution with knots as far apart as noise allows, whether closer ones would explain more, and by how
    much the last step of knots has moved the times (3, N).
    """
    solution = minimise_chain(problem, state, _STOPPING)
    while True:
        motion = solution.state.motion.refined()
        finer = replace(problem, spans=motion.knots.spans)
        found = minimise_chain(finer, replace(solution.state, motion=motion), _STOPPING)
        added = POSE * (motion.knots.spans - problem.spans)
        variance = _variance(finer, found)
        gain = 2 * (solution.cost - found.cost) / variance
        moved = found.state.times - solution.state.times
        if gain < added + _CERTAIN * np.sqrt(2 * added):
            return found, finer, False, moved  # a level closer than noise calls for: what is left is below it
        if motion.knots.step < 2 * _FINEST * interval:
            return found, finer, True, moved
        solution, problem = found, finer


def _variance(problem: TimeProblem, solution: ChainSolution[TimeState]) -> float:
    """Return twice the cost of a coordinate, the parameters deducted."""
    count = sum(2 * int(np.count_nonzero(own.weights)) for own in problem.cameras)
    spent = problem.shared + POSE * solution.state.motion.knots.nodes
    return 2 * solution.cost / max(count - spent, 0.05 * count)


def _weigh(problem: TimeProblem, state: TimeState) -> TimeProblem:
    """Return the problem with each camera's noise by its residuals, and without corners that are far from it."""
    count = sum(2 * int(np.count_nonzero(own.weights)) for own in problem.cameras)
    left = max(1 - (problem.shared + POSE * state.motion.knots.nodes) / count, 0.05)
    weights, sigmas = [], []
    for camera, own in enumerate(problem.cameras):
        given = np.where(own.weights > 0, own.weights, np.median(own.weights[own.weights > 0]))
        distances = np.linalg.norm(problem.residuals(state, camera), axis=0) * np.sqrt(given)
        distances = np.where(np.isfinite(distances), distances, np.inf)
        sigma = max(float(np.median(distances)) / np.sqrt(2 * np.log(2)), _LEAST_NOISE)
        for _ in range(_ROUNDS):
            kept = distances < _REJECTED * sigma
            sigma = max(float(np.sqrt(np.mean(distances[kept] ** 2) / 2)), _LEAST_NOISE)
        weights.append(np.where(kept, given, 0.0))
        sigmas.append(sigma / np.sqrt(left))
    return with_weights(problem, weights, sigmas)


def _covariance(problem: TimeProblem, solution: ChainSolution[TimeState]) -> tuple[Array, float]:
    """Return the covariance of the shared parameters, no less than the scatter between stretches of the recording says,
    and the variance by that over the one by noise.
    """
    factors = solution.factors
    covariance = factors.shared_covariance
    own = np.r_[problem.lens_starts[-1] : problem.board_start, problem.times_start : problem.shared]
    scores = np.zeros((_STRETCHES, problem.shared))
    blocks = problem.blocks(solution.state)
    assert blocks is not None
    for block in blocks:
        if block.group is None or block.groups is None:
            continue
        nodes = factors.followed[:, :-1].reshape(-1, POSE, problem.shared)
        of_span = np.stack([nodes[row : row + problem.spans] for row in range(4)], axis=1).reshape(
            problem.spans, -1, problem.shared
        )
        spans = np.repeat(block.groups, block.rows_per_group)
        _, weights = block.weighed()
        pulled = np.einsum("md,mdg->mg", block.residuals * weights[:, None], block.group)
        by_span = np.zeros((problem.spans, pulled.shape[1]))
        np.add.at(by_span, spans, pulled)
        stretch = np.arange(problem.spans) * _STRETCHES // problem.spans
        np.subtract.at(scores, stretch, np.einsum("sg,sgk->sk", by_span, of_span))
        for jacobian in block.shared:
            own_pull = np.einsum("md,mdl->ml", block.residuals * weights[:, None], jacobian.values)
            for place, column in enumerate(jacobian.columns):
                np.add.at(scores[:, column], stretch[spans], own_pull[:, place])
    steps = scores @ covariance[:, own]
    root = np.linalg.inv(np.linalg.cholesky(covariance[np.ix_(own, own)]))
    used = int(np.any(scores, axis=1).sum())
    scatter = root @ (steps.T @ steps) @ root.T * used / max(used - 2, 1)
    ratio = float(np.trace(scatter) / len(scatter))
    return covariance * max(ratio, 1.0), ratio
