"""`camcal plot`."""

from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.call import Call
from camcal.tasks.options import PlotOptions

if TYPE_CHECKING:
    from camcal.tasks.plot import PlotReport


def plot(options: PlotOptions, call: Call) -> None:
    """Draw figures of result files: camera and rig files, detections, poses, trajectories, disparity maps and others.

    What a file is follows from its content. Figures are PNG, SVG or PDF with units on their axes and colours for any
    colour vision; their captions are in figures.md.
    """
    from camcal.tasks.plot import document
    from camcal.tasks.plot import plot as run

    report = run(options, call.progress)
    call.give(lambda: document(report), lambda: _show(report))


def _show(report: "PlotReport") -> None:
    for each in report.drawn:
        show.text(f"{each.path}: {each.kind}: {', '.join(plot.name for plot in each.plots)}")
    show.wrote(show.several(report.figures, "figure"))
