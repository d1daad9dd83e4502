"""What a pose filter is fed with: the poses that single frames allow, several where a plane leaves a doubt."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from camcal.arrays import Array, readonly
from camcal.errors import InvalidInput
from camcal.estimate.poses.records import Alternative
from camcal.geometry.pose import Pose

_ASTRAY = 0.1, 0.3  # how far a wrong pose is off, standard deviations: share of the distance, and rad
_LEAST_DISTANCE = 1e-6  # m; poses of a camera in its own frame may have none
_RARE = 0.05  # share of detections that go wrong


class FramePose(Protocol):
    """The pose a_T_b that one frame gave: its covariances (6, 6), in all and of the pixels' noise, and its rivals."""

    @property
    def transform(self) -> Pose: ...
    @property
    def covariance(self) -> Array: ...
    @property
    def noise_covariance(self) -> Array: ...
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
        """-2 log likelihood of a detection that went wrong, as `Verdict.cost` counts: it may be anywhere near.

        Such a bound on what a frame can cost keeps outliers from speaking. A bound by the gate, which is far lower,
        would let a filter with too little noise call every quick motion an outlier.
        """
        distance = float(np.median(np.linalg.norm(self.translations[self.present, 0], axis=-1)))
        return float(6 * np.log(_ASTRAY[0] * max(distance, _LEAST_DISTANCE) * _ASTRAY[1]) - 2 * np.log(_RARE))

    @property
    def present(self) -> Array:
        """The mask (N,) of the frames with a candidate."""
        return np.isfinite(self.penalties[:, 0])


def _candidates(estimate: FramePose) -> Iterator[tuple[Pose, Array, float]]:
    """Yield the poses that one frame allows, with their noise and their penalties."""
    yield estimate.transform, estimate.noise_covariance, 0.0
    for other in estimate.alternatives:
        noise = estimate.noise_covariance if other.noise_covariance is None else other.noise_covariance
        yield other.transform, noise, other.chi_square_difference
