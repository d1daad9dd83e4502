"""`camcal pnp`."""

from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.command import ImageCall
from camcal.tasks.poses.options import PnpOptions

if TYPE_CHECKING:
    from camcal.tasks.poses.pnp import PnpReport

LISTED = 10


def pnp(options: PnpOptions, call: ImageCall) -> None:
    """Find the pose of an object from known points and their pixels, or of a board or of tags from images of them.

    camera_T_object takes points of the object to the camera (x right, y down, z forward). Every pose comes with its
    covariance and, where another pose fits nearly as well, with that pose and its probability.
    """
    from camcal.errors import ItemsFailed, NotConverged
    from camcal.tasks.poses.pnp import document
    from camcal.tasks.poses.pnp import pnp as run

    report = run(options, call.progress)
    call.give(lambda: document(report), lambda: _show(report, options, verbose=call.verbose))
    if report.unsettled:
        raise NotConverged(f"these poses did not converge: {', '.join(map(str, report.unsettled[:LISTED]))}")
    report.require_good(options.gates)
    if failed := report.failed:
        total = len(failed) + len(report.poses.estimates)
        raise ItemsFailed(f"{len(failed)} of {total} images have no pose: {', '.join(failed[:LISTED])}")


def _show(report: "PnpReport", options: PnpOptions, *, verbose: bool) -> None:
    from camcal.report import pose_words

    for note in report.notes:
        show.text(note)
    poses = report.poses
    listed = list(poses.estimates.items())[: None if verbose else LISTED]
    rows = [pose_words.row(poses, sight, record) for sight, record in listed]
    show.table(poses.frames, pose_words.columns(poses), rows)
    _show_more(len(poses.estimates) - len(listed))
    if options.all_solutions:
        _show_alternatives(report, verbose)
    show.text(pose_words.noise(poses))
    missing = list(poses.missing.items())[: None if verbose else LISTED]
    for sight, reason in missing:
        show.text(f"no pose: {sight}: {reason}")
    _show_more(len(poses.missing) - len(missing))
    if options.output:
        show.text(f"wrote {options.output}")
    if report.pictures:
        show.text(f"drew {len(report.pictures)} pictures in {report.pictures[0].parent}")


def _show_alternatives(report: "PnpReport", verbose: bool) -> None:
    from camcal.report import pose_words

    poses = report.poses
    rows = [row for item in poses.estimates.items() for row in pose_words.alternative_rows(poses, *item)]
    if not rows:
        show.text("no other pose fits")
        return
    heads = ["image", "x y z", "rotation vector, deg", "χ² above", "probability"]
    show.table("other poses", heads, rows if verbose else rows[:LISTED])
    _show_more(0 if verbose else len(rows) - LISTED)


def _show_more(count: int) -> None:
    if count > 0:
        show.text(f"… and {count} more (--verbose lists all)")
