"""`camcal undistort --points`: a table of pixels of the distorted image to pixels of the view, and the reverse."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle
from camcal.errors import InvalidInput
from camcal.formats.tables import Table, cell, csv_rows, numbered_lines
from camcal.images.views import make_view
from camcal.options import command_line
from camcal.progress import SILENT, Progress
from camcal.run.paths import refuse_overwriting
from camcal.tasks.calibration.options import UndistortOptions
from camcal.tasks.calibration.undistort import read_source, require_own, write_view

_PIXEL = ("u", "v")
_DIGITS = 12


@dataclass(frozen=True, eq=False)
class PointsReport:
    """What was written: moved points, and how many of them have no place on the other side.

    camera_file: the camera of the view, None for the way back.
    """

    output: Path
    camera_file: Path | None
    count: int
    lost: int


def undistort_points(options: UndistortOptions, progress: Progress = SILENT) -> PointsReport:
    """Return what was written to options.output: the table with other u and v, empty where a point has no place.

    Raises InvalidInput for a table without u and v, or with something else than numbers in them; FileError.
    """
    if options.points is None:
        raise InvalidInput("no points are given; name a table with --points")
    source = read_source(options.camera, options.camera_name, progress)
    output = options.output if options.output.suffix else options.output / options.points.name
    camera_file = None if options.distort else output.with_suffix(".camera.yaml")
    outputs = [output] if camera_file is None else [output, camera_file]
    refuse_overwriting(outputs, [source.path, options.points])
    if camera_file is not None:
        require_own(camera_file)
    view = make_view(source.camera, options.view, source.circle)
    table = _read(options.points)
    pixels = np.column_stack([table.numbers_or_empty(name) for name in _PIXEL])
    if options.distort:
        moved = _lit(move_pixels(view, source.camera, pixels), source.circle)
    else:
        moved = move_pixels(source.camera, view, _lit(pixels, source.circle))
    files.write_text(output, _text(table, moved))
    if camera_file is not None:
        write_view(camera_file, source, view, command_line("undistort", options), progress)
    return PointsReport(output, camera_file, len(moved), int(np.isnan(moved[:, 0]).sum()))


def move_pixels(source: Camera, target: Camera, pixels: Array) -> Array:
    """Return the pixels (N, 2) of `target` that look along the rays of pixels (N, 2) of `source`; NaN where none do."""
    return target.project(source.unproject(pixels).directions).pixels


def _lit(pixels: Array, circle: ImageCircle | None) -> Array:
    """Return the pixels (N, 2) with NaN for those outside of the image circle."""
    return pixels if circle is None else np.where(circle.contains(pixels)[:, None], pixels, np.nan)


def _read(path: Path) -> Table:
    lines = [(number, line) for number, line in numbered_lines(path) if not line.startswith("#")]
    rows = csv_rows(str(path), lines)
    names = [name.strip() for name in rows[0]] if rows else []
    if any(names.count(name) != 1 for name in _PIXEL):
        raise InvalidInput(f"the first row names the columns, u and v once among them; found {names}", where=str(path))
    if len(set(names)) < len(names):
        raise InvalidInput(f"column {max(names, key=names.count)!r} stands twice", where=str(path))
    return Table.of_rows(str(path), names, rows[1:], [number for number, _ in lines[1:]])


def _text(table: Table, pixels: Array) -> str:
    """Return a table as CSV with other pixels (N, 2); a point without a place has empty cells."""
    columns = dict(table.columns)
    for name, values in zip(_PIXEL, pixels.T, strict=True):
        columns[name] = ["" if np.isnan(value) else f"{value:.{_DIGITS}g}" for value in values]
    rows = [list(columns), *zip(*columns.values(), strict=True)]
    return "".join(",".join(map(cell, row)) + "\n" for row in rows)


def document(report: PointsReport) -> dict[str, Any]:
    """Return the report as plain data for --json."""
    return {
        "output": report.output,
        "camera_file": report.camera_file,
        "points": report.count,
        "without_place": report.lost,
    }
