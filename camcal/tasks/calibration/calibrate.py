"""`camcal calibrate`: images or a detections file in, one camera file out."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from camcal import messages
from camcal.calibrate import intrinsics
from camcal.calibrate.channels import aberration, fit_colour
from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Calibration, CandidateModel
from camcal.calibrate.several_cameras import name_groups
from camcal.cameras.catalogue import DEFAULT_MODEL, model_named
from camcal.cameras.validity import ImageCircle
from camcal.errors import GateFailed, InsufficientData, InvalidInput, NotConverged
from camcal.formats import detections, native, native_entry, split_address
from camcal.formats.camera_file import CameraEntry
from camcal.messages import Message
from camcal.options import command_line
from camcal.progress import SILENT, Progress, stage, warn_of
from camcal.quality.projection_uncertainty import ProjectionUncertainty, too_uncertain
from camcal.raw import COLOURS
from camcal.report.calibration import as_data, candidates_data, time_data, uncertainty_data
from camcal.run.outputs import writes
from camcal.targets.board import Board
from camcal.targets.detection import BoardDetection
from camcal.tasks.calibration.board_views import (
    BoardViews,
    board_views,
    is_located,
    is_refined,
    is_table,
    known_circle,
    view_settings,
)
from camcal.tasks.calibration.camera_result import (
    CalibrateReport,
    Channel,
    RefinementSummary,
    camera_file,
    channel_figures,
)
from camcal.tasks.calibration.model_selection import Selection, brief_calibration, solve
from camcal.tasks.calibration.options import CalibrateOptions
from camcal.tasks.figure_files import figure_data, write_figures


@writes
def calibrate(options: CalibrateOptions, progress: Progress = SILENT) -> CalibrateReport:
    """Return the calibration of one camera after writing it to options.output, if that is given.

    Raises InvalidInput, FileError, InsufficientData or NotConverged; nothing is written then.
    """
    look = partial(seen_of, options, options.board, progress)
    if any(map(is_table, options.inputs)):
        return calibrated(look, options, progress)
    from camcal.run.journal import journal_beside

    with journal_beside(options.output, options.batch):
        return calibrated(look, options, progress)


def seen_of(options: CalibrateOptions, board: Board | str | None, progress: Progress = SILENT) -> BoardViews:
    """Return what the inputs show of a board, see `board_views`; corners that the lens helps to measure are located."""
    if options.rolling_shutter:
        options = replace(options, frames=replace(options.frames, whole=True))
    seen = board_views(
        options.inputs,
        board,
        progress=progress,
        **view_settings(options),
        parts=options.parts,
        mixed_sizes=options.mixed_sizes,
        batch=options.batch,
        locate=is_located(options.refine, options.reading, mixed_sizes=options.mixed_sizes),
    )
    if not options.rolling_shutter:
        return seen
    from camcal.tasks.calibration.camera_times import with_frame_times

    return with_frame_times(seen, options.timing, progress)


def calibrated(
    look: Callable[[], BoardViews],
    options: CalibrateOptions,
    progress: Progress = SILENT,
    command: Sequence[str] | None = None,
) -> CalibrateReport:
    """Return the calibration from the views that `look` returns, which is called once the options are checked.

    What the options say of inputs and board is not used. command: the words that the file records, None for those of
    the options. Raises and writes as `calibrate` does.
    """
    words = command_line("calibrate", options) if command is None else command
    guess = _guess(options, progress)
    how = _solver_options(options, guess)
    seen = look()
    refined = is_refined(options.refine, seen.board, table=seen.table)
    how = replace(how, named_groups=name_groups([view.image for view in seen.detections.views]))
    if not seen.table:
        from camcal.tasks.calibration.images_again import with_circle

        seen = replace(seen, detections=with_circle(seen.detections, seen.videos, options.reading, seen.files))
    circle = known_circle(seen.detections, guess)
    if options.save_detections:
        detections.write(options.save_detections, seen.detections)
    brief, solve_seen = _ways(options, seen.board, how, circle, progress)
    refinement: RefinementSummary | None = None
    found: tuple[Message, ...] = ()
    try:
        if refined:
            seen, selection, refinement, found = _refine(seen, brief, solve_seen, options, progress)
        else:
            selection = solve_seen(seen.detections.views)
    except (InsufficientData, NotConverged) as refusal:
        error = _cause(refusal, seen, options, progress)
        if options.save_detections and any(view.located for view in seen.detections.views):
            detections.write(options.save_detections, _measure(seen, None, options, progress)[0].detections)
        if options.report is not None:
            from camcal.tasks.reports.pages import write_refusal

            write_refusal(options.report, seen, options, words, error)
        raise error from refusal.__cause__
    calibration, assessment = selection.calibration, selection.assessment
    found += selection.warnings
    if refinement is not None and options.save_detections:
        detections.write(options.save_detections, seen.detections)
    colours = COLOURS if options.reading.colours else ()
    channels = {colour: _channel(calibration, colour, seen.detections.views) for colour in colours}
    file = camera_file(
        calibration, assessment, options.name, words, channels=channels, circle=circle, times=selection.times
    )
    figures = _write_figures(options, calibration, assessment.uncertainty, selection.candidates, circle)
    if options.output is not None:
        with stage(progress, "writing"):
            native.write(options.output, file)
    said = {message.code for message in seen.warnings}
    found += tuple(own for own in assessment.warnings if own.code != "unit" or "unknown_board_size" not in said)
    warn_of(found, progress)
    report = CalibrateReport(
        calibration,
        assessment=assessment,
        file=file,
        views=seen,
        warnings=seen.warnings + found,
        failed=seen.failed,
        lines=seen.lines
        + (() if circle is None else (circle.words,))
        + selection.lines
        + (refinement.lines if refinement else ()),
        refinement=refinement,
        channels=channels,
        frames=seen.frames,
        candidates=selection.candidates,
        figures=figures,
        times=selection.times,
    )
    if options.report is not None:
        from camcal.tasks.reports.pages import write

        write(options.report, report, options, words)
    return report


def require_good(report: CalibrateReport, options: CalibrateOptions) -> None:
    """Raise GateFailed if the result is not what the options require; the camera file is written all the same."""
    if options.require and not report.assessment.trustworthy:
        raise GateFailed.of(report.assessment.failures, where=f"--require {options.require}")
    failures = too_uncertain(report.uncertainty, options.max_uncertainty)
    if failures:
        raise GateFailed.of(failures, where="--max-uncertainty")


def _write_figures(
    options: CalibrateOptions,
    calibration: Calibration,
    uncertainty: ProjectionUncertainty,
    candidates: Sequence[CandidateModel],
    circle: ImageCircle | None,
) -> tuple[Path, ...]:
    if options.figures.folder is None:
        return ()
    from camcal.report.figures.calibration import calibration_plots

    return write_figures(options.figures, calibration_plots(calibration, uncertainty, candidates, circle))


def _refine(
    seen: BoardViews,
    brief: Callable[[Sequence[BoardDetection]], Calibration | None],
    solve: Callable[[Sequence[BoardDetection]], Selection],
    options: CalibrateOptions,
    progress: Progress,
) -> tuple[BoardViews, Selection, RefinementSummary | None, tuple[Message, ...]]:
    """Return the views with their corners measured where a calibration expects them, what they lead to, what changed,
    and warnings. Views that a calibration cannot be made from then are measured as their images alone have them.

    brief: returns the calibration; a whole one is made where none of the brief ones would do.
    """
    with stage(progress, "solving briefly"):
        lens = brief(seen.detections.views)
    if lens is None:
        seen, _ = _measure(seen, None, options, progress)
        lens = solve(seen.detections.views).calibration
    better, summary = _measure(seen, lens, options, progress)
    try:
        return better, solve(better.detections.views), summary, ()
    except (InsufficientData, NotConverged) as error:
        seen, _ = _measure(seen, None, options, progress)
        text = f"corner refinement with the calibrated lens skipped, as with --no-refine: {error.message}"
        return seen, solve(seen.detections.views), None, (Message("refinement_failed", text),)


def _cause(
    refusal: InsufficientData | NotConverged, seen: BoardViews, options: CalibrateOptions, progress: Progress
) -> InsufficientData | NotConverged:
    """Return why views cannot be calibrated: that their images look like screenshots of the board, if they do."""
    if seen.table:
        return refusal
    from camcal.tasks.calibration.images_again import screenshots

    return screenshots(seen.detections, seen.board, seen.videos, seen.files, options, progress) or refusal


def _ways(
    options: CalibrateOptions, board: Board, how: intrinsics.Options, circle: ImageCircle | None, progress: Progress
) -> tuple[Callable[[Sequence[BoardDetection]], Calibration | None], Callable[[Sequence[BoardDetection]], Selection]]:
    """Return how views are calibrated briefly, and how wholly."""
    choose = options.model is None
    brief = partial(brief_calibration, board=board, options=how, circle=circle, choose=choose)
    whole = partial(solve, board=board, options=how, circle=circle, choose=choose, progress=progress)
    if not options.rolling_shutter:
        return brief, whole
    from camcal.tasks.calibration.camera_times import solve_at_once

    return brief, partial(solve_at_once, brief=brief, solve=whole, circle=circle, progress=progress)


def _measure(
    seen: BoardViews, lens: Calibration | None, options: CalibrateOptions, progress: Progress
) -> tuple[BoardViews, RefinementSummary]:
    """Return the views with their corners measured, see `refine_corners`, and what has changed."""
    from camcal.tasks.calibration.images_again import refine_corners

    how = options.reading, options.jobs, options.batch, progress
    look = refine_corners(lens, seen.board, seen.detections.views, seen.videos, *how, seen.files)
    better = replace(seen, detections=replace(seen.detections, views=look.views))
    return better, RefinementSummary(look.recovered, look.lost)


def _channel(calibration: Calibration, colour: str, views: Sequence[BoardDetection]) -> Channel:
    try:
        lens = fit_colour(calibration, views, colour)
    except (InsufficientData, NotConverged) as error:
        raise type(error)(f"{colour}: {error.message}") from error
    return Channel(lens, aberration(calibration.camera, lens))


def _guess(options: CalibrateOptions, progress: Progress) -> CameraEntry | None:
    from camcal.formats import cameras
    from camcal.tasks.given_camera import read_part, require_whole

    if options.guess is None:
        require_whole(options.part, "--guess CAMERA")
        return None
    path, name = split_address(options.guess)
    # a start may be poor; what is held at its value may not
    file = read_part(path, options.part, progress if options.fix else SILENT, central=False)
    return cameras.select(file, name, str(path))


def _solver_options(options: CalibrateOptions, guess: CameraEntry | None) -> intrinsics.Options:
    model = model_named(options.model or DEFAULT_MODEL)
    if model.configuration and options.reading.colours:
        raise InvalidInput(f"--channels: lenses of single colours are not {model.name}; give another --model")
    return intrinsics.Options(
        model,
        options.fix,
        None if guess is None else guess.camera,
        ShapeOptions(smooth=not options.flat_board, offsets=options.free_corners),
        options.max_rejected,
    )


def document(report: CalibrateReport, options: CalibrateOptions) -> dict[str, Any]:
    """Return the report as plain data for --json."""
    lenses = {"channels": channel_data(report.channels)} if report.channels else {}
    return {
        "output": options.output,
        **as_data(report.calibration),
        "uncertainty": uncertainty_data(report.uncertainty),
        "image_circle": native_entry.circle_block(report.file.cameras[options.name].image_circle),
        "times": None if report.times is None else time_data(*report.times.cameras.values()),
        "refinement": None if report.refinement is None else vars(report.refinement),
        "trustworthy": report.assessment.trustworthy,
        "region": {**vars(report.assessment.region), "polygon": report.assessment.region.polygon.round(2).tolist()},
        "failures": messages.as_data(report.assessment.failures),
        "candidates": candidates_data(report.candidates),
        "frames": [record.as_data() for record in report.frames],
        "failed": report.failed,
        **lenses,
        **figure_data(report.figures),
    }


def channel_data(channels: Mapping[str, Channel]) -> dict[str, Any]:
    """Return the lens of every colour and its aberration as plain data for --json."""
    figures = channel_figures(channels)
    return {
        colour: {
            "parameters": {name: camera.value(name) for name in camera.model.parameter_names},
            "std": {name: camera.std(name) for name in camera.model.parameter_names},
            "aberration": figures["aberration"][colour],
        }
        for colour, camera in ((colour, channel.lens.camera) for colour, channel in channels.items())
    }
