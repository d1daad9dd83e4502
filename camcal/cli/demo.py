"""`camcal demo`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from camcal.cli import options as shared
from camcal.cli import show

if TYPE_CHECKING:
    from camcal.tasks.calibration.demo import DemoReport


def demo(
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help="Where to leave images, results and an explanation.")
    ] = Path("camcal-demo"),
    views: Annotated[int, typer.Option(metavar="N", help="Number of photographs.")] = 20,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Another seed gives other poses and noise.")] = 0,
    jobs: shared.Jobs = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """See the main job without any input: a board is photographed, the camera calibrated, an image undistorted.

    The photographs are rendered with a known lens and a slightly bent board, so that truth stands beside estimate.
    """
    from camcal.tasks.calibration.demo import DemoOptions, document
    from camcal.tasks.calibration.demo import demo as run

    options = DemoOptions(output, views, seed, jobs)
    report = run(options, show.progress(quiet))
    if json:
        show.document("demo", document(report, options))
    elif not quiet:
        _show(report, output, verbose)


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
