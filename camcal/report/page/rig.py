"""The sections of a report on the calibration of a rig."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from camcal.calibrate.intrinsics import CandidateModel
from camcal.calibrate.rigs.record import RigCalibration
from camcal.dataclass import dataclass, replace
from camcal.formats.camera_file import STEP
from camcal.messages import Message, counted
from camcal.quality.rig_geometry import PairGeometry
from camcal.report.calibration import CANDIDATE_COLUMNS, candidate_rows
from camcal.report.figures.rig import joint_plots
from camcal.report.page.calibration import CalibratedCamera, camera_sections, camera_verdict
from camcal.report.page.record import BAD, Figure, PageVerdict, Section, Table, sentence, verdict
from camcal.report.page.thumbnails import pictures
from camcal.report.rig import (
    CAMERA_COLUMNS,
    PAIR_COLUMNS,
    TRANSFORM_COLUMNS,
    camera_rows,
    lines,
    pair_rows,
    transform_rows,
)
from camcal.report.table import value_and_std

_UNITS = ("mm", "mm", "mm", "deg", "deg", "deg")
_OF_CAPTURES = ("epipolar_errors", "exposure_motion")  # figures beside the table of captures
_COMMON = ("board", "models")  # sections that cameras have in common


@dataclass(frozen=True, eq=False)
class CalibratedRig:
    """What a report shows of a rig. pairs: what pairs of its cameras make. candidates: by the cameras of a kind."""

    calibration: RigCalibration
    cameras: Sequence[CalibratedCamera]
    pairs: Sequence[PairGeometry] = ()
    candidates: Mapping[tuple[str, ...], Sequence[CandidateModel]] | None = None
    failures: Sequence[Message] = ()
    warnings: Sequence[Message] = ()


def rig_verdict(rig: CalibratedRig) -> PageVerdict:
    """Return the verdict on a rig in words."""
    found = rig.calibration
    error = found.epipolar_rms_px
    words = f"Epipolar errors of the captures are {error:.3g} px RMS." if error is not None else ""
    own = verdict(rig.failures, rig.warnings, words)
    return replace(own, headline=own.headline.replace("calibration", "rig")) if own.state == BAD else own


def rig_figures(rig: CalibratedRig) -> Iterator[Figure]:
    """Yield the figures that are read first."""
    found = rig.calibration
    for name, length, std, *_ in transform_rows(found):
        spread = f" ± {std}" if std else ""
        yield Figure(f"Baseline {name}", f"{length}{spread} mm", "± 1 standard deviation")
    if found.epipolar_rms_px is not None:
        yield Figure("Epipolar error (RMS)", f"{found.epipolar_rms_px:.3g} px", "at corners that two cameras saw")
    shared = found.epipolar_by_capture
    pairs = int(np.isfinite(shared).sum())
    yield Figure("Captures used", f"{len(found.captures)}", f"{pairs} seen by two cameras or more")
    worst = max(found.calibrations.values(), key=lambda own: own.rms_px)
    yield Figure(
        "Largest reprojection error (RMS)", f"{worst.rms_px:.3g} px", f"of {counted(len(found.calibrations), 'camera')}"
    )


def rig_sections(rig: CalibratedRig) -> Iterator[Section]:
    """Yield the sections on a rig: its cameras, transforms and captures; then those of every camera."""
    found = rig.calibration
    rows = [
        [camera.name, camera_verdict(camera, camera.assessment.warnings).headline, _first(camera.assessment.failures)]
        for camera in rig.cameras
    ]
    tables = [
        Table.of("Verdicts of the cameras by themselves", ("camera", "verdict", "first failure"), rows),
        Table.under("Lenses", CAMERA_COLUMNS, camera_rows(found)),
    ]
    yield Section("cameras", "Cameras", tables=tables)
    drawn = {plot.name: plot for plot in joint_plots(found)}
    of_captures = pictures([drawn.pop(name) for name in _OF_CAPTURES if name in drawn])
    tables = [
        Table.under("Transforms to the first camera, ± 1 standard deviation", TRANSFORM_COLUMNS, transform_rows(found)),
        _steps(found),
    ]
    if rig.pairs:
        tables.append(Table.under("Pairs (vergence: + converging)", PAIR_COLUMNS, pair_rows(rig.pairs)))
    said = [sentence(line) for line in lines(found)]
    shown = list(pictures(list(drawn.values())).values())
    yield Section("transforms", "Transforms and baselines", said, pictures=shown, tables=tables)
    yield replace(_captures(found), pictures=list(of_captures.values()))
    if rig.candidates:
        heads = [column.head for column in CANDIDATE_COLUMNS]
        tables = [
            Table.of(
                f"Lens models of {', '.join(names)} by how well they predict left-out views",
                heads,
                candidate_rows(models),
            )
            for names, models in rig.candidates.items()
        ]
        yield Section("models", "Choice of the lens models", tables=tables)
    for place, camera in enumerate(rig.cameras):
        for section in camera_sections(camera, camera.assessment.messages):
            kind = section.name.removeprefix(camera.prefix)
            if kind == "board" and place == 0:
                yield replace(section, name=kind)
            elif kind not in _COMMON:
                yield replace(section, title=f"{camera.name}: {section.title[:1].lower()}{section.title[1:]}")


def _first(failures: Sequence[Message]) -> str:
    return failures[0].text if failures else ""


def _captures(found: RigCalibration) -> Section:
    """Return the section on the epipolar errors of captures and on motion between exposures."""
    errors = found.epipolar_by_capture
    order = np.argsort(-np.nan_to_num(errors, nan=-1.0), kind="stable").tolist()
    rows = [[found.captures[index], "" if np.isnan(errors[index]) else f"{errors[index]:.3g}"] for index in order]
    table = Table.of("Epipolar error by capture, the largest first", ("capture", "RMS, px"), rows)
    motion = found.motion
    if motion is None:
        words = "The cameras of a capture are taken to have exposed together."
    else:
        words = (
            f"Between the exposures of a capture the board moved {1e3 * motion.median:.2g} mm (median), at most "
            f"{1e3 * motion.largest:.2g} mm; the estimate takes it into account."
        )
    return Section("captures", "Captures", [words], tables=[table] if rows else [])


def _steps(found: RigCalibration) -> Table:
    """Return the table of the parts of all transforms with their standard deviations: mm and degrees."""
    rows = []
    for name, pose in found.poses.items():
        if name != found.first:
            std = np.sqrt(np.diag(found.pose_covariance(name)))
            values = [*(1e3 * pose.translation), *np.degrees(pose.vector())]
            stds = [*(1e3 * std[:3]), *np.degrees(std[3:])]
            rows += [
                [f"{found.transform_name(name)}, {axis}", *value_and_std(value, spread), unit]
                for axis, value, spread, unit in zip(STEP, values, stds, _UNITS, strict=True)
            ]
    return Table.of("Translation and rotation vector", ("part", "value", "± std", "unit"), rows, folded=True)
