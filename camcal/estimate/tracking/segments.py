"""Track segments from poses of single frames: initialisation, gating, and termination.

A frame allows several poses where a plane leaves a doubt. A wrong start among two mirrored poses would be followed for
long. So a piece starts with every candidate of its first frames, and the one that agrees with most of the frames to
come is kept. When a piece is lost, the next one starts again: nothing is bridged.

A jerk is no loss: if two detections in a row lie outside the gate, but both are inside once the velocity before the
first of them may have become any other, the piece goes on with that.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np

from camcal.arrays import Array, FloatArray, readonly
from camcal.errors import InvalidInput
from camcal.estimate.poses.records import Alternative
from camcal.estimate.smoothing.kalman import gate
from camcal.estimate.tracking import pose_filter
from camcal.estimate.tracking.pose_filter import Candidates, FilterState, GatingResult, Run
from camcal.geometry.pose import Pose

_ASTRAY = 0.1, 0.3  # how far a wrong pose is off, standard deviations: share of the distance, and rad
_LEAST_DISTANCE = 1e-6  # m; poses of a camera in its own frame may have none
_RARE = 0.05  # share of detections that go wrong
LEAST = 3  # detections of a piece: two fix a velocity, the third tells whether it holds
STARTS = 5  # detections, every candidate of which is tried as the first
WINDOW = 25  # frames after which one of them is kept
LOST = 8  # detections in a row outside the gate
AGREEING = 2  # of them that fit one another: the first gives the new velocity, the second tells whether it holds
_DEGREES = 6


class FramePose(Protocol):
    """The pose a_T_b that one frame gave: its covariances (6, 6), in all and of the pixels' noise, and its rivals."""

    @property
    def transform(self) -> Pose: ...
    @property
    def covariance(self) -> FloatArray: ...
    @property
    def noise_covariance(self) -> FloatArray: ...
    @property
    def alternatives(self) -> tuple[Alternative, ...]: ...


@dataclass(frozen=True, eq=False)
class PoseMeasurements:
    """The candidates for a pose a_T_b at increasing times, frames without any included.

    stamps: (N,) s. rotations: (N, C, 3, 3). translations: (N, C, 3), m. covariances: (N, C, 6, 6) of the frame's own
    noise, order tx ty tz rx ry rz, without what all frames share (an error of the lens does not average out).
    penalties: (N, C), by how much χ² of a candidate is above that of the best one; infinite where there is none.
    Raises InvalidInput unless stamps increase.
    """

    stamps: Array
    rotations: Array
    translations: Array
    covariances: Array
    penalties: Array

    def __post_init__(self) -> None:
        count, candidates = np.shape(self.penalties)
        shapes = {
            "stamps": (count,),
            "rotations": (count, candidates, 3, 3),
            "translations": (count, candidates, 3),
            "covariances": (count, candidates, 6, 6),
            "penalties": (count, candidates),
        }
        for name, shape in shapes.items():
            object.__setattr__(self, name, readonly(getattr(self, name), shape, name))
        late = np.flatnonzero(~(np.diff(self.stamps) > 0))
        if len(late):
            before, after = self.stamps[late[0]], self.stamps[late[0] + 1]
            raise InvalidInput(f"frame {late[0] + 1} at {after:.9g} s is not later than the one before, {before:.9g} s")

    @classmethod
    def of(cls, stamps: Array, estimates: Sequence[FramePose | None]) -> "PoseMeasurements":
        """Return the measurements that estimates make, one a frame, None for frames without a pose."""
        most = max((1 + len(estimate.alternatives) for estimate in estimates if estimate), default=1)
        shape = len(estimates), most
        rotations, translations = np.tile(np.eye(3), (*shape, 1, 1)), np.zeros((*shape, 3))
        covariances, penalties = np.tile(np.eye(6), (*shape, 1, 1)), np.full(shape, np.inf)
        for frame, estimate in enumerate(estimates):
            if estimate is None:
                # Places that stay empty are like the ones before, so that no filter meets wild numbers there.
                for values in (rotations, translations, covariances):
                    values[frame] = values[frame - 1]
                continue
            for rank, (pose, covariance, penalty) in enumerate(_candidates(estimate)):
                rotations[frame, rank:], translations[frame, rank:] = pose.rotation, pose.translation
                covariances[frame, rank:], penalties[frame, rank] = covariance, penalty
        return cls(stamps, rotations, translations, covariances, penalties)

    def __len__(self) -> int:
        return len(self.stamps)

    @cached_property
    def outlier_cost(self) -> float:
        """-2 log likelihood of a detection that went wrong, as `GatingResult.cost` counts: it may be anywhere near.

        Such a bound on what a frame can cost keeps outliers from speaking. A bound by the gate, which is far lower,
        would let a filter with too little noise call every quick motion an outlier.
        """
        distance = float(np.median(np.linalg.norm(self.translations[self.present, 0], axis=-1)))
        return float(6 * np.log(_ASTRAY[0] * max(distance, _LEAST_DISTANCE) * _ASTRAY[1]) - 2 * np.log(_RARE))

    @property
    def present(self) -> Array:
        """The mask (N,) of the frames with a candidate."""
        return np.asarray(np.isfinite(self.penalties).any(axis=1))

    def keeping(self, mask: Array) -> "PoseMeasurements":
        """Return the measurements with the candidates of the mask (N, C) alone."""
        return replace(self, penalties=np.where(mask, self.penalties, np.inf))


