"""`camcal stereo cloud`."""

from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.command import Call, ImageCall
from camcal.tasks.stereo.cloud_options import CloudOptions

if TYPE_CHECKING:
    from camcal.tasks.stereo.cloud import CloudReport

LISTED = 10


def cloud(options: CloudOptions, call: ImageCall) -> None:
    """Make a point cloud from a disparity map: z = f b / (d + doffs).

    What is not given is taken from the file that 'camcal stereo disparity' writes beside a map. Pixels without a match
    (zero, negative, NaN, infinite) never become points. Gray images give a colour and an intensity from 0 to 1.
    """
    from camcal.tasks.stereo.cloud import document, stereo_cloud

    if options.disparity.is_dir():
        _make_clouds(options, call)
        return
    report = stereo_cloud(options, call.progress)
    call.give(lambda: document(report), lambda: _show_cloud(report))


def _make_clouds(options: CloudOptions, call: Call) -> None:
    from camcal.progress import require_all
    from camcal.tasks.stereo.cloud_folder import cloud_folder, document

    outcomes = cloud_folder(options, call.progress)
    reports = [outcome.value for outcome in outcomes if outcome.value is not None]
    call.give(lambda: document(outcomes), lambda: _show_clouds(reports, call.verbose))
    require_all(outcomes, "maps")


def _show_clouds(reports: "list[CloudReport]", verbose: bool) -> None:
    for report in reports if verbose else reports[:LISTED]:
        show.text(f"{report.output}: {report.points} points of {report.pixels} pixels")
    if len(reports) > LISTED and not verbose:
        show.text(f"… and {len(reports) - LISTED} more (--verbose lists all)")


def _show_cloud(report: "CloudReport") -> None:
    geometry = report.geometry
    show.text(
        f"disparity = count / {report.scale:g}, {report.points} points of {report.pixels} pixels "
        f"({report.matched} with a match, {report.outliers} of these alone)"
    )
    show.text(f"fx {geometry.fx:g} px, baseline {geometry.baseline:g} m, doffs {geometry.doffs:g} px")
    if report.depth is not None:
        nearest, median, farthest = report.depth
        show.text(f"depth {nearest:.3f} … {farthest:.3f} m, median {median:.3f} m")
    show.text(f"wrote {report.output}: {' '.join(report.fields)} in {report.unit}; {report.frame}")
