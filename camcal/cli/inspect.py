"""`camcal inspect`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from camcal.cli import options as shared
from camcal.cli import show

if TYPE_CHECKING:
    from camcal.tasks.calibration.inspect import Inspection
    from camcal.tasks.raw.inspect_raw import InspectRawOptions

CAMERA_SUFFIXES = (".yaml", ".yml")  # for these, what reads images need not be loaded


def inspect(
    file: Annotated[
        str,
        typer.Argument(
            metavar="FILE",
            help="A camera file, or FILE#NAME for one of several cameras; or a raw frame: of a camera (.dng, .cr2, …), "
            "a bare mosaic (PNG, TIFF, PGM, NPY), a dump of a sensor (.raw, .bin).",
        ),
    ],
    get: Annotated[
        str | None,
        typer.Option(metavar="KEY", help="Print one value only, such as cameras.left.intrinsics.fx; lists as JSON."),
    ] = None,
    camera: shared.CameraName = None,
    pattern: shared.Pattern = None,
    format: shared.PixelFormat = None,  # noqa: A002 - it is the option's name
    size: shared.FrameSize = None,
    stride: shared.Stride = None,
    offset: shared.Offset = 0,
    endian: shared.Endian = "little",
    align: shared.Align = "lsb",
    frame: shared.Frame = None,
    max_pixels: shared.MaxPixels = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Show a camera file (lens with standard deviations, field of view, how good it is) or a raw frame (its exposure).

    Whatever in a camera file breaks a rule is listed with its line; what only looks wrong is warned of. Of a raw
    frame: pattern, levels, white balance, capture, and how many samples of each channel are clipped; of a file without
    a header, until --format and --size are given, what it may be by its length.
    """
    from camcal.run.inputs import split_address

    path, name = split_address(file)
    if path.suffix.lower() in CAMERA_SUFFIXES or not _is_raw(path):
        _inspect_camera(path, camera or name, get, json, quiet, verbose)
        return
    from camcal.tasks.raw.inspect_raw import InspectRawOptions

    _refuse_camera_options(file, get, camera or name)
    layout = shared.given_layout(format, size, stride, offset, endian, align, frame)
    _inspect_raw(InspectRawOptions(path, pattern, layout), json, quiet)


def _is_raw(path: Path) -> bool:
    from camcal.tasks.raw.inspect_raw import is_raw

    return is_raw(path)


def _refuse_camera_options(file: str, get: str | None, camera: str | None) -> None:
    from camcal.errors import InvalidInput

    if get is not None or camera is not None:
        raise InvalidInput(
            "--get and --camera are for camera files; use --json for one value of a raw frame", where=file
        )


def _inspect_raw(options: "InspectRawOptions", json: bool, quiet: bool) -> None:
    from camcal.tasks.raw import inspect_raw as task

    if options.says_too_little:
        _guess_layout(options, json, quiet)
        return
    inspection = task.inspect_raw(options)
    if json:
        show.document("inspect", task.document(inspection))
    elif not quiet:
        for line in task.frame_lines(inspection):
            show.text(line)
        show.table("counts", task.CHANNEL_COLUMNS, task.channel_rows(inspection))
        for line in task.histogram_lines(inspection):
            show.text(line)


def _guess_layout(options: "InspectRawOptions", json: bool, quiet: bool) -> None:
    from camcal.tasks.raw import inspect_raw as task

    guess = task.guess_layout(options)
    if json:
        show.document("inspect", task.guess_document(guess))
    elif not quiet:
        show.table(task.guess_title(guess), task.LAYOUT_COLUMNS, task.guess_rows(guess))


def _inspect_camera(path: Path, camera: str | None, get: str | None, json: bool, quiet: bool, verbose: bool) -> None:
    from camcal.tasks.calibration.inspect import InspectOptions, document, value_at
    from camcal.tasks.calibration.inspect import inspect as run

    inspection = run(InspectOptions(path, camera))
    if get is not None:
        value = value_at(inspection, get)
        if json:
            show.document("inspect", {"file": path, "key": get, "value": value})
        else:
            show.text(_one_value(value))
    elif json:
        show.document("inspect", document(inspection))
    else:
        for warning in inspection.file.warnings:
            show.warning(warning)
        if not quiet:
            _show(inspection, verbose)


def _one_value(value: Any) -> str:
    """Return a value for a shell: a text as it is, everything else as JSON, which is how a shell writes numbers."""
    from json import dumps

    return value if isinstance(value, str) else dumps(value)


def _show(inspection: "Inspection", verbose: bool) -> None:
    from camcal.tasks.calibration.inspect import camera_lines, file_lines, image_rows, parameter_rows

    for name, field in inspection.fields.items():
        entry = inspection.file.cameras[name]
        width, height = entry.camera.image_size
        title = f"{name}: {entry.camera.model.name}, {width}x{height}"
        show.table(title, ["parameter", "value", "± std"], parameter_rows(entry.camera))
        for line in camera_lines(entry, field):
            show.text(line)
    for line in file_lines(inspection.file):
        show.text(line)
    if verbose and (images := image_rows(inspection.file)):
        show.table("images", ["file", "points", "rms px", "not used because"], images)
