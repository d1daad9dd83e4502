"""`camcal stereo eval`: what a disparity map is worth."""

from pathlib import Path
from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.command import ImageCall
from camcal.tasks.stereo.options import EvalOptions

if TYPE_CHECKING:
    from camcal.tasks.stereo.stereo_eval import EvalReport, PairReport

LISTED = 10


def evaluate(options: EvalOptions, call: ImageCall) -> None:
    """Compare a disparity map with the truth: bad pixels, D1, averages, quantiles, depth errors, uncertainty.

    Figures stand in four columns: nocc counts the pixels both cameras see, all every pixel with a truth; a pixel
    without a disparity is bad there and left out in nocc-valid and all-valid. Without --mask and --right-truth the
    truth itself, warped to the right image, tells what is occluded.
    """
    from camcal.errors import GateFailed, ItemsFailed
    from camcal.tasks.stereo.stereo_eval import document, stereo_eval

    report = stereo_eval(options, call.progress)
    call.give(lambda: document(report), lambda: _show(report, call.verbose))
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
