"""`camcal rig` and `camcal stereo calibrate`: images of several cameras in, one rig file out."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from camcal import messages
from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Calibration, CandidateModel
from camcal.calibrate.rigs.calibrate import calibrate_rig
from camcal.calibrate.rigs.record import RigCalibration, RigOptions
from camcal.cameras.validity import ImageCircle
from camcal.errors import CamcalError, GateFailed, InsufficientData, InvalidInput, NotConverged
from camcal.formats import detections, native, native_entry
from camcal.messages import Message
from camcal.options import command_line
from camcal.progress import SILENT, Progress, stage, warn_of
from camcal.quality.assess import assess
from camcal.quality.projection_uncertainty import too_uncertain
from camcal.report.calibration import as_data, candidates_data, times_data, uncertainty_data
from camcal.report.rig import motion_data, scales_data, transform_data
from camcal.run.journal import journal_beside
from camcal.run.outputs import writes
from camcal.targets.board import Board
from camcal.targets.board_set import BoardSet, surfaces_of
from camcal.targets.detection import BoardDetection
from camcal.tasks.calibration.board_views import is_refined, known_circle
from camcal.tasks.calibration.camera_result import RefinementSummary
from camcal.tasks.calibration.images_again import refine_corners
from camcal.tasks.figure_files import figure_data, write_figures
from camcal.tasks.rigs.options import PRIOR, RigSettings, RigTaskOptions, StereoCalibrateOptions
from camcal.tasks.rigs.rig_boards import bodies_of, measured_of, require_size
from camcal.tasks.rigs.rig_lenses import (
    GivenLens,
    RigModels,
    brief_lenses,
    given_lenses,
    require_other_images,
    require_sizes,
    rig_models,
    starting,
)
from camcal.tasks.rigs.rig_result import CameraResult, RigReport, rig_file
from camcal.tasks.rigs.rig_views import RigViews, rig_views, with_circles


@writes
def rig(options: RigTaskOptions, progress: Progress = SILENT) -> RigReport:
    """Return the calibration of a rig after writing it to options.settings.output, if that is given.

    Raises InvalidInput, FileError, InsufficientData or NotConverged; nothing is written then.
    """
    settings = options.settings
    return calibrated(
        lambda: rig_views(options.inputs, settings, progress), settings, command_line("rig", options), progress
    )


@writes
def stereo_calibrate(options: StereoCalibrateOptions, progress: Progress = SILENT) -> RigReport:
    """Return the calibration of two cameras, left and right; raises and writes as `rig` does."""
    inputs = [options.left] if options.right is None else [f"left={options.left}", f"right={options.right}"]
    settings, command = options.settings, command_line("stereo calibrate", options)
    return calibrated(lambda: rig_views(inputs, settings, progress, pair=True), settings, command, progress)


def calibrated(
    look: Callable[[], RigViews], settings: RigSettings, command: Sequence[str], progress: Progress = SILENT
) -> RigReport:
    """Return the calibration from the views that `look` returns; command: the words that the file records.

    What the settings say of the board is not used. Raises and writes as `rig` does.
    """
    with journal_beside(settings.output, settings.batch):
        return _calibrate(look(), settings, command, progress)


class _Solution(NamedTuple):
    """The captures that a rig was calibrated from, the lens models, and the rig."""

    views: RigViews
    models: RigModels
    calibration: RigCalibration


def _calibrate(seen: RigViews, settings: RigSettings, command: Sequence[str], progress: Progress) -> RigReport:
    require_size(seen.board)
    names = seen.captures.cameras
    if isinstance(seen.board, BoardSet) and (settings.motion or settings.timed):
        wrong = "--motion" if settings.motion else "--time-offset" if settings.time_offset else "--rolling-shutter"
        raise InvalidInput(f"{wrong} is of one board: leave it out with several")
    given = given_lenses(settings, names, progress)
    require_sizes(given, seen.captures)
    if settings.lenses == PRIOR:
        require_other_images(given, seen.captures)
    refined = is_refined(settings.refine, seen.board, table=seen.table)
    seen = with_circles(seen, settings)
    circles = {name: circle for name in names if (circle := _circle(seen, name)) is not None}
    if settings.save_detections:
        detections.write(settings.save_detections, seen.detections())
    shape = ShapeOptions(smooth=not settings.flat_board, offsets=settings.free_corners)
    refinement: RefinementSummary | None = None
    found: tuple[Message, ...] = ()

    solve = partial(_solve, settings=settings, given=given, shape=shape, circles=circles, progress=progress)
    try:
        if refined:
            with stage(progress, "solving briefly"):
                lenses = brief_lenses(seen.captures, seen.board, settings, shape, circles)
            seen, solution, refinement, found = _refine(seen, lenses, solve, settings, progress)
        else:
            solution = solve(seen)
    except (InsufficientData, NotConverged) as error:
        _write_refusal(seen, settings, command, error, progress)
        raise
    if refined and settings.save_detections:
        detections.write(settings.save_detections, seen.detections())
    seen, models, calibration = solution
    results = {
        name: CameraResult(assess(own, circles.get(name), models.candidates_of(name)), circles.get(name))
        for name, own in calibration.calibrations.items()
    }
    file = rig_file(calibration, results, command)
    figures = _write_figures(settings, calibration, results, models.candidates)
    if settings.output is not None:
        native.write(settings.output, file)
    of_cameras = (each.at(name) for name, result in results.items() for each in result.assessment.warnings)
    found += (*calibration.warnings, *of_cameras)
    warn_of(found, progress)
    report = RigReport(
        calibration,
        results,
        views=seen,
        file=file,
        warnings=seen.warnings + found,
        lines=seen.lines + models.lines + (refinement.lines if refinement else ()),
        refinement=refinement,
        candidates=models.candidates,
        figures=figures,
    )
    if settings.report is not None:
        from camcal.tasks.reports.pages import write_rig

        write_rig(settings.report, report, settings, command)
    return report


def _solve(
    views: RigViews,
    settings: RigSettings,
    given: Mapping[str, GivenLens],
    shape: ShapeOptions,
    circles: Mapping[str, ImageCircle],
    progress: Progress,
) -> _Solution:
    """Return the rig, from views as of one moment where their times are asked for."""
    times = None
    if settings.timed:
        from camcal.tasks.calibration.camera_times import synchronised

        lenses = brief_lenses(views.captures, views.board, settings, shape, circles)
        with stage(progress, "times"):
            views, times = synchronised(views, lenses, settings)
    with stage(progress, "choosing lens models"):
        models = rig_models(views.captures, views.board, settings, given, shape, circles)
    with stage(progress, "solving"):
        bodies, measured = bodies_of(settings, views.board), measured_of(settings, views.board)
        how = replace(_solver_options(settings, given, shape, models), bodies=bodies, measured=measured)
        calibration = calibrate_rig(views.captures, views.board, how)
    if times is not None:
        from camcal.tasks.calibration.camera_times import with_times

        calibration = with_times(calibration, times)
    return _Solution(views, models, calibration)


def _write_refusal(
    seen: RigViews, settings: RigSettings, command: Sequence[str], error: CamcalError, progress: Progress
) -> None:
    """Write what there is of a rig that cannot be calibrated: its detections, measured, and a page."""
    if settings.save_detections and any(view.located for view in seen.detections().views):
        detections.write(settings.save_detections, _measure(seen, {}, settings, progress)[0].detections())
    if settings.report is not None:
        from camcal.tasks.reports.pages import write_rig_refusal

        write_rig_refusal(settings.report, seen, settings, command, error)


def require_good(report: RigReport, settings: RigSettings) -> None:
    """Raise GateFailed if the result is not what the settings require; the rig file is written all the same."""
    if settings.require and not report.trustworthy:
        raise GateFailed.of(report.failures, where=f"--require {settings.require}")
    most = settings.max_uncertainty
    failures = [
        each.at(name) for name, result in report.cameras.items() for each in too_uncertain(result.uncertainty, most)
    ]
    if failures:
        raise GateFailed.of(failures, where="--max-uncertainty")


def _write_figures(
    settings: RigSettings,
    calibration: RigCalibration,
    results: Mapping[str, CameraResult],
    candidates: Mapping[tuple[str, ...], tuple[CandidateModel, ...]] | None,
) -> tuple[Path, ...]:
    if settings.figures.folder is None:
        return ()
    from camcal.report.figures.rig import rig_plots

    uncertainties = {name: result.uncertainty for name, result in results.items()}
    circles = {name: result.circle for name, result in results.items() if result.circle is not None}
    return write_figures(settings.figures, rig_plots(calibration, uncertainties, circles, candidates))


def _circle(seen: RigViews, name: str) -> ImageCircle | None:
    return known_circle(replace(seen.detections(), views=tuple(seen.of(name))), None)


def _solver_options(
    settings: RigSettings, given: Mapping[str, GivenLens], shape: ShapeOptions, models: RigModels
) -> RigOptions:
    lenses = {name: starting(lens.camera, models.models[name]) for name, lens in given.items()}
    return RigOptions(
        models.models,
        settings.lenses,
        lenses,
        shape,
        settings.max_rejected,
        settings.motion,
        models.others,
        models.starts,
    )


def _refine(
    seen: RigViews,
    lenses: Mapping[str, Calibration],
    solve: Callable[[RigViews], _Solution],
    settings: RigSettings,
    progress: Progress,
) -> tuple[RigViews, _Solution, RefinementSummary | None, tuple[Message, ...]]:
    """Return the views with their corners measured where calibrations expect them, what they lead to, what changed, and
    warnings. Views that a calibration cannot be made from then are measured as their images alone have them.

    lenses: brief calibrations of cameras alone, of those that have one; the others are measured once more where the rig
    expects their corners.
    """
    others = set(seen.captures.cameras) - set(lenses)
    better, summary = _measure(seen, lenses, settings, progress)
    try:
        solution = solve(better)
        if others:
            found = solution.calibration.calibrations
            rest = {name: found[name] for name in others & set(found)}
            better, more = _measure(better, rest, settings, progress)
            summary = RefinementSummary(summary.added + more.added, summary.removed + more.removed)
            solution = solve(better)
    except (InvalidInput, InsufficientData, NotConverged) as error:
        seen, _ = _measure(seen, {}, settings, progress)
        text = f"corner refinement with the calibrated lenses skipped, as with --no-refine: {error.message}"
        return seen, solve(seen), None, (Message("refinement_failed", text),)
    return better, solution, summary, ()


def _measure(
    seen: RigViews, lenses: Mapping[str, Calibration], settings: RigSettings, progress: Progress
) -> tuple[RigViews, RefinementSummary]:
    """Return the views with their corners measured, see `refine_corners`, and what has changed."""
    views: dict[str, Sequence[BoardDetection]] = {}
    added = removed = 0
    for name in seen.captures.cameras:
        own, lens = seen.of(name), lenses.get(name)
        again = list(own)
        for body, board in seen.board.members.items():
            rows = [row for row, view in enumerate(own) if view.body == body or not body]
            found = refine_corners(
                None if lens is None else _of_board(lens, body, rows),
                board,
                [_alone(seen.board, own[row]) for row in rows],
                seen.videos,
                settings.reading,
                settings.jobs,
                settings.batch,
                progress,
                seen.files,
            )
            for row, view in zip(rows, found.views, strict=True):
                again[row] = seen.board.numbered(body, view) if isinstance(seen.board, BoardSet) else view
            added, removed = added + found.recovered, removed + found.lost
        views[name] = again
    return seen.with_views(views), RefinementSummary(added, removed)


def _of_board(lens: Calibration, body: str, rows: Sequence[int]) -> Calibration:
    """Return a calibration with one of its boards, and the views of it alone, by their places."""
    if not body:
        return lens
    surface = surfaces_of(lens.surface)[body]
    return replace(lens, board=surface.board, surface=surface, views=tuple(lens.views[row] for row in rows))


def _alone(board: Board, view: BoardDetection) -> BoardDetection:
    return board.alone(view) if isinstance(board, BoardSet) else view


def document(report: RigReport, settings: RigSettings) -> dict[str, Any]:
    """Return the report as plain data for --json."""
    calibration, captures = report.calibration, report.views.captures
    return {
        "output": settings.output,
        "lenses": settings.lenses,
        "first": calibration.first,
        "cameras": {name: _camera_data(report, name) for name in calibration.calibrations},
        "transforms": {
            name: transform_data(pose, calibration.transform_covariance(name))
            for name, pose in calibration.transforms.items()
        },
        "links": [link.as_data() for link in calibration.links],
        "scales": scales_data(calibration.scales),
        "epipolar_rms_px": calibration.epipolar_rms_px,
        "motion": motion_data(calibration.motion),
        "times": times_data(calibration.times),
        "unlinked": dict(calibration.unlinked),
        "matched_by": report.views.matched.by,
        "largest_time_difference_s": report.views.matched.largest,
        "captures": [
            {
                "name": capture,
                "images": {
                    name: view.image for name, view in zip(captures.cameras, row, strict=True) if view is not None
                },
            }
            for capture, row in zip(captures.names, captures.views, strict=True)
        ],
        "unmatched": list(report.views.matched.unmatched),
        "refinement": None if report.refinement is None else vars(report.refinement),
        "candidates": [
            {"cameras": list(names), "models": candidates_data(candidates)}
            for names, candidates in (report.candidates or {}).items()
        ],
        "trustworthy": report.trustworthy,
        "failures": messages.as_data(report.failures),
        "frames": [record.as_data() for record in report.views.frames],
        "failed": report.failed,
        **figure_data(report.figures),
    }


def _camera_data(report: RigReport, name: str) -> dict[str, Any]:
    result = report.cameras[name]
    return {
        **as_data(report.calibration.calibrations[name]),
        "uncertainty": uncertainty_data(result.uncertainty),
        "image_circle": native_entry.circle_block(result.circle),
        "trustworthy": result.assessment.trustworthy,
    }
