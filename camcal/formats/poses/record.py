"""What a pose file holds: poses by image and object, what is known of each, and why others are missing."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from camcal.arrays import FloatArray, readonly
from camcal.estimate.poses.records import Alternative
from camcal.geometry.pose import Pose, inverse_jacobian


class PoseKey(NamedTuple):
    """An object in an image; its name is empty where a run knows one object only."""

    image: str
    object: str = ""

    def __str__(self) -> str:
        return f"{self.image}, {self.object}" if self.object else self.image


@dataclass(frozen=True, eq=False)
class PoseRecord:
    """A pose, its uncertainty and how well it fits.

    covariance, noise_covariance: (6, 6), of everything that is known to be uncertain, and of the pixels' noise alone;
    order tx ty tz rx ry rz, R ← Exp(δr) R, t ← t + δt. p_wrong: probability that one of the alternatives, the likeliest
    of which comes first, is the true pose. error_ratio: RMS of this pose over that of the likeliest of them.
    n_points, n_inliers: points, and those that the pose follows from. outliers: ids of the rest. rms_px, max_px: of the
    inliers' residuals. planarity: smallest over largest spread of the points. least_depth: of the nearest point.
    tilt_rad: between the plane's normal and the line of sight. image_share: of the image that the points span.
    condition: of the scaled normal matrix. What is None does not apply.
    """

    transform: Pose
    covariance: FloatArray
    noise_covariance: FloatArray
    status: str
    rms_px: float
    max_px: float
    n_points: int
    n_inliers: int
    p_wrong: float = 0.0
    error_ratio: float | None = None
    alternatives: tuple[Alternative, ...] = ()
    outliers: tuple[int, ...] = ()
    planarity: float | None = None
    least_depth: float | None = None
    tilt_rad: float | None = None
    image_share: float | None = None
    condition: float | None = None

    def __post_init__(self) -> None:
        for name in ("covariance", "noise_covariance"):
            object.__setattr__(self, name, readonly(getattr(self, name), (6, 6), name))

    @property
    def std(self) -> FloatArray:
        """The standard deviations (6,) of the pose's steps."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def inverse(self) -> "PoseRecord":
        """Return the same estimate of the transform in the other direction."""
        jacobian = inverse_jacobian(self.transform)
        return replace(
            self,
            transform=self.transform.inverse(),
            covariance=jacobian @ self.covariance @ jacobian.T,
            noise_covariance=jacobian @ self.noise_covariance @ jacobian.T,
            alternatives=tuple(other.inverse() for other in self.alternatives),
        )


@dataclass(frozen=True)
class PixelNoise:
    """The standard deviation of a pixel coordinate, root mean square over all that poses follow from.

    scale: that over what the pixels came with, None if they came with nothing. degrees_of_freedom: of its estimation,
    None where it was given.
    """

    sigma_px: float
    scale: float | None = None
    degrees_of_freedom: int | None = None


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses by image and object, in order, and why others have none.

    frames: what every transform maps, such as camera_T_object, which takes points of the object to the camera.
    unit: of all lengths, 'm' or 'squares'. noise: of the pixels.
    """

    frames: str
    unit: str
    noise: PixelNoise
    estimates: Mapping[PoseKey, PoseRecord]
    missing: Mapping[PoseKey, str] = field(default_factory=dict)

    @property
    def of_object(self) -> bool:
        """Whether the transforms take points of the object to the camera or rig, not the other way."""
        return self.frames.endswith("_T_object")

    def position(self, record: PoseRecord) -> FloatArray:
        """Return where the camera or rig stands (3,) in the object's frame."""
        return record.transform.inverse().translation if self.of_object else record.transform.translation

    def inverse(self) -> "Poses":
        """Return the same poses in the other direction."""
        estimates = {pose_key: record.inverse() for pose_key, record in self.estimates.items()}
        return replace(self, frames="_T_".join(reversed(self.frames.split("_T_"))), estimates=estimates)
