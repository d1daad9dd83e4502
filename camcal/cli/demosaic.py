"""`camcal demosaic`."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from camcal.cli import options as shared
from camcal.cli import show

if TYPE_CHECKING:
    from camcal.progress import Outcome
    from camcal.tasks.raw.demosaic import DemosaicOptions, DevelopedFrame

LISTED = 10
CLIPPED = 1e-3  # share of a colour's samples that is worth saying


def demosaic(
    inputs: Annotated[
        list[str],
        typer.Argument(
            metavar="IN",
            help="Camera raw files, bare mosaics (PNG, TIFF, PGM, NPY), header-less .raw or .bin; folders, globs.",
        ),
    ],
    output: shared.Output,
    pattern: shared.Pattern = None,
    algorithm: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="auto (ri), ri, malvar, bilinear, ea, vng, half, green, gray, none, or libraw:AHD and its like.",
        ),
    ] = "auto",
    format: shared.PixelFormat = None,  # noqa: A002 - it is the option's name
    size: shared.FrameSize = None,
    stride: shared.Stride = None,
    offset: shared.Offset = 0,
    endian: shared.Endian = "little",
    align: shared.Align = "lsb",
    frame: shared.Frame = None,
    black: Annotated[
        str | None,
        typer.Option(metavar="COUNTS", help="Black level, or four: R,Gr,Gb,B; by default the camera file's, or 0."),
    ] = None,
    white: Annotated[
        float | None, typer.Option(metavar="COUNTS", help="Saturation; by default the camera file's, or full scale.")
    ] = None,
    dark: Annotated[
        list[str] | None, typer.Option(metavar="FRAMES", help="Dark frames; their mean takes the place of black.")
    ] = None,
    bad_pixels: Annotated[
        Path | None,
        typer.Option(metavar="MAP", help="Pixels to replace: text (x y per line), a PNG mask, or NPY."),
    ] = None,
    flat: Annotated[
        list[str] | None, typer.Option(metavar="FRAMES", help="Frames of even light, to undo fall-off and dust.")
    ] = None,
    wb: Annotated[
        str,
        typer.Option(metavar="BALANCE", help="White balance: none, camera, gray-world, patch:X,Y,W,H, or gains R,G,B."),
    ] = "none",
    wb_normalize: Annotated[
        str, typer.Option(metavar="min|green", help="Which of the gains that are found is 1: the smallest, or green's.")
    ] = "min",
    ev: Annotated[float, typer.Option(metavar="STOPS", help="Exposure: linear light is multiplied by 2^STOPS.")] = 0.0,
    colour: Annotated[
        str,
        typer.Option(metavar="MATRIX", help="none, srgb (by what the camera file says), or a file of nine numbers."),
    ] = "none",
    tone: Annotated[
        str, typer.Option(metavar="CURVE", help="linear, power:2.2 (v becomes v^(1/2.2)), srgb or bt709.")
    ] = "linear",
    depth: Annotated[
        str | None, typer.Option(metavar="8|16|float", help="Depth of the images; by default that of the input.")
    ] = None,
    encoding: Annotated[
        str | None,
        typer.Option(metavar="linear|gamma", help="What the counts are; 8 bits nothing is done to pass for gamma."),
    ] = None,
    type: Annotated[  # noqa: A002 - it is the option's name
        str, typer.Option(metavar="tiff|png|ppm|npy|dng", help="Type of the files in a folder.")
    ] = "tiff",
    make_bad_pixel_map: Annotated[
        bool, typer.Option("--make-bad-pixel-map", help="IN are dark frames: write the map of their bad pixels.")
    ] = False,
    preview_patterns: Annotated[
        bool, typer.Option("--preview-patterns", help="Write a thumbnail for each of the four patterns, nothing else.")
    ] = False,
    trust_pattern: Annotated[
        bool, typer.Option("--trust-pattern", help="Do not ask the frames whether green is where the pattern says.")
    ] = False,
    recursive: shared.Recursive = False,
    jobs: shared.Jobs = None,
    max_pixels: shared.MaxPixels = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Make colour images from raw frames, or the one channel that calibration wants, or repaired mosaics.

    Black level, bad pixels, flat field, white balance, exposure, demosaicing, colour, tone, depth: in that order, and
    each neutral unless asked for. With one frame the output may be a file (.tiff, .png, .ppm, .npy, .dng), else it is
    a folder. A YAML beside every image repeats it with --config. To find corners, take --algorithm green, or gray if
    the lens has no lateral colour; half makes them three times as uncertain.
    """
    from camcal.errors import InvalidInput
    from camcal.raw.balance import Balance
    from camcal.raw.develop import Development
    from camcal.tasks.raw.demosaic import DemosaicOptions
    from camcal.tasks.raw.raw_corrections import CorrectionFiles, RawInput

    if make_bad_pixel_map and preview_patterns:
        raise InvalidInput("--make-bad-pixel-map and --preview-patterns exclude each other")
    layout = shared.given_layout(format, size, stride, offset, endian, align, frame)
    reading = RawInput(pattern, layout, None if black is None else shared.parse_numbers("--black", black), white)
    options = DemosaicOptions(
        tuple(inputs),
        output,
        reading,
        Development(algorithm, Balance(wb, wb_normalize), ev, colour, tone, depth, encoding),
        CorrectionFiles(tuple(dark or ()), tuple(flat or ()), bad_pixels),
        type,
        trust_pattern,
        recursive,
        jobs,
    )
    if make_bad_pixel_map:
        _make_map(options, json, quiet)
    elif preview_patterns:
        _preview(options, json, quiet)
    else:
        _develop(options, json, quiet, verbose)


