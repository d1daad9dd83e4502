"""`camcal sensor`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from camcal.cli import options as shared
from camcal.cli import show

if TYPE_CHECKING:
    from camcal.raw.options import GivenLayout
    from camcal.tasks.raw.sensor import SensorOptions, SensorReport


def sensor(
    flats: Annotated[
        list[str],
        typer.Argument(
            metavar="FLATS",
            help="Frames of an evenly lit, unsharp white surface, two or more at each level of light; header-less .raw "
            "and .bin too.",
        ),
    ],
    output: shared.Output,
    dark: Annotated[
        list[str],
        typer.Option(metavar="DARKS", help="Frames without light, with the lens covered; can be given several times."),
    ],
    pattern: shared.Pattern = None,
    format: shared.PixelFormat = None,  # noqa: A002 - it is the option's name
    size: shared.FrameSize = None,
    stride: shared.Stride = None,
    offset: shared.Offset = 0,
    endian: shared.Endian = "little",
    align: shared.Align = "lsb",
    frame: shared.Frame = None,
    exposure: Annotated[
        str | None,
        typer.Option(
            metavar="S,…",
            help="Exposure of the flats in seconds, one or one for each FLATS; by default what files say, or folders "
            "named like 10ms.",
        ),
    ] = None,
    dark_exposure: Annotated[
        str | None, typer.Option(metavar="S,…", help="Exposure of the dark frames, likewise.")
    ] = None,
    iso: Annotated[
        float | None, typer.Option(metavar="N", help="ISO speed to look at, where files are of several.")
    ] = None,
    white: Annotated[
        float | None, typer.Option(metavar="COUNTS", help="Saturation; by default the camera file's, or full scale.")
    ] = None,
    pitch_um: Annotated[float | None, typer.Option(metavar="UM", help="Distance of the pixels, micrometres.")] = None,
    sensor_format: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="Optical format of the sensor, such as 1/2.8, 2/3, APS-C: it gives the pixel pitch."
        ),
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw the photon transfer curve (.png, .svg, .pdf).")
    ] = None,
    jobs: shared.Jobs = None,
    max_pixels: shared.MaxPixels = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Measure a sensor by photon transfer (EMVA 1288): gain, read noise, full well, dynamic range, nonuniformity.

    Two flat and two dark frames are enough for a first answer; twelve levels from dark to saturated and sixteen dark
    frames for a good one. Frames are sorted by folder, exposure, and brightness.
    """
    from camcal.tasks.raw.sensor import SensorOptions, document
    from camcal.tasks.raw.sensor import sensor as run

    options = SensorOptions(
        tuple(flats),
        tuple(dark),
        output,
        pattern,
        _layout(format, size, stride, offset, endian, align, frame),
        _seconds(exposure, "--exposure"),
        _seconds(dark_exposure, "--dark-exposure"),
        iso,
        white,
        None if pitch_um is None else pitch_um / 1e6,
        sensor_format,
        plot,
        jobs,
    )
    report = run(options, show.progress(quiet))
    if json:
        show.document("sensor", document(report, options))
    elif not quiet:
        _show(report, options, verbose)


def _layout(name: str | None, *others: Any) -> "GivenLayout":
    """Return the layout of header-less files; an optical format in the place of a pixel format is named."""
    from camcal.errors import InvalidInput
    from camcal.optics.sensor_format import sensor_format

    try:
        return shared.given_layout(name, *others)
    except InvalidInput:
        try:
            sensor_format(name or "")
        except InvalidInput:
            pass
        else:
            raise InvalidInput(
                f"--format is the pixel format of header-less files; the optical one is --sensor-format {name}"
            ) from None
        raise


def _seconds(text: str | None, option: str) -> tuple[float, ...]:
    from camcal.errors import InvalidInput
    from camcal.parsing import parse_numbers

    try:
        return tuple(parse_numbers(text.split(","))) if text else ()
    except ValueError:
        raise InvalidInput(f"{option} {text!r}: write seconds as 0.01,0.02") from None


def _show(report: "SensorReport", options: "SensorOptions", verbose: bool) -> None:
    from camcal.tasks.raw.sensor import rows

    found = report.sensor
    width, height = found.size
    show.text(f"{len(report.flats)} levels of light, {len(report.darks)} of darkness, {width}x{height}")
    show.table("sensor", ["figure", "value", "std", "unit"], rows(found.figures))
    show.text(f"the counts end at the {found.saturation}" if found.saturation != "not reached" else "not saturated")
    if report.pitch is not None:
        show.text(f"pixel pitch {1e6 * report.pitch:.3g} um")
    if verbose:
        for name, part in found.phases.items():
            show.table(name, ["figure", "value", "std", "unit"], rows(part))
    show.text(f"wrote {options.output}" + (f" and {options.plot}" if options.plot else ""))
