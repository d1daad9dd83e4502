"""Which way round a symmetric board was seen.

A chessboard with columns + rows even looks the same turned by 180°, a square one by 90°. A flat board fits either
way, a bent one does not: numbering some views from the wrong end would average its shape away.
"""

from dataclasses import replace

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.outliers import CUT
from camcal.calibrate.problem import BoardProblem, State
from camcal.geometry import rotation as so3
from camcal.solve.descent import Stopping
from camcal.solve.least_squares import minimise
from camcal.solve.losses import Cauchy
from camcal.targets.board import Board

_MARGIN = 9.0  # a fall of χ² by 3σ turns a view; less is noise
_POSES = Stopping(relative_decrease=1e-6, iterations=20)


def renumbered(problem: BoardProblem, turns: Array) -> BoardProblem:
    """Return the problem with view v numbered by symmetry turns[v] of the board."""
    ids = np.take_along_axis(np.stack(problem.board.symmetries())[turns], problem.observations.ids, axis=1)
    return replace(problem, observations=replace(problem.observations, ids=ids))


def turned(problem: BoardProblem, state: State, turns: Array) -> tuple[BoardProblem, State]:
    """Return problem and state with view v numbered by symmetry turns[v] of the board, the poses turned along."""
    motions = [_motion(problem.board, permutation) for permutation in problem.board.symmetries()]
    rotations = np.stack([motion[0] for motion in motions])[turns]
    shifts = np.stack([motion[1] for motion in motions])[turns]
    moved = np.einsum("vij,vj->vi", state.rotations, shifts) + state.translations
    return renumbered(problem, turns), replace(state, rotations=state.rotations @ rotations, translations=moved)


def _motion(board: Board, permutation: Array) -> tuple[Array, Array]:
    """Return the rotation (3, 3) and shift (3,) that take the drawn point permutation[id] to the point id."""
    points, centre = board.points(), board.points().mean(axis=0)
    moment = (points - centre).T @ (points[permutation] - centre)
    moment[2, 2] = np.linalg.norm(moment)  # the board stays face up
    rotation = so3.nearest(moment)
    return rotation, centre - rotation @ centre


def best_turns(problem: BoardProblem, state: State, present: Array) -> tuple[Array, State]:
    """Return for every view the symmetry (V,) under which the board's shape fits it best, 0 where none is better, and
    the state with the poses of the views so turned.

    Every present point (V, P) has its say: a view may have been rejected because it was numbered from another end.
    """
    poses, bare = problem.poses_only(state)
    observations = replace(poses.observations, weights=present.astype(float))
    poses = replace(poses, observations=observations, loss=Cauchy(CUT))
    states, costs = [bare], [_view_costs(poses, bare)]
    for index, permutation in enumerate(problem.board.symmetries()[1:], start=1):
        if _looks_the_same(problem.board, problem.board_points(state), permutation):
            states.append(bare)
            costs.append(costs[0])
            continue
        trial, start = turned(poses, bare, np.full(len(present), index))
        states.append(minimise(trial.within_domain(start), start, _POSES).state)
        costs.append(_view_costs(trial, states[-1]))
    gains = costs[0] - np.stack(costs)
    views, best = np.arange(len(present)), np.argmax(gains, axis=0)
    turns = np.where(gains[best, views] > _MARGIN, best, 0)
    rotations = np.stack([trial.rotations for trial in states])[turns, views]
    translations = np.stack([trial.translations for trial in states])[turns, views]
    return turns, replace(state, rotations=rotations, translations=translations)


def _looks_the_same(board: Board, points: Array, permutation: Array) -> bool:
    """Return whether a shape fits itself when turned, so that no view could tell."""
    rotation, shift = _motion(board, permutation)
    return bool(np.abs(points[permutation] @ rotation.T + shift - points).max() < 1e-9 * max(board.extent))


def _view_costs(problem: BoardProblem, state: State) -> Array:
    """Return χ² of each view (V,), every point counted up to the cut of outliers."""
    squared = np.nan_to_num(problem.distances(problem.residuals(state)) / problem.sigma, nan=np.inf) ** 2
    present = problem.observations.weights > 0
    return np.asarray(np.where(present, np.minimum(squared, CUT**2), 0.0).sum(axis=1))


def opposed_views(scores: Array, information: Array) -> Array:
    """Return a guess (V,) of which views were numbered from the other end, as 0 or 1; all 0 when nothing says so.

    scores: (V, 4) each view's pull on the cubic terms. information: (4, 4) what all views know of them.
    Turning a view by 180° changes the sign of its pull. When views of both kinds are mixed the pulls cancel and no
    shape is seen to choose by; their main axis still tells the two kinds apart.
    """
    pulls = np.linalg.solve(np.linalg.cholesky(information), scores.T)
    axis = np.linalg.eigh(pulls @ pulls.T)[1][:, -1]
    signs = np.where(axis @ pulls < 0, -1.0, 1.0)
    gain = np.sum((pulls @ signs) ** 2) - np.sum(pulls.sum(axis=1) ** 2)
    # signs chosen on noise alone would raise χ² by some 0.6 to 0.9 per view
    if gain < _MARGIN + 1.5 * len(signs):
        return np.zeros(len(signs), np.intp)
    return np.asarray(signs * np.sign(signs.sum() or 1.0) < 0, dtype=np.intp)
