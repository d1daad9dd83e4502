"""`camcal stereo check`."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.command import ImageCall
from camcal.tasks.stereo.options import StereoCheckOptions

if TYPE_CHECKING:
    from camcal.progress import Outcome
    from camcal.tasks.stereo.stereo_check import CheckedPair, Pair


def check(options: StereoCheckOptions, call: ImageCall) -> None:
    """Say how good a rectified pair is: how far rows are off and where, swapped or repeated images, exposure, range.

    Every number comes with its standard error. Below 0.1 px rows need nothing, up to 0.5 px 'camcal stereo disparity'
    puts them right, and more is worth a new rectification.
    """
    from camcal.errors import ItemsFailed
    from camcal.tasks.stereo.stereo_check import document, require_good, stereo_check

    outcomes = stereo_check(options, call.progress)
    call.give(lambda: document(outcomes), lambda: _show(outcomes, call.verbose))
    require_good(outcomes, options.max_rms)
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
