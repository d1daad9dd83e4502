"""`camcal pnp`, `track`, `handeye`, `smooth`, `fit`: what is estimated from points, images, poses and tables."""

from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.call import Call, ImageCall
from camcal.messages import counted
from camcal.report.table import Column
from camcal.tasks.calibration.check_options import HandEyeOptions
from camcal.tasks.fit_options import TABLE, FitOptions
from camcal.tasks.poses.options import PnpOptions
from camcal.tasks.poses.smooth_options import SmoothOptions, TrackingOptions

if TYPE_CHECKING:
    from camcal.estimate.curves.curve import CurveFit, Estimate
    from camcal.estimate.curves.fit import End
    from camcal.report.handeye import HandEyeReport
    from camcal.tasks.fit_report import FitReport
    from camcal.tasks.poses.pnp import PnpReport
    from camcal.tasks.poses.smooth import Smoothing
    from camcal.tasks.poses.track import TrackReport

ESTIMATE_COLUMNS = (
    Column(),
    Column("value"),
    Column("± std"),
    Column("95 % from", priority=1),
    Column("to", priority=1),
    Column("held"),
)


def pnp(options: PnpOptions, call: ImageCall) -> None:
    """Estimate the pose of an object from 3D-2D correspondences, or of a board or tags from images.

    camera_T_object transforms points of the object to the camera frame (x right, y down, z forward). Every pose has a
    covariance and, if a second pose fits nearly as well, that pose with its probability.
    """
    call.once(options, options.output, lambda: _pnp(options, call), resume=options.detection.batch.resume)


def _pnp(options: PnpOptions, call: ImageCall) -> None:
    from camcal.errors import ItemsFailed, NotConverged
    from camcal.run.journal import resume_hint
    from camcal.tasks.poses.pnp import document
    from camcal.tasks.poses.pnp import pnp as run

    report = run(options, call.progress)
    call.give_with_reused(lambda: document(report), lambda: _show_poses(report, options, verbose=call.verbose))
    if report.unsettled:
        raise NotConverged(f"these poses did not converge: {', '.join(map(str, report.unsettled[: show.LISTED]))}")
    report.require_good(options.gates)
    if failed := report.failed:
        total = len(failed) + len(report.poses.estimates)
        listed = ", ".join(failed[: show.LISTED])
        again = resume_hint(options.output)
        raise ItemsFailed(f"no pose from {len(failed)} of {counted(total, 'image')}: {listed}{again}")


def _show_poses(report: "PnpReport", options: PnpOptions, *, verbose: bool) -> None:
    from camcal.report import track_words

    for line in report.lines:
        show.text(line)
    poses = report.poses
    rows = [track_words.row(poses, pose_key, record) for pose_key, record in poses.estimates.items()]
    show.table(poses.frames, track_words.columns(poses), rows, verbose=verbose, most=show.LISTED)
    if options.all_solutions:
        _show_alternatives(report, verbose)
    show.text(track_words.noise(poses))
    show.lines([f"no pose: {pose_key}: {reason}" for pose_key, reason in poses.missing.items()], verbose)
    show.wrote(options.output, show.several(report.pictures, "picture"))


def _show_alternatives(report: "PnpReport", verbose: bool) -> None:
    from camcal.report import track_words

    poses = report.poses
    rows = [row for item in poses.estimates.items() for row in track_words.alternative_rows(poses, *item)]
    if not rows:
        show.text("no alternative poses")
        return
    columns = track_words.alternative_columns(poses)
    show.table("other poses", columns, rows, verbose=verbose, most=show.LISTED)


def track(options: TrackingOptions, call: ImageCall) -> None:
    """Track a board or tags over a video, a folder of images or a pose file: smoothed poses with covariances.

    Outliers are rejected, mirrored poses of planar objects are resolved by the motion, and a new track segment begins
    after the object was lost. A consistency check (NIS) tells whether the covariances are reliable.
    """
    from camcal.errors import ItemsFailed
    from camcal.tasks.poses.track import document
    from camcal.tasks.poses.track import track as run

    report = run(options, call.progress)
    call.give(lambda: document(report), lambda: _show_tracks(report, call.verbose))
    if report.lost or report.failed:
        lost = [f"{name}: {error.message}" for name, error in report.lost.items()]
        raise ItemsFailed(f"some failed, the rest is tracked: {'; '.join((*lost, *report.failed))}")


def _show_tracks(report: "TrackReport", verbose: bool) -> None:
    from camcal.estimate.smoothing.kalman import CONSISTENT
    from camcal.report.track_words import consistency_details, consistency_line, lines, plain

    for line in report.lines:
        show.text(line)
    for name, item in report.objects.items():
        show.text(f"{item.track.frames}{f', {name}' if name else ''}:")
        judged = item.track.consistency
        if judged is not None:
            show.verdict(f"  {consistency_line(judged)}", good=judged.verdict == CONSISTENT)
        for line in (*lines(item), *([] if judged is None else [consistency_details(judged)])):
            show.text(f"  {line}")
        if verbose:
            for image in plain(item, report.images)["rejected"]:
                show.text(f"  rejected: {image}")
    show.wrote(*report.outputs, show.several(report.figures, "figure"))


def smooth(options: SmoothOptions, call: Call) -> None:
    """Smooth trajectories or time series, with covariances.

    Noise is estimated unless given. Outliers are listed, and a consistency check of the innovations tells whether the
    covariances are reliable.
    """
    from camcal.tasks.poses.smooth import document
    from camcal.tasks.poses.smooth import smooth as run

    found = run(options, call.progress)
    call.give(lambda: document(found), lambda: _show_smoothed(found, call.verbose))


