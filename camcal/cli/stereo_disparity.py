"""`camcal stereo disparity`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from camcal.cli import options as shared
from camcal.cli import show

if TYPE_CHECKING:
    from camcal.tasks.stereo.matched_pair import MatchedPair

COMMAND = "stereo disparity"
LISTED = 10


def disparity(
    left: Annotated[str, typer.Argument(metavar="LEFT", help="Rectified left image; or a folder, or a quoted glob.")],
    right: Annotated[str, typer.Argument(metavar="RIGHT", help="Rectified right image, folder or glob.")],
    output: shared.Output,
    camera_file: shared.PairCamera = None,
    camera: shared.CameraName = None,
    fx: shared.Fx = None,
    fy: shared.Fy = None,
    cx: shared.Cx = None,
    cy: shared.Cy = None,
    baseline: shared.Baseline = None,
    doffs: shared.Doffs = None,
    quality: Annotated[
        str,
        typer.Option(metavar="NAME", help="best (two matchers), balanced (one, nearly as good), or fast (one pass)."),
    ] = "best",
    search: Annotated[
        str,
        typer.Option("--range", metavar="MIN:MAX", help="Disparities to look through, pixels; auto: what images show."),
    ] = "auto",
    fill: Annotated[
        str,
        typer.Option(
            metavar="NAME", help="none, background (gaps of a row from what lies farther), or all (whole rows too)."
        ),
    ] = "none",
    align_rows: Annotated[
        str,
        typer.Option(metavar="auto|on|off", help="Put rows right that are measurably off; auto: unless fast."),
    ] = "auto",
    exposure: Annotated[
        str, typer.Option(metavar="auto|off", help="Bring the right image to the left one's exposure.")
    ] = "auto",
    engine: Annotated[str, typer.Option(metavar="own|onnx", help="onnx: by the network given with --model.")] = "own",
    model: Annotated[Path | None, typer.Option(metavar="FILE", help="Stereo network of your own, ONNX.")] = None,
    type: Annotated[  # noqa: A002 - it is the option's name
        str, typer.Option(metavar="TYPE", help="Type of the maps in a folder: tiff, pfm, png, npy, npz, exr.")
    ] = "tiff",
    vis: Annotated[bool, typer.Option("--vis", help="Draw each map, with a legend, as MAP.vis.png.")] = False,
    map_only: Annotated[
        bool, typer.Option("--map-only", help="Write no .sigma.tiff and no .confidence.png beside the map.")
    ] = False,
    force: Annotated[
        bool,
        typer.Option("--force", help="Exit with 0 although a pair is swapped, not rectified, or hardly matched."),
    ] = False,
    recursive: shared.Recursive = False,
    jobs: shared.Jobs = None,
    max_pixels: shared.MaxPixels = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Match rectified pairs: the disparity of every pixel, its uncertainty and its class.

    Column in the left image minus column in the right one, in pixels. Beside a map stand its standard deviation, the
    class of every pixel (1 filled, 2 single, 3 apart, 4 near, 5 agreed) and a JSON file with scale, code of no match
    and geometry, so that 'camcal stereo cloud' and 'camcal view' need no options. Exit 7 if left and right are swapped,
    rows differ by more than 5 px, or fewer than 15 % of the pixels are matched; the map is written all the same.
    """
    from camcal.progress import require_all
    from camcal.stereo.matching.match import MatchOptions
    from camcal.tasks.stereo.matched_pair import document
    from camcal.tasks.stereo.rectified_pair import GeometryOptions
    from camcal.tasks.stereo.stereo_disparity import DisparityOptions, network_of, require_good, stereo_disparity

    options = DisparityOptions(
        (left,),
        (right,),
        output,
        camera_file,
        GeometryOptions(camera, fx, fy, cx, cy, baseline, doffs),
        MatchOptions(
            quality,
            _range(search),
            fill,
            {"auto": None, "on": True, "off": False}[shared.one_of("--align-rows", align_rows, ("auto", "on", "off"))],
            shared.one_of("--exposure", exposure, ("auto", "off")) == "auto",
        ),
        network_of(engine, model),
        type,
        vis,
        map_only,
        recursive,
        jobs,
    )
    outcomes = stereo_disparity(options, show.progress(quiet))
    if json:
        show.document(COMMAND, document(outcomes))
    elif not quiet:
        matched = [outcome.value for outcome in outcomes if outcome.value is not None]
        for pair in matched if verbose else matched[:LISTED]:
            _show(pair, verbose)
        if len(matched) > LISTED and not verbose:
            show.text(f"… and {len(matched) - LISTED} more (--verbose lists all)")
    if force:
        for pair in (outcome.value for outcome in outcomes if outcome.value is not None):
            for failure in pair.failures:
                show.warning(f"{pair.left}: {failure}")
    else:
        require_good(outcomes)
    require_all(outcomes, "pairs")


def _range(text: str) -> tuple[int, int] | None:
    """Return the range of a text such as 0:128 or -16:48, None for auto."""
    from camcal.errors import InvalidInput
    from camcal.parsing import parse_integer

    if text == "auto":
        return None
    try:
        first, last = (parse_integer(part) for part in text.split(":"))
    except ValueError:
        raise InvalidInput(f"--range {text!r}: write auto, or whole numbers as 0:128") from None
    return first, last


def _show(pair: "MatchedPair", verbose: bool) -> None:
    figures = pair.figures
    first, last = figures.searched
    filled = f", {figures.filled:.1%} filled" if figures.filled else ""
    median = "" if figures.median is None else f", median {figures.median:.2f} px"
    sigma = "" if figures.sigma is None else f", sigma {figures.sigma:.2f} px"
    rows = f", rows aligned by {pair.rows:.2f} px" if pair.rows else ""
    show.text(f"{pair.output}: {figures.matched:.1%} matched{filled}, range {first}:{last}{median}{sigma}{rows}")
    if verbose:
        show.text("  " + ", ".join(f"{name} {share:.1%}" for name, share in figures.classes.items()))
