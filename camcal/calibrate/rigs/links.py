"""Which cameras captures link, and where the cameras are to begin with.

Two cameras that saw the board in the same capture have a relative pose by it. Over captures the one is taken that most
of them agree with; a board that is symmetric may have been numbered from another end in one of the views, so that each
capture has as many candidates as the board has symmetries. Cameras are placed along the paths whose relative poses are
known best.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.initialise import symmetry_motion
from camcal.geometry import rotation as so3
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


def place(links: Mapping[tuple[int, int], Link], count: int) -> Placed:
    """Return where `count` cameras are, as far as they are linked to most others, along the paths known best.

    links: b_T_a by (a, b), a < b. The camera that comes first among those that are linked stands at the identity.
    """
    both = dict(links) | {(b, a): own.inverse() for (a, b), own in links.items()}
    components = _components(links, count)
    chosen = max(components, key=lambda own: (len(own), -own[0]))
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
