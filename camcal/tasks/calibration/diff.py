"""`camcal diff`: by how much the projections of cameras differ, and whether that is more than is uncertain."""

from collections.abc import Iterator, Sequence
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.cameras.model import Camera
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.formats import cameras, split_address, tables
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.formats.provenance import image_counts
from camcal.messages import Message
from camcal.quality.camera_comparison import Calibrated, CameraComparison, Excess, compare
from camcal.report.table import Column
from camcal.run.outputs import claim, writes
from camcal.tasks.calibration.options import DiffOptions
from camcal.tasks.given_camera import read_part, require_no_image
from camcal.tasks.options import WHOLE, ImagePart

COLUMNS = (
    Column("camera", file=True),
    Column("distance"),
    Column("RMS", "px"),
    Column("worst", "px"),
    Column("std", "px"),
    Column("difference / std"),
    Column("verdict", wraps=True),
)


@dataclass(frozen=True, eq=False)
class DiffReport:
    """The cameras that were compared with the first, by their names: FILE, or FILE#NAME of a file with several."""

    first: str
    comparisons: dict[str, CameraComparison]
    failures: tuple[Message, ...]
    outputs: tuple[Path, ...] = ()


@writes
def diff(options: DiffOptions) -> DiffReport:
    """Return the differences of cameras from the first one, after drawing and writing them where that is asked for.

    Every camera of a first file with several is compared with the one of the same name. Raises InvalidInput or
    FileError for files that are not read, and cameras that cannot be compared.
    """
    first, *others = (_read(each, WHOLE if number else options.part) for number, each in enumerate(options.files))
    found = {
        second.name: compare(own, second, options.distances)
        for own in first.values()
        for other in others
        for second in [_partner(own.name, first, other)]
    }
    outputs = tuple(path for path in (options.plot, options.csv) if path is not None)
    if options.plot is not None and len(found) > 1:
        raise InvalidInput(f"--plot draws one difference, and there are {len(found)}: name two cameras, or use --csv")
    claim(outputs)
    if options.plot is not None:
        from camcal.report.figures.differences import camera_difference
        from camcal.report.figures.figure import encoded

        files.write_bytes(options.plot, encoded(camera_difference(next(iter(found.values()))), options.plot.suffix))
    if options.csv is not None:
        files.write_text(options.csv, "\n".join(_csv_lines(found)) + "\n")
    names = ", ".join(each.name for each in first.values())
    return DiffReport(names, found, tuple(_failures(found, options)), outputs)


def compare_cameras(
    first: Camera | Path | str, second: Camera | Path | str, distances: Sequence[float] = ()
) -> CameraComparison:
    """Return by how much the projections of two cameras differ, over the image of the first, and what that means.

    first, second: camera files of any format, FILE or FILE#NAME, or cameras. distances: m, of points for which the
    rigid motion that suits best is taken out; none for directions, for which it is the rotation. Of cameras that are no
    files, the number of views is taken as large. Raises InvalidInput for images of other shapes, and as
    `read_camera_file`.
    """
    found = []
    for name, each in (("the first camera", first), ("the second camera", second)):
        if isinstance(each, Camera):
            found.append(Calibrated(name, each))
        else:
            path, chosen = split_address(str(each))
            file = cameras.read(path)
            found.append(calibration_of(str(each), cameras.select(file, chosen, str(path)), file))
    return compare(found[0], found[1], distances)


def calibration_of(name: str, entry: CameraEntry, file: CameraFile) -> Calibrated:
    """Return what a file says of the calibration of one of its cameras."""
    region = entry.verdict.region if entry.verdict is not None else None
    images = file.provenance.get("images")
    hashes = [
        str(each["sha256"])
        for each in (images if isinstance(images, list) else ())
        if "sha256" in each and each.get("used", True)
    ]
    views = entry.quality.get("images_used") or image_counts(file.provenance)[0] or float("inf")
    return Calibrated(
        name,
        entry.camera,
        None if region is None else region.polygon,
        entry.image_circle,
        float(views),
        frozenset(hashes),
    )


def _read(address: str, part: ImagePart) -> dict[str, Calibrated]:
    """Return the cameras of a file, or the one that an address names, by their names in it."""
    path, name = split_address(address)
    require_no_image(path)
    file = read_part(path, part, central=False)
    if name is not None or len(file.cameras) == 1:
        return {name or next(iter(file.cameras)): calibration_of(address, cameras.select(file, name, str(path)), file)}
    return {each: calibration_of(f"{address}#{each}", entry, file) for each, entry in file.cameras.items()}


