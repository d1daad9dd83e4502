"""`camcal stereo eval`: what a disparity map is worth."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from camcal.cli import options as shared
from camcal.cli import show

if TYPE_CHECKING:
    from camcal.tasks.stereo.stereo_eval import EvalReport, PairReport

LISTED = 10


def evaluate(
    disparity: Annotated[
        Path, typer.Argument(metavar="DISPARITY", help="Disparity map of the left image, or a folder of maps.")
    ],
    truth: Annotated[
        Path, typer.Argument(metavar="TRUTH", help="The true disparity, or a folder in the same natural order.")
    ],
    camera_file: Annotated[
        str | None,
        typer.Argument(
            metavar="CAMERA",
            help="Camera file of the rectified pair or FILE#NAME; or Middlebury's or KITTI's calib.txt. For depth.",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="PATH", help="Where to write the error picture; for folders a folder."),
    ] = None,
    scale: Annotated[
        float | None,
        typer.Option(
            metavar="COUNTS",
            help="Counts of the map per pixel; by default its sidecar's, or 256 for 16-bit (signed: 16), else 1.",
        ),
    ] = None,
    truth_scale: Annotated[
        float | None, typer.Option(metavar="COUNTS", help="The same of the truth, such as 4 for Middlebury 2003.")
    ] = None,
    mask: Annotated[
        Path | None, typer.Option(metavar="FILE", help="What both cameras see: where 8 bits are 255, or 16 bits not 0.")
    ] = None,
    right_truth: Annotated[
        Path | None, typer.Option(metavar="FILE", help="True disparity of the right image: tells what is occluded.")
    ] = None,
    sigma: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Uncertainty of every pixel; by default the sidecar's.")
    ] = None,
    confidence: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Confidence class of every pixel; by default the sidecar's.")
    ] = None,
    camera: shared.CameraName = None,
    fx: Annotated[float | None, typer.Option(metavar="PIXELS", help="Focal length, for errors of the depth.")] = None,
    baseline: shared.Baseline = None,
    doffs: shared.Doffs = None,
    gate: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FIGURE=LIMIT", help="Fail (exit 7) if a figure is worse: bad2=2.5, bad2:all=5. Repeatable."
        ),
    ] = None,
    jobs: shared.Jobs = None,
    max_pixels: shared.MaxPixels = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Compare a disparity map with the truth: bad pixels, D1, averages, quantiles, depth errors, uncertainty.

    Figures stand in four columns: nocc counts the pixels both cameras see, all every pixel with a truth; a pixel
    without a disparity is bad there and left out in nocc-valid and all-valid. Without --mask and --right-truth the
    truth itself, warped to the right image, tells what is occluded.
    """
    from camcal.errors import GateFailed, ItemsFailed
    from camcal.tasks.stereo.rectified_pair import GeometryOptions
    from camcal.tasks.stereo.stereo_eval import EvalOptions, document, stereo_eval
    from camcal.tasks.stereo.truth_pairs import TruthPair

    files = TruthPair(disparity, truth, mask, right_truth, sigma, confidence)
    geometry = GeometryOptions(camera, fx=fx, baseline=baseline, doffs=doffs)
    options = EvalOptions(files, scale, truth_scale, camera_file, geometry, output, tuple(gate or ()), jobs)
    report = stereo_eval(options, show.progress(quiet))
    if json:
        show.document("stereo eval", document(report))
    elif not quiet:
        _show(report, verbose)
    broken = [f"{verdict.gate} (found {verdict.value:.4g})" for verdict in report.verdicts if not verdict.passed]
    if broken:
        raise GateFailed(f"gate failed: {', '.join(broken)}")
    failed = [outcome for outcome in report.outcomes if outcome.error]
    if failed:
        raise ItemsFailed(f"{len(failed)} of {len(report.outcomes)} maps failed: {failed[0].error}")


def _show(report: "EvalReport", verbose: bool) -> None:
    from camcal.report.disparity_errors import CLASS_COLUMNS, class_rows, figure_rows

    shown = report.pairs if verbose else report.pairs[:LISTED]
    for pair in shown:
        _show_pair(pair, in_full=verbose or len(report.outcomes) == 1)
    if len(shown) < len(report.pairs):
        show.text(f"… and {len(report.pairs) - len(shown)} more (--verbose lists all)")
    title = "errors" if len(report.outcomes) == 1 else f"mean over {len(report.pairs)} maps"
    show.table(title, ["", *report.mean.figures, ""], figure_rows(report.mean))
    if report.mean.classes:
        show.table("confidence, all-valid (% and px)", CLASS_COLUMNS, class_rows(report.mean.classes))
    for verdict in report.verdicts:
        show.text(f"gate {verdict.gate}: {verdict.value:.4g}, {'holds' if verdict.passed else 'FAILED'}")
    for outcome in report.outcomes:
        if outcome.error is not None:
            show.text(f"failed: {outcome.error}")


def _show_pair(pair: "PairReport", *, in_full: bool) -> None:
    disparity, truth = _counted(pair.files.disparity, pair.scale), _counted(pair.files.truth, pair.truth_scale)
    show.text(f"{disparity} against {truth}")
    if not in_full:
        return
    show.text(f"  occluded by: {pair.occlusion}")
    if pair.geometry is not None:
        geometry = pair.geometry
        show.text(f"  fx {geometry.fx:g} px, baseline {geometry.baseline:g} m, doffs {geometry.doffs:g} px")
    if pair.picture is not None:
        show.text(f"  wrote {pair.picture}")


def _counted(path: Path, scale: float) -> str:
    """Return the file, and what its counts are divided by where they are not pixels already."""
    return str(path) if scale == 1 else f"{path} (count / {scale:g})"
