"""`camcal optics`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from camcal.cli import options as shared
from camcal.cli import show

if TYPE_CHECKING:
    from camcal.tasks.lenses.board_plan import BoardOptions
    from camcal.tasks.lenses.optics import OpticsReport


def optics(
    camera_file: Annotated[
        str | None,
        typer.Argument(
            metavar="[CAMERA]", help="Camera file, or FILE#NAME: its rays give field of view and resolution."
        ),
    ] = None,
    focal: Annotated[float | None, typer.Option("--focal", "--f", metavar="MM", help="Focal length.")] = None,
    sensor: Annotated[
        str | None, typer.Option(metavar="NAME|WxH", help="Sensor format such as 1/1.8, or its sides in mm: 7.2x5.4.")
    ] = None,
    pitch_um: Annotated[
        float | None, typer.Option("--pitch-um", "--pitch", metavar="UM", help="Distance of the pixels, micrometres.")
    ] = None,
    size: Annotated[str | None, typer.Option(metavar="WxH", help="Size of the image in pixels.")] = None,
    f_number: Annotated[
        float | None, typer.Option("--f-number", "--N", metavar="N", help="F-number of the lens.")
    ] = None,
    focus: Annotated[
        float | None,
        typer.Option(metavar="METRES", help="Distance in focus, from the front principal plane; inf for infinity."),
    ] = None,
    coc: Annotated[
        str | None, typer.Option(metavar="LENGTH", help="Circle of confusion: 5um, 0.03mm or 1.5px; by default 1px.")
    ] = None,
    wavelength: Annotated[float, typer.Option(metavar="NM", help="Of the light, for diffraction.")] = 550.0,
    image_circle: Annotated[
        float | None, typer.Option(metavar="MM", help="Diameter that the lens lights; checked against the sensor.")
    ] = None,
    distance: Annotated[
        str | None, typer.Option(metavar="M,…", help="Distances to say figures for; by default the focus.")
    ] = None,
    speed: Annotated[float | None, typer.Option(metavar="M/S", help="Of the object across the view.")] = None,
    exposure: Annotated[float | None, typer.Option(metavar="MS", help="Exposure time.")] = None,
    baseline: shared.Baseline = None,
    disparity_noise: Annotated[
        float, typer.Option(metavar="PIXELS", help="Standard deviation of a stereo disparity.")
    ] = 0.25,
    solve: Annotated[
        str | None, typer.Option(metavar="f|wd|sensor", help="Find the lens, the working distance or the sensor.")
    ] = None,
    width: Annotated[
        float | None, typer.Option(metavar="METRES", help="What is to fill the width of the image, for --solve.")
    ] = None,
    board: shared.BoardOption = None,
    tilt: Annotated[float, typer.Option(metavar="DEG", help="Of the board, about the vertical.")] = 0.0,
    noise: Annotated[
        float, typer.Option(metavar="PIXELS", help="Standard deviation of a corner of a sharp board at rest.")
    ] = 0.1,
    share: Annotated[
        float, typer.Option(metavar="SHARE", help="Of the image's width or height that the board is to take.")
    ] = 0.6,
    least_square: Annotated[
        float | None,
        typer.Option(metavar="PIXELS", help="Smallest square that is found; by default 8, or 2 for a marker's cell."),
    ] = None,
    views: Annotated[
        int, typer.Option(metavar="N", min=1, help="Of the board, for the forecast of a calibration.")
    ] = 20,
    formats: Annotated[bool, typer.Option("--formats", help="List the sensor formats, and nothing else.")] = False,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw the blur over distance (.png, .svg, .pdf).")
    ] = None,
    camera: shared.CameraName = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Work out a lens and its sensor: field of view, focus, blur, what a pixel sees, and what a board will give.

    Give what is known: a camera file, or a focal length and a sensor; every figure that follows is shown, and what
    the others still need. --formats lists sensors.
    """
    from camcal.tasks.lenses import optics_document as words
    from camcal.tasks.lenses.optics import optics as run
    from camcal.tasks.lenses.optics_setup import OpticsOptions

    if formats:
        _show_formats(json)
        return
    options = OpticsOptions(
        camera_file,
        camera,
        _scaled(focal, 1e-3),
        sensor,
        _scaled(pitch_um, 1e-6),
        None if size is None else shared.parse_size(size),
        f_number,
        focus,
        coc,
        wavelength * 1e-9,
        _scaled(image_circle, 1e-3),
        speed,
        _scaled(exposure, 1e-3),
        baseline,
        disparity_noise,
        () if distance is None else shared.parse_numbers("--distance", distance),
        solve,
        width,
    )
    plan = _board_options(board, tilt, noise, share, least_square, views)
    report = run(options, plan, plot, show.progress(quiet))
    if json:
        show.document("optics", words.document(report))
    elif not quiet:
        _show(report)


def _scaled(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor


def _board_options(
    board: str | None, tilt: float, noise: float, share: float, least_square: float | None, views: int
) -> "BoardOptions | None":
    from math import radians

    from camcal.tasks.lenses.board_plan import BoardOptions

    return None if board is None else BoardOptions(board, radians(tilt), noise, share, least_square, views)


def _show_formats(json: bool) -> None:
    from camcal.tasks.lenses import optics_document as words

    if json:
        show.document("optics", words.formats_document())
        return
    columns = ["name", "width mm", "height mm", "diagonal mm", "the name says mm"]
    show.table("sensor formats", columns, words.format_rows())
    show.text(words.FORMAT_NOTE)


def _show(report: "OpticsReport") -> None:
    from camcal.tasks.lenses import optics_document as words

    show.table("lens and sensor", ["figure", "value", "unit", "from"], list(words.lens_rows(report)))
    for columns, rows in words.distance_tables(report):
        show.table("at a distance", columns, rows)
    if report.board is not None:
        for columns, rows in words.board_tables(report.board):
            show.table(words.board_title(report.board), columns, rows)
        for line in words.board_lines(report, report.board):
            show.text(line)
    for line in words.closing_lines(report):
        show.text(line)
