"""`camcal stereo check`."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from camcal.cli import options as shared
from camcal.cli import show

if TYPE_CHECKING:
    from camcal.progress import Outcome
    from camcal.tasks.stereo.stereo_check import CheckedPair, Pair


def check(
    left: Annotated[
        str, typer.Argument(metavar="LEFT", help="The left image, or a folder or quoted pattern of several.")
    ],
    right: Annotated[str, typer.Argument(metavar="RIGHT", help="The right image, or as many as there are left ones.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="PATH", help="A picture of the check (.png); a folder for several pairs."
        ),
    ] = None,
    max_rms: Annotated[
        float | None,
        typer.Option(
            metavar="PIXELS",
            help="Exit with 7 if rows are off by more (RMS), or the pair is swapped or one image twice; try 0.5.",
        ),
    ] = None,
    recursive: shared.Recursive = False,
    jobs: shared.Jobs = None,
    max_pixels: shared.MaxPixels = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Say how good a rectified pair is: how far rows are off and where, swapped or repeated images, exposure, range.

    Every number comes with its standard error. Below 0.1 px rows need nothing, up to 0.5 px 'camcal stereo disparity'
    puts them right, and more is worth a new rectification.
    """
    from camcal.errors import ItemsFailed
    from camcal.tasks.stereo.stereo_check import StereoCheckOptions, document, require_good, stereo_check

    options = StereoCheckOptions((left,), (right,), output, max_rms, recursive, jobs)
    outcomes = stereo_check(options, show.progress(quiet))
    if json:
        show.document("stereo check", document(outcomes))
    elif not quiet:
        _show(outcomes, verbose)
    require_good(outcomes, max_rms)
    failed = [outcome for outcome in outcomes if outcome.error]
    if failed:
        raise ItemsFailed(f"{len(failed)} of {len(outcomes)} pairs failed, the rest is checked")


def _show(outcomes: "Sequence[Outcome[Pair, CheckedPair]]", verbose: bool) -> None:
    from camcal.report.pair_check import lines

    checked = [outcome.value for outcome in outcomes if outcome.value is not None]
    if len(outcomes) == 1 or verbose:
        for pair in checked:
            show.text(f"{pair.left}, {pair.right}:")
            for line in lines(pair.check):
                show.text(f"  {line}")
            if pair.picture is not None:
                show.text(f"wrote {pair.picture}")
    if len(outcomes) > 1:
        _show_together(outcomes)
    for outcome in outcomes:
        if outcome.error is not None:
            show.text(f"failed: {outcome.error}")


def _show_together(outcomes: "Sequence[Outcome[Pair, CheckedPair]]") -> None:
    from camcal.report.pair_check import spanned, verdict
    from camcal.tasks.stereo.stereo_check import overall

    checked = [outcome.value for outcome in outcomes if outcome.value is not None]
    columns = ("left", "median dy", "±", "RMS", "95 %", "disparity", "")
    rows = []
    for pair in checked:
        residual = pair.check.residual
        numbers = (*residual.median, residual.rms, residual.p95)
        rows.append(
            [
                pair.left,
                *(f"{number:.3f}" for number in numbers),
                spanned(*pair.check.disparity),
                verdict(pair.check),
            ]
        )
    show.table("pixels", columns, rows)
    together = overall(outcomes)
    if together is not None:
        show.text(
            f"all {together.pairs} pairs: median {together.median:+.3f} px, RMS {together.rms:.2f} px, 95 % within "
            f"{together.p95:.2f} px; the worst is {together.worst}"
        )
