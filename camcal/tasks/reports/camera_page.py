"""The report page of the calibration of a camera, and of detections that no calibration can be made from."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from camcal import files
from camcal.errors import CamcalError
from camcal.formats import provenance
from camcal.formats.page_data import CALIBRATE
from camcal.messages import Message, counted
from camcal.report.page.calibration import CalibratedCamera, camera_sections, camera_verdict, key_figures, refused_page
from camcal.report.page.record import Page, rendered
from camcal.report.page.thumbnails import views_of, worst_first
from camcal.report.page.verdict import shown_messages
from camcal.tasks.calibration.board_views import BoardViews
from camcal.tasks.calibration.camera_result import CalibrateReport
from camcal.tasks.calibration.options import CalibrateOptions
from camcal.tasks.reports.carried import blocks, candidates_data, messages_data, run_of
from camcal.tasks.reports.closing import closing_sections, images_of, made, photographs, result_text

CAMERA_NAME = "camera.yaml"  # of the file that a rerun writes


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
