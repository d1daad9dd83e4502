"""`camcal stereo disparity`."""

from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.command import ImageCall
from camcal.tasks.stereo.options import DisparityOptions

if TYPE_CHECKING:
    from camcal.tasks.stereo.matched_pair import MatchedPair

LISTED = 10


def disparity(options: DisparityOptions, call: ImageCall) -> None:
    """Match rectified pairs: the disparity of every pixel, its uncertainty and its class.

    Column in the left image minus column in the right one, in pixels. Beside a map stand its standard deviation, the
    class of every pixel (1 filled, 2 single, 3 apart, 4 near, 5 agreed) and a JSON file with scale, code of no match
    and geometry, so that 'camcal stereo cloud' and 'camcal view' need no options. Exit 7 if left and right are swapped,
    rows differ by more than 5 px, or fewer than 15 % of the pixels are matched; the map is written all the same.
    """
    from camcal.progress import require_all
    from camcal.tasks.stereo.matched_pair import document
    from camcal.tasks.stereo.stereo_disparity import require_good, stereo_disparity

    outcomes = stereo_disparity(options, call.progress)
    matched = [outcome.value for outcome in outcomes if outcome.value is not None]
    call.give(lambda: document(outcomes), lambda: _show(matched, call.verbose))
    if options.force:
        for pair in matched:
            for failure in pair.failures:
                show.warning(f"{pair.left}: {failure}")
    else:
        require_good(outcomes)
    require_all(outcomes, "pairs")


def _show(matched: "list[MatchedPair]", verbose: bool) -> None:
    for pair in matched if verbose else matched[:LISTED]:
        _show_pair(pair, verbose)
    if len(matched) > LISTED and not verbose:
        show.text(f"… and {len(matched) - LISTED} more (--verbose lists all)")


def _show_pair(pair: "MatchedPair", verbose: bool) -> None:
    figures = pair.figures
    first, last = figures.searched
    filled = f", {figures.filled:.1%} filled" if figures.filled else ""
    median = "" if figures.median is None else f", median {figures.median:.2f} px"
    sigma = "" if figures.sigma is None else f", sigma {figures.sigma:.2f} px"
    rows = f", rows aligned by {pair.rows:.2f} px" if pair.rows else ""
    show.text(f"{pair.output}: {figures.matched:.1%} matched{filled}, range {first}:{last}{median}{sigma}{rows}")
    if verbose:
        show.text("  " + ", ".join(f"{name} {share:.1%}" for name, share in figures.classes.items()))
