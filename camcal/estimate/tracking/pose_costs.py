"""Cost, gradient and curvature of poses given the poses of single frames, where there are no pixels.

Each minimum of a frame counts by the normal density and the χ² that it has, so that both branches of a plane speak; or
the frame's pose is wrong, and the true one anywhere: cost = -2 ln[Σ exp(-(Δχ² + dᵀ Σ⁻¹ d)/2) + ε], up to a constant, d
the step from a minimum with covariance Σ.
"""

from dataclasses import dataclass, fields, replace
from typing import ClassVar

import numpy as np

from camcal.arrays import Array
from camcal.estimate.tracking.free_motion import POSE, VELOCITY, ObjectPlane, steps_from
from camcal.estimate.tracking.measurements import PoseMeasurements
from camcal.estimate.tracking.pixel_costs import WRONG
from camcal.geometry import rotation as so3

_NOWHERE = 1e3  # squared deviations of a pose that is near no minimum


@dataclass(frozen=True, eq=False)
class PoseFrames:
    """The poses that N frames allow, up to C each.

    rotations: (N, C, 3, 3). translations: (N, C, 3). information: (N, C, 6, 6) inverse covariances. penalties: (N, C)
    Δχ², infinite where there is none. there: (N, 1) which frames have a pose. floors: (N, 1) ε. gates: (N, 1)
    likelihood below which a pose is refused.
    """

    rotations: Array
    translations: Array
    information: Array
    penalties: Array
    there: Array
    floors: Array
    gates: Array
    coordinates: ClassVar[int] = 6
    # Near the frontal view a normal density is not the likelihood, and neighbouring frames have the same error of it:
    # so many frames count as one (docs/mathematics.md).
    overstated: ClassVar[float] = 8.0

    @classmethod
    def of(cls, measurements: PoseMeasurements, unknown: Array, gate: float) -> "PoseFrames":
        """Return the frames of measurements; unknown: (S,) variances of an unknown state. gate: bound of χ²."""
        there = measurements.present[:, None]
        information = np.linalg.inv(measurements.covariances)
        # A wrong pose may be as far off as an unknown velocity leads: else no track begins where frames are rare.
        since = np.zeros((len(there), 1))
        since[np.flatnonzero(there)[1:], 0] = np.diff(measurements.stamps[there[:, 0]])
        spread = unknown[POSE] + unknown[VELOCITY] * since**2
        volumes = np.linalg.slogdet(np.eye(6) + spread[:, None, :, None] * information[:, :1])[1]
        return cls(
            measurements.rotations,
            measurements.translations,
            information,
            measurements.penalties,
            there=there,
            floors=WRONG * np.exp(-volumes / 2),
            gates=np.full(there.shape, np.exp(-gate / 2)),
        )

    def __len__(self) -> int:
        return len(self.there)

    def at(self, frames: Array | int) -> "PoseFrames":
        """Return some of the frames, or one without the first axis."""
        return PoseFrames(*(getattr(self, field.name)[frames] for field in fields(self)))

    def with_noise(self, factor: float) -> "PoseFrames":
        """Return the frames with the standard deviations of their poses times a factor."""
        return replace(
            self,
            information=self.information / factor**2,
            penalties=self.penalties / factor**2,
            floors=self.floors * factor**6,
        )

    def squares(self, rotations: Array, translations: Array) -> Array:
        """Return the squared deviations (..., 1) of frames from poses (...), of all their minima together."""
        squared, _, _ = self._deviations(rotations, translations)
        squared = np.minimum(-2 * np.logaddexp.reduce(-squared / 2, axis=-1, keepdims=True), _NOWHERE)
        return np.asarray(squared * self.there)

    def inlier_probabilities(self, squared: Array) -> Array:
        """Return the probabilities (..., 1) that frames show the object, a half at the gate; 0 without a pose."""
        near = np.exp(-squared / 2)
        return np.asarray(np.where(self.there, near / (near + self.gates), 0.0))

    def linearised(self, rotations: Array, translations: Array, temper: float = 1.0) -> tuple[Array, Array, Array]:
        """Return the cost of poses with its derivatives, see FrameCosts."""
        squared, pulls, slopes = self._deviations(rotations, translations)
        near = np.exp(-squared / 2)
        cost = -2 * np.log((near.sum(axis=-1, keepdims=True) + self.floors) / (1 + self.floors))
        if temper != 1.0:
            near = np.exp(-squared / (2 * temper))
        weights = near / (near.sum(axis=-1, keepdims=True) + self.floors)
        across = slopes.swapaxes(-1, -2)
        gradient = (weights[..., None] * (across @ pulls[..., None])[..., 0]).sum(axis=-2)
        curvature = (weights[..., None, None] * (across @ self.information @ slopes)).sum(axis=-3)
        return np.where(self.there, cost, 0.0)[..., 0], gradient, curvature

    def _deviations(self, rotations: Array, translations: Array) -> tuple[Array, Array, Array]:
        """Return χ² (..., C) of poses at each minimum, Σ⁻¹ d (..., C, 6) and the slopes (..., C, 6, 6) of d."""
        steps, slopes = steps_from(
            rotations[..., None, :, :], translations[..., None, :], self.rotations, self.translations
        )
        pulls = (self.information @ steps[..., None])[..., 0]
        return self.penalties + (steps * pulls).sum(axis=-1), pulls, slopes


def mirror_plane(measurements: PoseMeasurements) -> ObjectPlane | None:
    """Return the plane z = 0 of an object whose second poses are the first ones mirrored, None of another object."""
    two = np.isfinite(measurements.penalties[:, 1:2]).any(axis=1)
    if not two.any():
        return None
    flat = ObjectPlane(np.array([0.0, 0.0, 1.0]), np.zeros(3))
    first, second = measurements.rotations[two, 0], measurements.rotations[two, 1]
    mirrored, _ = flat.mirrored(first, measurements.translations[two, 0])
    off, apart = so3.angle_between(mirrored, second), so3.angle_between(first, second)
    return flat if np.median(off) < np.median(apart) / 2 else None
