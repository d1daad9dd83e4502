"""`camcal detect`, `calibrate`, `advise`, `rig` and `stereo calibrate`."""

from collections.abc import Callable, Sequence
from functools import partial
from math import isfinite
from typing import TYPE_CHECKING, Any, TypeVar

from camcal.cli import show
from camcal.cli.call import Call, ImageCall
from camcal.messages import counted
from camcal.progress import Progress
from camcal.report.table import Column
from camcal.tasks.calibration.options import AdviseOptions, CalibrateOptions, DetectOptions
from camcal.tasks.rigs.options import RigSettings, RigTaskOptions, StereoCalibrateOptions

if TYPE_CHECKING:
    from camcal.calibrate.intrinsics import RejectedCorner
    from camcal.tasks.calibration.camera_result import CalibrateReport
    from camcal.tasks.calibration.detect import DetectReport
    from camcal.tasks.calibration.video_frames import FrameRecord
    from camcal.tasks.rigs.rig_result import RigReport

IMAGES_LISTED = 50
DETECTION_COLUMNS = (Column("image", file=True), Column("corners"), Column("reason", wraps=True))

CAMERAS_DRAWN = 4
Options = TypeVar("Options", RigTaskOptions, StereoCalibrateOptions)


def calibrate(options: CalibrateOptions, call: ImageCall) -> None:
    """Calibrate one camera from images or videos of a board, raw frames, or a detections file.

    The shape of the board is estimated together with the lens, outliers are listed, and every value has a standard
    deviation.
    """
    call.once(options, options.output, lambda: _calibrate(options, call), resume=options.batch.resume)


def _calibrate(options: CalibrateOptions, call: ImageCall) -> None:
    from camcal.tasks.calibration.calibrate import calibrate as run
    from camcal.tasks.calibration.calibrate import document, require_good

    report = run(options, call.progress)
    failures = () if options.require else report.assessment.failures  # which end the command with an error then
    call.give_with_reused(
        lambda: document(report, options), lambda: _show_calibration(report, options, call.verbose), failures
    )
    require_good(report, options)
    call.require_all(report.failed, f"could not be read: {', '.join(report.failed[: show.LISTED])}", options.output)


def advise(options: AdviseOptions, call: Call) -> None:
    """Suggest the views to take next: the poses of the board that lower the projection uncertainty most, and what it
    will be; and which of the views that there are may be left out.

    From detections the camera is calibrated first; a camera file does not hold the views, so that none are named.

    With --robot, the poses of a robot's hand that hand and eye gain most from.
    """
    from camcal.tasks.calibration import advise as views
    from camcal.tasks.calibration import advise_hand as poses

    task: Any = views if options.robot is None else poses
    report = task.advise(options, call.progress)

    def shown() -> None:
        show.text(task.headline(report))
        show.table("views to take next", task.COLUMNS, list(task.rows(report)))
        for line in task.lines(report):
            show.text(line)
        show.wrote(options.output)

    call.give(lambda: task.document(report), shown)


def _show_calibration(report: "CalibrateReport", options: CalibrateOptions, verbose: bool) -> None:
    from camcal.calibrate.view_records import shown_name
    from camcal.formats.camera_file import ProjectionStd
    from camcal.report.calibration import (
        CANDIDATE_COLUMNS,
        candidate_rows,
        headline,
        parameter_rows,
        summary,
        time_lines,
    )
    from camcal.report.table import projection_words, region_words
    from camcal.report.text_figures import calibration_figures, coverage_words, residual_words

    calibration, circle = report.calibration, next(iter(report.file.cameras.values())).image_circle
    if report.frames and verbose:
        _show_frames(report.frames, verbose)
    show.trust(report.assessment.failures, region_words(report.assessment.region))
    show.text(headline(calibration))
    show.text(projection_words(ProjectionStd.of(report.uncertainty).figures))
    for line in (*report.lines, *time_lines(report.times)):
        show.text(line)
    width, height = calibration.camera.image_size
    title = f"{calibration.camera.model.name}, {width}x{height}"
    show.table(title, ["parameter", "value", "± std"], parameter_rows(calibration))
    if verbose and report.candidates:
        title = "Lens models by how well they predict left-out views"
        show.table(title, CANDIDATE_COLUMNS, candidate_rows(report.candidates))
    for line in summary(calibration):
        show.text(line)
    show.text(f"Coverage: {coverage_words(calibration, circle)}")
    show.text(f"Residuals: {residual_words(calibration)}")
    show.figure(partial(calibration_figures, calibration, circle))
    _show_channels(report)
    unused = [f"{shown_name(view.image)}: {view.reason}" for view in calibration.views if not view.used]
    show.titled("Not used:", unused, verbose)
    if verbose:
        corners = [
            f"{shown_name(corner.image)}: corner {corner.id}, {_how_far(corner)}" for corner in calibration.rejected
        ]
        show.titled("Rejected corners:", corners, verbose)
    figures = show.several(report.figures, "figure")
    show.wrote(options.output, options.save_detections, options.report, figures)


