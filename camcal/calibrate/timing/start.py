"""Time offsets to begin with, from the poses of single cameras.

How a board moves, in its own frame, is the same whichever camera sees it and wherever that stands: angular velocity,
and velocity of its centre along its axes. Two cameras' clocks are apart by the lag at which these agree best. Of the
lags that agree about as well as any, the one is taken at which one relative pose fits most moments; a motion that
repeats itself has several.
"""

from collections.abc import Sequence

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.rigs.links import CameraPoses, Link, link, motions
from camcal.dataclass import dataclass, replace
from camcal.geometry import rotation as so3
from camcal.targets.board import Board

_SPAN = 0.13  # s over which velocities are taken: poses of adjacent frames differ by their noise
_GAP = 2.5  # intervals between two poses that are still adjacent
_FEWEST, _SHARE = 15, 0.25  # of the moments that two cameras must have in common at a lag, and of the shorter series
_CLIP = 4.0  # times the RMS of most velocities
_CANDIDATES, _NEAR = 6, 0.1  # lags that are looked at: those whose disagreement is at most so much above the least
_STEPS = np.linspace(-1, 1, 21)  # of a lag, in which the best is searched
_ALIKE = 1.5  # times the spread of the best lag: another one that fits as well
_APART = 2.0  # intervals between two lags that are not the same


@dataclass(frozen=True, eq=False)
class Track:
    """Poses camera_T_board of one camera at times (V,), s, increasing; interval: the usual one between them."""

    times: Array
    rotations: Array
    translations: Array

    @property
    def interval(self) -> float:
        return float(np.median(np.diff(self.times)))

    def at(self, times: Array) -> tuple[Array, "Track"]:
        """Return which of some times (M,) have poses on both sides, and the poses between them."""
        after = np.clip(np.searchsorted(self.times, times), 1, len(self.times) - 1)
        before = after - 1
        length = self.times[after] - self.times[before]
        share = (times - self.times[before]) / length
        inside = (share >= 0) & (share <= 1) & (length < _GAP * self.interval)
        before, after, share = before[inside], after[inside], share[inside]
        rotations = so3.between(self.rotations[before], self.rotations[after], share)
        way = self.translations[after] - self.translations[before]
        translations = self.translations[before] + share[:, None] * way
        return inside, Track(times[inside], rotations, translations)

    def velocities(self, centre: Array, reach: float) -> tuple[Array, Array]:
        """Return times (N,) and how the board moved, (N, 6): its centre (3,), and by turning a point at `reach`, along
        its own axes, per second.
        """
        steps = max(1, round(_SPAN / self.interval))
        first, last = np.arange(len(self.times) - steps), np.arange(steps, len(self.times))
        length = self.times[last] - self.times[first]
        kept = length < steps * self.interval * 1.5
        first, last, length = first[kept], last[kept], length[kept, None]
        middle = (self.rotations @ centre) + self.translations
        turns = so3.log(self.rotations[first].transpose(0, 2, 1) @ self.rotations[last])
        half = self.rotations[first] @ so3.exp(turns / 2)
        moved = np.einsum("nji,nj->ni", half, middle[last] - middle[first])
        return (self.times[first] + self.times[last]) / 2, np.concatenate([moved, reach * turns], axis=1) / length


@dataclass(frozen=True, eq=False)
class Alignment:
    """Another camera's clock and place against one's: time = other's time + offset, link: other_T_one.

    symmetry: of the board, by which the other camera numbers it. others: offsets that fit as well. contrast: the spread
    at other lags over that at this one; 1 where nothing tells the lag.
    """

    offset: float
    link: Link
    symmetry: int
    others: tuple[float, ...] = ()
    contrast: float = np.inf


def align(one: Track, other: Track, board: Board, *, lags: bool) -> Alignment | None:
    """Return how two cameras' clocks are apart, None where they have no motion in common; lags: whether they may be."""
    step = min(one.interval, other.interval)
    turns, shifts = motions(board)
    if not lags:
        found = _spread(one, other, 0.0, board)
        return None if found is None else Alignment(0.0, found, int(np.bincount(found.symmetries).argmax()))
    points = board.points()
    centre, reach = points.mean(axis=0), float(np.linalg.norm(points - points.mean(axis=0), axis=1).mean())
    best: list[tuple[float, float]] = []
    seen = _sample(*one.velocities(centre, reach), step)
    usual = np.inf
    for turn, shift in zip(turns, shifts, strict=True):
        turned = Track(other.times, other.rotations @ turn, other.translations + other.rotations @ shift)
        offsets, scores = _disagreement(seen, _sample(*turned.velocities(centre, reach), step), step)
        if not len(offsets):
            continue
        lowest = np.r_[True, scores[1:] <= scores[:-1]] & np.r_[scores[:-1] <= scores[1:], True]
        best += zip(scores[lowest].tolist(), offsets[lowest].tolist(), strict=True)
        usual = min(usual, float(np.median(scores)))
    best.sort()
    best = [own for own in best if own[0] <= best[0][0] + _NEAR * max(usual, best[0][0])][:_CANDIDATES]
    links = [own for _, offset in best if (own := _nearest(one, other, offset, step, board)) is not None]
    if not links:
        return None
    links.sort(key=lambda own: own[1].spread)
    offset, found = links[0]
    as_good = [
        own for own, far in links[1:] if far.spread < _ALIKE * found.spread and abs(own - offset) > _APART * step
    ]
    distinct = [
        own for place, own in enumerate(as_good) if all(abs(own - each) > _APART * step for each in as_good[:place])
    ]
    symmetry = int(np.bincount(found.symmetries).argmax())
    return Alignment(offset, found, symmetry, tuple(distinct), usual / max(best[0][0], 1e-12))


