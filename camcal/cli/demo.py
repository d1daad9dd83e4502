"""`camcal demo`."""

from pathlib import Path
from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.command import Call
from camcal.tasks.calibration.options import DemoOptions

if TYPE_CHECKING:
    from camcal.tasks.calibration.demo import DemoReport


def demo(options: DemoOptions, call: Call) -> None:
    """See the main job without any input: a board is photographed, the camera calibrated, an image undistorted.

    The photographs are rendered with a known lens and a slightly bent board, so that truth stands beside estimate.
    """
    from camcal.tasks.calibration.demo import demo as run
    from camcal.tasks.calibration.demo import document

    report = run(options, call.progress)
    call.give(lambda: document(report, options), lambda: _show(report, options.output, call.verbose))


def _show(report: "DemoReport", output: Path, verbose: bool) -> None:
    from camcal.report.calibration import summary
    from camcal.report.uncertain import value_and_std

    rows = [
        [row.name, f"{row.truth:.6g}", *value_and_std(row.estimate, row.std), _sigmas(row.sigmas)]
        for row in report.compared
    ]
    show.table("truth beside estimate", ["parameter", "truth", "estimate", "± std", "off by"], rows)
    calibration = report.calibrated.calibration
    for line in (*report.calibrated.notes, *summary(calibration)):
        show.text(line)
    if verbose:
        views = [[view.image, view.kept, view.rms_px] for view in calibration.views]
        show.table("images", ["image", "corners", "rms px"], views)
    for reason in report.calibrated.advice.reasons:
        show.text(f"DO NOT TRUST: {reason}")
    show.text(f"{output / 'README.txt'} says what lies in {output} and what to try next")


def _sigmas(value: float | None) -> str:
    return "-" if value is None else f"{value:+.1f} σ"