def _partner(name: str, first: dict[str, Calibrated], other: dict[str, Calibrated]) -> Calibrated:
    """Return the camera that one of the first file, called `name`, is compared with."""
    if len(first) == len(other) == 1:
        return next(iter(other.values()))
    key = next(key for key, each in first.items() if each.name == name)
    if key not in other:
        names = ", ".join(each.name for each in other.values())
        raise InvalidInput(f"{name}: no camera of that name among {names}; name one camera of each file, as FILE#NAME")
    return other[key]


def _failures(found: dict[str, CameraComparison], options: DiffOptions) -> Iterator[Message]:
    for name, each in found.items():
        worst = max(each.figures(index)["compared_worst_px"] or 0.0 for index in range(len(each.distances)))
        if options.most_px is not None and worst > options.most_px:
            text = f"projections differ by up to {worst:.3g} px (limit {options.most_px:g} px)"
            yield Message("camera_difference", text, {"difference_px": worst, "limit_px": options.most_px}, name)
        if options.most_sigma is None or (each.total is None and each.agree):
            continue
        if each.total is None:
            yield Message("unknown_difference_std", f"no standard deviation of the difference: {each.reason}", {}, name)
        elif each.total.sigmas > options.most_sigma:
            text = f"the difference is {each.total.sigmas:.3g} standard deviations (limit {options.most_sigma:g})"
            values = {"sigmas": each.total.sigmas, "limit": options.most_sigma}
            yield Message("camera_difference_sigmas", text, values, name)


def rows(report: DiffReport) -> list[list[object]]:
    """Return the rows of the table: for each camera, and each of the distances."""
    table: list[list[object]] = []
    for name, each in report.comparisons.items():
        for index, distance in enumerate(each.distances):
            own = each.figures(index)
            figures = [own["compared_rms_px"], own["compared_worst_px"], own["std_px"]]
            shown = ["" if value is None else f"{value:.3g}" for value in figures]
            sigmas = "" if each.total is None else f"{each.total.sigmas:.2f}"
            table.append([name, _at(distance), *shown, "" if index else sigmas, "" if index else each.words])
    return table


def _at(distance: float) -> str:
    return f"{distance:g} m" if isfinite(distance) else "infinity"


def document(report: DiffReport) -> dict[str, Any]:
    """Return the report as plain data for --json."""
    return {
        "first": report.first,
        "cameras": [
            {
                "camera": name,
                "verdict": each.verdict,
                "reason": each.reason,
                "focal_change": each.focal,
                "principal_point_shift_px": list(each.shift),
                "common_images": each.common_images,
                "distances": [
                    {"distance_m": distance if isfinite(distance) else None, **each.figures(index)}
                    for index, distance in enumerate(each.distances)
                ],
                "difference": _excess_data(each.total),
                "distortion": _excess_data(each.distortion),
            }
            for name, each in report.comparisons.items()
        ],
        "outputs": list(report.outputs),
    }


def _excess_data(excess: Excess | None) -> dict[str, float] | None:
    return None if excess is None else vars(excess)


def _csv_lines(found: dict[str, CameraComparison]) -> Iterator[str]:
    """Yield the lines of a table of differences: px from the first camera, px standard deviation, their ratio."""
    yield "# camcal diff"
    yield "camera,distance_m,u,v,du,dv,difference_px,std_px,sigmas,compared"
    for name, each in found.items():
        quoted = tables.cell(name)
        pixels = np.stack(np.meshgrid(each.u, each.v), axis=-1).reshape(-1, 2)
        for index, distance in enumerate(each.distances):
            std = each.std[index] if each.std is not None else np.full(len(pixels), np.nan)
            columns = (
                *pixels.T,
                *each.difference[index].T,
                each.lengths[index],
                std,
                each.sigmas[index],
                each.compared,
            )
            for u, v, *values, compared in zip(*columns, strict=True):
                numbers = ["" if np.isnan(value) else f"{value:.6g}" for value in values]
                yield ",".join([quoted, f"{distance:g}", f"{u:.12g}", f"{v:.12g}", *numbers, str(int(compared))])
