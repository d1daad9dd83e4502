"""`camcal inspect` and `camcal convert`: what files hold, and camera files in other formats."""

import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.call import Call, ImageCall
from camcal.files import STANDARD
from camcal.report.table import Column
from camcal.tasks.options import CAMERA_SUFFIXES, ConvertFileOptions, InspectOptions

if TYPE_CHECKING:
    from camcal.tasks.calibration.inspect import Inspection
    from camcal.tasks.convert import ConvertReport
    from camcal.tasks.raw.inspect_raw import RawInspection
    from camcal.tasks.rigs.inspect_rig import RigInspection

IMAGE_COLUMNS = (
    Column("image", file=True),
    Column("points"),
    Column("RMS", "px"),
    Column("not used because", wraps=True),
)


def inspect(options: InspectOptions, call: ImageCall) -> None:
    """Show a camera file (lens with standard deviations, field of view, quality; of a rig baseline and depth errors) or
    a raw frame (its exposure).

    Errors in a camera file are listed with their lines; implausible values give warnings. For a raw frame: pattern,
    levels, white balance, capture settings, and clipped samples per channel; for a file without a header, the layouts
    that match its length, until --format and --size are given.
    """
    path, _ = options.address
    is_camera = str(path) == STANDARD or path.suffix.lower() in CAMERA_SUFFIXES
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
        return
    warn_of(inspection.file.warnings, call.progress)
    call.give(lambda: document(inspection), lambda: _show(inspection, options, call.verbose))


def _show(inspection: "Inspection", options: InspectOptions, verbose: bool) -> None:
    from camcal.report.uncertain import region_words
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
    if verbose and (images := image_rows(inspection.file)):
        show.table("images", IMAGE_COLUMNS, images, verbose=True)
    if inspection.rig is not None and options.output is not None:
        from camcal.tasks.rigs.inspect_rig import colour_words

        show.text(f"colours of the cameras: {colour_words(inspection.rig)}; boards gray")
    show.wrote(options.output)


def _show_rig(rig: "RigInspection") -> None:
    from camcal.quality.rig_geometry import DISPARITY_PX
    from camcal.report.rig import DEPTH_COLUMNS, PAIR_COLUMNS, depth_rows, pair_rows

    show.table("pairs of cameras (vergence: + converging)", PAIR_COLUMNS, pair_rows(rig.pairs))
    for pair in rig.pairs:
        title = f"depth error of {pair.first}, {pair.second} (1 sigma; matching: {DISPARITY_PX:g} px of disparity)"
        if rows := depth_rows(pair):
            show.table(title, DEPTH_COLUMNS, rows)
    if isinstance(error := rig.measured.get("epipolar_rms_px"), float):
        show.text(f"Epipolar error of the calibration images {error:.3f} px RMS")


def convert(options: ConvertFileOptions, call: Call) -> None:
    """Convert a camera file: camcal's own, OpenCV's FileStorage (YAML, XML, JSON), ROS camera_info, Kalibr's camchain.

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