def _show_channels(report: "CalibrateReport") -> None:
    from camcal.report.table import value_and_std

    if not report.channels:
        return
    rows = []
    for colour, channel in report.channels.items():
        seen, lens = channel.aberration, channel.lens
        corner = value_and_std(seen.corner_px, seen.corner_std_px)
        largest = value_and_std(seen.largest_px, seen.largest_std_px)
        rows.append([colour, *corner, *largest, lens.points, lens.rejected, f"{lens.sigma_px:.3f}"])
    measured = [Column("colour"), Column("shift at the corner"), Column("± std"), Column("largest"), Column("± std")]
    counted = [Column("corners", priority=3), Column("rejected", priority=2), Column("noise", priority=1)]
    show.table("lateral chromatic aberration against green, px", [*measured, *counted], rows)


def _how_far(corner: "RejectedCorner") -> str:
    """Return how far a rejected corner is off in words; one that the lens does not see at all is nowhere near."""
    return f"off by {corner.distance:.2f} px" if isfinite(corner.distance) else "outside the domain of the lens model"


def detect(options: DetectOptions, call: ImageCall) -> None:
    """Find the corners of a board in images, videos or raw frames and write a table (.csv, or .vnl for mrcal).

    Sizes of chessboards count inner corners, sizes of ChArUco boards count squares. Images without a detection are
    listed with the reason. From videos, sharp frames with different views of the board are selected and listed.
    `camcal calibrate` accepts the table instead of the images.
    """
    call.once(options, options.output, lambda: _detect(options, call), resume=options.batch.resume)


def _detect(options: DetectOptions, call: ImageCall) -> None:
    from camcal.tasks.calibration.detect import detect_images, document

    report = detect_images(options, call.progress)
    call.give_with_reused(
        lambda: document(report, options.output), lambda: _show_detections(report, options, call.verbose)
    )
    show.failed(report.failed)
    call.require_all(report.failed, "could not be read, the rest is written", options.output)


def _show_detections(report: "DetectReport", options: DetectOptions, verbose: bool) -> None:
    from_videos = {record.view.image for record in report.frames}
    views = [view for view in report.detections.views if view.image not in from_videos]
    shown = views if verbose or len(views) <= IMAGES_LISTED else [view for view in views if not view.found]
    rows = [[view.image, len(view.ids), view.reason or ""] for view in shown]
    if views:
        found = sum(view.found for view in views)
        show.table(
            f"{found} of {counted(len(views), 'image')} with the board", DETECTION_COLUMNS, rows, verbose=verbose
        )
    if len(shown) < len(views):
        show.text(f"  … and {len(views) - len(shown)} with corners (--verbose lists all)")
    if report.frames:
        _show_frames(report.frames, verbose)
    for line in report.lines:
        show.text(line)
    show.wrote(options.output, show.several(report.pictures, "picture"))


def _show_frames(records: Sequence["FrameRecord"], verbose: bool) -> None:
    """Print which frames of videos are taken, or with `verbose` what became of all that were searched."""
    from camcal.tasks.calibration.video_frames import COLUMNS, cells

    taken = [record for record in records if record.taken]
    shown = records if verbose else taken[:IMAGES_LISTED]
    title = f"{len(taken)} of {len(records)} searched frames used"
    show.table(title, COLUMNS, [cells(record) for record in shown], verbose=verbose)
    if len(shown) < len(taken):
        show.text(f"  … and {len(taken) - len(shown)} more")
    if len(shown) < len(records):
        show.text("  (--verbose lists all searched frames)")


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
