"""`camcal undistort`, `demosaic`, `sensor` and `optics`: images, raw images, sensors, lenses."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from camcal import records
from camcal.cli import show
from camcal.cli.call import Call, ImageCall
from camcal.messages import counted
from camcal.report.table import Column
from camcal.tasks.calibration.drawing_options import UndistortOptions
from camcal.tasks.lenses.options import OpticsOptions
from camcal.tasks.raw.options import DemosaicOptions, SensorOptions

if TYPE_CHECKING:
    from camcal.progress import Outcome
    from camcal.tasks.calibration.undistort import MapsReport, PointsReport, UndistortReport
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


def undistort(options: UndistortOptions, call: ImageCall) -> None:
    """Undistort images, videos or points, or write the map by which others do, and the camera file of the result.

    Images keep their type, depth and EXIF orientation; frames of a video become images. camera.yaml in the output
    folder describes the undistorted images.
    """
    if options.points is not None:
        from camcal.tasks.calibration.undistort import points_document
        from camcal.tasks.calibration.undistort import undistort_points as run

        report = run(options, call.progress)
        call.give(lambda: points_document(report), lambda: _show_points(report))
    elif options.maps:
        _undistort_maps(options, call)
    else:
        _undistort_images(options, call)


def _undistort_images(options: UndistortOptions, call: ImageCall) -> None:
    from camcal.errors import ItemsFailed
    from camcal.tasks.calibration.undistort import document
    from camcal.tasks.calibration.undistort import undistort as run

    report = run(options, call.progress)
    call.give(lambda: document(report), lambda: _show_undistorted(report, call.verbose))
    show.failed(report.failed)
    if report.failed:
        raise ItemsFailed.of(len(report.failed), len(report.outcomes), "images")


def _undistort_maps(options: UndistortOptions, call: ImageCall) -> None:
    from camcal.tasks.calibration.undistort import maps_document
    from camcal.tasks.calibration.undistort import undistort_maps as run

    report = run(options, call.progress)
    call.give(lambda: maps_document(report), lambda: _show_maps(report))


def _show_maps(report: "MapsReport") -> None:
    show.text(f"{report.usage}; {100 * report.valid:.4g} % of the pixels have a source")
    show.wrote(report.output, report.camera_file)


def _show_points(report: "PointsReport") -> None:
    lost = f", {report.lost} outside the lens model (empty cells)" if report.lost else ""
    show.text(f"{counted(report.count, 'point')}{lost}")
    show.wrote(report.output, report.camera_file)


def _show_undistorted(report: "UndistortReport", verbose: bool) -> None:
    written = [outcome.value.output for outcome in report.outcomes if outcome.value is not None]
    if verbose:
        show.table("undistorted", [Column("image", file=True)], [[str(path)] for path in written], verbose=True)
    if report.aligned:
        show.text(f"{' and '.join(report.aligned)} of colour images undistorted with their own lens models")
    width, height = report.view.image_size
    focal = " ".join(f"{name}={report.view.value(name):.6g}" for name in ("fx", "fy", "cx", "cy"))
    empty = f"; {100 * (1 - report.valid):.1f} % of its pixels without source" if report.valid < 1 else ""
    show.text(f"{report.view.model.name}, {width}x{height}, {focal}{empty}")
    show.reused(report.outcomes, "image")
    if drawn := [each.output for each in show.made(report.outcomes)]:
        show.wrote(report.camera_file, report.mask_file, show.several(drawn, "image"))
