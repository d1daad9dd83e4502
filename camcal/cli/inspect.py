"""`camcal inspect`, `diff`, `convert`, `report`, `rerun`, `plot`, `doctor`: what files hold, and what is installed."""

import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from camcal import records
from camcal.cli import show
from camcal.cli.call import Call, ImageCall
from camcal.files import STANDARD
from camcal.report.table import Column
from camcal.tasks.calibration.check_options import CheckOptions
from camcal.tasks.calibration.options import DiffOptions
from camcal.tasks.file_options import ConvertFileOptions, InspectOptions, PlotOptions, ReportOptions, RerunOptions
from camcal.tasks.options import CAMERA_SUFFIXES

if TYPE_CHECKING:
    from camcal.tasks.calibration.check import CheckReport
    from camcal.tasks.calibration.diff import DiffReport
    from camcal.tasks.calibration.inspect import Inspection
    from camcal.tasks.convert import ConvertReport
    from camcal.tasks.doctor import Examination
    from camcal.tasks.plot import PlotReport
    from camcal.tasks.raw.inspect_raw import RawInspection
    from camcal.tasks.reports.report import Reported
    from camcal.tasks.reports.rerun import Rerun
    from camcal.tasks.rigs.inspect_rig import RigInspection

IMAGE_COLUMNS = (
    Column("image", file=True),
    Column("points"),
    Column("RMS", "px"),
    Column("not used because", wraps=True),
)

OPTIONAL_COLUMNS = ("extra", "name", "installed", "needed", Column("for", wraps=True))


def inspect(options: InspectOptions, call: ImageCall) -> None:
    """Show a camera file (lens with standard deviations, field of view, quality; of a rig baseline and depth errors) or
    a raw frame (its exposure).

    Errors in a camera file are listed with their lines; implausible values give warnings. For a raw frame: pattern,
    levels, white balance, capture settings, and clipped samples per channel; for a file without a header, the layouts
    that match its length, until --format and --size are given. Gates of camera files end with exit 7.
    """
    path, _ = options.address
    is_camera = str(path) == STANDARD or path.suffix.lower() in CAMERA_SUFFIXES
    if is_camera and path.suffix.lower() == ".bin":  # of COLMAP, or a frame without a header
        from camcal.formats.cameras import is_camera_file

        is_camera = is_camera_file(path)
    if is_camera or not _is_raw(path):  # what reads raw frames need not be loaded for a camera file
        _inspect_camera(options, call)
    else:
        _inspect_raw(options, call)


def _is_raw(path: Path) -> bool:
    from camcal.tasks.raw.inspect_raw import is_raw

    return is_raw(path)


def _inspect_raw(options: InspectOptions, call: ImageCall) -> None:
    from camcal.errors import InvalidInput
    from camcal.tasks.raw import inspect_raw as task

    if options.output is not None:
        raise InvalidInput("-o draws a rig; this is a raw frame", where=options.file)
    if options.measured.distances:
        raise InvalidInput("--at is for camera files; this is a raw frame", where=options.file)
    if options.gates.given:
        raise InvalidInput("--require, --max-uncertainty and --min-coverage are for camera files", where=options.file)
    if options.get is not None or options.address[1] is not None:
        raise InvalidInput(
            "--get and --camera are for camera files; use --json for one value of a raw frame", where=options.file
        )
    if task.lacks_layout(options):
        guess = task.guess_layout(options)
        title, rows = task.guess_title(guess), task.guess_rows(guess)
        call.give(lambda: task.guess_document(guess), lambda: show.table(title, task.LAYOUT_COLUMNS, rows))
    else:
        inspection = task.inspect_raw(options)
        call.give(lambda: task.document(inspection), lambda: _show_frame(inspection))


def _show_frame(inspection: "RawInspection") -> None:
    from camcal.tasks.raw import inspect_raw as task

    for line in task.frame_lines(inspection):
        show.text(line)
    show.table("counts", task.CHANNEL_COLUMNS, task.channel_rows(inspection))
    show.figure(partial(task.histogram_lines, inspection))


def _inspect_camera(options: InspectOptions, call: ImageCall) -> None:
    from camcal.errors import GateFailed
    from camcal.progress import warn_of
    from camcal.tasks.calibration.inspect import document, value_at
    from camcal.tasks.calibration.inspect import inspect as run

    inspection = run(options)
    if options.get is not None:
        value = value_at(inspection, options.get)
        if call.json:
            show.result("inspect", {"file": options.address[0], "key": options.get, "value": value})
        else:
            show.value(value if isinstance(value, str) else json.dumps(value))  # a shell writes numbers as JSON does
    else:
        warn_of(inspection.file.warnings, call.progress)
        call.give(lambda: document(inspection), lambda: _show(inspection, options, call.verbose))
    cameras = {name: inspection.file.cameras[name] for name in inspection.fields}
    if failures := [each for name, entry in cameras.items() for each in options.gates.failures(name, entry)]:
        raise GateFailed.of(failures)


