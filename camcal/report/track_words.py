"""Poses and tracks as text and as plain data: detections, rejections, consistency."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from camcal.arrays import Array
from camcal.estimate.smoothing.kalman import CORRELATED, UNDERCONFIDENT, Consistency
from camcal.estimate.tracking.process_noise import Jitter
from camcal.estimate.tracking.track import MEASURED, REJECTED, Track
from camcal.formats.poses.record import PoseKey, PoseRecord, Poses
from camcal.formats.trajectories.tracked import TrackedObject
from camcal.messages import Message
from camcal.report.table import Column, values_and_stds

MILLI = 1000.0
_STATUS = Column("status", wraps=True)
_NEAR = 1.5  # a-posteriori scales up to this, and down to its inverse, are what real corners have

_IN_A_ROW = 3  # outliers hardly ever come so
# What `camcal track` has for the remedies of `camcal smooth`; --noise is an option of `camcal pnp` as well
_REMEDIES = {
    "--q": "--process-noise",
    "try another motion --model": "errors last from frame to frame, increase --noise",
    "use --robust huber": "increase --noise",
    "--sigma": "--noise",
}


def columns(poses: Poses) -> list[Column]:
    """Return the columns of a table of poses."""
    named = [Column("object")] if any(pose_key.object for pose_key in poses.estimates) else []
    length = _length(poses)
    quality = [Column("points", priority=5), Column("RMS", "px", priority=2)]
    place = [Column("x y z", length), Column("± std", length, priority=3)]
    turn = [Column("rotation vector", "deg", priority=1), Column("± std", "deg", priority=4)]
    return [Column("image", file=True), *named, *quality, *place, *turn, Column("seen from", priority=6), _STATUS]


def alternative_columns(poses: Poses) -> list[Column]:
    """Return the columns of a table of other poses."""
    place, turn = Column("x y z", _length(poses)), Column("rotation vector", "deg")
    return [Column("image", file=True), place, turn, Column("χ² above", priority=1), Column("probability")]


def row(poses: Poses, pose_key: PoseKey, record: PoseRecord) -> list[object]:
    """Return the cells of one pose."""
    named = [pose_key.object] if any(other.object for other in poses.estimates) else []
    scale = MILLI if poses.unit == "m" else 1.0
    place = values_and_stds(scale * record.transform.translation, scale * record.std[:3])
    turn = values_and_stds(np.degrees(record.transform.vector()), np.degrees(record.std[3:]))
    fit = points(record), f"{record.rms_px:.3g}"
    return [pose_key.image, *named, *fit, *place, *turn, standpoint(poses, record), record.status]


def alternative_rows(poses: Poses, pose_key: PoseKey, record: PoseRecord) -> list[list[object]]:
    """Return the cells of the other poses that an image allows."""
    scale = MILLI if poses.unit == "m" else 1.0
    return [
        [
            str(pose_key),
            _numbers(scale * other.transform.translation, ".3f"),
            _numbers(np.degrees(other.transform.vector()), ".3f"),
            other.chi_square_difference,
            f"{other.probability:.2g}",
        ]
        for other in record.alternatives
    ]


def points(record: PoseRecord) -> str:
    """Return how many points a pose follows from, such as 54, or 50 of 54."""
    return str(record.n_points) if record.n_points == record.n_inliers else f"{record.n_inliers} of {record.n_points}"


def standpoint(poses: Poses, record: PoseRecord) -> str:
    """Return where the camera stands, such as '0.712 m away, 38° oblique', 0° being straight in front of a plane."""
    away = f"{np.linalg.norm(record.transform.translation):.3g} {poses.unit} away"
    return away if record.tilt_rad is None else f"{away}, {math.degrees(record.tilt_rad):.0f}° oblique"


def noise(poses: Poses) -> str:
    """Return how large the noise of a pixel coordinate is and where that is known from.

    How far the residuals are from what the pixels came with is said only where that is more than chance and habit.
    """
    found = poses.noise
    size, dof = f"noise {found.sigma_px:.3g} px", f"{found.degrees_of_freedom} degrees of freedom"
    if found.degrees_of_freedom is None:
        return f"{size}, as given"
    if found.scale is None:
        return f"{size}, from the residuals, {dof}"
    if 1 / _NEAR <= found.scale <= _NEAR:
        return f"{size}, by the corner standard deviations, consistent with the residuals"
    return f"{size}: the residuals are {found.scale:.3g} x the corner standard deviations (a-posteriori scale, {dof})"


def caption(poses: Poses, pose_key: PoseKey, record: PoseRecord) -> str:
    """Return a line about a pose in plain letters, for a picture."""
    named = f"{pose_key.object}: " if pose_key.object else ""
    place = standpoint(poses, record).replace("°", " deg")
    return f"{named}{place}; RMS {record.rms_px:.2f} px, {points(record)} points; {record.status}".replace("±", "+-")


def _length(poses: Poses) -> str:
    """Return the unit that lengths are shown in."""
    return "mm" if poses.unit == "m" else poses.unit


def _numbers(values: Array, form: str) -> str:
    return " ".join(format(value, form) for value in values)


def lines(item: TrackedObject) -> Iterator[str]:
    """Yield the report on a track, a line at a time."""
    track, frames = item.track, len(item.single)
    found = sum(each is not None for each in item.single)
    yield f"detected in {found} of {frames} frames ({_percent(found, frames)})"
    refused, flips = track.count(REJECTED), _flips(track)
    used = f"inliers {track.count(MEASURED)}, {flips} of them by their mirror pose"
    yield f"{used}; rejected {refused} ({_percent(refused, found)})"
    if track.jerks:
        yield f"velocity reset at: {', '.join(f'{track.stamps[frame]:.6g} s' for frame in track.jerks)}"
    yield f"track segments: {', '.join(_piece(track, number) for number in range(int(track.segments.max()) + 1))}"
    yield f"jitter (RMS): raw {_jitter(track.before)}; filtered {_jitter(track.after)}"
    for first, last, chance in track.ambiguous:
        yield f"ambiguous {_span(track.stamps[first], track.stamps[last])}: probability of the pose used {chance:.2f}"
    unit, fading = ("s³", "") if track.noise.fading is None else ("s⁵", f", correlation time {track.noise.fading:g} s")
    densities = f"translation {_density(track, 0, f'm²/{unit}')}; rotation {_density(track, 1, f'rad²/{unit}')}"
    yield f"process noise (PSD{fading}): {densities}"
    shaking = track.jitter_std
    if shaking is not None and shaking.any:
        turns = f"camera {1e3 * shaking.camera_turn:.2g} mrad, object {1e3 * shaking.object_turn:.2g} mrad"
        yield f"vibration (RMS per axis): {turns} and {1e3 * shaking.object_shift:.2g} mm"


def consistency_line(judged: Consistency) -> str:
    """Return whether the covariances of a track or a series are reliable, with the figure that decides."""
    low, high = judged.interval
    nis = f": mean NIS {judged.mean_nis:.2f} ({low:.2f} … {high:.2f} expected)" if judged.innovations else ""
    verdict = "consistent in size, but innovations correlated" if judged.verdict == CORRELATED else judged.verdict
    return f"covariances {verdict}{nis}"


def consistency_details(judged: Consistency) -> str:
    """Return the other figures of the innovations."""
    beyond = f"{100 * judged.beyond_95:.1f} % beyond their 95 % bound"
    lag = f"lag-1 correlation {judged.autocorrelation:+.2f} (±{judged.autocorrelation_limit:.2f} expected)"
    return f"innovations: {beyond}, {lag}"


def warnings(item: TrackedObject, *, of_poses: bool = False) -> Iterator[Message]:
    """Yield what is weak about a track; of_poses: whether it is of a pose file."""
    if (row := _longest_refusal(item.track)) is not None:
        start = float(item.track.stamps[row[0]])
        text = (
            f"{len(row)} successive detections rejected from {start:.6g} s: check time stamps and detections, or "
            "increase --process-noise"
        )
        yield Message("successive_rejections", text, {"frames": len(row), "start_s": start})
    judged = item.track.consistency
    if judged is not None and judged.warning is not None:
        text = judged.warning.text
        for smoothing, tracking in _REMEDIES.items():
            text = text.replace(smoothing, tracking)
        if judged.verdict == UNDERCONFIDENT and of_poses:
            text = "innovations smaller than their covariances: track the images, not their poses"
        yield replace(judged.warning, text=text)


def _longest_refusal(track: Track) -> Array | None:
    """Return the frames of the longest row of detections left out within a piece, None if it is short."""
    refused = np.array(track.states) == REJECTED
    frames = np.flatnonzero((refused | (np.array(track.states) == MEASURED)) & (track.segments >= 0))
    rows = np.split(frames, np.flatnonzero(np.diff(refused[frames].astype(int))) + 1)
    longest = max((row for row in rows if refused[row].all()), key=len, default=frames[:0])
    return longest if len(longest) >= _IN_A_ROW else None


def plain(item: TrackedObject, images: Sequence[str]) -> dict[str, Any]:
    """Return the report on a track as plain data."""
    track = item.track
    return {
        "frames": track.frames,
        "detections": sum(each is not None for each in item.single),
        "measured": track.count(MEASURED),
        "predicted": track.count("predicted"),
        "rejected": [image for image, state in zip(images, track.states, strict=True) if state == REJECTED],
        "mirrored": _flips(track),
        "jerks": [images[frame] for frame in track.jerks],
        "segments": [_segment(track, number, images) for number in range(int(track.segments.max()) + 1)],
        "process_noise": {
            "qv": track.noise.translation,
            "qw": track.noise.rotation,
            "factors": track.noise.factors,
            "fading_s": track.noise.fading,
        },
        "vibration": None if track.jitter_std is None else vars(track.jitter_std),
        "ambiguous": [
            {"start_s": float(track.stamps[first]), "end_s": float(track.stamps[last]), "p_branch": chance}
            for first, last, chance in track.ambiguous
        ],
        "consistency": None if track.consistency is None else track.consistency.data(),
        "jitter": {"before": vars(track.before), "after": vars(track.after)},
    }


def _flips(track: Track) -> int:
    """Return how many detections were used by another of their candidates than the best of their frame."""
    return int(np.sum((track.candidates > 0) & (np.array(track.states) == MEASURED)))


def _segment(track: Track, number: int, images: Sequence[str]) -> dict[str, Any]:
    inside = np.flatnonzero(track.segments == number)
    return {
        "first": images[inside[0]],
        "last": images[inside[-1]],
        "start_s": float(track.stamps[inside[0]]),
        "end_s": float(track.stamps[inside[-1]]),
        "frames": len(inside),
    }


def _piece(track: Track, number: int) -> str:
    stamps = track.stamps[track.segments == number]
    return f"{_span(stamps[0], stamps[-1])} ({len(stamps)} frames)"


def _span(start: float, end: float) -> str:
    return f"{start:.2f}–{end:.2f} s"


def _jitter(jitter: Jitter) -> str:
    return f"{1e3 * jitter.translation:.3g} mm, {np.degrees(jitter.rotation):.3g}°"


def _density(track: Track, axis: int, unit: str) -> str:
    noise = track.noise
    value = (noise.translation, noise.rotation)[axis]
    return f"{value:.3g} {unit}" + ("" if noise.factors is None else f", uncertainty factor {noise.factors[axis]:.2g}")


def _percent(part: int, whole: int) -> str:
    return f"{100 * part / whole:.1f} %" if whole else "none"
