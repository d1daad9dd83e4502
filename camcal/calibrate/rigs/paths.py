"""What links cameras to each other, and how well each link alone says where they stand."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.problem import POSE
from camcal.calibrate.rigs.fit import RigFit
from camcal.calibrate.robot.problem import by_factors, by_inverse
from camcal.calibrate.robot.start import Poses
from camcal.geometry.camera_links import CameraLink

_HELD = 1e-12  # m² and rad², so that views without noise have an inverse


@dataclass(frozen=True, eq=False)
class _CameraViews:
    """Of a camera the captures of a body (V,) and the boards (V,) of its views, their poses camera_T_board and the
    covariances (V, 6, 6) of these by the view itself.
    """

    name: str
    captures: Array
    boards: Array
    poses: Poses
    covariances: Array


def camera_links(fit: RigFit, names: Sequence[str], alone: Sequence[Array]) -> tuple[CameraLink, ...]:
    """Return the best link of every pair of cameras that saw boards of one body in the same captures.

    alone: of each camera the covariances (V, 6, 6) of the poses of its views by itself.
    """
    problem, boards = fit.problem, tuple(fit.problem.board.members)
    on_body = Poses(fit.state.boards.rotations, fit.state.boards.translations)
    variances = dict.fromkeys(range(len(boards)), 0.0)
    for place, board in enumerate(problem.attached):
        start = problem.attached_start + POSE * place
        variances[board] = float(np.trace(fit.covariance[start : start + 3, start : start + 3])) / 3
    views = [
        _CameraViews(name, captures, on_board, Poses(state.rotations, state.translations), covariances)
        for name, captures, on_board, state, covariances in zip(
            names, problem.captures, problem.boards, fit.camera_states(), alone, strict=True
        )
    ]
    result = []
    for a, b in combinations(views, 2):
        found = []
        for one, other in product(np.unique(a.boards).tolist(), np.unique(b.boards).tolist()):
            rows_a, rows_b = np.flatnonzero(a.boards == one), np.flatnonzero(b.boards == other)
            common, in_a, in_b = np.intersect1d(a.captures[rows_a], b.captures[rows_b], return_indices=True)
            if len(common):
                between = on_body.take(np.array([other])).inverse() @ on_body.take(np.array([one]))
                variance = _variance(a, rows_a[in_a], b, rows_b[in_b], between)
                variance += sum(variances[board] for board in ({one, other} if one != other else ()))
                through = tuple(dict.fromkeys(boards[place] for place in (one, other) if boards[place]))
                found.append(CameraLink((a.name, b.name), through, len(common), float(np.sqrt(variance))))
        if found:
            result.append(min(found, key=lambda own: own.std))
    return tuple(result)


def _variance(a: _CameraViews, rows_a: Array, b: _CameraViews, rows_b: Array, between: Poses) -> float:
    """Return the variance, m², of an axis of b's position in a by views of common captures; between: other_T_one."""
    seen, board = a.poses.take(rows_a), b.poses.take(rows_b)
    moved = board @ between  # b_T_one
    by_a, by_back = by_factors(seen, moved.inverse())
    by_b = by_back @ by_inverse(moved) @ by_factors(board, between)[0]
    covariances = by_a @ a.covariances[rows_a] @ by_a.transpose(0, 2, 1)
    covariances += by_b @ b.covariances[rows_b] @ by_b.transpose(0, 2, 1)
    information = np.linalg.inv(covariances + _HELD * np.eye(POSE)).sum(axis=0)
    return float(np.trace(np.linalg.inv(information)[:3, :3])) / 3
