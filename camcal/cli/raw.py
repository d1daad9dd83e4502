"""`camcal demosaic`, `sensor` and `optics`: raw images, sensors, lenses."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from camcal import records
from camcal.cli import show
from camcal.cli.call import Call, ImageCall
from camcal.messages import counted
from camcal.report.table import Column
from camcal.tasks.lenses.options import OpticsOptions
from camcal.tasks.raw.options import DemosaicOptions, SensorOptions

if TYPE_CHECKING:
    from camcal.progress import Outcome
    from camcal.tasks.lenses.optics import OpticsReport
    from camcal.tasks.raw.demosaic import BadPixelMap, DevelopedFrame, PatternPreviews
    from camcal.tasks.raw.sensor import SensorReport

FIGURE_COLUMNS = ("figure", "value", "± std", "unit")
FRAME_COLUMNS = (
    Column("image", file=True),
    Column("size", priority=3),
    Column("pattern", priority=2),
    Column("black"),
    Column("white"),
    Column("gains R G B", priority=1),
    Column("clipped", "%"),
)
CLIPPED = 1e-3  # share of a colour's samples that is worth saying


def demosaic(options: DemosaicOptions, call: ImageCall) -> None:
    """Demosaic raw frames to colour images, to one channel for calibration, or to corrected mosaics.

    Steps: black level, bad pixels, flat field, white balance, exposure, demosaicing, colour, tone, depth; each is off
    unless asked for. For one frame the output may be a file (.tiff, .png, .ppm, .npy, .dng), else it is a folder. A
    YAML beside every image reproduces it with --config. For corner detection use --algorithm green, or gray if the lens
    has no lateral chromatic aberration; half triples the corner error.
    """
    if options.make_bad_pixel_map:
        from camcal.tasks.raw.demosaic import make_bad_pixel_map

        found = make_bad_pixel_map(options, call.progress)
        call.give(lambda: records.document(found), lambda: _show_map(found))
    elif options.preview_patterns:
        from camcal.tasks.raw.demosaic import preview_patterns

        previews = preview_patterns(options)
        call.give(lambda: {"previews": previews}, lambda: _show_previews(previews))
    else:
        _develop(options, call)


def _develop(options: DemosaicOptions, call: ImageCall) -> None:
    from camcal.errors import ItemsFailed
    from camcal.tasks.raw.demosaic import demosaic as run
    from camcal.tasks.raw.demosaic import document

    outcomes = run(options, call.progress)
    call.give(lambda: document(outcomes), lambda: _show_images(outcomes, call.verbose))
    show.failed(outcomes)
    failed = [outcome for outcome in outcomes if outcome.error]
    if failed:
        raise ItemsFailed.of(len(failed), len(outcomes), "frames")


def _show_map(found: "BadPixelMap") -> None:
    show.text(f"{found.bad} of {found.pixels} bad pixels in {found.frames} dark frames")
    show.wrote(found.output)


def _show_previews(previews: "Sequence[PatternPreviews]") -> None:
    for preview in previews:
        likely = f", by its greens {' or '.join(preview.likely)}" if len(preview.likely) == 2 else ""
        show.text(f"{preview.source}{likely}: {' '.join(path.name for path in preview.thumbnails.values())}")
    show.wrote(show.several([path for preview in previews for path in preview.thumbnails.values()], "picture"))


def _show_images(outcomes: "Sequence[Outcome[Path, DevelopedFrame]]", verbose: bool) -> None:
    from camcal.raw.mosaic import pattern_words

    written = [outcome.value for outcome in outcomes if outcome.value is not None]
    rows = []
    for frame in written:
        black = " ".join(f"{level:g}" for level in sorted(set(frame.black)))
        gains = None if frame.gains is None else " ".join(f"{gain:.4g}" for gain in frame.gains)
        clipped = f"{100 * max(frame.clipped):.1f}" if max(frame.clipped) >= CLIPPED else None
        size, pattern = "{}x{}".format(*frame.size), pattern_words(frame.pattern)
        rows.append([str(frame.output), size, pattern, black, f"{frame.white:g}", gains, clipped])
    if rows:
        show.table(counted(len(rows), "image"), FRAME_COLUMNS, rows, verbose=verbose, most=show.LISTED)
    show.reused(outcomes, "image")
    show.wrote(show.several([frame.output for frame in show.made(outcomes)], "image"))


def sensor(options: SensorOptions, call: ImageCall) -> None:
    """Measure a sensor by photon transfer (EMVA 1288): gain, read noise, full well, dynamic range, nonuniformity.

    Two flat and two dark frames are the minimum; use twelve levels from dark to saturated and sixteen dark frames for
    accurate results. Frames are grouped by folder, exposure and brightness.
    """
    from camcal.tasks.raw.sensor import document
    from camcal.tasks.raw.sensor import sensor as run

    report = run(options, call.progress)
    call.give(lambda: document(report, options), lambda: _show_sensor(report, options, call.verbose))


def _show_sensor(report: "SensorReport", options: SensorOptions, verbose: bool) -> None:
    from camcal.tasks.raw.sensor import rows

    found = report.sensor
    width, height = found.size
    show.text(f"{len(report.flats)} illumination levels, {len(report.darks)} dark levels, {width}x{height}")
    show.table("sensor", FIGURE_COLUMNS, rows(found.figures))
    show.text(f"saturation at the {found.saturation}" if found.saturation != "not reached" else "not saturated")
    if report.pitch is not None:
        show.text(f"pixel pitch {1e6 * report.pitch:.3g} um")
    if verbose:
        for name, part in found.phases.items():
            show.table(name, FIGURE_COLUMNS, rows(part))
    show.wrote(options.output, options.plot, show.several(report.figures, "figure"))


def optics(options: OpticsOptions, call: Call) -> None:
    """Compute field of view, depth of field, blur, pixel footprint, and the expected accuracy with a board.

    Give what is known: a camera file, or a focal length and a sensor. All figures that follow are shown, and which
    input the others need. --formats lists sensors.
    """
    from camcal.tasks.lenses import optics as words
    from camcal.tasks.lenses.optics import optics as run

    if options.formats:
        call.give(words.formats_document, _show_formats)
        return
    report = run(options, call.progress)
    call.give(lambda: words.document(report), lambda: _show(report))


def _show_formats() -> None:
    from camcal.tasks.lenses import optics as words

    sides = [Column(name, "mm") for name in ("width", "height", "diagonal")]
    columns = [Column("name"), *sides, Column("the name says", "mm")]
    show.table("sensor formats", columns, words.format_rows())
    show.text(words.FORMAT_NOTE)


def _show(report: "OpticsReport") -> None:
    from camcal.tasks.lenses import optics as words

    show.table(
        "lens and sensor", ["figure", "value", "unit", Column("from", wraps=True)], list(words.lens_rows(report))
    )
    if report.at:
        show.table("at a distance", *words.distance_table(report))
    if report.board is not None:
        show.table(words.board_title(report.board), *words.board_table(report.board))
        for line in words.board_lines(report, report.board):
            show.text(line)
    for line in words.closing_lines(report):
        show.text(line)
    show.wrote(report.plot)