def _show(inspection: "Inspection", options: InspectOptions, verbose: bool) -> None:
    from camcal.report.table import region_words
    from camcal.tasks.calibration.inspect import camera_lines, file_lines, image_rows, parameter_rows

    for name, field in inspection.fields.items():
        entry = inspection.file.cameras[name]
        width, height = entry.camera.image_size
        title = f"{name}: {entry.camera.model.name}, {width}x{height}"
        show.table(title, ["parameter", "value", "± std"], parameter_rows(entry.camera))
        for line in camera_lines(entry, field):
            show.text(line)
        if entry.verdict is not None and (entry.verdict.trustworthy or entry.verdict.reasons):
            show.trust(entry.verdict.reasons, region_words(entry.verdict.region))
    if inspection.rig is not None:
        _show_rig(inspection.rig)
    for line in file_lines(inspection.file, verbose=verbose):
        show.text(line)
    if inspection.errors:
        from camcal.tasks.calibration import errors_at_range as task

        table = [row for each in inspection.errors for row in task.rows(each)]
        columns = task.COLUMNS if any(each.pairs for each in inspection.errors) else task.COLUMNS[:-1]
        table = [row[: len(columns)] for row in table]
        show.table("errors that the calibration leaves (1 sigma)", columns, table, verbose=verbose)
        for line in (line for each in inspection.errors for line in task.lines(each)):
            show.text(line)
    if verbose and (images := image_rows(inspection.file)):
        show.table("images", IMAGE_COLUMNS, images, verbose=True)
    if inspection.rig is not None and options.output is not None:
        from camcal.tasks.rigs.inspect_rig import colour_words

        show.text(f"colours of the cameras: {colour_words(inspection.rig)}; boards gray")
    show.wrote(options.output)


def _show_rig(rig: "RigInspection") -> None:
    from camcal.quality.rig_geometry import DISPARITY_PX
    from camcal.report.rig import DEPTH_COLUMNS, PAIR_COLUMNS, depth_rows, pair_rows
    from camcal.tasks.rigs.inspect_rig import path_words

    show.table("pairs of cameras (vergence: + converging)", PAIR_COLUMNS, pair_rows(rig.pairs))
    for pair in rig.pairs:
        title = f"depth error of {pair.first}, {pair.second} (1 sigma; matching: {DISPARITY_PX:g} px of disparity)"
        if rows := depth_rows(pair):
            show.table(title, DEPTH_COLUMNS, rows)
    for pair, path in zip(rig.pairs, rig.paths, strict=False):
        if path:
            show.text(f"most certain path: {path_words(path, pair.first)}")
    if isinstance(error := rig.measured.get("epipolar_rms_px"), float):
        show.text(f"Epipolar error of the calibration images {error:.3f} px RMS")


def check(options: CheckOptions, call: ImageCall) -> None:
    """Check by new images of a board, from one on, whether the calibration of a camera or a rig still holds.

    The answer is "still valid", "drifted" (exit 7: by how much, and the lens, the mount, the board or the images) or
    "not shown" (exit 4: the smallest drift that the images would have shown). The board is that of the calibration
    unless --board names another one.
    """
    from camcal.tasks.calibration.check import check as run
    from camcal.tasks.calibration.check import document

    report = run(options, call.progress)
    call.give(lambda: document(report), lambda: _show_check(report, call.verbose))
    report.require_valid()


def _show_check(report: "CheckReport", verbose: bool) -> None:
    from camcal.tasks.calibration.check import COLUMNS, rows

    if len(report.found) == 1:
        [found] = report.found.values()
        show.text(found.words)
    else:
        show.table("checks", COLUMNS, rows(report), verbose=verbose)
    show.wrote(*report.outputs)


def diff(options: DiffOptions, call: Call) -> None:
    """Compare cameras with the first one: by how much projections differ, and whether that is more than is uncertain.

    The rotation that best undoes the difference is taken out, with --at the rigid motion. Cameras may have other lens
    models, image sizes of the same shape and file formats. Exit 7 beyond --max or --max-sigma.
    """
    from camcal.errors import GateFailed
    from camcal.tasks.calibration.diff import diff as run
    from camcal.tasks.calibration.diff import document

    report = run(options)
    call.give(lambda: document(report), lambda: _show_diff(report, call.verbose))
    if report.failures:
        raise GateFailed.of(report.failures)


def _show_diff(report: "DiffReport", verbose: bool) -> None:
    from camcal.tasks.calibration.diff import COLUMNS, rows

    if len(report.comparisons) == 1:
        [(name, found)] = report.comparisons.items()
        show.text(f"{name}: {found.words}")
    columns = COLUMNS if len(report.comparisons) > 1 else COLUMNS[:-1]
    table = [row[: len(columns)] for row in rows(report)]
    show.table(f"difference from {report.first} where both are known", columns, table, verbose=verbose)
    show.wrote(*report.outputs)


