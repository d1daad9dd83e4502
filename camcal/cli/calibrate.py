"""`camcal calibrate`."""

from math import isfinite
from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.command import ImageCall
from camcal.cli.detect import show_frames
from camcal.tasks.calibration.options import CalibrateOptions

if TYPE_CHECKING:
    from camcal.calibrate.intrinsics import RejectedCorner
    from camcal.tasks.calibration.calibrate import CalibrateReport

LISTED = 10


def calibrate(options: CalibrateOptions, call: ImageCall) -> None:
    """Calibrate one camera from images or videos of a board, raw frames, or a detections file.

    The board's bend and stretch are estimated along with the lens, outliers are listed, and every value comes with
    its standard deviation.
    """
    from camcal.errors import ItemsFailed
    from camcal.tasks.calibration.calibrate import calibrate as run
    from camcal.tasks.calibration.calibrate import document, require_good

    report = run(options, call.progress)
    call.give(lambda: document(report, options), lambda: _show(report, options, call.verbose))
    require_good(report, options)
    if report.failed:
        raise ItemsFailed(f"{len(report.failed)} of the images could not be read: {', '.join(report.failed[:LISTED])}")


def _show(report: "CalibrateReport", options: CalibrateOptions, verbose: bool) -> None:
    from camcal.formats.camera_file import ProjectionStd
    from camcal.report.calibration import contender_rows, headline, parameter_rows, summary
    from camcal.report.uncertain import projection_words

    calibration = report.calibration
    if report.frames and verbose:
        show_frames(report.frames, verbose)
    for reason in report.advice.reasons:
        show.text(f"DO NOT TRUST: {reason}")
    if report.advice.trustworthy:
        show.text("trustworthy")
    show.text(headline(calibration))
    show.text(projection_words(ProjectionStd.of(report.uncertainty).figures))
    for remark in report.advice.remarks:
        show.text(f"note: {remark}")
    for note in report.notes:
        show.text(note)
    width, height = calibration.camera.image_size
    show.table(
        f"{calibration.camera.model.name}, {width}x{height}",
        ["parameter", "value", "± std"],
        parameter_rows(calibration),
    )
    if verbose and report.contenders:
        header = ["lens model", "nat per corner", "prediction error px", ""]
        show.table("Lens models by how well they predict left-out views", header, contender_rows(report.contenders))
    for line in summary(calibration):
        show.text(line)
    _show_channels(report)
    _list("Not used:", [f"  {view.image}: {view.reason}" for view in calibration.views if not view.used], verbose)
    if verbose:
        corners = [f"  {corner.image}: corner {corner.id}, {_how_far(corner)}" for corner in calibration.rejected]
        _list("Rejected corners:", corners, verbose)
    show.text(f"wrote {options.output}")


def _show_channels(report: "CalibrateReport") -> None:
    from camcal.report.uncertain import value_and_std

    if not report.channels:
        return
    rows = []
    for colour, channel in report.channels.items():
        seen, lens = channel.aberration, channel.lens
        corner = value_and_std(seen.corner_px, seen.corner_std_px)
        largest = value_and_std(seen.largest_px, seen.largest_std_px)
        rows.append([colour, *corner, *largest, lens.points, lens.rejected, f"{lens.sigma_px:.3f}"])
    header = ["colour", "outwards at the corner", "± std", "largest", "± std", "corners", "rejected", "noise"]
    show.table("lateral chromatic aberration against green, px", header, rows)


def _how_far(corner: "RejectedCorner") -> str:
    """Return how far a rejected corner is off in words; one that the lens does not see at all is nowhere near."""
    return f"off by {corner.distance:.2f} px" if isfinite(corner.distance) else "beyond what the lens model covers"


def _list(title: str, lines: list[str], verbose: bool) -> None:
    if not lines:
        return
    show.text(title)
    shown = lines if verbose else lines[:LISTED]
    for line in shown:
        show.text(line)
    if len(shown) < len(lines):
        show.text(f"  … and {len(lines) - len(shown)} more (--verbose lists all)")
