"""`camcal inspect`."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from camcal.cli import options as shared
from camcal.cli import show

if TYPE_CHECKING:
    from camcal.tasks.inspect import Inspection


def inspect(
    camera_file: Annotated[
        str, typer.Argument(metavar="CAMERA", help="A camera file, or FILE#NAME for one of several cameras.")
    ],
    get: Annotated[
        str | None,
        typer.Option(metavar="KEY", help="Print one value only, such as cameras.left.intrinsics.fx; lists as JSON."),
    ] = None,
    camera: shared.CameraName = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Show a camera file: size, field of view, lens with standard deviations, where it is valid, how good it is.

    Whatever breaks a rule is listed with its line; what only looks wrong is warned of.
    """
    from camcal.run.inputs import split_address
    from camcal.tasks.inspect import InspectOptions, document, value_at
    from camcal.tasks.inspect import inspect as run

    path, name = split_address(camera_file)
    inspection = run(InspectOptions(path, camera or name))
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
    from camcal.tasks.inspect import camera_lines, file_lines, image_rows, parameter_rows

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
