"""The minima of the reprojection error: starts, the lowest of each valley refined, and the planes' second poses."""

import numpy as np

from camcal.arrays import Array
from camcal.estimate.poses import states as se3
from camcal.estimate.poses.extent import NEAR_PLANE, Extents
from camcal.estimate.poses.problem import PoseProblems
from camcal.estimate.poses.starts import starts
from camcal.solve.independent import Minima, joined

_STARTS = 4
_COMPARED = 12  # starts or minima of one view that are compared with each other, the lowest
_SAME_START = 0.1  # rad, and share of the distance: starts this near lead to one minimum
_SAME_MINIMUM = 1e-3


def pose_minima(problems: PoseProblems, extents: Extents) -> Minima:
    """Return the different minima of every problem, in the order of the problems and the lowest first.

    problems: one of each view, of all points present. A problem may have none: no start has its points in the domain.
    """
    if len(problems.sights) == 1:
        return _with_second_poses(problems, extents, *_starts_of(problems, extents))
    found = []
    for sight in problems.sights:
        own = PoseProblems.of((sight,))
        spread = Extents.of(sight.points, sight.present)
        minima = _with_second_poses(own, spread, *_starts_of(own, spread))
        found.append((minima.states, minima.which))
    found.append(anchors(problems))
    return refined(problems, *(np.concatenate(parts) for parts in zip(*found, strict=True)))


def _starts_of(problems: PoseProblems, extents: Extents) -> tuple[Array, Array]:
    """Return starts (S, 3, 4), frame_T_object, of what one camera sees, and their problems (S,)."""
    sight = problems.sights[0]
    states, which = starts(sight, extents)
    parts = (se3.compose(sight.inverse_frame, states), which), anchors(problems)
    return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])


def anchors(problems: PoseProblems) -> tuple[Array, Array]:
    """Return the pose known beforehand, if there is one, as a start (S, 3, 4) of every problem (S,)."""
    if problems.anchor is None:
        return np.zeros((0, 3, 4)), np.zeros(0, np.intp)
    return problems.anchor.states[problems.view], np.arange(len(problems.view))


def _with_second_poses(problems: PoseProblems, extents: Extents, states: Array, which: Array) -> Minima:
    """Return the minima that starts lead to, and those that planes are mistaken for."""
    eye = problems.sights[0].eye
    flat = np.flatnonzero(extents.flatness[which] < NEAR_PLANE)
    second = extents.reflected(states[flat], which[flat], eye)
    of_second = which[flat]
    found = refined(problems, np.concatenate([states, second]), np.concatenate([which, of_second]))
    # the reflection of a start far from its minimum may lie in another valley than that of the minimum
    best = lowest(found)
    best = best[extents.flatness[found.which[best]] < NEAR_PLANE]
    best = best[~_tried(found.states[best], found.which[best], (states[flat], of_second), (second, of_second))]
    if not best.size:
        return found
    mirrors = extents.reflected(found.states[best], found.which[best], eye)
    return different(joined(found, problems.minimise(mirrors, found.which[best])))


def _tried(minima: Array, problem: Array, *starts: tuple[Array, Array]) -> Array:
    """Return the mask (S,) of minima (S, 3, 4) near the only start of their problems (S,), or near its reflection.

    The reflections of such minima lead where those of the starts did. starts: states and their problems, of each kind.
    """
    tried = np.zeros(len(problem), dtype=bool)
    for states, which in starts:
        order = np.argsort(which, kind="stable")
        first = order[np.searchsorted(which[order], problem)]
        single = np.bincount(which)[problem] == 1
        tried |= single & se3.near(states[first], minima, _SAME_START)
    return tried


def refined(problems: PoseProblems, states: Array, which: Array) -> Minima:
    """Return the different minima that the most promising starts (S, 3, 4) of problems (S,) lead to."""
    # two starts are faster followed than told apart
    if np.bincount(which).max(initial=0) > 2:
        chosen = distinct(states, which, problems.cost(states, which), _SAME_START, _STARTS)
        states, which = states[chosen], which[chosen]
    return different(problems.minimise(states, which))


def different(minima: Minima) -> Minima:
    """Return the minima without repetitions, in the order of the problems and the lowest first."""
    inside = np.isfinite(minima.cost)
    if not inside.all():
        minima = minima.take(inside)
    # searches that ended early are near their minima only
    tolerance = np.where(minima.converged, _SAME_MINIMUM, _SAME_START)
    return minima.take(distinct(minima.states, minima.which, minima.cost, tolerance, _COMPARED))


def lowest(minima: Minima) -> Array:
    """Return the indices of the first of each problem, of minima in their order."""
    return firsts(minima.which)


def firsts(which: Array) -> Array:
    """Return the indices at which the problems (S,), in their order, begin."""
    begins = np.ones(len(which), dtype=bool)
    np.not_equal(which[1:], which[:-1], out=begins[1:])
    return begins.nonzero()[0]


def distinct(states: Array, which: Array, cost: Array, tolerance: Array | float, most: int) -> Array:
    """Return the indices of up to `most` states of each problem that no lower one is near to, problems in order and
    the lowest first; tolerance: rad, and share of the distance, (S,) or one for all.
    """
    order = np.lexsort((cost, which))
    first = firsts(which[order])
    if len(first) == len(order):
        return order
    length = np.diff(first, append=len(order))
    width = min(int(length.max(initial=0)), _COMPARED)
    ranks = np.arange(width)
    table = order[np.minimum(first[:, None] + ranks, len(order) - 1)]
    there = ranks < length[:, None]
    own = np.broadcast_to(tolerance, len(order))[table][:, None]
    close = se3.near(states[table][:, :, None], states[table][:, None], own)
    kept = there.copy()
    for rank in range(1, width):
        kept[:, rank] &= ~np.any(close[:, :rank, rank] & kept[:, :rank], axis=1)
    kept &= np.cumsum(kept, axis=1) <= most
    return np.asarray(table[kept])
