"""The report pages of the calibration of a camera or a rig, and of detections that no calibration can be made from."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from camcal import files
from camcal.errors import CamcalError
from camcal.formats import provenance
from camcal.messages import Message, counted
from camcal.report.page.calibration import CalibratedCamera, camera_sections, camera_verdict, key_figures, refused_page
from camcal.report.page.record import Page, rendered, shown_messages
from camcal.report.page.rig import CalibratedRig, rig_figures, rig_sections, rig_verdict
from camcal.report.page.thumbnails import views_of, worst_first
from camcal.targets.detection import Detections
from camcal.tasks.calibration.board_views import BoardViews
from camcal.tasks.calibration.camera_result import CalibrateReport
from camcal.tasks.calibration.options import CalibrateOptions
from camcal.tasks.reports.carried import CALIBRATE, RIG, blocks, candidates_data, messages_data, run_of
from camcal.tasks.reports.closing import closing_sections, images_of, made, photographs, result_text
from camcal.tasks.rigs.inspect_rig import inspect_rig
from camcal.tasks.rigs.options import RigSettings
from camcal.tasks.rigs.rig_result import RigReport
from camcal.tasks.rigs.rig_views import RigViews

CAMERA_NAME, RIG_NAME = "camera.yaml", "rig.yaml"  # of the files that a rerun writes
_MOST = 24  # thumbnails of all cameras
_LEAST = 3  # of each


def write(path: Path, report: CalibrateReport, options: CalibrateOptions, words: Sequence[str]) -> None:
    """Write the report of a calibration; words: the command line that is recorded. Raises FileError."""
    seen = report.views
    chosen = [each.view.image for each in worst_first(views_of(report.calibration))]
    photos = photographs(chosen, seen.detections.views, options.reading, seen.files, seen.videos)
    run = _run(report, options, words)
    files.write_text(path, page_text(report, run, photos))


def _run(report: CalibrateReport, options: CalibrateOptions, words: Sequence[str]) -> dict[str, Any]:
    """Return what the page carries; what images said beside detections is recorded, the rest is found again."""
    seen = report.views
    text = result_text(report.file, CAMERA_NAME)
    run = run_of(CALIBRATE, words, options, seen.board, images_of(report.file), text)
    run |= {"warnings": messages_data(report.warnings), "lines": list(report.lines), "failed": list(report.failed)}
    if not seen.table:
        run["models"] = {options.name: report.calibration.camera.model.name}
        run["candidates"] = candidates_data({(options.name,): report.candidates})
    if report.refinement is not None:
        run["refinement"] = vars(report.refinement)
    return run


def page_text(report: CalibrateReport, run: Mapping[str, Any], photos: Mapping[str, str]) -> str:
    """Return the report of a calibration as HTML."""
    name, entry = next(iter(report.file.cameras.items()))
    camera = CalibratedCamera(
        report.calibration, report.uncertainty, report.assessment, entry.image_circle, report.candidates, photos
    )
    sections = (
        *camera_sections(camera, report.assessment.messages),
        *closing_sections(report.file.provenance, run["environment"], report.lines),
    )
    calibration = report.calibration
    width, height = calibration.camera.image_size
    images = counted(len(calibration.views), "image")
    subtitle = f"{calibration.camera.model.name}, {width} x {height} px, from {images} of a {calibration.board.words}"
    page = Page(
        f"Calibration of {name}",
        subtitle,
        camera_verdict(camera, report.warnings),
        shown_messages(report.failures, report.warnings),
        figures=tuple(key_figures(camera)),
        sections=sections,
        made=made(),
        blocks=blocks(run, report.views.detections),
    )
    return rendered(page)


def write_refusal(
    path: Path, seen: BoardViews, options: CalibrateOptions, words: Sequence[str], error: CamcalError
) -> None:
    """Write the report on detections that no calibration can be made from; raises FileError."""
    run = run_of(CALIBRATE, words, options, seen.board, ()) | {
        "refusal": error.message,
        "lines": list(seen.lines),
    }
    images = [view.image for view in seen.detections.views if view.found]
    photos = photographs(images, seen.detections.views, options.reading, seen.files, seen.videos)
    files.write_text(path, refusal_text(seen, options.name, error, run, photos))


def refusal_text(
    seen: BoardViews, name: str, error: CamcalError, run: Mapping[str, Any], photos: Mapping[str, str]
) -> str:
    """Return the report on detections that no calibration can be made from as HTML."""
    views = seen.detections.views
    failure = next(iter(error.failures), Message(error.kind, error.message))
    origin = provenance.build(run["words"], seen.board, [{"file": view.image} for view in views])
    page = refused_page(
        f"Calibration of {name}",
        seen.board,
        views,
        failure,
        made(),
        closing_sections(origin, run["environment"], seen.lines),
        blocks(run, seen.detections),
        photos,
    )
    return rendered(page)


def write_rig(path: Path, report: RigReport, settings: RigSettings, command: Sequence[str]) -> None:
    """Write the report of a calibration; command: the words that the rig file records. Raises FileError."""
    seen = report.views
    photos: dict[str, str] = {}
    for name, own in report.calibration.calibrations.items():
        chosen = [each.view.image for each in worst_first(views_of(own))]
        views = [replace(view, camera=name) for view in seen.of(name)]
        photos |= photographs(chosen, views, settings.reading, seen.files, seen.videos, _most(report))
    run = _rig_run(report, settings, command)
    files.write_text(path, rig_page_text(report, run, photos))


def _most(report: RigReport) -> int:
    """Return how many thumbnails a camera has."""
    return max(_MOST // len(report.calibration.calibrations), _LEAST)


def _rig_run(report: RigReport, settings: RigSettings, command: Sequence[str]) -> dict[str, Any]:
    """Return what the page carries; what images said beside detections is recorded, the rest is found again."""
    seen = report.views
    text = result_text(report.file, RIG_NAME)
    run = run_of(RIG, command, settings, seen.board, images_of(report.file), text)
    run |= {"warnings": messages_data(report.warnings), "lines": list(report.lines), "failed": list(report.failed)}
    run["captures"] = captures_data(seen)
    if not seen.table:
        own = report.calibration.calibrations.items()
        run["models"] = {name: each.camera.model.name for name, each in own}
        run["candidates"] = candidates_data(report.candidates or {})
    if report.refinement is not None:
        run["refinement"] = vars(report.refinement)
    return run


def captures_data(seen: RigViews) -> dict[str, Any]:
    """Return which images make a capture as plain data."""
    captures, matched = seen.captures, seen.matched
    images = [[view.image if view is not None else "" for view in row] for row in captures.views]
    largest = {} if matched.largest is None else {"largest_s": float(matched.largest)}
    return {
        "cameras": list(captures.cameras),
        "names": list(captures.names),
        "images": images,
        "matched_by": matched.by,
        "unmatched": list(matched.unmatched),
    } | largest


def _detections(seen: RigViews) -> Detections:
    """Return the detections of all views with the names of their cameras."""
    views = {name: [replace(view, camera=name) for view in seen.of(name)] for name in seen.captures.cameras}
    return seen.with_views(views).detections()


def rig_page_text(report: RigReport, run: Mapping[str, Any], photos: Mapping[str, str]) -> str:
    """Return the report of a calibration as HTML."""
    inspection = inspect_rig(report.file, RIG_NAME)
    rig = CalibratedRig(
        report.calibration,
        [_camera(report, name, photos) for name in report.calibration.calibrations],
        pairs=() if inspection is None else inspection.pairs,
        candidates=report.candidates,
        failures=report.failures,
        warnings=report.warnings,
    )
    names = list(report.calibration.calibrations)
    captures = counted(len(report.calibration.captures), "capture")
    closing = closing_sections(report.file.provenance, run["environment"], report.lines)
    page = Page(
        f"Calibration of the rig {', '.join(names)}",
        f"{counted(len(names), 'camera')}, {captures} of a {report.views.board.words}",
        rig_verdict(rig),
        shown_messages(report.failures, report.warnings),
        figures=tuple(rig_figures(rig)),
        sections=(*rig_sections(rig), *closing),
        made=made(),
        blocks=blocks(run, _detections(report.views)),
    )
    return rendered(page)


def _camera(report: RigReport, name: str, photos: Mapping[str, str]) -> CalibratedCamera:
    own = report.cameras[name]
    return CalibratedCamera(
        report.calibration.calibrations[name],
        own.uncertainty,
        own.assessment,
        own.circle,
        photos=photos,
        name=name,
        most=_most(report),
    )


def write_rig_refusal(
    path: Path, seen: RigViews, settings: RigSettings, command: Sequence[str], error: CamcalError
) -> None:
    """Write the report on captures that no calibration can be made from; raises FileError."""
    found = _detections(seen)
    run = run_of(RIG, command, settings, seen.board, ()) | {
        "refusal": error.message,
        "captures": captures_data(seen),
        "lines": list(seen.lines),
    }
    photos: dict[str, str] = {}
    for name in seen.captures.cameras:
        views = [view for view in found.views if view.camera == name]
        images = [view.image for view in views if view.found]
        photos |= photographs(images, views, settings.reading, seen.files, seen.videos)
    files.write_text(path, rig_refusal_text(seen, error, run, photos))


def rig_refusal_text(seen: RigViews, error: CamcalError, run: Mapping[str, Any], photos: Mapping[str, str]) -> str:
    """Return the report on captures that no calibration can be made from as HTML."""
    found = _detections(seen)
    failure = next(iter(error.failures), Message(error.kind, error.message))
    images = [{"file": view.image, "camera": view.camera} for view in found.views]
    origin = provenance.build(run["words"], seen.board, images)
    page = refused_page(
        f"Calibration of the rig {', '.join(seen.captures.cameras)}",
        seen.board,
        found.views,
        failure,
        made(),
        closing_sections(origin, run["environment"], seen.lines),
        blocks(run, found),
        photos,
    )
    return rendered(page)
