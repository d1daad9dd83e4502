"""Mirrored sections of a track: each candidate is reflected, solved again, and compared by its evidence.

A flat object seen from the front changes from one of its two poses to the other without a jump. So a track is cut
where its tilt is least and where the object was not seen; runs of pieces are mirrored, solved together with the frames
around them, and kept where they explain all pixels better. What explains them nearly as well is a rival, of weight
exp(-Δ/2).
"""

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass, replace
from camcal.estimate.tracking.frames import frame_minima
from camcal.estimate.tracking.measurements import ObjectPlane
from camcal.estimate.tracking.motion import MotionState
from camcal.estimate.tracking.pixel_batch import Chains, solve, spread_of
from camcal.estimate.tracking.process_noise import NoiseFit
from camcal.geometry import rotation as so3

FAR = np.radians(10.0)  # poses that are more than this apart are not the same
_FLAT = np.radians(30.0)  # a tilt at which one pose may pass into the other
_APART = 6  # frames between cuts
_RUNS = 4  # pieces that are mirrored together
_MAX_CHI2_INCREASE = 40.0  # of χ² by which a mirrored run may be worse before it is solved
_AROUND = 20  # frames on either side that are solved with it
_UNSEEN = 3  # frames in a row that are a cut
_ROUNDS = 6
_ITERATIONS = 30
_MOST = 40  # runs that are solved in one round
_PER_FRAME = 0.2  # of χ²: shorter runs are cheaper and come first
_LARGEST = 8.0  # times the frames of the track that they may have together
_HELD = 1e4  # times what is known of a state at the end of a stretch
_SIDE = np.radians(20.0)  # turned by more, an object shows another side
_MAX_ALTERNATIVE = 16.0  # Δ of rivals that are reported: a weight of 3e-4


# Another course of a track: the frames (K) where it is another pose, and its weight, of 1 for the track's own
Rival = tuple[Array, float]


def search_alternatives(found: NoiseFit, other: NoiseFit | None, flat: ObjectPlane | None) -> tuple[NoiseFit, Array]:
    """Return the track with the stretches turned over that are better so, and the probability (M) that a rival holds.

    other: a track of the same frames from another start, None if there is none. flat: the object's plane, if it has
    one.
    """
    if other is not None and other.evidence < found.evidence:
        found, other = other, found
    best, rivals = _turn_where_better(found, flat)
    if other is not None:
        apart = so3.angle_between(best.track.states.rotations, other.track.states.rotations)
        rivals += _rival(best, np.flatnonzero(apart > FAR), other.evidence - best.evidence)
    weights = np.zeros(len(best.track.chains.used))
    for frames, weight in rivals:
        weights[frames] += weight
    return best, weights / (1 + weights)


def _rival(found: NoiseFit, frames: Array, difference: float) -> list[Rival]:
    """Return the course of another pose at some frames, of -2 ln evidence larger by a difference, if it is a rival.

    Frames that show the object from one side have one error of the likelihood in common, however many they are. So the
    difference has the variance 4 Δ of noise, and n times as much by n frames of each side that they show it from.
    """
    if not len(frames):
        return []
    normals = found.track.states.rotations[frames][:, :, 2]
    turned = np.arccos(np.clip(np.sum(normals[1:] * normals[:-1], axis=1), -1.0, 1.0)).sum()
    alike = len(frames) / (1 + turned / _SIDE)
    difference = max(difference, 0.0) / (1 + found.track.chains.frames.repeated * alike)
    if difference > _MAX_ALTERNATIVE:
        return []
    return [(frames, float(np.exp(-difference / 2)))]


def _turn_where_better(found: NoiseFit, flat: ObjectPlane | None) -> tuple[NoiseFit, list[Rival]]:
    for _ in range(_ROUNDS):
        trials = None if flat is None else _try_mirrored(found, flat)
        if trials is None:
            break
        better = trials.accepted()
        if not better:
            return found, trials.rivals()
        track = solve(found.track.chains, found.track.motion, trials.entered(better))
        after = replace(found, track=track, spread=spread_of(track))
        if after.evidence > found.evidence:
            return found, trials.rivals()
        found = after
    return found, []


