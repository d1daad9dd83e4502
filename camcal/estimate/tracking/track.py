"""Tracks from poses of single frames, with covariances, velocities and a consistency check."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from camcal.arrays import Array, BoolArray, FloatArray, IntArray, readonly
from camcal.brief import Brief
from camcal.errors import InsufficientData, InvalidInput
from camcal.estimate.smoothing.kalman import AMBIGUOUS, Consistency, consistency, successive
from camcal.estimate.tracking.flips import FAR
from camcal.estimate.tracking.jitter import Jitter, JitterStd, jitter
from camcal.estimate.tracking.pose_filter import FilterState, smoothed, smoothed_with_lag
from camcal.estimate.tracking.process_noise import ProcessNoise, tuned
from camcal.estimate.tracking.segments import (
    LEAST,
    WINDOW,
    FramePose,
    GateOptions,
    PoseMeasurements,
    Segment,
    follow,
)
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose, inverse_jacobian
from camcal.messages import Message

MEASURED, PREDICTED, REJECTED, GAP = "measured", "predicted", "rejected", "gap"
STATES = (MEASURED, PREDICTED, REJECTED, GAP)
_OTHER_POSE_LIKELY = 0.01  # probability of another pose that is told
_OFTEN = 0.03  # share of poses that may be wrong, on average, from which on a track is ambiguous


@dataclass(frozen=True)
class TrackOptions(Brief):
    """How poses are followed.

    noise: None to find it out. lag: frames of look-ahead, 0 for none, None for all there are. fill: poses for the
    frames of a piece that have no accepted detection.
    """

    noise: ProcessNoise | None = None
    following: GateOptions = field(default_factory=GateOptions)
    lag: int | None = None
    fill: bool = False

    def __post_init__(self) -> None:
        if self.lag is not None and self.lag < 0:
            raise InvalidInput(f"a lag is 0 frames or more, found {self.lag}")


DEFAULTS = TrackOptions()


@dataclass(frozen=True, eq=False)
class Track(Brief):
    """A pose over N frames; NaN where there is none.

    frames: what the poses map, such as camera_T_object. stamps: (N,) s. states: (N,) of STATES. segments: (N,) the
    number of the piece from 0, -1 outside. rotations: (N, 3, 3). translations: (N, 3) m. velocities: (N, 6) m/s and
    rad/s, R' = hat(w) R. covariances: (N, 6, 6) of the poses' steps. nis: (N,) of detections that were predicted.
    candidates: (N,) which candidate was examined, 0 the best of its frame, -1 where there was none.
    jerks: the frames before which the velocity became another at once, in order.
    consistency: None where no detection was predicted. before, after: jitter of the single poses and of the track.
    p_wrong: (N,) the probability that the true pose is another one than the track's; NaN where nothing
    is known of it.
    jitter_std: what moves single poses off the smooth motion, None where it was not searched for.
    """

    frames: str
    stamps: FloatArray
    states: tuple[str, ...]
    segments: IntArray
    rotations: FloatArray
    translations: FloatArray
    velocities: FloatArray
    covariances: FloatArray
    nis: FloatArray
    candidates: IntArray
    noise: ProcessNoise
    jerks: tuple[int, ...]
    consistency: Consistency | None
    before: Jitter
    after: Jitter
    p_wrong: FloatArray
    jitter_std: JitterStd | None = None

    def __post_init__(self) -> None:
        count = len(self.stamps)
        shapes = {
            "stamps": (count,),
            "rotations": (count, 3, 3),
            "translations": (count, 3),
            "velocities": (count, 6),
            "covariances": (count, 6, 6),
            "nis": (count,),
            "p_wrong": (count,),
        }
        for name, shape in shapes.items():
            object.__setattr__(self, name, readonly(getattr(self, name), shape, name))
        for name in ("segments", "candidates"):
            object.__setattr__(self, name, readonly(getattr(self, name), (count,), name, np.int64))

    @property
    def posed(self) -> BoolArray:
        """The mask (N,) of the frames with a pose."""
        return np.isfinite(self.translations[:, 0])

    def count(self, state: str) -> int:
        """Return how many frames are in a state."""
        return self.states.count(state)

    @property
    def ambiguous(self) -> list[tuple[int, int, float]]:
        """The stretches with two possible poses: first and last frame, and the probability of the pose given.

        Frames without a pose between two of them do not end a stretch.
        """
        frames = np.flatnonzero(self.posed)
        rows = np.split(frames, np.flatnonzero(np.diff((self.p_wrong[frames] > _OTHER_POSE_LIKELY).astype(int))) + 1)
        doubtful = [row for row in rows if len(row) and self.p_wrong[row[0]] > _OTHER_POSE_LIKELY]
        return [(int(row[0]), int(row[-1]), float(1 - self.p_wrong[row].max())) for row in doubtful]

    def inverse(self) -> "Track":
        """Return the same track in the other direction, such as object_T_camera."""
        turned = self.rotations.swapaxes(-1, -2)
        speeds = self.velocities[:, :3] - np.cross(self.velocities[:, 3:], self.translations)
        moves = np.stack([self.translations, speeds, self.velocities[:, 3:]], axis=1)
        translations, *velocities = -np.einsum("nij,nkj->kni", turned, moves)
        covariances = np.array(self.covariances)
        for index in np.flatnonzero(self.posed):
            jacobian = inverse_jacobian(Pose(self.rotations[index], self.translations[index]))
            covariances[index] = jacobian @ covariances[index] @ jacobian.T
        return replace(
            self,
            frames="_T_".join(reversed(self.frames.split("_T_"))),
            rotations=turned,
            translations=translations,
            velocities=np.concatenate(velocities, axis=1),
            covariances=covariances,
        )


def track_poses(
    stamps: Array,
    poses: Sequence[FramePose | None],
    options: TrackOptions = DEFAULTS,
    frames: str = "camera_T_object",
) -> Track:
    """Return the track of an object from its poses in single frames.

    stamps: (N,) s, increasing. poses: one a frame, None where the object was not found. frames: what they map; of the
    object in the camera, where they are measured, rather than of the camera in the object.
    Raises InvalidInput for stamps that do not increase, InsufficientData if the pose can nowhere be followed.
    """
    require_found(poses)
    measurements = PoseMeasurements.of(stamps, poses)
    noise = options.noise or tuned(measurements, options.following)
    segments = follow(measurements, noise.densities, options.following)
    if not segments:
        raise no_track(poses)
    track = _assembled(frames, measurements, common_part(poses), noise, segments, options)
    if options.lag is not None:
        return track
    track = replace(track, p_wrong=_chance_of_others(measurements, track, segments, options.following))
    if track.consistency is None:
        return track
    return replace(track, consistency=or_ambiguous(track.consistency, float(np.nanmean(track.p_wrong))))


def _chance_of_others(
    measurements: PoseMeasurements, track: Track, segments: Sequence[Segment], following: GateOptions
) -> Array:
    """Return the probability (N,) that the other poses of the frames around each are the true ones, NaN without a pose.

    A second track follows these. Motion and pixels both speak: each frame counts with the likelihood of its pose given
    those before, over a window, as the true pose may be the other one for a while.
    """
    rotations = np.where(track.posed[:, None, None], track.rotations, np.eye(3))
    near = so3.angle_between(rotations[:, None], measurements.rotations) < FAR
    found = np.isfinite(measurements.penalties)
    two = track.posed & (found & near).any(axis=1) & (found & ~near).any(axis=1)
    rival = measurements.keeping(np.where(two[:, None], ~near, True))
    cost = []
    for seen, pieces in ((measurements, segments), (rival, follow(rival, track.noise.densities, following))):
        each = np.full(len(seen), measurements.outlier_cost)
        for piece in pieces:
            each[piece.frames] = piece.costs(measurements.outlier_cost)
        cost.append(each)
    more = np.where(two, cost[1] - cost[0], 0.0)
    total = np.concatenate([[0.0], np.cumsum(more)])
    frames = np.arange(len(more))
    lead = total[np.minimum(frames + WINDOW + 1, len(more))] - total[np.maximum(frames - WINDOW, 0)]
    chance = np.where(two, 1 / (1 + np.exp(np.clip(lead / 2, -500, 500))), 0.0)
    return np.where(track.posed, chance, np.nan)


def or_ambiguous(judged: Consistency, share: float) -> Consistency:
    """Return a check of innovations, or ambiguous poses: share, the mean probability of one that is off by over 10°."""
    if share <= _OFTEN:
        return judged
    text = f"probability of a pose off by more than 10° is {100 * share:.0f} % on average; see the ambiguous intervals"
    return replace(judged, verdict=AMBIGUOUS, warning=Message("ambiguous_poses", text, {"p_wrong": share}))


def require_found(poses: Sequence[FramePose | None]) -> None:
    """Raise InsufficientData where too few frames show the object for any track."""
    found = sum(pose is not None for pose in poses)
    if found < LEAST:
        raise InsufficientData(f"found in {found} of {len(poses)} frames (minimum {LEAST})")


def no_track(poses: Sequence[FramePose | None]) -> InsufficientData:
    """Return the error of detections of which no few make a piece."""
    found = sum(pose is not None for pose in poses)
    return InsufficientData(f"no {LEAST} of {found} detections are successive: check time stamps and --max-gap")


def at_poses(posed: Array, values: Array) -> Array:
    """Return values (N, …) of frames, NaN where there is no pose."""
    return np.where(posed.reshape(-1, *(1,) * (values.ndim - 1)), values, np.nan)


def common_part(poses: Sequence[FramePose | None]) -> Array:
    """Return the part (N, 6, 6) of the covariances that frames share, of the nearest detection where there is none."""
    places = np.array([index for index, pose in enumerate(poses) if pose is not None])
    parts = np.array([pose.covariance - pose.noise_covariance for pose in poses if pose is not None])
    every = np.arange(len(poses))
    after = np.searchsorted(places, every).clip(1, len(places) - 1)  # there are LEAST or more
    before = after - 1
    nearer = np.abs(places[before] - every) <= np.abs(places[after] - every)
    return np.asarray(parts[np.where(nearer, before, after)])


@dataclass(eq=False)
class _Frames:
    """What is known of each of N frames while the pieces are put in their places."""

    belief: FilterState
    segments: Array
    accepted: Array
    settled: Array
    nis: Array
    candidates: Array

    @classmethod
    def nothing(cls, count: int) -> "_Frames":
        shapes = ((3, 3), (3,), (6,), (12, 12))
        belief = FilterState(*(np.full((count, *shape), np.nan) for shape in shapes))
        numbers, flags = np.full(count, -1), np.zeros(count, dtype=bool)
        return cls(belief, numbers, flags, flags.copy(), np.full(count, np.nan), numbers.copy())

    def put(self, number: int, segment: Segment, present: Array, lag: int | None) -> None:
        """Enter a piece; with a bounded look-ahead the poses before its start is settled are not given."""
        at, verdicts = segment.frames, segment.verdicts
        belief = smoothed(segment.run) if lag is None else smoothed_with_lag(segment.run, lag)
        for whole, part in zip(self.belief, belief, strict=True):
            whole[at] = part
        self.segments[at] = number
        self.accepted[at] = verdicts.accepted
        self.settled[at] = lag is None or at + lag >= segment.settled
        self.nis[at] = np.where(present[at], verdicts.nis, np.nan)
        self.candidates[at] = np.where(present[at], verdicts.chosen, -1)

    def states(self, present: Array, *, fill: bool) -> Array:
        """Return the states (N,): a detection is measured if its pose is given, a frame without one predicted."""
        result = np.full(len(present), GAP, dtype=object)
        result[present & (self.settled | (self.segments < 0))] = REJECTED
        result[self.accepted & self.settled] = MEASURED
        if fill:
            result[~present & self.settled] = PREDICTED
        return result


def _assembled(
    frames: str,
    measurements: PoseMeasurements,
    common: Array,
    noise: ProcessNoise,
    segments: Sequence[Segment],
    options: TrackOptions,
) -> Track:
    stamps, present = measurements.stamps, measurements.present
    known = _Frames.nothing(len(stamps))
    for number, segment in enumerate(segments):
        known.put(number, segment, present, options.lag)
    states = known.states(present, fill=options.fill)
    posed = known.settled & (options.fill | (states == MEASURED))
    if not posed.any():
        raise InsufficientData(f"no initial pose found within {options.lag} frames of look-ahead; allow more, or all")
    rotations, translations, velocities, covariances = (at_poses(posed, values) for values in known.belief)
    used, pieces = states == MEASURED, known.segments
    return Track(
        frames,
        stamps,
        states=tuple(states),
        segments=pieces,
        rotations=rotations,
        translations=translations,
        velocities=velocities,
        covariances=covariances[:, :6, :6] + common,
        nis=known.nis,
        candidates=known.candidates,
        noise=noise,
        jerks=tuple(jerk for segment in segments for jerk in segment.jerks),
        consistency=_judged(segments),
        before=jitter(
            *(part[used] for part in (stamps, measurements.rotations[:, 0], measurements.translations[:, 0], pieces))
        ),
        after=jitter(*(part[used] for part in (stamps, rotations, translations, pieces))),
        p_wrong=np.full(len(stamps), np.nan),
    )


def _judged(segments: Sequence[Segment]) -> Consistency | None:
    """Return a consistency check of the innovations of accepted detections."""
    chains = np.concatenate([np.full(len(segment.verdicts.nis), number) for number, segment in enumerate(segments)])
    nis, whitened = (
        np.concatenate([getattr(segment.verdicts, name) for segment in segments]) for name in ("nis", "whitened")
    )
    foretold = np.concatenate([segment.foretold for segment in segments])
    if not foretold.any():
        return None
    pairs = successive(whitened[foretold], chains[foretold])
    return consistency(nis[foretold], np.full(int(foretold.sum()), 6.0), pairs)
