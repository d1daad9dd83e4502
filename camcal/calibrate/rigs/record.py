"""Captures of a board by the cameras of a rig, how to calibrate from them, and the result."""

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from camcal.arrays import FloatArray
from camcal.calibrate.fit import CalibrationFit, ShapeOptions
from camcal.calibrate.intrinsics import Calibration
from camcal.calibrate.rigs.measured import Measured
from camcal.cameras.lens import CameraModel
from camcal.cameras.model import Camera
from camcal.dataclass import dataclass, field, replace
from camcal.errors import InvalidInput
from camcal.geometry.frame_graph import CameraLink
from camcal.geometry.pose import Pose
from camcal.messages import Message
from camcal.records import Brief
from camcal.targets.detection import BoardDetection

if TYPE_CHECKING:
    from camcal.calibrate.timing.record import CameraTimes


@dataclass(frozen=True, eq=False)
class Captures(Brief):
    """cameras: (N,) names. names: (G,) of the captures. views[g][c]: what camera c saw in capture g, None without an
    image of it. Of several boards each has captures of its own: moments (G,) says which are of one moment, boards (G,)
    of which of the boards they are, by its place; empty for one board. Raises InvalidInput for names that occur twice
    and for rows of another length.
    """

    cameras: tuple[str, ...]
    names: tuple[str, ...]
    views: tuple[tuple[BoardDetection | None, ...], ...]
    moments: tuple[int, ...] = ()
    boards: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        for what, names in (("camera", self.cameras), ("capture", self.names)):
            twice = next((name for index, name in enumerate(names) if name in names[:index]), None)
            if twice is not None:
                raise InvalidInput(f"{what} {twice!r} occurs twice")
        if len(self.views) != len(self.names) or any(len(row) != len(self.cameras) for row in self.views):
            raise InvalidInput("captures need a row each and a view, or None, of every camera in it")

    def __len__(self) -> int:
        """Return the number of captures."""
        return len(self.names)

    def of(self, camera: int) -> tuple[BoardDetection | None, ...]:
        """Return the views of one camera, one for each capture."""
        return tuple(row[camera] for row in self.views)

    def without(self, views: Collection[tuple[int, int]], reason: str) -> "Captures":
        """Return the captures without the points of some views (capture, camera), and why they have none."""
        rows = [
            tuple(
                view.without_points(reason) if view is not None and (capture, camera) in views else view
                for camera, view in enumerate(row)
            )
            for capture, row in enumerate(self.views)
        ]
        return replace(self, views=tuple(rows))

    def take(self, captures: Sequence[int]) -> "Captures":
        """Return some of the captures."""
        return replace(
            self,
            names=tuple(self.names[index] for index in captures),
            views=tuple(self.views[index] for index in captures),
            moments=tuple(self.moments[index] for index in captures) if self.moments else (),
            boards=tuple(self.boards[index] for index in captures) if self.boards else (),
        )


JOINT, FIXED, PRIOR = "joint", "fixed", "prior"
LENSES = (JOINT, FIXED, PRIOR)


@dataclass(frozen=True, eq=False)
class RigOptions:
    """How to calibrate a rig: the lens model of every camera, what is known of the lenses, how free the board is.

    lenses: joint estimates them with the rig; fixed holds the `given` cameras; prior starts at them, with their
    covariances as prior. given: by the names of cameras. motion: whether the board may have moved between the exposures
    of a capture, None: where the data show it. bodies: groups of the names of boards that are joined; None: all are.
    measured: what is known of the boards beforehand. others: lens models that predict about alike, by the names of
    cameras; how far the poses of the cameras move with them counts as uncertainty. starts: brief fits of cameras alone,
    of all their views with their models, to go on from.
    """

    models: Mapping[str, CameraModel]
    lenses: str = JOINT
    given: Mapping[str, Camera] = field(default_factory=dict)
    shape: ShapeOptions = field(default_factory=ShapeOptions)
    max_rejected: float = 0.1
    motion: bool | None = None
    others: Mapping[str, CameraModel] = field(default_factory=dict)
    starts: Mapping[str, CalibrationFit] = field(default_factory=dict)
    bodies: tuple[tuple[str, ...], ...] | None = None
    measured: Measured = field(default_factory=Measured)


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
    motion: None where the cameras exposed together. times: of their images, None unless estimated. unlinked: cameras
    that no capture links to the first one, and why. epipolar_rms_px: of the corners that two cameras saw, None without
    any; epipolar_by_capture: (C,) that of each of `captures`, NaN without any. boards: poses of boards in the frame of
    the first one of their body, by the names of transforms, such as a_T_b. links: what links pairs of cameras. scales:
    of boards, where distances tell them, by their names (empty for a single one): factor and standard deviation.
    """

    calibrations: Mapping[str, Calibration]
    poses: Mapping[str, Pose]
    names: tuple[str, ...]
    covariance: FloatArray
    captures: tuple[str, ...]
    motion: ExposureMotion | None = None
    times: "CameraTimes | None" = None
    unlinked: Mapping[str, str] = field(default_factory=dict)
    epipolar_rms_px: float | None = None
    epipolar_by_capture: FloatArray = field(default_factory=lambda: np.zeros(0))
    boards: Mapping[str, Pose] = field(default_factory=dict)
    links: tuple[CameraLink, ...] = ()
    scales: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    warnings: tuple[Message, ...] = ()
    failures: tuple[Message, ...] = ()

    @property
    def first(self) -> str:
        """The name of the camera whose frame is the rig's."""
        return next(iter(self.poses))

    @property
    def transforms(self) -> dict[str, Pose]:
        """The poses of the cameras but the first, and of boards on their bodies, by the names of transforms."""
        others = {self.transform_name(name): pose for name, pose in self.poses.items() if name != self.first}
        return others | dict(self.boards)

    def transform_name(self, camera: str) -> str:
        """Return the name of a camera's pose, such as right_T_left."""
        return f"{camera}_T_{self.first}"

    def covariance_of(self, names: tuple[str, ...]) -> FloatArray:
        """Return the covariance (n, n) of some of the parameters."""
        index = [self.names.index(name) for name in names]
        return np.asarray(self.covariance[np.ix_(index, index)])

    def pose_covariance(self, camera: str) -> FloatArray:
        """Return the covariance (6, 6) of camera_T_first, order tx ty tz rx ry rz, m and rad."""
        return self.transform_covariance(self.transform_name(camera))

    def transform_covariance(self, transform: str) -> FloatArray:
        """Return the covariance (6, 6) of a transform by its name, order tx ty tz rx ry rz, m and rad."""
        return self.covariance_of(tuple(f"{transform}.{axis}" for axis in ("tx", "ty", "tz", "rx", "ry", "rz")))