def _candidates(estimate: FramePose) -> Iterator[tuple[Pose, Array, float]]:
    """Yield the poses that one frame allows, with their noise and their penalties."""
    yield estimate.transform, estimate.noise_covariance, 0.0
    for other in estimate.alternatives:
        noise = estimate.noise_covariance if other.noise_covariance is None else other.noise_covariance
        yield other.transform, noise, other.chi_square_difference


@dataclass(frozen=True)
class GateOptions:
    """When a frame belongs to a track.

    confidence: with which a good detection is inside the gate. max_gap: s without an accepted detection that a piece
    outlives.
    """

    confidence: float = 0.999
    max_gap: float = 1.0

    def __post_init__(self) -> None:
        if not 0 < self.confidence < 1:
            raise InvalidInput(f"a gate is a probability between 0 and 1, such as 0.999, found {self.confidence:g}")
        if not self.max_gap > 0:
            raise InvalidInput(f"a gap is longer than 0 s, found {self.max_gap:g}")

    @cached_property
    def gate(self) -> float:
        """The bound of the NIS."""
        return gate(_DEGREES, self.confidence)


class Start(NamedTuple):
    """Where a piece starts: the frame, the candidate, and the last frame that was examined to choose it."""

    frame: int
    candidate: int
    settled: int


@dataclass(frozen=True, eq=False)
class Segment:
    """A piece of a track: frames `first` … `first` + M - 1, from an accepted detection to an accepted one.

    settled: the frame with which its start was chosen. run: the filter's beliefs at its frames. verdicts: on their
    detections, arrays (M, …); the first one, which nothing predicts, is accepted with a NIS of NaN.
    jerks: the frames with the first detections after the velocity had become another.
    """

    first: int
    settled: int
    run: Run
    verdicts: GatingResult
    jerks: tuple[int, ...]

    @property
    def frames(self) -> Array:
        """The indices (M,) of its frames."""
        return self.first + np.arange(len(self.run.growth))

    def costs(self, outlier_cost: float) -> Array:
        """Return -2 log likelihood (M,) of its frames, of those refused that of a detection that went wrong."""
        return np.minimum(np.where(self.verdicts.accepted, self.verdicts.cost, outlier_cost), outlier_cost)

    @property
    def foretold(self) -> Array:
        """The mask (M,) of accepted detections that a known velocity predicted: their innovations tell of the noise.

        At the first two of a piece and the first after a jerk they tell of how little was known of the velocity.
        """
        result = np.array(self.verdicts.accepted)
        result[np.flatnonzero(result)[:2]] = False
        result[np.array(self.jerks, dtype=int) - self.first] = False
        return result


