"""What a calibration leaves uncertain of measurements at a distance: of projected points, lengths and depths."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from camcal.cameras.model import require_central
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.formats import cameras, split_address
from camcal.formats.camera_file import CameraFile
from camcal.quality.range_uncertainty import CameraErrors, ErrorSize, camera_errors
from camcal.quality.rig_geometry import DISPARITY_PX, PairErrors, pair_errors
from camcal.records import Brief
from camcal.report.table import Column
from camcal.tasks.rigs.inspect_rig import RigInspection, inspect_rig

COLUMNS = (
    Column("distance", "m"),
    Column("camera"),
    Column("error of"),
    Column("std"),
    Column("95 %"),
    Column("worst", priority=1),
    Column("by matching", priority=2),
)


@dataclass(frozen=True, eq=False)
class RangeErrors(Brief):
    """What is uncertain at a distance (m) from a camera: of each camera, and of pairs of a rig.

    length: m, of an object, where one was asked for.
    """

    distance: float
    length: float | None
    cameras: Mapping[str, CameraErrors]
    pairs: tuple[PairErrors, ...] = ()


def errors_at_range(
    calibration: CameraFile | Path | str, distance: float, length: float | None = None, camera: str | None = None
) -> RangeErrors:
    """Return the standard deviations that a calibration leaves to measurements at a distance (m) from a camera.

    calibration: a camera file of any format, FILE or FILE#NAME, or its content. length: m, of an object. camera: one of
    several; of all cameras, pairs are included. Raises InvalidInput for a distance or a length that is not positive,
    where the covariance is not known, and as `read_camera_file`.
    """
    where = ""
    if not isinstance(calibration, CameraFile):
        path, named = split_address(str(calibration))
        calibration, where, camera = cameras.read(path), str(path), camera or named
    if not distance > 0 or not (length is None or length > 0):
        raise InvalidInput(f"distances and lengths are positive; found {distance:g} and {length or 0:g} m")
    if camera is not None:
        cameras.select(calibration, camera, where)
    rig = inspect_rig(calibration, where) if camera is None else None
    return errors_of_file(calibration, rig, distance, length, camera)


def errors_of_file(
    file: CameraFile, rig: RigInspection | None, distance: float, length: float | None, camera: str | None
) -> RangeErrors:
    """Return what `errors_at_range` does of the content of a file; rig: what its cameras make together."""
    from camcal.tasks.calibration.diff import calibration_of  # `inspect` of a camera does not wait for it

    names = list(file.cameras) if camera is None else [camera]
    for name in names:
        require_central(file.cameras[name].camera.model, f"camera {name!r}")
    own = {name: calibration_of(f"camera {name!r}", file.cameras[name], file) for name in names}
    found = {name: camera_errors(own[name], file.cameras[name].boards, distance, length) for name in names}
    pairs = []
    if rig is not None and rig.rig.covariance is not None:
        for pair in rig.pairs:
            views = min(own[pair.first].views, own[pair.second].views)
            pairs.append(pair_errors(rig.rig, pair.first, pair.second, distance, length, views, rig.circles))
    return RangeErrors(distance, length, found, tuple(pairs))


def rows(found: RangeErrors) -> Iterator[list[str]]:
    """Yield the rows of the table: what is measured at a distance, with units."""
    length = "" if found.length is None else f"length {_length(found.length)}"
    for name, own in found.cameras.items():
        yield _row(found, name, "projected point", own.point, "px")
        if found.length is not None:
            yield _row(found, name, length, own.length, "mm")
    for pair in found.pairs:
        name = f"{pair.first}, {pair.second}"
        yield _row(found, name, "depth", pair.depth, "mm")
        if found.length is not None:
            yield _row(found, name, length, pair.length, "mm")


def _row(found: RangeErrors, camera: str, what: str, size: ErrorSize | None, unit: str) -> list[str]:
    row = [f"{found.distance:g}", camera, what]
    if size is None:
        return [*row, "not in view", "", "", ""]
    factor = 1e3 if unit == "mm" else 1.0
    matching = "" if size.matching is None else f"{factor * size.matching:.3g} {unit}"
    figures = [f"{sign}{factor * value:.3g} {unit}" for sign, value in (("", size.std), ("± ", size.bound))]
    return [*row, *figures, f"{factor * size.worst:.3g} {unit}", matching]


def _length(value: float) -> str:
    return f"{1e3 * value:g} mm" if value < 1 else f"{value:g} m"


def lines(found: RangeErrors) -> Iterator[str]:
    """Yield what the figures at a distance stand for, a sentence each."""
    without = [name for name, own in found.cameras.items() if not own.by_boards]
    if without:
        yield (
            f"projected points of {', '.join(without)} are placed from the camera itself: the file does not say how "
            "well the boards of the calibration were placed"
        )
    spans = ", ".join(f"{1e3 * own.pixel:.3g} mm" for own in found.cameras.values())
    yield f"one pixel spans {spans} at {found.distance:g} m in the middle of the image"
    if found.pairs:
        yield f"matching: {DISPARITY_PX:g} px of disparity, included in the 95 % bound"


def as_data(found: RangeErrors) -> dict[str, Any]:
    """Return the errors at a distance as plain data; m, px."""
    return {
        "distance_m": found.distance,
        "length_m": found.length,
        "cameras": {
            name: {
                "point": _size(own.point, "px"),
                "placed_by_boards": own.by_boards,
                "pixel_m": own.pixel,
                "length": _size(own.length, "m"),
            }
            for name, own in found.cameras.items()
        },
        "pairs": [
            {
                "cameras": [pair.first, pair.second],
                "depth": _size(pair.depth, "m"),
                "length": _size(pair.length, "m"),
            }
            for pair in found.pairs
        ],
    }


def _size(size: ErrorSize | None, unit: str) -> dict[str, float] | None:
    if size is None:
        return None
    figures = {"std": size.std, "worst": size.worst, "bound_95": size.bound, "matching": size.matching}
    return {f"{name}_{unit}": value for name, value in figures.items() if value is not None}
