"""What `camcal simulate --stereo` makes of its options, and what it shows."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from camcal.cli import options as shared
from camcal.cli import show

if TYPE_CHECKING:
    from camcal.tasks.simulation.simulate_stereo import StereoOptions, StereoReport

_AS_THEY_ARE = ("baseline", "doffs", "objects", "blur", "noise", "depth", "row_shift", "row_tilt")
_ALONE = {
    *("pairs", "baseline", "doffs", "disparities", "distance", "objects", "gray"),
    *("right_gain", "right_offset", "right_gamma", "row_shift", "row_tilt"),
}
_TOO = {"stereo", "output", "size", "fov", "blur", "noise", "depth", "seed"}
_EVERYWHERE = {"jobs", "json", "quiet", "verbose", "config"}


def require_fitting(context: typer.Context, *, stereo: bool) -> None:
    """Raise InvalidInput if what was given has no meaning with, or without, --stereo."""
    from camcal.errors import InvalidInput

    given = [each for each in context.command.params if _is_given(context, each.name)]
    for each in given:
        if stereo and each.name not in _ALONE | _TOO | _EVERYWHERE:
            raise InvalidInput(f"{_spelled(each)} has no meaning with --stereo; leave it out")
        if not stereo and each.name in _ALONE:
            raise InvalidInput(f"{_spelled(each)} needs --stereo")


def _is_given(context: typer.Context, name: str | None) -> bool:
    source = context.get_parameter_source(name) if name else None
    return source is not None and source.name != "DEFAULT"


def _spelled(parameter: Any) -> str:
    """Return how a user writes a parameter: --views, or BOARD."""
    longest = max(parameter.opts, key=len)
    return str(longest if longest.startswith("-") else parameter.metavar.strip("[]"))


def run(given: Mapping[str, Any]) -> None:
    """Render the pairs that the options of `camcal simulate` ask for, and show what came of it."""
    from math import radians

    from camcal.tasks.simulation.simulate_stereo import StereoOptions, document, pair_options, simulate_pairs

    settings = {
        "size": shared.parse_size(given["size"]) if given["size"] else None,
        "fov": None if given["fov"] is None else radians(given["fov"]),
        "disparities": _two_numbers("--disparities", given["disparities"]),
        "distance": _two_numbers("--distance", given["distance"]),
        "colour": not given["gray"],
        "gain": given["right_gain"],
        "offset": given["right_offset"],
        "gamma": given["right_gamma"],
        **{name: given[name] for name in _AS_THEY_ARE},
    }
    pair = pair_options(**{name: value for name, value in settings.items() if value is not None})
    options = StereoOptions(given["output"], given["pairs"], pair, given["seed"], given["jobs"])
    report = simulate_pairs(options, show.progress(given["quiet"]))
    if given["json"]:
        show.document("simulate", document(report, options))
    elif not given["quiet"]:
        _show(report, options, given["verbose"])


def _two_numbers(option: str, text: str | None) -> tuple[float, float] | None:
    """Return the numbers of a text such as 6:64; raises InvalidInput, naming the option, for anything else."""
    from camcal.errors import InvalidInput
    from camcal.parsing import parse_numbers

    if text is None:
        return None
    try:
        first, second = parse_numbers(text.split(":"))
    except ValueError:
        raise InvalidInput(f"{option} {text!r}: write two numbers as 6:64") from None
    return first, second


def _show(report: "StereoReport", options: "StereoOptions", verbose: bool) -> None:
    output, geometry, (width, height) = options.output, report.geometry, options.pair.size
    least, greatest = min(pair.least for pair in report.pairs), max(pair.greatest for pair in report.pairs)
    count = len(report.pairs)
    show.text(f"{count} pair{'s' * (count > 1)} of {width}x{height}, disparities {least:.1f} … {greatest:.1f} px")
    show.text(f"fx {geometry.fx:g} px, baseline {geometry.baseline:g} m, doffs {geometry.doffs:g} px")
    if verbose:
        rows = [[pair.left.name, pair.least, pair.greatest, 100 * pair.shared] for pair in report.pairs]
        show.table("pairs", ["image", "least px", "greatest px", "seen by both %"], rows)
    show.text(f"wrote {output}: left, right, disparity, disparity_right, visible, {report.rig.name}")
    first = report.pairs[0]
    show.text(f"next: {_next(first.left, first.right, report.rig)}")


def _next(left: Path, right: Path, rig: Path) -> str:
    return f"camcal stereo disparity {left} {right} {rig} -o disparity.pfm"
