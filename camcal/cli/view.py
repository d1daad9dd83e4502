"""`camcal view`."""

from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.command import ImageCall
from camcal.tasks.stereo.options import ViewOptions

if TYPE_CHECKING:
    from camcal.tasks.stereo.view import ViewReport


def view(options: ViewOptions, call: ImageCall) -> None:
    """Look at a point cloud or a disparity map: a page that turns and measures, a picture, or a film.

    A page is one file that opens offline in any browser: drag to turn, wheel or pinch to zoom, click two points to
    measure. Pictures and films need no screen. A map without a geometry beside it is shown as it is, as a .png.
    """
    from camcal.tasks.stereo.view import document
    from camcal.tasks.stereo.view import view as run

    report = run(options, call.progress)
    call.give(lambda: document(report), lambda: _show(report))


def _show(report: "ViewReport") -> None:
    if report.points:
        shown = report.shown + report.outside
        points = f"{report.points} points" if shown == report.points else f"{shown} of {report.points} points"
        outside = f" ({report.outside} far outside left out)" if report.outside else ""
        show.text(f"{points}{outside} in {report.unit}, coloured by {report.colour}; {report.frame}")
    show.text(f"wrote {report.output}" if report.output else "opened the Rerun viewer")