@dataclass(frozen=True, eq=False)
class _Trials:
    """Mirrored stretches after they were solved: windows (W, 2) of frames, states of all windows, differences Δ."""

    found: NoiseFit
    windows: Array
    offsets: Array
    states: MotionState
    differences: Array

    def apart(self, index: int) -> Array:
        """Return the frames of a trial whose pose is another one than the track's."""
        first, last = self.windows[index]
        own = self.found.track.states.rotations[first:last]
        rows = slice(self.offsets[index], self.offsets[index + 1])
        return np.asarray(first + np.flatnonzero(so3.angle_between(own, self.states.rotations[rows]) > FAR))

    def accepted(self) -> list[int]:
        """Return the trials that are better than the track, of overlapping ones the best."""
        result: list[int] = []
        for index in map(int, np.argsort(self.differences)):
            first, last = self.windows[index]
            clear = all(self.windows[one][1] <= first or last <= self.windows[one][0] for one in result)
            if self.differences[index] < 0 and clear and len(self.apart(index)):
                result.append(index)
        return result

    def entered(self, chosen: list[int]) -> MotionState:
        """Return the track's states with those of some trials in their places."""
        parts = [part.copy() for part in self.found.track.states]
        for index in chosen:
            first, last = self.windows[index]
            for whole, part in zip(parts, self.states, strict=True):
                whole[first:last] = part[self.offsets[index] : self.offsets[index + 1]]
        return MotionState(*parts)

    def rivals(self) -> list[Rival]:
        """Return the trials that are nearly as good, each course once."""
        result: list[Rival] = []
        for index in map(int, np.argsort(self.differences)):
            frames = self.apart(index)
            known = any(len(np.setxor1d(frames, others)) <= 0.1 * len(frames) for others, _ in result)
            if not known:
                result.extend(_rival(self.found, frames, float(self.differences[index])))
        return result


def _try_mirrored(found: NoiseFit, flat: ObjectPlane) -> _Trials | None:
    """Return all mirrored runs to be tried, solved; None if there are none."""
    track = found.track
    chains = track.chains
    rotations, translations = track.poses
    least = frame_minima(chains.frames, *flat.mirrored(rotations, translations))
    own = frame_minima(chains.frames, rotations, translations)
    worse = np.where(chains.used, least - own, 0.0)
    runs = _runs(_cuts(found, flat), worse, len(own))
    if not runs:
        return None
    breaks = np.flatnonzero(~chains.linked) + 1
    bounds = np.concatenate([[0], breaks, [len(chains.used)]])
    begun, ended = np.array(runs).T
    low = bounds[np.searchsorted(bounds, begun, side="right") - 1]
    high = bounds[np.searchsorted(bounds, ended, side="left")]
    # the frames around a run, within the chains it touches
    windows = np.stack([np.maximum(low, begun - _AROUND), np.minimum(high, ended + _AROUND)], axis=1)
    rows = np.concatenate([np.arange(first, last) for first, last in windows])
    offsets = np.concatenate([[0], np.cumsum(windows[:, 1] - windows[:, 0])])
    stacked = _stack(found, windows, rows)
    before = solve(stacked, track.motion, track.states.at(rows), 0, track.pulls[rows])
    mirrored = flat.mirrored(track.states.rotations, track.states.translations)
    states = _turn_over(track.states.at(rows), runs, windows, offsets, mirrored, chains.steps)
    after = solve(stacked, track.motion, states, _ITERATIONS)
    return _Trials(found, windows, offsets, after.states, after.evidence - before.evidence)


def _cuts(found: NoiseFit, flat: ObjectPlane) -> Array:
    """Return the frames before which a piece begins, without the first."""
    track = found.track
    tilt = flat.tilt(track.states.rotations, track.states.translations)
    inner = np.arange(1, len(tilt) - 1)
    least = inner[(tilt[inner] <= tilt[inner - 1]) & (tilt[inner] < tilt[inner + 1]) & (tilt[inner] < _FLAT)]
    used = np.flatnonzero(track.chains.used)
    blind = used[1:][np.diff(used) > _UNSEEN]
    begun = 1 + np.flatnonzero(track.chains.begun | ~track.chains.linked)
    cuts = sorted(int(each) for each in (*blind, *begun))
    for cut in least[np.argsort(tilt[least])]:
        if all(abs(int(cut) - each) >= _APART for each in cuts):
            cuts.append(int(cut))
    return np.unique(cuts)


