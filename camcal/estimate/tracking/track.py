"""Tracks from the poses or the pixels of single frames, with covariances, velocities and a consistency check."""

from collections.abc import Sequence

import numpy as np

from camcal.arrays import Array, BoolArray, FloatArray, IntArray, readonly
from camcal.cameras.model import Camera
from camcal.dataclass import dataclass, field, replace
from camcal.errors import InsufficientData, InvalidInput
from camcal.estimate.poses.records import Correspondences
from camcal.estimate.smoothing.kalman import AMBIGUOUS, Consistency, consistency, successive
from camcal.estimate.tracking.flips import FAR
from camcal.estimate.tracking.frames import PoseFrames
from camcal.estimate.tracking.measurements import LEAST, FramePose, GateOptions, ObjectPlane, PoseMeasurements
from camcal.estimate.tracking.motion import FreeMotion
from camcal.estimate.tracking.pixel_track import PixelTrack, follow_frames, pixel_frames, usual_distance
from camcal.estimate.tracking.process_noise import Jitter, JitterStd, ProcessNoise, jitter
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose, inverse_jacobian
from camcal.messages import Message
from camcal.records import Brief

MEASURED, PREDICTED, REJECTED, GAP = "measured", "predicted", "rejected", "gap"
STATES = (MEASURED, PREDICTED, REJECTED, GAP)
_OTHER_POSE_LIKELY = 0.01  # probability of another pose that is told
_JUMP = 0.1, 0.35  # of the distance, and rad: what starts again with such a step is another piece
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
    unknown = FreeMotion((1.0, 1.0)).unknown(usual_distance(measurements))
    followed = follow_frames(
        PoseFrames.of(measurements, unknown, options.following.gate),
        measurements,
        ObjectPlane.of_mirrored(measurements),
        noise=options.noise,
        lag=options.lag,
        max_gap=options.following.max_gap,
    )
    return _assembled(frames, followed, measurements, poses, options)


def track_views(
    camera: Camera,
    stamps: Array,
    views: Sequence[Correspondences | None],
    poses: Sequence[FramePose | None],
    options: TrackOptions = DEFAULTS,
    noise_px: float | None = None,
) -> Track:
    """Return the track camera_T_object of an object from its pixels in single frames.

    views: the object's points and pixels, one a frame, None where it was not found. poses: what single frames gave,
    None where they gave none. noise_px: standard deviation of a pixel coordinate, None to find it out.
    Raises as `track_poses` does.
    """
    require_found(poses)
    measurements = PoseMeasurements.of(stamps, poses)
    frames, sigma = pixel_frames(camera, views, measurements, noise_px)
    followed = follow_frames(
        frames,
        measurements,
        ObjectPlane.of_points(frames.points[frames.there]),
        sigma=None if noise_px else sigma,
        noise=options.noise,
        lag=options.lag,
        max_gap=options.following.max_gap,
    )
    return _assembled("camera_T_object", followed, measurements, poses, options)


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


def common_part(poses: Sequence[FramePose | None]) -> Array:
    """Return the part (N, 6, 6) of the covariances that frames share, of the nearest detection where there is none."""
    places = np.array([index for index, pose in enumerate(poses) if pose is not None])
    parts = np.array([pose.covariance - pose.noise_covariance for pose in poses if pose is not None])
    every = np.arange(len(poses))
    after = np.searchsorted(places, every).clip(1, len(places) - 1)  # there are LEAST or more
    before = after - 1
    nearer = np.abs(places[before] - every) <= np.abs(places[after] - every)
    return np.asarray(parts[np.where(nearer, before, after)])


