"""What comes of the calibration of a camera, and its file: the camera, the board, the images and their hashes."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from camcal import files
from camcal.calibrate.channels import Aberration, ColourLens
from camcal.calibrate.intrinsics import Calibration, CandidateModel, View
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle
from camcal.dataclass import dataclass, field, replace
from camcal.formats import provenance
from camcal.formats.camera_file import (
    CalibrationNoise,
    CalibrationVerdict,
    CameraEntry,
    CameraFile,
    ProjectionStd,
    ValidRegion,
)
from camcal.messages import Message, counted
from camcal.quality.assess import Assessment
from camcal.quality.projection_uncertainty import ProjectionUncertainty
from camcal.quality.range_uncertainty import CalibrationBoards
from camcal.records import Brief
from camcal.report.calibration import headline, time_data, view_record
from camcal.report.table import projection_words, region_words
from camcal.targets.board import Surface
from camcal.tasks.calibration.board_views import BoardViews

if TYPE_CHECKING:
    from camcal.tasks.calibration.video_frames import FrameRecord

if TYPE_CHECKING:
    from camcal.calibrate.timing.record import CameraTimes


@dataclass(frozen=True, eq=False)
class Channel:
    """The lens of a colour, and how far that colour lies from green."""

    lens: ColourLens
    aberration: Aberration


@dataclass(frozen=True)
class RefinementSummary:
    """How many corners measuring them again with the calibrated lens has added and removed."""

    added: int
    removed: int

    @property
    def lines(self) -> tuple[str, ...]:
        """The line of the report, none where nothing has changed."""
        if not self.added and not self.removed:
            return ()
        return (f"corner refinement with the calibrated lens: {self.added} added, {self.removed} removed",)


def camera_file(
    calibration: Calibration,
    assessment: Assessment,
    name: str,
    command: Sequence[str],
    channels: Mapping[str, Channel] = MappingProxyType({}),
    circle: ImageCircle | None = None,
    times: "CameraTimes | None" = None,
) -> CameraFile:
    """Return what the camera file says of a calibration; green is the camera itself and no channel of its own.

    name: of the camera. command: the words that are recorded. circle: the image circle, where there is one. times: when
    its rows were taken, where that was estimated.
    """
    entry = camera_entry(calibration, assessment, circle, channels)
    if times is not None:
        [own] = times.cameras.values()
        entry = replace(entry, timing=time_data(own))
    surface = calibration.surface
    return CameraFile(
        {name: entry},
        board_shape=surface if is_shaped(surface) else None,
        provenance=provenance.build(command, calibration.board, map(image_record, calibration.views))
        | channel_figures(channels),
    )


def camera_entry(
    calibration: Calibration,
    assessment: Assessment,
    circle: ImageCircle | None,
    channels: Mapping[str, Channel] = MappingProxyType({}),
) -> CameraEntry:
    """Return the entry of a calibrated camera in a camera file; circle: its image circle, where there is one."""
    return CameraEntry(
        calibration.camera,
        valid=ValidRegion.of(calibration.camera, circle),
        projection=(ProjectionStd.of(assessment.uncertainty),),
        quality=quality_figures(calibration),
        noise=CalibrationNoise(calibration.sigma_px, calibration.degrees_of_freedom, calibration.model_error_px),
        verdict=CalibrationVerdict(
            assessment.trustworthy,
            tuple(each.text for each in assessment.failures),
            assessment.region if assessment.trustworthy else None,
        ),
        channels={colour: channel.lens.camera for colour, channel in channels.items()},
        held_by_prior=calibration.held_by_prior,
        boards=CalibrationBoards.of(calibration) if calibration.board.unit == "m" else None,
    )


def is_shaped(surface: Surface) -> bool:
    """Return whether the shape of a board was estimated."""
    return bool(surface.tiers or surface.terms or surface.classes or surface.offsets is not None)


def channel_figures(channels: Mapping[str, Channel]) -> dict[str, Any]:
    """Return what is known of the aberration of every colour against green, under the key 'aberration'; pixels."""
    figures = {
        colour: {
            "corner_px": channel.aberration.corner_px,
            "corner_std_px": channel.aberration.corner_std_px,
            "largest_px": channel.aberration.largest_px,
            "largest_std_px": channel.aberration.largest_std_px,
            "largest_at": channel.aberration.largest_at.tolist(),
            "terms": list(channel.lens.terms),
            "sigma_px": channel.lens.sigma_px,
            "points_used": channel.lens.points,
            "points_rejected": channel.lens.rejected,
        }
        for colour, channel in channels.items()
    }
    return {"aberration": figures} if figures else {}


def quality_figures(calibration: Calibration) -> dict[str, float]:
    """Return the figures of the file's quality block: pixels and counts."""
    lengths = np.linalg.norm(calibration.residuals, axis=1)
    return {
        "rms_px": calibration.rms_px,
        "median_px": float(np.median(lengths)),
        "p95_px": float(np.percentile(lengths, 95)),
        "max_px": float(lengths.max()),
        "images_used": len(calibration.used),
        "points_used": len(lengths),
        "points_rejected": len(calibration.rejected),
    }


def image_record(view: View) -> dict[str, Any]:
    """Return what the provenance says of an image, with the hash of its file; an empty one is not recorded."""
    path = Path(view.image)
    digest = view.sha256 if view.sha256 is not None or not path.is_file() else files.sha256(path)
    return view_record(view) | ({"sha256": digest} if digest else {})


@dataclass(frozen=True, eq=False)
class CalibrateReport(Brief):
    """The calibration, its assessment, the file that was written, what it is from, and failed inputs.

    warnings: of the detection and of the assessment. lines: other lines of the report. refinement: what the second pass
    of corner refinement changed, None without one. channels: by the names of colours, empty unless asked for. frames:
    what became of the frames of videos. candidates: lens models that were compared, none where the model was given.
    figures: the files of figures. times: when rows were taken, None where that was not asked for.
    """

    calibration: Calibration
    assessment: Assessment
    file: CameraFile
    views: BoardViews
    warnings: tuple[Message, ...]
    failed: tuple[str, ...]
    lines: tuple[str, ...] = ()
    refinement: RefinementSummary | None = None
    channels: Mapping[str, Channel] = field(default_factory=dict)
    frames: "tuple[FrameRecord, ...]" = ()
    candidates: tuple[CandidateModel, ...] = ()
    figures: tuple[Path, ...] = ()
    times: "CameraTimes | None" = None

    def __repr__(self) -> str:
        """Return the verdict, the lens and its uncertainty in a line."""
        verdict = (
            f"trustworthy{region_words(self.assessment.region)}"
            if self.trustworthy
            else f"DO NOT TRUST: {self.failures[0].text}"
        )
        lens = f"{headline(self.calibration)}; {projection_words(self.uncertainty.figures())}"
        return f"<CalibrateReport: {verdict[:200]}; {lens}; {counted(len(self.calibration.used), 'view')}>"

    @property
    def camera(self) -> Camera:
        """The camera with its covariance."""
        return self.calibration.camera

    @property
    def uncertainty(self) -> ProjectionUncertainty:
        """The uncertainty of projections over the image."""
        return self.assessment.uncertainty

    @property
    def trustworthy(self) -> bool:
        """Whether the calibration may be trusted."""
        return self.assessment.trustworthy

    @property
    def failures(self) -> tuple[Message, ...]:
        """Why it may not be trusted."""
        return self.assessment.failures