def _develop(options: "DemosaicOptions", json: bool, quiet: bool, verbose: bool) -> None:
    from camcal.errors import ItemsFailed
    from camcal.tasks.raw.demosaic import demosaic as run
    from camcal.tasks.raw.demosaic import document

    outcomes = run(options, show.progress(quiet))
    if json:
        show.document("demosaic", document(outcomes))
    elif not quiet:
        _show(outcomes, verbose)
    failed = [outcome for outcome in outcomes if outcome.error]
    if failed:
        raise ItemsFailed(f"{len(failed)} of {len(outcomes)} frames failed, the rest is written")


def _make_map(options: "DemosaicOptions", json: bool, quiet: bool) -> None:
    from camcal.tasks.raw.bad_pixel_map import BadPixelMapOptions, document, make_bad_pixel_map

    found = make_bad_pixel_map(
        BadPixelMapOptions(options.inputs, options.output, options.reading, options.recursive), show.progress(quiet)
    )
    if json:
        show.document("demosaic", document(found))
    elif not quiet:
        show.text(f"{found.bad} of {found.pixels} pixels stand out in {found.frames} dark frames")
        show.text(f"wrote {found.output}")


def _preview(options: "DemosaicOptions", json: bool, quiet: bool) -> None:
    from camcal.tasks.raw.pattern_previews import document, preview_patterns

    previews = preview_patterns(options)
    if json:
        show.document("demosaic", document(previews))
    elif not quiet:
        for preview in previews:
            likely = f", by its greens {' or '.join(preview.likely)}" if len(preview.likely) == 2 else ""
            show.text(f"{preview.source}{likely}: {' '.join(str(path) for path in preview.thumbnails.values())}")


def _show(outcomes: "Sequence[Outcome[Path, DevelopedFrame]]", verbose: bool) -> None:
    from camcal.raw.mosaic import pattern_words

    written = [outcome.value for outcome in outcomes if outcome.value is not None]
    shown = written if verbose else written[:LISTED]
    for frame in shown:
        gains = "" if frame.gains is None else ", gains {:.4g} {:.4g} {:.4g}".format(*frame.gains)
        levels = f"black {' '.join(f'{level:g}' for level in sorted(set(frame.black)))}, white {frame.white:g}"
        clipped = f", {max(frame.clipped):.1%} clipped" if max(frame.clipped) >= CLIPPED else ""
        pattern = pattern_words(frame.pattern)
        show.text(f"{frame.output}: {frame.size[0]}x{frame.size[1]}, {pattern}, {levels}{gains}{clipped}")
    if len(shown) < len(written):
        show.text(f"… and {len(written) - len(shown)} more (--verbose lists all)")
    for outcome in outcomes:
        if outcome.error is not None:
            show.text(f"failed: {outcome.error}")