def _assembled(
    frames: str,
    followed: PixelTrack,
    measurements: PoseMeasurements,
    poses: Sequence[FramePose | None],
    options: TrackOptions,
) -> Track:
    segments = _pieces(followed, measurements.stamps, options.following.max_gap)
    if (segments < 0).all():
        found = sum(pose is not None for pose in poses)
        raise InsufficientData(f"no {LEAST} of {found} detections are successive: check time stamps and --max-gap")
    present, inside = measurements.present, segments >= 0
    used = followed.used & inside
    states = np.full(len(present), GAP, dtype=object)
    states[present] = REJECTED
    states[used] = MEASURED
    if options.fill:
        states[inside & ~present] = PREDICTED
    posed = inside & (options.fill | used)
    rotations, translations, velocities, covariances = (
        np.where(posed.reshape(-1, *(1,) * (values.ndim - 1)), values, np.nan)
        for values in (followed.rotations, followed.translations, followed.velocities, followed.covariances)
    )
    turns = so3.angle_between(measurements.rotations, np.nan_to_num(rotations)[:, None])
    nearest = np.argmin(np.where(np.isfinite(measurements.penalties), turns, np.inf), axis=1)
    p_wrong = np.where(posed, followed.p_wrong, np.nan)
    jerks = np.flatnonzero(followed.jerked & inside)
    single = (measurements.rotations[:, 0], measurements.translations[:, 0])
    return Track(
        frames,
        measurements.stamps,
        states=tuple(states),
        segments=segments,
        rotations=rotations,
        translations=translations,
        velocities=velocities,
        covariances=covariances + common_part(poses),
        nis=np.where(used, (followed.surprises**2).sum(axis=1), np.nan),
        candidates=np.where(present & posed, nearest, -1),
        noise=followed.noise,
        jerks=tuple(int(each) for each in jerks if each and segments[each - 1] == segments[each]),
        consistency=_judged_pixels(followed, used, segments, p_wrong, covariances),
        before=jitter(*(part[used] for part in (measurements.stamps, *single, segments))),
        after=jitter(*(part[used] for part in (measurements.stamps, rotations, translations, segments))),
        p_wrong=p_wrong,
        jitter_std=followed.jitter_std,
    )


def _pieces(followed: PixelTrack, stamps: Array, max_gap: float) -> Array:
    """Return the numbers (N,) of the pieces from the first to the last frame used of each, -1 outside."""
    shifts = np.linalg.norm(np.diff(followed.translations, axis=0), axis=1)
    far = shifts > _JUMP[0] * np.linalg.norm(followed.translations[1:], axis=1)
    far |= so3.angle_between(followed.rotations[1:], followed.rotations[:-1]) > _JUMP[1]
    ends = ~followed.linked
    ends[1:] |= followed.jerked[1:] & far
    used = np.flatnonzero(followed.used)
    ends[used[1:][np.diff(stamps[used]) > max_gap]] = True
    result = np.full(len(stamps), -1)
    number = 0
    for frames in np.split(np.arange(len(stamps)), np.flatnonzero(ends)):
        there = frames[followed.used[frames]]
        if len(there) >= LEAST:
            result[there[0] : there[-1] + 1] = number
            number += 1
    return result


def _judged_pixels(
    followed: PixelTrack, used: Array, segments: Array, p_wrong: Array, covariances: Array
) -> Consistency | None:
    """Return a check of the innovations of frames with known velocities, and whether poses are ambiguous."""
    foretold = used & ~followed.jerked & np.isfinite(followed.surprises[:, 0])
    for number in range(int(segments.max()) + 1):
        foretold[np.flatnonzero(used & (segments == number))[:2]] = False
    if not foretold.any():
        return None
    whitened = followed.surprises[foretold]
    pairs = successive(whitened, segments[foretold])
    judged = consistency((whitened**2).sum(axis=1), np.full(len(whitened), 6.0), pairs)
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(covariances[used][:, 3:, 3:])[:, -1], 1e-18))
    doubt = np.maximum(p_wrong, followed.contradicted)[used]
    share = float(np.mean(1 - (1 - doubt) * (1 - _beyond(FAR / spread))))
    return or_ambiguous(judged, share)


def _beyond(ratio: Array) -> Array:
    """Return how likely a normal deviate is beyond so many standard deviations, on either side."""
    from scipy.special import erfc

    return np.asarray(erfc(ratio / np.sqrt(2)))
