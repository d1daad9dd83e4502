"""What links cameras to each other, and how well each link alone says where they stand."""

from collections.abc import Sequence
from itertools import combinations, product

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.problem import POSE
from camcal.calibrate.rigs.fit import RigFit
from camcal.calibrate.robot.problem import Poses, by_factors, by_inverse
from camcal.dataclass import dataclass
from camcal.geometry.frame_graph import CameraLink

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
    own = slice(problem.attached_start, problem.board_start)
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
                between, slopes = _between(on_body, one, other, problem.attached)
                uncertain = slopes @ fit.covariance[own, own] @ slopes.T
                std = _std(a, rows_a[in_a], b, rows_b[in_b], between, uncertain)
                through = tuple(dict.fromkeys(boards[place] for place in (one, other) if boards[place]))
                found.append(CameraLink((a.name, b.name), through, len(common), std))
        if found:
            result.append(min(found, key=lambda own: own.std))
    return tuple(result)


def _between(on_body: Poses, one: int, other: int, attached: Sequence[int]) -> tuple[Poses, Array]:
    """Return other_T_one of two boards on their body, and its derivatives (6, 6 n) by the steps of those attached."""
    ends = [on_body.take(np.array([board])) for board in (other, one)]
    back = ends[0].inverse()
    by_back, by_one = by_factors(back, ends[1])
    slopes = np.zeros((POSE, POSE * len(attached)))
    for board, values in ((one, by_one[0]), (other, (by_back @ by_inverse(ends[0]))[0])):
        if board in attached:
            start = POSE * attached.index(board)
            slopes[:, start : start + POSE] += values
    return back @ ends[1], slopes


def _std(a: _CameraViews, rows_a: Array, b: _CameraViews, rows_b: Array, between: Poses, uncertain: Array) -> float:
    """Return the standard deviation, m, of an axis of the positions of b in a and a in b by views of common captures.

    between: other_T_one of the boards that they see, and its covariance.
    """
    seen, board = a.poses.take(rows_a), b.poses.take(rows_b)
    moved = board @ between  # b_T_one
    by_a, by_back = by_factors(seen, moved.inverse())
    by_b, by_between = (by_back @ by_inverse(moved) @ each for each in by_factors(board, between))
    covariances = by_a @ a.covariances[rows_a] @ by_a.transpose(0, 2, 1)
    covariances += by_b @ b.covariances[rows_b] @ by_b.transpose(0, 2, 1)
    information = np.linalg.inv(covariances + _HELD * np.eye(POSE))
    total = np.linalg.inv(information.sum(axis=0))
    mean = total @ (information @ by_between).sum(axis=0)
    total = total + mean @ uncertain @ mean.T
    back = by_inverse((seen @ moved.inverse()).take(np.array([0])))[0]
    return float(np.sqrt(np.trace((total + back @ total @ back.T)[:3, :3]) / 6))