def _runs(cuts: Array, worse: Array, count: int) -> list[tuple[int, int]]:
    """Return the frames [first, last) of runs of pieces that mirrored explain their own pixels nearly as well."""
    ends = [0, *map(int, cuts), count]
    pieces = len(ends) - 1
    total = np.concatenate([[0.0], np.cumsum(np.minimum(worse, 2 * _MAX_CHI2_INCREASE))])
    wanted = {(i, j) for i in range(pieces) for j in range(i + 1, min(i + _RUNS, pieces) + 1)}
    wanted |= {(0, j) for j in range(1, pieces + 1)} | {(i, pieces) for i in range(pieces)}
    runs = [(ends[i], ends[j]) for i, j in wanted]
    excess = {run: float(total[run[1]] - total[run[0]]) for run in runs if run[1] > run[0]}
    likely = sorted(
        (run for run, value in excess.items() if value < _MAX_CHI2_INCREASE),
        key=lambda run: (excess[run] + _PER_FRAME * (run[1] - run[0]), run),
    )
    kept: list[tuple[int, int]] = []
    rows = 0
    for run in likely[:_MOST]:
        rows += run[1] - run[0] + 2 * _AROUND
        if kept and rows > _LARGEST * max(count, 100):
            break
        kept.append(run)
    return kept


def _stack(found: NoiseFit, windows: Array, rows: Array) -> Chains:
    """Return the chains of windows one after another, their ends held where the track goes on."""
    chains, size = found.track.chains, found.track.motion.size
    numbers = np.repeat(np.arange(len(windows)), windows[:, 1] - windows[:, 0])
    own = chains.chains[rows]
    cut = np.diff(numbers) != 0
    fresh = np.cumsum(np.concatenate([[0], cut | (np.diff(own) != 0)]))
    anchors = chains.anchors[rows].copy()
    known = np.diagonal(found.spread.states, axis1=1, axis2=2)
    offset = 0
    for first, last in windows:
        if first > 0 and chains.chains[first - 1] == chains.chains[first]:
            anchors[offset] = _HELD / known[first]
        offset += last - first
        if last < len(chains.used) and chains.chains[last - 1] == chains.chains[last]:
            anchors[offset - 1] = _HELD / known[last - 1]
    within = rows[:-1].clip(max=len(chains.steps) - 1)
    return Chains(
        chains.frames.at(rows),
        chains.used[rows],
        steps=np.where(cut, 1.0, chains.steps[within]),
        chains=fresh,
        begun=chains.begun[within] & ~cut,
        unknown=chains.unknown,
        anchors=anchors.reshape(-1, size),
        jitter_std=None if chains.jitter_std is None else chains.jitter_std[rows],
        groups=numbers,
    )


def _turn_over(
    states: MotionState,
    runs: list[tuple[int, int]],
    windows: Array,
    offsets: Array,
    mirrored: tuple[Array, Array],
    steps: Array,
) -> MotionState:
    """Return the states of windows with their runs mirrored, turning as the mirrored poses do."""
    rotations, translations, rates = (part.copy() for part in states)
    for index, (first, last) in enumerate(runs):
        at = slice(offsets[index] + first - windows[index, 0], offsets[index] + last - windows[index, 0])
        rotations[at], translations[at] = mirrored[0][first:last], mirrored[1][first:last]
        if last - first > 1:
            turn = so3.log(mirrored[0][first + 1 : last] @ mirrored[0][first : last - 1].swapaxes(-1, -2))
            speed = turn / steps[first : last - 1, None]
            rates[at, 0, 3:] = np.concatenate([speed, speed[-1:]])
            rates[at, 1:] = 0.0
    return MotionState(rotations, translations, rates)
