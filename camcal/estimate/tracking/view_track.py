"""Tracks from the pixels of single frames, in track segments, with a consistency check."""

from collections.abc import Sequence

import numpy as np

from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.estimate.poses.records import Correspondences
from camcal.estimate.smoothing.kalman import Consistency, consistency, successive
from camcal.estimate.tracking.flips import FAR
from camcal.estimate.tracking.jitter import jitter
from camcal.estimate.tracking.pixel_track import PixelTrack, track_pixels
from camcal.estimate.tracking.segments import LEAST, FramePose, PoseMeasurements
from camcal.estimate.tracking.track import (
    GAP,
    MEASURED,
    PREDICTED,
    REJECTED,
    Track,
    TrackOptions,
    at_poses,
    common_part,
    no_track,
    or_ambiguous,
    require_found,
)
from camcal.geometry import rotation as so3

_JUMP = 0.1, 0.35  # of the distance, and rad: what starts again with such a step is another piece


def track_views(
    camera: Camera,
    stamps: Array,
    views: Sequence[Correspondences | None],
    poses: Sequence[FramePose | None],
    options: TrackOptions,
    noise_px: float | None = None,
) -> Track:
    """Return the track camera_T_object of an object from its pixels in single frames.

    views: the object's points and pixels, one a frame, None where it was not found. poses: what single frames gave,
    None where they gave none. noise_px: standard deviation of a pixel coordinate, None to find it out.
    Raises as `track_poses` does.
    """
    require_found(poses)
    followed = track_pixels(
        camera,
        stamps,
        views,
        poses,
        sigma=noise_px,
        noise=options.noise,
        lag=options.lag,
        max_gap=options.following.max_gap,
    )
    segments = _pieces(followed, np.asarray(stamps), options.following.max_gap)
    if (segments < 0).all():
        raise no_track(poses)
    measurements = PoseMeasurements.of(stamps, poses)
    present, inside = measurements.present, segments >= 0
    used = followed.used & inside
    states = np.full(len(present), GAP, dtype=object)
    states[present] = REJECTED
    states[used] = MEASURED
    if options.fill:
        states[inside & ~present] = PREDICTED
    posed = inside & (options.fill | used)
    rotations, translations, velocities, covariances = (
        at_poses(posed, values)
        for values in (followed.rotations, followed.translations, followed.velocities, followed.covariances)
    )
    turns = so3.angle_between(measurements.rotations, np.nan_to_num(rotations)[:, None])
    nearest = np.argmin(np.where(np.isfinite(measurements.penalties), turns, np.inf), axis=1)
    p_wrong = np.where(posed, followed.p_wrong, np.nan)
    jerks = np.flatnonzero(followed.jerked & inside)
    single = (measurements.rotations[:, 0], measurements.translations[:, 0])
    return Track(
        "camera_T_object",
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
