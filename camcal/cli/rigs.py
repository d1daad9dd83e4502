"""`camcal rig` and `stereo calibrate`."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, TypeVar

from camcal.cli import show
from camcal.cli.call import ImageCall
from camcal.progress import Progress
from camcal.tasks.rigs.options import RigSettings, RigTaskOptions, StereoCalibrateOptions

if TYPE_CHECKING:
    from camcal.tasks.rigs.rig_result import RigReport

CAMERAS_DRAWN = 4
Options = TypeVar("Options", RigTaskOptions, StereoCalibrateOptions)


def rig(options: RigTaskOptions, call: ImageCall) -> None:
    """Calibrate several cameras and where they stand from images of a board, or from detections files.

    Cameras may differ in resolution and lens, and need not all see the board at once: captures that two of them share
    link them. Lenses, transforms and the shape of the board are estimated together; the rig file has the covariance of
    all of them.
    """
    from camcal.tasks.rigs.calibrate_rig import rig as run

    _calibrate_rig(run, options, call)


def stereo_calibrate(options: StereoCalibrateOptions, call: ImageCall) -> None:
    """Calibrate a pair of cameras, left and right, from images of a board: 'camcal rig' for two cameras."""
    from camcal.tasks.rigs.calibrate_rig import stereo_calibrate as run

    _calibrate_rig(run, options, call)


def _calibrate_rig(run: Callable[[Options, Progress], "RigReport"], options: Options, call: ImageCall) -> None:
    """Do the task unless an earlier run has done the same, and show what comes of it."""
    settings = options.settings
    call.once(
        options,
        settings.output,
        lambda: _finish_rig(run(options, call.progress), settings, call),
        resume=settings.batch.resume,
    )


def _finish_rig(report: "RigReport", settings: RigSettings, call: ImageCall) -> None:
    """Show a report, and end as it and the settings say."""
    from camcal.tasks.rigs.calibrate_rig import document, require_good

    failures = () if settings.require else report.failures  # which end the command with an error then
    call.give_with_reused(
        lambda: document(report, settings), lambda: _show_rig(report, settings, call.verbose), failures
    )
    require_good(report, settings)
    call.require_all(report.failed, f"could not be read: {', '.join(report.failed[: show.LISTED])}", settings.output)


def _show_rig(report: "RigReport", settings: RigSettings, verbose: bool) -> None:
    from camcal.calibrate.view_records import shown_name
    from camcal.report.calibration import CANDIDATE_COLUMNS, candidate_rows, parameter_rows
    from camcal.report.rig import CAMERA_COLUMNS, TRANSFORM_COLUMNS, camera_rows, lines, transform_rows
    from camcal.report.table import region_words
    from camcal.report.text_figures import calibration_figures, coverage_words, residual_words

    calibration = report.calibration
    regions = {name: result.assessment.region for name, result in report.cameras.items()}
    smallest = min(regions, key=lambda name: regions[name].share)
    show.trust(report.failures, region_words(regions[smallest], smallest))
    for line in report.lines:
        show.text(line)
    show.table("cameras", CAMERA_COLUMNS, camera_rows(calibration), verbose=verbose)
    show.table("transforms", TRANSFORM_COLUMNS, transform_rows(calibration), verbose=verbose)
    for line in lines(calibration):
        show.text(line)
    for number, (name, own) in enumerate(calibration.calibrations.items()):
        circle = report.file.cameras[name].image_circle
        show.text(f"{name}: {coverage_words(own, circle)}; residuals {residual_words(own)}")
        if verbose or number < CAMERAS_DRAWN:
            show.figure(partial(calibration_figures, own, circle))
    for names, candidates in (report.candidates or {}).items() if verbose else ():
        show.table(f"Lens models of {', '.join(names)}", CANDIDATE_COLUMNS, candidate_rows(candidates))
    for name, own in calibration.calibrations.items() if verbose else ():
        show.table(f"{name}: {own.camera.model.name}", ["parameter", "value", "± std"], parameter_rows(own))
    unmatched = report.views.matched.unmatched
    show.titled("Without a partner:", list(unmatched), verbose)
    views = [view for own in calibration.calibrations.values() for view in own.views]
    unused = [f"{shown_name(view.image)}: {view.reason}" for view in views if view.reason]
    show.titled("Not used:", unused, verbose)
    figures = show.several(report.figures, "figure")
    show.wrote(settings.output, settings.save_detections, settings.report, figures)
