"""`camcal demosaic`."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from camcal.cli import options as shared
from camcal.cli import show

if TYPE_CHECKING:
    from camcal.progress import Outcome
    from camcal.tasks.demosaic import DevelopedFrame

LISTED = 10


def demosaic(
    inputs: Annotated[
        list[str],
        typer.Argument(
            metavar="IN", help="Camera raw files, or bare mosaics (PNG, TIFF, PGM, NPY); folders and globs too."
        ),
    ],
    output: shared.Output,
    pattern: Annotated[
        str | None,
        typer.Option(
            metavar="LETTERS", help="Colours of the first 2x2 pixels of bare mosaics: RGGB, GRBG, GBRG, BGGR."
        ),
    ] = None,
    algorithm: Annotated[
        str, typer.Option(metavar="NAME", help="bilinear: mean of the nearest samples; none: the mosaic itself.")
    ] = "bilinear",
    black: Annotated[
        float | None, typer.Option(metavar="COUNTS", help="Black level; by default the camera file's, or 0.")
    ] = None,
    white: Annotated[
        float | None, typer.Option(metavar="COUNTS", help="Saturation; by default the camera file's, or full scale.")
    ] = None,
    wb: Annotated[
        str, typer.Option(metavar="BALANCE", help="White balance, applied first: none, camera, gray-world, or R,G,B.")
    ] = "none",
    tone: Annotated[
        str, typer.Option(metavar="CURVE", help="linear, power:2.2 (v becomes v^(1/2.2)), srgb or bt709.")
    ] = "linear",
    depth: Annotated[
        str | None, typer.Option(metavar="8|16|float", help="Depth of the images; by default that of the input.")
    ] = None,
    recursive: shared.Recursive = False,
    jobs: shared.Jobs = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Make colour images from raw frames: levels, white balance, demosaicing, tone, depth, in that order.

    Everything is neutral unless asked for: linear light, no white balance, no look of a camera maker. With one frame
    the output may be a file (.tiff, .png, .ppm, .npy), else it is a folder of TIFFs.
    """
    from camcal.errors import ItemsFailed
    from camcal.raw.develop import Development
    from camcal.tasks.demosaic import DemosaicOptions, document
    from camcal.tasks.demosaic import demosaic as run

    outcomes = run(
        DemosaicOptions(
            tuple(inputs), output, pattern, Development(algorithm, wb, tone, depth), black, white, recursive, jobs
        ),
        show.progress(quiet),
    )
    if json:
        show.document("demosaic", document(outcomes))
    elif not quiet:
        _show(outcomes, verbose)
    failed = [outcome for outcome in outcomes if outcome.error]
    if failed:
        raise ItemsFailed(f"{len(failed)} of {len(outcomes)} frames failed, the rest is written")


def _show(outcomes: "Sequence[Outcome[Path, DevelopedFrame]]", verbose: bool) -> None:
    written = [outcome.value for outcome in outcomes if outcome.value is not None]
    shown = written if verbose else written[:LISTED]
    for frame in shown:
        gains = "" if frame.gains is None else ", gains {:.4g} {:.4g} {:.4g}".format(*frame.gains)
        levels = f"black {' '.join(f'{level:g}' for level in sorted(set(frame.black)))}, white {frame.white:g}"
        show.text(f"{frame.output}: {frame.size[0]}x{frame.size[1]}, {frame.pattern}, {levels}{gains}")
    if len(shown) < len(written):
        show.text(f"… and {len(written) - len(shown)} more (--verbose lists all)")
    for outcome in outcomes:
        if outcome.error is not None:
            show.text(f"failed: {outcome.error}")
