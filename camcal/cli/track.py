"""`camcal track`."""

from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.command import ImageCall
from camcal.tasks.poses.track_options import FollowOptions

if TYPE_CHECKING:
    from camcal.tasks.poses.track import FollowReport


def track(options: FollowOptions, call: ImageCall) -> None:
    """Follow a board or tags over a video, a folder of images or a pose file: smooth poses with their uncertainty.

    Detections that do not fit are left out, mirrored poses of flat objects are told apart by the motion, and where the
    object is lost the track ends and another begins. It says whether the uncertainty is to be trusted.
    """
    from camcal.errors import ItemsFailed
    from camcal.tasks.poses.track import document
    from camcal.tasks.poses.track import track as run

    report = run(options, call.progress)
    call.give(lambda: document(report), lambda: _show(report, call.verbose))
    if report.lost or report.failed:
        lost = [f"{name}: {error.message}" for name, error in report.lost.items()]
        raise ItemsFailed(f"some failed, the rest is followed: {'; '.join((*lost, *report.failed))}")


def _show(report: "FollowReport", verbose: bool) -> None:
    from camcal.report.track_words import lines, plain

    for note in report.notes:
        show.text(note)
    for name, item in report.objects.items():
        show.text(f"{item.track.frames}{f', {name}' if name else ''}:")
        for line in lines(item):
            show.text(f"  {line}")
        if verbose:
            for image in plain(item, report.images)["rejected"]:
                show.text(f"  left out: {image}")
    for path in report.outputs:
        show.text(f"wrote {path}")