def convert(options: ConvertFileOptions, call: Call) -> None:
    """Convert a camera file, camcal's own or that of another program, into those of others.

    The format of IN follows from its content, that of each OUT from its suffix or --to. Lenses are written exactly or
    refused, unless --max-error accepts the nearest one. What else is known and a format does not store is named.
    """
    from camcal.tasks.convert import convert as run
    from camcal.tasks.convert import document

    report = run(options, call.progress)
    call.give(lambda: document(report), lambda: _show_converted(report))


def _show_converted(report: "ConvertReport") -> None:
    from camcal.tasks.convert import words

    for converted in report.files:
        show.text(words(converted))
    show.wrote(*report.outputs)


def plot(options: PlotOptions, call: Call) -> None:
    """Draw figures of result files: camera and rig files, detections, poses, trajectories, disparity maps and others.

    What a file is follows from its content. Figures are PNG, SVG or PDF with units on their axes and colours for any
    colour vision; their captions are in figures.md.
    """
    from camcal.tasks.plot import document
    from camcal.tasks.plot import plot as run

    report = run(options, call.progress)
    call.give(lambda: document(report), lambda: _show_plots(report))


def _show_plots(report: "PlotReport") -> None:
    for each in report.drawn:
        show.text(f"{each.path}: {each.kind}: {', '.join(plot.name for plot in each.plots)}")
    show.wrote(show.several(report.figures, "figure"))


def report(options: ReportOptions, call: Call) -> None:
    """Write a report: one HTML file with the verdict, what to do, figures, tables and provenance.

    From a detections file the camera, or the cameras of a rig, are calibrated; the report then also has residuals,
    coverage, poses and images, and carries the detections, so that 'camcal rerun' can repeat it. Of a camera or rig
    file alone it shows what the file holds. It opens in any browser without a network, prints, and has a light and a
    dark theme. Detections that no calibration can be made from get a report that says why.
    """
    from camcal.tasks.reports.report import report as run

    found = run(options, call.progress)
    call.give(lambda: records.document(found), lambda: _show_report(found), found.failures)


def _show_report(found: "Reported") -> None:
    if found.trustworthy or found.failures:
        show.trust(found.failures)
    show.wrote(found.output)


def rerun(options: RerunOptions, call: Call) -> None:
    """Calibrate again from the detections and options that a report carries, and compare the results.

    Writes camera.yaml or rig.yaml and report.html: the same bytes on the same machine with the same libraries.
    Elsewhere what differs is listed: versions, processor, figures. Figures within 1e-6 standard deviations are equal;
    exit 7 if others differ.
    """
    from camcal.tasks.reports.rerun import document, require_agreement
    from camcal.tasks.reports.rerun import rerun as run

    found = run(options, call.progress)
    call.give(lambda: document(found), lambda: _show_rerun(found, call.verbose))
    require_agreement(found)


def _show_rerun(found: "Rerun", verbose: bool) -> None:
    show.text("Same report, byte for byte" if found.same else "The bytes of the report differ")
    if found.environment:
        show.text("Versions and machine:")
        show.lines([f"  {line}" for line in found.environment], verbose)
    if found.differences:
        show.text("Figures that differ:")
        show.lines([f"  {each.line}" for each in found.differences], verbose)
    elif not found.same:
        show.text("All figures agree within 1e-6 standard deviations")
    show.wrote(*found.outputs)


def doctor(call: Call) -> None:
    """Show versions of camcal and its packages, and check that they work together.

    The exit code is 7 if a check fails.
    """
    from camcal.errors import GateFailed
    from camcal.tasks.doctor import examine

    found = examine()
    call.give(lambda: records.document(found), lambda: _show_examination(found, call.verbose))
    if found.failures:
        raise GateFailed.of(found.failures)


def _show_examination(found: "Examination", verbose: bool) -> None:
    if not found.failures:
        show.verdict("all checks passed", good=True)
    show.text(f"camcal {found.camcal}, Python {found.python}, {found.cores} cores to use")
    show.text(found.system)
    rows = [[package.name, package.version or "-", package.wanted] for package in found.packages]
    show.table("Packages", ["name", "installed", "needed"], rows)
    optional = [[each.extra, each.name, each.version or "-", each.wanted, each.purpose] for each in found.optional]
    show.table("Optional packages: pip install 'camcal[EXTRA]'", OPTIONAL_COLUMNS, optional, verbose=verbose)
    if verbose:
        for line in (*found.opencv_wheels, *(f"{name}={value}" for name, value in found.environment.items())):
            show.text(line)
