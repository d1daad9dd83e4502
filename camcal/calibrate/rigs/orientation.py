"""From which end a symmetric board is numbered in each capture.

A chessboard that looks the same turned by half may be numbered from either end in every image. Within a capture all
views are numbered alike, as their cameras' poses demand. From capture to capture the shape of the board tells its ends
apart; a flat one fits either way.
"""

from dataclasses import replace

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.initialise import MARGIN, looks_the_same, view_costs
from camcal.calibrate.noise import CUT
from camcal.calibrate.rigs.links import motions
from camcal.calibrate.rigs.problem import RigProblem, RigState
from camcal.solve.descent import Stopping
from camcal.solve.least_squares import minimise
from camcal.solve.losses import Cauchy
from camcal.targets.board import Board

_POSES = Stopping(relative_decrease=1e-6, iterations=20)


def turned(problem: RigProblem, state: RigState, turns: Array) -> tuple[RigProblem, RigState]:
    """Return problem and state with the board of capture g numbered by symmetry turns[g], its poses turned along."""
    table = np.stack(problem.board.symmetries())
    parts = []
    for part, captures in zip(problem.parts, problem.captures, strict=True):
        ids = np.take_along_axis(table[turns[captures]], part.observations.ids, axis=1)
        parts.append(replace(part, observations=replace(part.observations, ids=ids)))
    rotations, shifts = (own[turns] for own in motions(problem.board))
    moved = np.einsum("gij,gj->gi", state.rotations, shifts) + state.translations
    return problem.with_parts(parts), replace(state, rotations=state.rotations @ rotations, translations=moved)


def composed(first: Array, then: Array, board: Board) -> Array:
    """Return the symmetries (V,), by their places among the board's, of views turned by one and then by another."""
    table = np.stack(board.symmetries())
    ids = np.take_along_axis(table[then], table[first], axis=1)
    return np.array([int(np.flatnonzero((table == row).all(axis=1))[0]) for row in ids], np.intp)


def best_turns_of_captures(problem: RigProblem, state: RigState) -> Array:
    """Return for every capture the symmetry (G,) under which the board's shape fits its views best, 0 where none is
    better. Every point that there is counts.
    """
    held, bare = problem.captures_only(state)
    parts = [
        replace(
            part,
            observations=replace(part.observations, weights=part.observations.present.astype(float)),
            loss=Cauchy(CUT),
        )
        for part in held.parts
    ]
    held, points = held.with_parts(parts), parts[0].board_points(held.of_camera(bare, 0))
    costs = [_costs(held, bare)]
    for index, permutation in enumerate(problem.board.symmetries()[1:], start=1):
        if looks_the_same(problem.board, points, permutation):
            costs.append(costs[0])
            continue
        trial, start = turned(held, bare, np.full(problem.count, index))
        inside = trial.with_parts(
            [part.within_domain(trial.of_camera(start, camera)) for camera, part in enumerate(trial.parts)]
        )
        costs.append(_costs(trial, minimise(inside, start, _POSES).state))
    gains = costs[0] - np.stack(costs)
    best = np.argmax(gains, axis=0)
    return np.where(gains[best, np.arange(problem.count)] > MARGIN, best, 0)


def _costs(problem: RigProblem, state: RigState) -> Array:
    """Return χ² of the captures (G,), every point counted up to the cut of outliers."""
    result = np.zeros(problem.count)
    for camera, (part, captures) in enumerate(zip(problem.parts, problem.captures, strict=True)):
        result[captures] += view_costs(part, problem.of_camera(state, camera))
    return result
