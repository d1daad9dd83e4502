"""The result of a rig calibration, and what it is asked for."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from camcal.arrays import FloatArray
from camcal.brief import Brief
from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Calibration
from camcal.cameras.model import Camera, CameraModel
from camcal.geometry.pose import Pose
from camcal.messages import Message

JOINT, FIXED, PRIOR = "joint", "fixed", "prior"
LENSES = (JOINT, FIXED, PRIOR)


@dataclass(frozen=True, eq=False)
class RigOptions:
    """How to calibrate a rig: the lens model of every camera, what is known of the lenses, how free the board is.

    lenses: joint estimates them with the rig; fixed holds the `given` cameras; prior starts at them, with their
    covariances as prior. given: by the names of cameras. motion: whether the board may have moved between the exposures
    of a capture, None: where the data show it. others: lens models that predict about alike, by the names of cameras;
    how far the poses of the cameras move with them counts as uncertainty.
    """

    models: Mapping[str, CameraModel]
    lenses: str = JOINT
    given: Mapping[str, Camera] = field(default_factory=dict)
    shape: ShapeOptions = field(default_factory=ShapeOptions)
    max_rejected: float = 0.1
    motion: bool | None = None
    others: Mapping[str, CameraModel] = field(default_factory=dict)


@dataclass(frozen=True)
class ExposureMotion:
    """How far the board moved between the exposures of a capture, as seen at its centre: m, standard deviation of each
    axis over all captures, and the median and the largest distance of a capture. by_capture: the largest distance of
    each capture, 0 where no camera saw another pose than the first.
    """

    std: float
    median: float
    largest: float
    by_capture: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class RigCalibration(Brief):
    """The cameras of a rig and where they are.

    calibrations: by the names of cameras, in their order; lens, views, residuals of each. poses: camera_T_first of the
    cameras that could be linked, the first of them at the identity. names: of the parameters of `covariance` (N, N):
    left.fx … of the lenses, then right_T_left.tx … .rz of the transforms (m and rad; see Pose.retract).
    motion: None where the cameras exposed together. unlinked: cameras that no capture links to the first one, and
    why. epipolar_rms_px: of the corners that two cameras saw, None without any; epipolar_by_capture: (C,) that of each
    of `captures`, NaN without any.
    """

    calibrations: Mapping[str, Calibration]
    poses: Mapping[str, Pose]
    names: tuple[str, ...]
    covariance: FloatArray
    captures: tuple[str, ...]
    motion: ExposureMotion | None = None
    unlinked: Mapping[str, str] = field(default_factory=dict)
    epipolar_rms_px: float | None = None
    epipolar_by_capture: FloatArray = field(default_factory=lambda: np.zeros(0))
    warnings: tuple[Message, ...] = ()
    failures: tuple[Message, ...] = ()

    @property
    def first(self) -> str:
        """The name of the camera whose frame is the rig's."""
        return next(iter(self.poses))

    def transform_name(self, camera: str) -> str:
        """Return the name of a camera's pose, such as right_T_left."""
        return f"{camera}_T_{self.first}"

    def covariance_of(self, names: tuple[str, ...]) -> FloatArray:
        """Return the covariance (n, n) of some of the parameters."""
        index = [self.names.index(name) for name in names]
        return np.asarray(self.covariance[np.ix_(index, index)])

    def pose_covariance(self, camera: str) -> FloatArray:
        """Return the covariance (6, 6) of camera_T_first, order tx ty tz rx ry rz, m and rad."""
        transform = self.transform_name(camera)
        return self.covariance_of(tuple(f"{transform}.{axis}" for axis in ("tx", "ty", "tz", "rx", "ry", "rz")))
