"""Which cameras captures link, and where the cameras are to begin with.

Two cameras that saw the board in the same capture have a relative pose by it. Over captures the one is taken that most
of them agree with; a board that is symmetric may have been numbered from another end in one of the views, so that each
capture has as many candidates as the board has symmetries. Cameras are placed along the paths whose relative poses are
known best.

A chessboard that looks the same turned by half may be numbered from either end in every image. Within a capture all
views are numbered alike, as their cameras' poses demand. From capture to capture the shape of the board tells its ends
apart; a flat one fits either way.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.initialise import MARGIN, looks_the_same, symmetry_motion, view_costs
from camcal.calibrate.noise import CUT
from camcal.calibrate.rigs.problem import RigProblem, RigState
from camcal.dataclass import dataclass, replace
from camcal.geometry import rotation as so3
from camcal.solve.descent import Stopping
from camcal.solve.least_squares import minimise
from camcal.solve.losses import Cauchy
from camcal.targets.board import Board

_TRIED = 200  # captures whose candidates are tried as the relative pose of two cameras


@dataclass(frozen=True, eq=False)
class CameraPoses:
    """Poses camera_T_board of one camera's views: captures (V,), rotations (V, 3, 3), translations (V, 3)."""

    captures: Array
    rotations: Array
    translations: Array


@dataclass(frozen=True, eq=False)
class Link:
    """The relative pose b_T_a of two cameras, as their common captures (n,) agree on it.

    errors: (n,) how far the board of each capture is from where it should be, in its unit. symmetries: (n,) by which
    the board as b saw it is turned for that. spread: the typical error.
    """

    rotation: Array
    translation: Array
    captures: Array
    errors: Array
    symmetries: Array

    @property
    def spread(self) -> float:
        """The median of the errors."""
        return float(np.median(self.errors))

    @property
    def variance(self) -> float:
        """How badly the relative pose is known, in the square of the board's unit; for comparison only."""
        return self.spread**2 / max(len(self.errors) - 1, 0.5) + 1e-18

    def inverse(self) -> "Link":
        """Return the link the other way round."""
        turned = self.rotation.T
        return Link(turned, -turned @ self.translation, self.captures, self.errors, self.symmetries)


def motions(board: Board) -> tuple[Array, Array]:
    """Return the rotations (S, 3, 3) and shifts (S, 3) under which the drawn board looks the same."""
    found = [symmetry_motion(board, permutation) for permutation in board.symmetries()]
    return np.stack([motion[0] for motion in found]), np.stack([motion[1] for motion in found])


def link(a: CameraPoses, b: CameraPoses, board: Board) -> Link | None:
    """Return the relative pose b_T_a that most captures agree with, None where two cameras have none in common."""
    common, of_a, of_b = np.intersect1d(a.captures, b.captures, return_indices=True)
    if not len(common):
        return None
    turns, shifts = motions(board)
    rotations = b.rotations[of_b][:, None] @ turns  # (n, S, 3, 3), the board numbered from each of its ends
    translations = b.translations[of_b][:, None] + np.einsum("nij,sj->nsi", b.rotations[of_b], shifts)
    back = a.rotations[of_a].transpose(0, 2, 1)[:, None]
    relative = rotations @ back
    moved = translations - np.einsum("nsij,nj->nsi", relative, a.translations[of_a])
    tried = np.unique(np.linspace(0, len(common) - 1, min(len(common), _TRIED)).astype(np.intp))
    points = outline(board)
    seen = np.einsum("nij,pj->npi", a.rotations[of_a], points) + a.translations[of_a][:, None]
    target = np.einsum("nsij,pj->nspi", rotations, points) + translations[:, :, None]
    best = None
    for rotation, translation in zip(relative[tried].reshape(-1, 3, 3), moved[tried].reshape(-1, 3), strict=True):
        errors = _errors(seen @ rotation.T + translation, target)
        total = float(np.sum(np.sqrt(errors.min(axis=1))))  # a robust sum: few captures may be anything
        if best is None or total < best[0]:
            best = (total, rotation, translation, errors)
    assert best is not None
    errors = best[3]
    chosen = np.argmin(errors, axis=1)
    rows = np.arange(len(common))
    rotation, translation = _mean(relative[rows, chosen], moved[rows, chosen], errors[rows, chosen], best[1:3])
    errors = _errors(seen @ rotation.T + translation, target)
    chosen = np.argmin(errors, axis=1)
    return Link(rotation, translation, common, errors[rows, chosen], chosen)


def outline(board: Board) -> Array:
    """Return the corners of the board's outline and its centre (5, 3)."""
    width, height = board.extent
    return np.array(
        [[0, 0, 0], [width, 0, 0], [0, height, 0], [width, height, 0], [width / 2, height / 2, 0]], dtype=float
    )


def _errors(points: Array, target: Array) -> Array:
    """Return the RMS distances (n, S) of points (n, P, 3) from candidates (n, S, P, 3)."""
    return np.asarray(np.sqrt(np.mean(np.sum((points[:, None] - target) ** 2, axis=3), axis=2)))


def _mean(rotations: Array, translations: Array, errors: Array, start: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return the mean of the relative poses whose errors are not far above the typical one, about the start."""
    weights = 1 / (1 + (errors / max(3 * float(np.median(errors)), 1e-12)) ** 4)
    weights /= weights.sum()
    turn = start[0] @ so3.exp(weights @ so3.log(start[0].T @ rotations))
    return np.asarray(turn), np.asarray(weights @ translations)


@dataclass(frozen=True, eq=False)
class Placed:
    """Poses camera_T_first of the cameras that are linked: rotations and translations by their places."""

    rotations: Mapping[int, Array]
    translations: Mapping[int, Array]


def place(links: Mapping[tuple[int, int], Link], count: int) -> tuple[Placed, ...]:
    """Return where `count` cameras are, those that are linked together, along the paths known best.

    links: b_T_a by (a, b), a < b. Of those that are linked the one that comes first stands at the identity.
    """
    both = dict(links) | {(b, a): own.inverse() for (a, b), own in links.items()}
    return tuple(_place_linked(both, chosen) for chosen in _components(links, count))


def _place_linked(both: Mapping[tuple[int, int], Link], chosen: Sequence[int]) -> Placed:
    first = chosen[0]
    rotations, translations = {first: np.eye(3)}, {first: np.zeros(3)}
    variance = {first: 0.0}
    while len(rotations) < len(chosen):
        a, b = min(
            (pair for pair in both if pair[0] in rotations and pair[1] not in rotations),
            key=lambda pair: (variance[pair[0]] + both[pair].variance, pair),
        )
        own = both[a, b]
        rotations[b] = own.rotation @ rotations[a]
        translations[b] = own.rotation @ translations[a] + own.translation
        variance[b] = variance[a] + own.variance
    return Placed(rotations, translations)


def _components(links: Mapping[tuple[int, int], Link], count: int) -> list[list[int]]:
    """Return the groups of cameras that links join, each in order."""
    group = list(range(count))
    for a, b in links:
        joined, gone = group[a], group[b]
        group = [joined if own == gone else own for own in group]
    return [[camera for camera in range(count) if group[camera] == own] for own in dict.fromkeys(group)]


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