def _nearest(one: Track, other: Track, offset: float, step: float, board: Board) -> tuple[float, Link] | None:
    """Return the offset near one at which a relative pose fits best, and that pose."""
    tried = [(offset + step * share, _spread(one, other, offset + step * share, board)) for share in _STEPS]
    fitting = [(own, found) for own, found in tried if found is not None]
    return min(fitting, key=lambda own: own[1].spread) if fitting else None


def _spread(one: Track, other: Track, offset: float, board: Board) -> Link | None:
    """Return the relative pose that fits most moments where the other camera's time is `offset` behind."""
    inside, there = one.at(other.times + offset)
    if inside.sum() < 3:
        return None
    places = np.arange(int(inside.sum()))
    return link(
        CameraPoses(places, there.rotations, there.translations),
        CameraPoses(places, other.rotations[inside], other.translations[inside]),
        board,
    )


def _sample(times: Array, values: Array, step: float) -> tuple[float, Array, Array]:
    """Return the first time, values (N, 6) every `step`, which (N,) are known; few values that are far off are cut."""
    sizes = np.linalg.norm(values, axis=1)
    most = _CLIP * float(np.sqrt(np.mean(np.sort(sizes)[: max(1, int(0.95 * len(sizes)))] ** 2))) + 1e-300
    values = values * np.minimum(1, most / np.maximum(sizes, 1e-300))[:, None]
    grid = np.arange(times[0], times[-1] + step / 2, step)
    near = np.clip(np.searchsorted(times, grid), 1, len(times) - 1)
    apart = np.minimum(np.abs(times[near] - grid), np.abs(times[near - 1] - grid))
    known = apart < _GAP / 2 * max(float(np.median(np.diff(times))), step)
    sampled = np.stack([np.interp(grid, times, column) for column in values.T], axis=1)
    return float(grid[0]), np.where(known[:, None], sampled, 0.0), known.astype(float)


def _disagreement(
    one: tuple[float, Array, Array], other: tuple[float, Array, Array], step: float
) -> tuple[Array, Array]:
    """Return offsets (L,), s, and how much of the motion two cameras do not agree on at each: 0 … 1, 2 if opposite."""
    (start, a, known_a), (start_b, b, known_b) = one, other
    both = np.correlate(known_a, known_b, "full")
    energy = np.correlate((a**2).sum(axis=1), known_b, "full") + np.correlate(known_a, (b**2).sum(axis=1), "full")
    common = sum(np.correlate(first, second, "full") for first, second in zip(a.T, b.T, strict=True))
    lags = np.arange(-(len(b) - 1), len(a))
    enough = both >= max(_FEWEST, _SHARE * min(known_a.sum(), known_b.sum()))
    enough &= energy > _SHARE * min((a**2).sum(), (b**2).sum())
    scores = 1 - 2 * np.asarray(common) / np.maximum(energy, 1e-300)
    return (start - start_b + step * lags)[enough], np.asarray(scores[enough])


def place_tracks(tracks: Sequence[Track], board: Board, *, lags: bool) -> dict[int, Alignment]:
    """Return the alignment with the first camera of all others that have motion in common with it, or with one that
    does, by their places.
    """
    found = {
        0: Alignment(0.0, Link(np.eye(3), np.zeros(3), np.zeros(1, np.intp), np.zeros(1), np.zeros(1, np.intp)), 0)
    }
    placed = {0: tracks[0]}
    turns, shifts = motions(board)
    while len(found) < len(tracks):
        pairs = [
            (own.link.spread, new, _by_way_of(found[old], own))
            for new in range(len(tracks))
            if new not in found
            for old in found
            if (own := align(placed[old], tracks[new], board, lags=lags)) is not None
        ]
        if not pairs:
            break
        _, new, own = min(pairs, key=lambda pair: pair[0])
        found[new], track = own, tracks[new]
        turn, shift = turns[own.symmetry], shifts[own.symmetry]
        placed[new] = Track(track.times, track.rotations @ turn, track.translations + track.rotations @ shift)
    return found


def _by_way_of(first: Alignment, then: Alignment) -> Alignment:
    """Return the alignment with the first camera by way of another one."""
    own = then.link
    translation = own.rotation @ first.link.translation + own.translation
    joined = replace(own, rotation=own.rotation @ first.link.rotation, translation=translation)
    others = tuple(offset + first.offset for offset in then.others)
    return replace(then, offset=then.offset + first.offset, link=joined, others=others)
