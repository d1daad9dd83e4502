"""`camcal plot`, `camcal report` and `camcal rerun`: figures and reports of result files."""

from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.call import Call
from camcal.tasks.options import PlotOptions
from camcal.tasks.reports.options import ReportOptions, RerunOptions

if TYPE_CHECKING:
    from camcal.tasks.plot import PlotReport
    from camcal.tasks.reports.report import Reported
    from camcal.tasks.reports.rerun import Rerun


def plot(options: PlotOptions, call: Call) -> None:
    """Draw figures of result files: camera and rig files, detections, poses, trajectories, disparity maps and others.

    What a file is follows from its content. Figures are PNG, SVG or PDF with units on their axes and colours for any
    colour vision; their captions are in figures.md.
    """
    from camcal.tasks.plot import document
    from camcal.tasks.plot import plot as run

    report = run(options, call.progress)
    call.give(lambda: document(report), lambda: _show_plots(report))


def _show_plots(report: "PlotReport") -> None:
    for each in report.drawn:
        show.text(f"{each.path}: {each.kind}: {', '.join(plot.name for plot in each.plots)}")
    show.wrote(show.several(report.figures, "figure"))


def report(options: ReportOptions, call: Call) -> None:
    """Write a report: one HTML file with the verdict, what to do, figures, tables and provenance.

    From a detections file the camera, or the cameras of a rig, are calibrated; the report then also has residuals,
    coverage, poses and images, and carries the detections, so that 'camcal rerun' can repeat it. Of a camera or rig
    file alone it shows what the file holds. It opens in any browser without a network, prints, and has a light and a
    dark theme. Detections that no calibration can be made from get a report that says why.
    """
    from camcal.tasks.reports.report import document
    from camcal.tasks.reports.report import report as run

    found = run(options, call.progress)
    call.give(lambda: document(found), lambda: _show_report(found), found.failures)


def _show_report(found: "Reported") -> None:
    if found.trustworthy or found.failures:
        show.trust(found.failures)
    show.wrote(found.output)


def rerun(options: RerunOptions, call: Call) -> None:
    """Calibrate again from the detections and options that a report carries, and compare the results.

    Writes camera.yaml or rig.yaml and report.html: the same bytes on the same machine with the same libraries.
    Elsewhere what differs is listed: versions, processor, figures. Figures within 1e-6 standard deviations are equal;
    exit 7 if others differ.
    """
    from camcal.tasks.reports.rerun import document, require_agreement
    from camcal.tasks.reports.rerun import rerun as run

    found = run(options, call.progress)
    call.give(lambda: document(found), lambda: _show_rerun(found, call.verbose))
    require_agreement(found)


def _show_rerun(found: "Rerun", verbose: bool) -> None:
    show.text("Same report, byte for byte" if found.same else "The bytes of the report differ")
    if found.environment:
        show.text("Versions and machine:")
        show.lines([f"  {line}" for line in found.environment], verbose)
    if found.differences:
        show.text("Figures that differ:")
        show.lines([f"  {each.line}" for each in found.differences], verbose)
    elif not found.same:
        show.text("All figures agree within 1e-6 standard deviations")
    show.wrote(*found.outputs)
