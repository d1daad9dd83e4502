"""`camcal smooth`."""

from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.command import Call
from camcal.tasks.poses.smooth_options import SmoothOptions

if TYPE_CHECKING:
    from camcal.tasks.poses.smoothing import Smoothing


def smooth(options: SmoothOptions, call: Call) -> None:
    """Smooth what was measured over time, and say how well it is known.

    Noise is estimated where it is not given. The result has covariances; what does not fit is listed, and the filter's
    innovations say whether the covariances can be believed.
    """
    from camcal.tasks.poses.smooth import document
    from camcal.tasks.poses.smooth import smooth as run

    found = run(options, call.progress)
    call.give(lambda: document(found), lambda: _show(found, call.verbose))


def _show(found: "Smoothing", verbose: bool) -> None:
    from camcal.tasks.poses.smooth_words import evaluation_rows, lines, outlier_line

    for line in lines(found):
        show.text(line)
    if found.outliers:
        show.text(outlier_line(found, verbose))
    if found.before is not None and found.after is not None:
        show.table(*evaluation_rows(found.options.comparison, found.before, found.after))
    for path in found.written:
        show.text(f"wrote {path}")
