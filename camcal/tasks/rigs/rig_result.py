"""What comes of the calibration of a rig, and the rig file: its cameras, transforms, their joint covariance."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from camcal.calibrate.intrinsics import CandidateModel
from camcal.calibrate.rigs.record import RigCalibration
from camcal.cameras.validity import ImageCircle
from camcal.dataclass import dataclass, replace
from camcal.formats import provenance
from camcal.formats.camera_file import CalibrationVerdict, CameraFile, JointCovariance, Transform
from camcal.geometry.pose import Pose
from camcal.messages import Message
from camcal.quality.assess import Assessment
from camcal.quality.projection_uncertainty import ProjectionUncertainty
from camcal.records import Brief
from camcal.report.calibration import time_data
from camcal.report.rig import motion_data, scales_data
from camcal.targets.board_set import surfaces_of
from camcal.tasks.calibration.camera_result import RefinementSummary, camera_entry, image_record, is_shaped
from camcal.tasks.rigs.rig_views import RigViews


@dataclass(frozen=True, eq=False)
class CameraResult(Brief):
    """What is said of one camera of a rig beside its calibration; circle: its image circle, where there is one."""

    assessment: Assessment
    circle: ImageCircle | None = None

    @property
    def uncertainty(self) -> ProjectionUncertainty:
        """The uncertainty of projections over the image."""
        return self.assessment.uncertainty


@dataclass(frozen=True, eq=False)
class RigReport(Brief):
    """The calibration of a rig, what is said of each of its cameras, the captures, and the file that was written.

    candidates: lens models that were compared, by the cameras of a kind. refinement: what the second pass of corner
    refinement changed, None without one. warnings: all of them; lines: other lines of the report.
    figures: the files of figures.
    """

    calibration: RigCalibration
    cameras: Mapping[str, CameraResult]
    views: RigViews
    file: CameraFile
    warnings: tuple[Message, ...]
    lines: tuple[str, ...] = ()
    refinement: RefinementSummary | None = None
    candidates: Mapping[tuple[str, ...], tuple[CandidateModel, ...]] | None = None
    figures: tuple[Path, ...] = ()

    @property
    def failures(self) -> tuple[Message, ...]:
        """Why the rig, or one of its cameras, must not be trusted."""
        own = (each.at(name) for name, result in self.cameras.items() for each in result.assessment.failures)
        return (*self.calibration.failures, *own)

    @property
    def trustworthy(self) -> bool:
        """Whether the rig and all its cameras may be trusted."""
        return not self.failures

    @property
    def failed(self) -> tuple[str, ...]:
        """The images that could not be read."""
        return self.views.failed


def rig_file(calibration: RigCalibration, results: Mapping[str, CameraResult], command: Sequence[str]) -> CameraFile:
    """Return what the rig file says of the cameras that are linked: lenses, transforms, their joint covariance."""
    failures = tuple(each.text for each in calibration.failures)
    entries = {}
    for name in calibration.poses:
        result = results[name]
        entry = camera_entry(calibration.calibrations[name], result.assessment, result.circle)
        verdict = entry.verdict or CalibrationVerdict(True)
        # the shift of boards that several cameras see is another one than those of one camera say
        entries[name] = replace(
            entry,
            timing={} if calibration.times is None else time_data(calibration.times.cameras[name]),
            boards=entry.boards and replace(entry.boards, shift=None),
            verdict=CalibrationVerdict(
                verdict.trustworthy and not failures, verdict.reasons + failures, None if failures else verdict.region
            ),
        )
    transforms = {
        name: Transform(pose, calibration.transform_covariance(name)) for name, pose in calibration.transforms.items()
    }
    kept = {*entries, *transforms}
    names = tuple(name for name in calibration.names if name.rpartition(".")[0] in kept)
    surfaces = surfaces_of(calibration.calibrations[calibration.first].surface)
    surface = surfaces.pop("", None)
    board = calibration.calibrations[calibration.first].board
    return CameraFile(
        entries,
        transforms,
        JointCovariance(names, calibration.covariance_of(names)),
        board_shape=surface if surface is not None and is_shaped(surface) else None,
        boards=surfaces,
        provenance=provenance.build(command, board, _image_records(calibration)) | {"rig": _figures(calibration)},
    )


def _figures(calibration: RigCalibration) -> dict[str, Any]:
    """Return the figures of the rig as a whole that the provenance keeps; px, m."""
    motion = motion_data(calibration.motion) or {}
    figures = {
        "epipolar_rms_px": calibration.epipolar_rms_px,
        **{f"motion_{key}": value for key, value in motion.items()},
        "links": [link.as_data() for link in calibration.links] or None,
        "scales": scales_data(calibration.scales) or None,
    }
    return {key: value for key, value in figures.items() if value is not None}


def _image_records(calibration: RigCalibration) -> list[dict[str, Any]]:
    """Return what the provenance says of all images, each with its camera and where that saw the board."""
    return [
        image_record(view)
        | {"camera": name, **({"board": view.body} if view.body else {})}
        | _pose_record(view.camera_T_board)
        for name, own in calibration.calibrations.items()
        for view in own.views
    ]


def _pose_record(pose: Pose | None) -> dict[str, Any]:
    if pose is None:
        return {}
    return {"camera_T_board": {"t": pose.translation.tolist(), "rotation_vector": pose.vector().tolist()}}
