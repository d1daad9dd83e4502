"""Poses of single frames as a track is given them, when a frame belongs to it, and the plane of the object.

A frame allows several poses where a plane leaves a doubt: the one seen is reflected across the line of sight.
"""

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Protocol

import numpy as np

from camcal.arrays import Array, FloatArray, readonly
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.estimate.poses.records import Alternative
from camcal.estimate.smoothing.kalman import gate
from camcal.estimate.tracking.motion import MotionState
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose

LEAST = 3  # detections of a piece: two fix a velocity, the third tells whether it holds
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

    @property
    def present(self) -> Array:
        """The mask (N,) of the frames with a candidate."""
        return np.asarray(np.isfinite(self.penalties).any(axis=1))


def _candidates(estimate: FramePose) -> Iterator[tuple[Pose, Array, float]]:
    """Yield the poses that one frame allows, with their noise and their penalties."""
    yield estimate.transform, estimate.noise_covariance, 0.0
    for other in estimate.alternatives:
        noise = estimate.noise_covariance if other.noise_covariance is None else other.noise_covariance
        yield other.transform, noise, other.chi_square_difference


@dataclass(frozen=True)
class GateOptions:
    """When a frame belongs to a track.

    confidence: with which a good detection is inside the gate. max_gap: s without a detection that a piece outlives.
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
        """The bound of χ² of a pose."""
        return gate(_DEGREES, self.confidence)


@dataclass(frozen=True)
class ObjectPlane:
    """The plane of an object: its normal (3,) and middle (3,)."""

    normal: Array
    middle: Array

    @classmethod
    def of_points(cls, points: Array) -> "ObjectPlane | None":
        """Return the plane of points (N, 3), None if they are in none."""
        points = np.unique(points, axis=0)
        middle = points.mean(axis=0)
        _, spreads, axes = np.linalg.svd(points - middle, full_matrices=False)
        return cls(axes[2], middle) if spreads[2] < 0.05 * spreads[1] else None

    @classmethod
    def of_mirrored(cls, measurements: "PoseMeasurements") -> "ObjectPlane | None":
        """Return the plane z = 0 of an object whose second poses are the first ones mirrored, None of another."""
        two = np.isfinite(measurements.penalties[:, 1:2]).any(axis=1)
        if not two.any():
            return None
        flat = cls(np.array([0.0, 0.0, 1.0]), np.zeros(3))
        first, second = measurements.rotations[two, 0], measurements.rotations[two, 1]
        mirrored, _ = flat.mirrored(first, measurements.translations[two, 0])
        off, apart = so3.angle_between(mirrored, second), so3.angle_between(first, second)
        return flat if np.median(off) < np.median(apart) / 2 else None

    def sight(self, rotations: Array, translations: Array) -> Array:
        """Return the unit directions (N, 3) from the camera to the middle."""
        seen = rotations @ self.middle + translations
        return np.asarray(seen / np.linalg.norm(seen, axis=-1, keepdims=True))

    def tilt(self, rotations: Array, translations: Array) -> Array:
        """Return the angles (N) between the normal and the line of sight, rad."""
        cosine = np.abs((self.sight(rotations, translations) * (rotations @ self.normal)).sum(axis=-1))
        return np.asarray(np.arccos(np.clip(cosine, 0, 1)))

    def mirrored(self, rotations: Array, translations: Array) -> tuple[Array, Array]:
        """Return the mirrored poses: the plane reflected across the line of sight."""
        sight = self.sight(rotations, translations)
        across = np.eye(3) - 2 * sight[:, :, None] * sight[:, None, :]
        turned = across @ rotations @ (np.eye(3) - 2 * np.outer(self.normal, self.normal))
        return turned, translations + (rotations - turned) @ self.middle

    def mirrored_states(self, states: MotionState) -> MotionState:
        """Return the mirrored poses of states, turning the way that mirrored motions turn."""
        sight = self.sight(states.rotations, states.translations)[:, None]
        rates = states.rates.copy()
        turning = rates[..., 3:]
        # a reflection by I - 2 v vᵀ takes ω to -(I - 2 v vᵀ) ω: a turn about the line of sight stays
        rates[..., 3:] = 2 * sight * (turning * sight).sum(axis=-1, keepdims=True) - turning
        return MotionState(*self.mirrored(states.rotations, states.translations), rates)