def follow(measurements: PoseMeasurements, noise: Array, following: GateOptions) -> list[Segment]:
    """Return the pieces in which a pose can be followed, in order; noise: (2,) as `process_covariance` has it."""
    detections = np.flatnonzero(measurements.present)
    segments: list[Segment] = []
    place = 0
    while place < len(detections):
        chosen = _start(measurements, detections[place:], noise, following)
        if chosen is None:
            place += 1
            continue
        segment, resume = _followed(measurements, chosen, noise, following)
        segments.append(segment)
        place = int(np.searchsorted(detections, resume))
    return segments


def candidates_at(measurements: PoseMeasurements, frame: int | Array) -> Candidates:
    """Return the candidates of one frame, or of an array of frames."""
    return Candidates(
        measurements.rotations[frame],
        measurements.translations[frame],
        measurements.covariances[frame],
        measurements.penalties[frame],
    )


def _start(measurements: PoseMeasurements, detections: Array, noise: Array, following: GateOptions) -> Start | None:
    """Return the start at one of the first detections with which most of the frames agree, None if too few do."""
    stamps = measurements.stamps
    last = min(int(detections[0]) + WINDOW, len(stamps) - 1)
    apart = np.flatnonzero(np.diff(stamps[detections]) > following.max_gap)
    if len(apart):
        last = min(last, int(detections[apart[0]]))
    trial = _Trial.empty()
    firsts = detections[:STARTS]
    for frame in detections[detections <= last]:
        trial = trial.advanced(measurements, int(frame), noise, following.gate)
        if frame in firsts:
            trial = trial.joined(measurements, int(frame))
    accepted, cost = trial.accepted, trial.cost
    best = int(np.lexsort((cost, -accepted))[0])
    if accepted[best] < LEAST:
        return None
    frame, candidate = map(int, trial.origins[best])
    return Start(frame, candidate, last)


class _Trial(NamedTuple):
    """Filters that started at different candidates (B, 2), frame and rank, and are fed with the same frames.

    stamp: s, of the last of them. accepted: (B,) how many detections. cost: (B,) -2 log likelihood of all they saw.
    """

    origins: Array
    belief: FilterState
    stamp: float
    accepted: Array
    cost: Array

    @classmethod
    def empty(cls) -> "_Trial":
        belief = FilterState(*(np.empty((0, *shape)) for shape in ((3, 3), (3,), (6,), (12, 12))))
        return cls(np.empty((0, 2), dtype=int), belief, 0.0, np.empty(0, dtype=int), np.empty(0))

    def advanced(self, measurements: PoseMeasurements, frame: int, noise: Array, bound: float) -> "_Trial":
        """Return the filters after another frame with detections."""
        stamp = float(measurements.stamps[frame])
        expected, _ = pose_filter.predict(self.belief, noise, np.array(stamp - self.stamp))
        seen = Candidates(*(part[None] for part in candidates_at(measurements, frame)))
        belief, verdict = pose_filter.update(expected, seen, bound)
        cost = self.cost + np.minimum(verdict.cost, measurements.outlier_cost)
        return _Trial(self.origins, belief, stamp, self.accepted + verdict.accepted, cost)

    def joined(self, measurements: PoseMeasurements, frame: int) -> "_Trial":
        """Return the filters with those that start at a frame."""
        penalties = measurements.penalties[frame]
        ranks = np.flatnonzero(np.isfinite(penalties))
        new = pose_filter.start(*(part[ranks] for part in candidates_at(measurements, frame)[:3]))
        belief = FilterState(*(np.concatenate(parts) for parts in zip(self.belief, new, strict=True)))
        origins = np.concatenate([self.origins, np.stack([np.full(len(ranks), frame), ranks], axis=1)])
        accepted = np.concatenate([self.accepted, np.ones(len(ranks), dtype=int)])
        return _Trial(origins, belief, self.stamp, accepted, np.concatenate([self.cost, penalties[ranks]]))


