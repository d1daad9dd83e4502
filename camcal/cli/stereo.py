"""`camcal stereo rectify`, `check`, `disparity`, `cloud`, `run` and `eval`, and `camcal view`."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from camcal import records
from camcal.cli import show
from camcal.cli.call import ImageCall
from camcal.messages import counted
from camcal.report.table import Column
from camcal.tasks.stereo.options import DisparityOptions, EvalOptions, StereoCheckOptions, ViewOptions
from camcal.tasks.stereo.run_options import CloudOptions, RectifyOptions, RunOptions

if TYPE_CHECKING:
    from camcal.progress import Outcome
    from camcal.tasks.stereo.cloud import CloudReport
    from camcal.tasks.stereo.rectify import RectifyReport
    from camcal.tasks.stereo.stereo_check import CheckedPair, Pair
    from camcal.tasks.stereo.stereo_disparity import MatchedPair
    from camcal.tasks.stereo.stereo_eval import EvalReport, PairReport
    from camcal.tasks.stereo.stereo_run import RunReport
    from camcal.tasks.stereo.view import ViewReport

MAP_COLUMNS = (
    Column("map", file=True),
    Column("matched", "%"),
    Column("filled", "%", priority=1),
    Column("range", "px", priority=3),
    Column("median", "px", priority=2),
    Column("sigma", "px"),
    Column("rows aligned by", "px", priority=4),
)
RUN_COLUMNS = (
    Column("pair", file=True),
    Column("row offsets", "px RMS", priority=1),
    Column("matched", "%"),
    Column("points"),
    Column("median depth", "m"),
)
CLOUD_COLUMNS = (Column("cloud", file=True), Column("points"), Column("pixels"))


def rectify(options: RectifyOptions, call: ImageCall) -> None:
    """Rectify the images of two cameras of a rig: corresponding points come to lie in one row (one column, if one
    camera is above the other).

    Lenses of any model and field of view, mixed too; projection, field of view, size and focal length follow from what
    both cameras see. rectified.yaml in the output folder describes the rectified pair for 'camcal stereo disparity' and
    'cloud'; masks show which pixels have a source. Without images only these files are written.
    """
    from camcal.errors import ItemsFailed
    from camcal.tasks.stereo.rectify import document
    from camcal.tasks.stereo.rectify import rectify as run

    report = run(options, call.progress)
    call.give(lambda: document(report), lambda: _show_rectified(report))
    show.failed(report.failed)
    if report.failed:
        raise ItemsFailed.of(len(report.failed), len(report.images), "images")


def _show_rectified(report: "RectifyReport") -> None:
    found = report.rectification
    width, height = found.size
    unit = "px" if found.projection == "pinhole" else "px/rad"
    common = "rows" if found.axis == "x" else "columns"
    show.text(f"{found.projection}, {width}x{height}, f = {found.focal:.6g} {unit}; corresponding {common}")
    order = ("left", "right") if found.axis == "x" else ("top", "bottom")
    cameras = f"{order[0]} {found.left}, {order[1]} {found.right}"
    show.text(f"{cameras}; baseline {found.baseline:.6g} m, doffs {found.doffs:.6g} px")
    empty = ", ".join(f"{name} {100 * (1 - share):.1f} %" for name, share in report.valid.items())
    show.text(f"{100 * found.kept:.1f} % of the common field of view kept; pixels without source: {empty}")
    beside = report.beside
    show.reused(report.images, "image")
    drawn = [each.output for each in show.made(report.images)]
    if drawn or not report.images:
        masks = show.several(beside.masks, "mask")
        show.wrote(*beside.all[:1], *beside.all[3:], masks, show.several(drawn, "image"))


def check(options: StereoCheckOptions, call: ImageCall) -> None:
    """Check a rectified pair: row offsets, swapped or identical images, exposure, range of disparities.

    Every number has a standard error. Row offsets below 0.1 px need no correction, 'camcal stereo disparity' corrects
    up to 0.5 px, and for more the pair should be rectified again.
    """
    from camcal.errors import ItemsFailed
    from camcal.tasks.stereo.stereo_check import document, require_good, stereo_check

    outcomes = stereo_check(options, call.progress)
    call.give(lambda: document(outcomes), lambda: _show_checks(outcomes, call.verbose))
    show.failed(outcomes)
    require_good(outcomes, options.max_rms)
    failed = [outcome for outcome in outcomes if outcome.error]
    if failed:
        raise ItemsFailed(f"{len(failed)} of {len(outcomes)} pairs failed, the rest is checked")


def _show_checks(outcomes: "Sequence[Outcome[Pair, CheckedPair]]", verbose: bool) -> None:
    from camcal.report.stereo_words import agrees, lines, verdict

    checked = [outcome.value for outcome in outcomes if outcome.value is not None]
    if len(outcomes) == 1 or verbose:
        for pair in checked:
            show.text(f"{pair.left}, {pair.right}:")
            show.verdict(f"  {verdict(pair.check)}", good=agrees(pair.check))
            for line in lines(pair.check):
                show.text(f"  {line}")
    if len(outcomes) > 1:
        _show_together(outcomes, verbose)
    show.wrote(show.several([pair.picture for pair in checked if pair.picture is not None], "picture"))


def _show_together(outcomes: "Sequence[Outcome[Pair, CheckedPair]]", verbose: bool) -> None:
    from camcal.report.stereo_words import CHECK_COLUMNS, check_row
    from camcal.tasks.stereo.stereo_check import overall

    checked = [outcome.value for outcome in outcomes if outcome.value is not None]
    rows = [[str(pair.left), *check_row(pair.check)] for pair in checked]
    show.table("rows of the pairs", CHECK_COLUMNS, rows, verbose=verbose)
    together = overall(outcomes)
    if together is not None:
        show.text(
            f"all {together.pairs} pairs: median {together.median:+.3f} px, RMS {together.rms:.2f} px, 95 % within "
            f"{together.p95:.2f} px; the worst is {together.worst}"
        )


def disparity(options: DisparityOptions, call: ImageCall) -> None:
    """Compute the disparity map of a pair, with uncertainty and confidence class of every pixel.

    With a rig file in the place of CAMERA the images are rectified first, and MAP.left.png is the rectified left image.
    Disparity is the column in the left image minus the column in the right image, in pixels. Beside the map are written
    its standard deviation, the confidence class (1 filled, 2 single, 3 apart, 4 near, 5 agreed) and a JSON sidecar with
    scale, invalid value and geometry, so that 'camcal stereo cloud' and 'camcal view' need no options. Exit 7 if left
    and right are swapped, rows differ by more than 5 px, or fewer than 15 % of the pixels are matched; the map is still
    written.
    """
    from camcal.progress import require_all, warn_of
    from camcal.tasks.stereo.stereo_disparity import document, failures, require_good, stereo_disparity

    outcomes = stereo_disparity(options, call.progress)
    call.give(lambda: document(outcomes), lambda: _show_matched(outcomes, call.verbose))
    if options.force:
        warn_of(failures(outcomes), call.progress)
    else:
        require_good(outcomes)
    require_all(outcomes, "pairs")


def _show_matched(outcomes: "Sequence[Outcome[Pair, MatchedPair]]", verbose: bool) -> None:
    """Print the maps as a table, with `verbose` the shares of their classes too."""
    pairs = [outcome.value for outcome in outcomes if outcome.value is not None]
    classes = list(pairs[0].figures.classes) if pairs and verbose else []
    rows = []
    for pair in pairs:
        figures = pair.figures
        shares = [f"{100 * share:.1f}" for share in (figures.matched, figures.filled)]
        sizes = [None if size is None else f"{size:.2f}" for size in (figures.median, figures.sigma)]
        more = [f"{100 * figures.classes[name]:.1f}" for name in classes]
        rows.append([str(pair.output), *shares, "{}:{}".format(*figures.searched), *sizes, f"{pair.rows:.2f}", *more])
    if rows:
        columns = [*MAP_COLUMNS, *(Column(name, "%") for name in classes)]
        show.table(counted(len(rows), "map"), columns, rows, verbose=verbose, most=show.LISTED)
    show.reused(outcomes, "map")
    made = show.made(outcomes)
    pictures = [pair.picture for pair in made if pair.picture is not None]
    show.wrote(show.several([pair.output for pair in made], "map"), show.several(pictures, "picture"))


def cloud(options: CloudOptions, call: ImageCall) -> None:
    """Compute a point cloud from a disparity map, or from an unrectified pair and its rig file: z = f b / (d + doffs).

    A cloud of images that camcal rectified is in the frame of the left camera before rectification (--frame camera).
    Missing options are taken from the sidecar that 'camcal stereo disparity' writes beside a map. Invalid disparities
    (zero, negative, NaN, infinite) give no points. Gray images give a colour and an intensity from 0 to 1.
    """
    from camcal.progress import require_all
    from camcal.tasks.stereo.clouds import cloud_folder, folder_document, stereo_cloud

    if options.disparity.is_dir():
        outcomes = cloud_folder(options, call.progress)
        call.give(lambda: folder_document(outcomes), lambda: _show_clouds(outcomes, call.verbose))
        require_all(outcomes, "maps")
        return
    report = stereo_cloud(options, call.progress)
    call.give(lambda: records.document(report), lambda: _show_cloud(report))


def _show_clouds(outcomes: "Sequence[Outcome[Path, CloudReport]]", verbose: bool) -> None:
    reports = [outcome.value for outcome in outcomes if outcome.value is not None]
    rows = [[str(report.output), report.points, report.pixels] for report in reports]
    show.table(counted(len(rows), "cloud"), CLOUD_COLUMNS, rows, verbose=verbose, most=show.LISTED)
    show.reused(outcomes, "cloud")
    show.wrote(show.several([report.output for report in show.made(outcomes)], "cloud"))


def _show_cloud(report: "CloudReport") -> None:
    geometry = report.geometry
    show.text(
        f"disparity = count / {report.scale:g}, {report.points} points of {report.pixels} pixels "
        f"({report.matched} with a match, {report.outliers} outliers)"
    )
    show.text(f"fx {geometry.fx:g} px, baseline {geometry.baseline:g} m, doffs {geometry.doffs:g} px")
    if report.depth is not None:
        nearest, median, farthest = report.depth
        show.text(f"depth {nearest:.3f} … {farthest:.3f} m, median {median:.3f} m")
    show.text(f"{' '.join(report.fields)} in {report.unit}; {report.frame}")
    if "sigma" in report.fields:
        parts = "matching and calibration" if report.calibration_known else "matching; the calibration counts as exact"
        show.text(f"sigma: {parts}")
    if report.reused:
        show.text(f"nothing to do: {report.output} is complete and unchanged")
    else:
        show.wrote(report.output)


def run(options: RunOptions, call: ImageCall) -> None:
    """Rectify, check and match pairs, and make a point cloud and a page to view it of each; calibrate first if needed.

    With a rig file LEFT and RIGHT are the scene. Without one they show a board, the cameras are calibrated with them,
    and the scene is what is behind the board, or the images of --scene. The folder holds rig.yaml (if it was
    calibrated), rectified.yaml, rectified/, disparity/, clouds/ and views/; views/NAME.html opens in any browser.
    """
    from camcal.tasks.stereo.stereo_run import document, require_good, stereo_run

    report = stereo_run(options, call.progress)
    # what a rig file says against itself was a warning; what is required ends the command with an error
    failures = () if report.calibration is None or options.settings.require else report.doubts
    call.give(lambda: document(report), lambda: _show_run(report, call.verbose), failures)
    show.failed(report.outcomes)
    require_good(report, options)


def _show_run(report: "RunReport", verbose: bool) -> None:
    rectified = report.rectification
    if report.calibration is not None:
        show.trust(report.doubts)
    where = "above each other" if rectified.axis == "y" else "beside each other"
    size = "{}x{}".format(*rectified.size)
    show.text(f"{rectified.left} and {rectified.right} {where}, baseline {1000 * rectified.baseline:.1f} mm")
    show.text(f"rectified to {rectified.projection} views of {size} pixels")
    rows = []
    for pair in report.pairs:
        depth = None if pair.cloud.depth is None else f"{pair.cloud.depth[1]:.3f}"
        row_offsets = None if pair.check is None else f"{pair.check.residual.rms:.2f}"
        matched = f"{100 * pair.figures.matched:.1f}"
        rows.append([pair.capture.name, row_offsets, matched, pair.cloud.points, depth])
    show.table(counted(len(rows), "pair"), RUN_COLUMNS, rows, verbose=verbose, most=show.LISTED)
    show.reused(report.outcomes, "pair")
    own = None if report.calibration is None else report.rig_file
    made = show.made(report.outcomes)
    pages = [pair.page for pair in made if pair.page is not None]
    clouds = [pair.files.cloud for pair in made]
    if made:
        show.wrote(own, report.rectified_file, show.several(clouds, "cloud"), show.several(pages, "page"))


def evaluate(options: EvalOptions, call: ImageCall) -> None:
    """Evaluate a disparity map against ground truth: bad pixels, D1, averages, quantiles, depth errors, uncertainty.

    Four columns: nocc counts non-occluded pixels, all every pixel with ground truth; a pixel without a disparity counts
    as bad there and is ignored in nocc-valid and all-valid. Without --mask and --right-truth, occlusions are computed
    from the ground truth warped to the right image.
    """
    from camcal.errors import GateFailed, ItemsFailed
    from camcal.tasks.stereo.stereo_eval import document, stereo_eval

    report = stereo_eval(options, call.progress)
    call.give(lambda: document(report), lambda: _show_errors(report, call.verbose))
    show.failed(report.outcomes)
    if report.failures:
        raise GateFailed.of(report.failures, where="--gate")
    failed = [outcome for outcome in report.outcomes if outcome.error]
    if failed:
        raise ItemsFailed(f"{len(failed)} of {len(report.outcomes)} maps failed: {failed[0].error}")


def _show_errors(report: "EvalReport", verbose: bool) -> None:
    from camcal.report.stereo_words import CLASS_COLUMNS, class_rows, figure_rows

    for verdict in report.verdicts:
        line = f"gate {verdict.gate} {'passed' if verdict.passed else 'FAILED'}: {verdict.value:.4g}"
        show.verdict(line, good=verdict.passed)
    in_full = verbose or len(report.outcomes) == 1
    show.lines(["\n".join(_pair_lines(pair, in_full=in_full)) for pair in report.pairs], verbose)
    title = "errors" if len(report.outcomes) == 1 else f"mean over {len(report.pairs)} maps"
    show.table(title, ["", *report.mean.figures], figure_rows(report.mean))
    if report.mean.classes:
        show.table("confidence, all-valid", CLASS_COLUMNS, class_rows(report.mean.classes), verbose=verbose)
    pictures = [pair.picture for pair in report.pairs if pair.picture is not None]
    show.wrote(show.several(pictures, "picture"), show.several(report.figures, "figure"))


def _pair_lines(pair: "PairReport", *, in_full: bool) -> Iterator[str]:
    disparity, truth = _file_words(pair.files.disparity, pair.scale), _file_words(pair.files.truth, pair.truth_scale)
    yield f"{disparity} against {truth}"
    if not in_full:
        return
    yield f"  occluded by: {pair.occlusion}"
    if pair.geometry is not None:
        geometry = pair.geometry
        yield f"  fx {geometry.fx:g} px, baseline {geometry.baseline:g} m, doffs {geometry.doffs:g} px"


def _file_words(path: Path, scale: float) -> str:
    """Return the file, and what its counts are divided by where they are not pixels already."""
    return str(path) if scale == 1 else f"{path} (count / {scale:g})"


def view(options: ViewOptions, call: ImageCall) -> None:
    """View a point cloud or a disparity map: an interactive HTML page, a picture, or a video.

    The page is one file that opens offline in any browser: drag to rotate, wheel or pinch to zoom, click two points to
    measure. Pictures and videos need no display. A map without a sidecar is drawn as a colour picture (.png).
    """
    from camcal.tasks.stereo.view import view as run

    report = run(options, call.progress)
    call.give(lambda: records.document(report), lambda: _show_view(report))


def _show_view(report: "ViewReport") -> None:
    if report.points:
        shown = report.shown + report.outside
        points = f"{report.points} points" if shown == report.points else f"{shown} of {report.points} points"
        outside = f" ({report.outside} far outliers omitted)" if report.outside else ""
        show.text(f"{points}{outside} in {report.unit}, coloured by {report.colour}; {report.frame}")
    if report.output:
        show.wrote(report.output)
    else:
        show.text("opened the Rerun viewer")
