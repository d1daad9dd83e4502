"""`camcal calibrate`."""

from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from camcal.cli import options as shared
from camcal.cli import show, targets

if TYPE_CHECKING:
    from camcal.calibrate.intrinsics import RejectedCorner
    from camcal.tasks.calibration.calibrate import CalibrateReport

LISTED = 10
TRUSTWORTHY = "trustworthy"


def calibrate(
    inputs: Annotated[
        list[str],
        typer.Argument(metavar="IMAGES…|DETECTIONS", help="Images, videos, folders, globs; or a detections file."),
    ],
    output: shared.Output,
    board: shared.BoardOption = None,
    model: Annotated[
        str | None,
        typer.Option(
            metavar="MODEL",
            help=f"Lens model: {shared.LENS_MODELS}. "
            "Default: opencv5, unless another one predicts views clearly better; it is said.",
        ),
    ] = None,
    fix: Annotated[
        str, typer.Option(metavar="NAMES", help="Lens parameters to hold, such as k3 or p1,p2: at 0, or the guess's.")
    ] = "",
    guess: Annotated[
        str | None, typer.Option(metavar="CAMERA", help="A camera file to start from; FILE#NAME for one of several.")
    ] = None,
    flat_board: Annotated[
        bool, typer.Option("--flat-board", help="Take the board as drawn; by default its shape is estimated.")
    ] = False,
    free_corners: Annotated[bool, typer.Option(help="Estimate an offset of every corner of the board.")] = True,
    refine: Annotated[
        bool | None,
        typer.Option(
            "--refine/--no-refine",
            help="Measure the corners once more along the edges that the calibrated lens expects, look for those that "
            "were missed, and calibrate with them; by default where there are images.",
        ),
    ] = None,
    max_rejected: Annotated[
        float,
        typer.Option(metavar="PERCENT", help="Refuse the result if more corners than this are off by 4 % of a square."),
    ] = 10.0,
    require: Annotated[
        str | None, typer.Option(metavar="trustworthy", help="Exit with 7 if the result is not to be trusted.")
    ] = None,
    max_uncertainty: Annotated[
        float | None,
        typer.Option(
            metavar="PX",
            help="Exit with 7 if the projection uncertainty (1 sigma, RMS where corners were seen) is larger.",
        ),
    ] = None,
    name: Annotated[str, typer.Option("--name", help="Name of the camera in the file.")] = "camera",
    save_detections: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the corners too, so that a second solve needs no images.")
    ] = None,
    image_size: Annotated[
        str | None, typer.Option(metavar="WxH", help="Size of the images of a .vnl file, which does not say.")
    ] = None,
    pattern: targets.Pattern = None,
    algorithm: targets.Algorithm = "green",
    channels: Annotated[
        bool,
        typer.Option(
            "--channels",
            help="Estimate a lens for red and one for blue too, and with them the lateral chromatic aberration: best "
            "from raw frames, whose samples no demosaicing has mixed.",
        ),
    ] = False,
    format: shared.PixelFormat = None,  # noqa: A002 - it is the option's name
    size: shared.FrameSize = None,
    stride: shared.Stride = None,
    offset: shared.Offset = 0,
    endian: shared.Endian = "little",
    align: shared.Align = "lsb",
    max_frames: targets.MaxFrames = 40,
    every: targets.Every = 1,
    all_frames: targets.AllFrames = False,
    parts: targets.Parts = False,
    mixed_sizes: targets.MixedSizes = False,
    recursive: shared.Recursive = False,
    jobs: shared.Jobs = None,
    max_pixels: shared.MaxPixels = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Calibrate one camera from images or videos of a board, raw frames, or a detections file.

    The board's bend and stretch are estimated along with the lens, outliers are listed, and every value comes with
    its standard deviation.
    """
    from camcal.errors import InvalidInput, ItemsFailed
    from camcal.formats.native_entry import circle_block
    from camcal.report.calibration import as_data, contenders_data, uncertainty_data
    from camcal.tasks.calibration.calibrate import CalibrateOptions, channel_data
    from camcal.tasks.calibration.calibrate import calibrate as run
    from camcal.tasks.calibration.photographs import Reading
    from camcal.tasks.calibration.video_frames import FrameOptions
    from camcal.tasks.calibration.video_frames import as_data as frame_data

    if require not in (None, TRUSTWORTHY):
        raise InvalidInput(f"--require {require}: can only be {TRUSTWORTHY}")
    if max_uncertainty is not None and not max_uncertainty > 0:
        raise InvalidInput(f"--max-uncertainty {max_uncertainty:g} is not above 0")
    layout = shared.given_layout(format, size, stride, offset, endian, align)
    report = run(
        CalibrateOptions(
            tuple(inputs),
            output,
            board,
            model,
            tuple(part.strip() for part in fix.split(",") if part.strip()),
            guess,
            flat_board,
            free_corners,
            max_rejected / 100,
            name,
            save_detections,
            shared.parse_size(image_size) if image_size else None,
            recursive,
            jobs,
            Reading(pattern, algorithm, channels, layout),
            FrameOptions(max_frames, every, all_frames),
            parts,
            refine,
            mixed_sizes,
        ),
        show.progress(quiet),
    )
    if json:
        verdict = {
            "trustworthy": report.advice.trustworthy,
            "reasons": report.advice.reasons,
            "remarks": report.advice.remarks,
            "findings": [vars(found) for found in report.advice.findings],
            "contenders": contenders_data(report.contenders),
        }
        frames = [frame_data(record) for record in report.frames]
        said = {"frames": frames, "notes": report.notes, "failed": report.failed}
        lenses = {"channels": channel_data(report.channels)} if report.channels else {}
        circle = {"image_circle": circle_block(report.file.cameras[name].image_circle)}
        numbers = {**as_data(report.calibration), "uncertainty": uncertainty_data(report.uncertainty), **circle}
        show.document("calibrate", {"output": output, **numbers, **verdict, **said, **lenses})
    elif not quiet:
        _show(report, output, verbose)
    _gate(report, require, max_uncertainty)
    if report.failed:
        raise ItemsFailed(f"{len(report.failed)} of the images could not be read: {', '.join(report.failed[:LISTED])}")


def _gate(report: "CalibrateReport", require: str | None, max_uncertainty: float | None) -> None:
    """Raise GateFailed if the result does not do; the camera file is written all the same."""
    from camcal.errors import GateFailed

    figures = report.uncertainty.figures()
    reached = figures.get("inside_rms_px", figures["rms_px"])
    if require and not report.advice.trustworthy:
        raise GateFailed(f"--require {require}: {report.advice.reasons[0]}")
    if max_uncertainty is not None and not reached <= max_uncertainty:
        raise GateFailed(f"--max-uncertainty {max_uncertainty:g}: the projection uncertainty is {reached:.3g} px")


def _show(report: "CalibrateReport", output: Path, verbose: bool) -> None:
    from camcal.formats.camera_file import ProjectionStd
    from camcal.report.calibration import contender_rows, headline, parameter_rows, summary
    from camcal.report.uncertain import projection_words

    calibration = report.calibration
    if report.frames and verbose:
        targets.show_frames(report.frames, verbose)
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
    show.text(f"wrote {output}")


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