def _followed(
    measurements: PoseMeasurements, start: Start, noise: Array, following: GateOptions
) -> tuple[Segment, int]:
    """Return the piece from a start to the last detection accepted, and the frame at which the next one may start."""
    stamps, present = measurements.stamps, measurements.present
    belief = pose_filter.start(*(part[start.candidate] for part in candidates_at(measurements, start.frame)[:3]))
    taken = [_Taken(belief, belief, np.eye(pose_filter.SIZE), _first_verdict(start))]
    accepted = start.frame
    refused: list[int] = []
    jerks: list[int] = []
    resume = len(stamps)
    for frame in range(start.frame + 1, len(stamps)):
        if present[frame] and stamps[frame] - stamps[accepted] > following.max_gap:
            resume = frame
            break
        taken.append(_taken(measurements, taken[-1].filtered, frame, noise, following.gate))
        if present[frame] and not taken[-1].verdict.accepted:
            refused.append(frame)
            agreeing = range(refused[-AGREEING:][0], frame + 1)
            if len(refused) >= AGREEING and (
                again := _after_jerk(measurements, taken, agreeing, noise, following.gate)
            ):
                taken[-len(again) :] = again
                jerks.append(agreeing[0])
        if taken[-1].verdict.accepted:
            accepted, refused = frame, []
        if len(refused) == LOST:
            resume = refused[0]
            break
    return _segment(start, taken[: accepted - start.frame + 1], jerks), resume


class _Taken(NamedTuple):
    """What a filter made of a frame: beliefs after and before it, how errors grew (12, 12), and the verdict on it."""

    filtered: FilterState
    predicted: FilterState
    growth: Array
    verdict: GatingResult


def _taken(measurements: PoseMeasurements, belief: FilterState, frame: int, noise: Array, bound: float) -> _Taken:
    """Return what a filter makes of a frame; belief: after the frame before."""
    dt = np.array(measurements.stamps[frame] - measurements.stamps[frame - 1])
    expected, growth = pose_filter.predict(belief, noise, dt)
    filtered, verdict = pose_filter.update(expected, candidates_at(measurements, frame), bound)
    return _Taken(filtered, expected, growth, verdict)


def _after_jerk(
    measurements: PoseMeasurements, taken: list[_Taken], frames: range, noise: Array, bound: float
) -> list[_Taken]:
    """Return what the filter makes of the last frames if the velocity before them may have changed.

    taken: of all frames so far, `frames` being the last ones. Nothing is returned unless all their detections agree.
    """
    belief = pose_filter.after_jerk(taken[-len(frames) - 1].filtered)
    again: list[_Taken] = []
    for frame in frames:
        again.append(_taken(measurements, belief, frame, noise, bound))
        belief = again[-1].filtered
        if measurements.present[frame] and not again[-1].verdict.accepted:
            return []
    return again


def _segment(start: Start, taken: list[_Taken], jerks: list[int]) -> Segment:
    filtered, predicted, growth, verdicts = zip(*taken, strict=True)
    after, before = (FilterState(*map(np.stack, zip(*part, strict=True))) for part in (filtered, predicted))
    run = Run(after, before, np.stack(growth))
    return Segment(
        start.frame, start.settled, run, GatingResult(*map(np.stack, zip(*verdicts, strict=True))), tuple(jerks)
    )


def _first_verdict(start: Start) -> GatingResult:
    return GatingResult(
        np.array(start.candidate), np.array(True), np.array(np.nan), np.full(_DEGREES, np.nan), np.array(0.0)
    )