def _show_smoothed(found: "Smoothing", verbose: bool) -> None:
    from camcal.estimate.smoothing.kalman import CONSISTENT
    from camcal.tasks.poses.smooth import consistency_lines, evaluation_rows, lines, outlier_line

    verdict, *reasons = consistency_lines(found)
    show.verdict(verdict, good=found.consistency.verdict == CONSISTENT if reasons else None)
    for line in (*lines(found), *reasons):
        show.text(line)
    if found.outliers:
        show.text(outlier_line(found, verbose))
    if found.before is not None and found.after is not None:
        show.table(*evaluation_rows(found.options.comparison, found.before, found.after))
    show.wrote(*found.written, show.several(found.figures, "figure"))


def fit(options: FitOptions, call: Call) -> None:
    """Fit a formula, a curve or a shape to data, with standard errors, intervals and a verdict.

    Problems are reported by name: unobservable parameters, active bounds, searches that did not converge.
    """
    from camcal.tasks.figure_files import figure_data
    from camcal.tasks.fit import fit as run
    from camcal.tasks.fit_report import document, require_settled

    report = run(options, call.progress)
    call.give(lambda: document(report) | figure_data(report.figures), lambda: _show(report, options, call.verbose))
    require_settled(report)


def _show(report: "FitReport", options: FitOptions, verbose: bool) -> None:
    found = report.fit
    every = {**found.parameters, **found.derived}
    rows = [[name, *_cells(value)] for name, value in every.items()]
    show.table(found.curve.text, ESTIMATE_COLUMNS, rows, verbose=verbose)
    for line in _lines(found):
        show.text(line)
    if report.intervals is not None:
        ends = [[name, *_ends(pair, every[name].std)] for name, pair in report.intervals.items()]
        show.table("by likelihood", ("", "95 % from", "to"), ends)
    if verbose and len(found.free) > 1:
        matrix = [
            [name, *map("{:.3f}".format, row)] for name, row in zip(found.free, found.correlations(), strict=True)
        ]
        show.table("correlations", ("", *found.free), matrix)
    if report.check is not None:
        show.text(f"derivatives agree with the {report.check.method} step to {report.check.error:.1e}")
    _show_comparison(report)
    if options.trace == TABLE:
        from camcal.tasks.fit_report import TRACE_COLUMNS, trace_rows

        show.table("iterations", TRACE_COLUMNS, trace_rows(report.turns))
    show.wrote(*options.outputs(), show.several(report.figures, "figure"))


def _lines(found: "CurveFit") -> list[str]:
    good = found.goodness
    dof = f"{good.degrees_of_freedom} degrees of freedom"
    scatter = "" if good.sigma is None else f", standard deviation {good.sigma:.4g} ({dof})"
    lines = [f"residuals: RMS {good.rms:.4g}{scatter}"]
    if good.chi_square is not None and good.p_value is not None:
        lines.append(f"chi-square {good.chi_square:.4g}, p {good.p_value:.3g}")
    if good.r_squared is not None:
        lines.append(f"R2 {good.r_squared:.6f}")
    outliers = int(found.outliers.sum())
    if outliers:
        lines.append(f"{outliers} of {good.rows} rows with less than half weight")
    lines.append(
        f"{found.reason}; {found.iterations} iterations, best of {found.runs} runs, condition {found.condition:.3g}"
    )
    return lines


def _show_comparison(report: "FitReport") -> None:
    comparison, other = report.comparison, report.other
    if comparison is None or other is None:
        return
    fits = ((report.fit, comparison.first), (other, comparison.second))
    rows = [
        [fit.curve.text, fit.goodness.sum_of_squares, *(f"{value:.2f}" for value in (c.aic, c.aicc, c.bic))]
        for fit, c in fits
    ]
    show.table("comparison", (Column(wraps=True), "sum of squares", "AIC", "AICc", "BIC"), rows)
    words = {"first": report.fit.curve.text, "second": other.curve.text, "neither": "neither"}
    show.text(f"preferred: {words[comparison.preferred]}")
    if comparison.f is not None:
        show.text(f"F {comparison.f:.4g}, p {comparison.p_value:.3g}, if the models are nested")


def _cells(estimate: "Estimate") -> list[object]:
    from camcal.report.table import value_and_std

    value, std = value_and_std(estimate.value, estimate.std)
    return [value, std or "-", *_ends(estimate.interval or (None, None), estimate.std), estimate.held or ""]


def _ends(ends: "tuple[End, End]", std: float | None) -> list[str | None]:
    """Return the ends of an interval to the place where the value is known."""
    from camcal.report.table import value_and_std

    return [None if end is None else value_and_std(end, std)[0] for end in ends]


def handeye(options: HandEyeOptions, call: ImageCall) -> None:
    """Calibrate where a camera stands on a robot's hand, from images of a board that stands still.

    With the board in the hand, where it stands beside the robot.

    How the robot's poses are written, which way they are and their unit are told from the images where they are not
    given, and said. The robot's own noise is estimated, with its intervals.
    """
    from camcal.report.handeye import document
    from camcal.tasks.calibration.handeye import handeye as run

    report = run(options, call.progress)
    call.give(lambda: document(report), lambda: _show_handeye(report, call.verbose))


def _show_handeye(report: "HandEyeReport", verbose: bool) -> None:
    from camcal.report.handeye import COLUMNS, noise_words, rows

    show.text(f"Poses of the robot read as {report.words}")
    show.table("transforms", COLUMNS, rows(report), verbose=verbose)
    show.text(noise_words(report))
    show.wrote(*report.outputs)
