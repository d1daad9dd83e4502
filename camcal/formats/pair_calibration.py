"""Calibrations of rectified pairs in files of others: those of public stereo pairs, read, and one of camcal's, written.

Read are Middlebury's and ETH3D's calib.txt and KITTI's calib.txt, written R1 R2 P1 P2 Q for OpenCV and the camera_info
of both cameras for ROS.
Middlebury (2014 and later, ETH3D's two views): cam0=[fx 0 cx; 0 fy cy; 0 0 1], cam1, doffs in pixels, baseline in mm.
KITTI: P0: to P3: (or P_rect_00: …), 3 × 4 projections of the two gray and the two colour cameras, metres.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.dataclass import dataclass, replace
from camcal.errors import FileError, InvalidInput, Located
from camcal.formats.camera_file import CameraFile, Transform
from camcal.formats.cameras import file_storage, ros
from camcal.formats.cameras.nearest import prepared
from camcal.geometry.pose import Pose
from camcal.parsing import parse_numbers
from camcal.stereo.disparity import StereoGeometry
from camcal.stereo.rectify.record import OpenCVRectification, Rectification

SUFFIX = ".txt"

_LINE = re.compile(r"\s*(\w+)\s*[=:]\s*(.*?)\s*")
_PAIRS = {"P0": "P1", "P2": "P3"}
_LIMIT = 1 << 20
_PIXELS = 0.1  # by how much doffs and the principal points may disagree: quarter sizes are rounded
_SHARE = 0.02  # of the baseline, what KITTI's cameras may stand off its line: the colour pair does by 0.006
_MILLIMETRES = 1000.0


@dataclass(frozen=True)
class PairCalibration:
    """The geometry of a rectified pair, and the size (width, height) of its images where the file tells it."""

    geometry: StereoGeometry
    image_size: tuple[int, int] | None = None


class _Entry(NamedTuple):
    text: str
    where: str


def read(path: Path, left: str | None = None) -> PairCalibration:
    """Return the geometry that a calib.txt describes.

    left: P0 or P2, the left camera of a KITTI file, which holds two pairs.
    Raises FileError if it is no such file, InvalidInput, with the line, for what is missing, broken or ambiguous.
    """
    entries = _entries(path)
    if "cam0" in entries or "cam1" in entries:
        if left is not None:
            raise InvalidInput(f"holds one pair and no camera {left!r}", where=str(path))
        return _middlebury(entries, path)
    if any(name in entries for name in ("P0", "P1", "P2", "P3")):
        return _kitti(entries, path, left)
    raise FileError("not a stereo calibration file: no cam0 (Middlebury) and no P0 (KITTI)", where=str(path))


def _entries(path: Path) -> Mapping[str, _Entry]:
    """Return what stands behind the names of a file, whose P_rect_00 are called P0."""
    entries: dict[str, _Entry] = {}
    for number, line in enumerate(files.read_text(path, _LIMIT).splitlines(), 1):
        where = f"{path}:{number}"
        match = _LINE.fullmatch(line)
        if match is None:
            if line.strip():
                raise FileError(f"{line.strip()[:40]!r} is not name=value or name: value", where=where)
            continue
        name = re.sub(r"([PS])_rect_0(?=[0-3]$)", r"\1", match[1])
        if name in entries:
            raise InvalidInput(f"{match[1]} duplicate key", where=where)
        entries[name] = _Entry(match[2], where)
    return entries


def _middlebury(entries: Mapping[str, _Entry], path: Path) -> PairCalibration:
    left, right = _camera_matrix(entries, "cam0", path), _camera_matrix(entries, "cam1", path)
    doffs, baseline = (_numbers(entries, name, 1, path)[0] for name in ("doffs", "baseline"))
    if max(abs(left[0, 0] - right[0, 0]), abs(left[1, 2] - right[1, 2])) > _PIXELS:
        raise InvalidInput("cam0 and cam1 differ in focal length or row; the pair is not rectified", where=str(path))
    shift = right[0, 2] - left[0, 2]
    if abs(doffs - shift) > _PIXELS:
        where = entries["doffs"].where
        raise InvalidInput(f"doffs is {doffs:g}, but cx of cam1 less cx of cam0 is {shift:g}", where=where)
    size = None
    if "width" in entries or "height" in entries:
        size = (_whole(entries, "width", path), _whole(entries, "height", path))
    return PairCalibration(_geometry(left, baseline / _MILLIMETRES, doffs, entries["baseline"].where), size)


def _kitti(entries: Mapping[str, _Entry], path: Path, left: str | None) -> PairCalibration:
    names = _pair_named(entries, path, left)
    first, second = (_numbers(entries, name, 12, path).reshape(3, 4) for name in names)
    for name, projection in zip(names, (first, second), strict=True):
        _require_pinhole(projection[:, :3], entries[name].where)
    where = entries[names[1]].where
    if not np.allclose(first[:2, :2], second[:2, :2]) or abs(first[1, 2] - second[1, 2]) > _PIXELS:
        raise InvalidInput(f"{names[1]} differs from {names[0]} in focal length or row; not rectified", where=where)
    left_centre, right_centre = (-np.linalg.solve(camera[:, :3], camera[:, 3]) for camera in (first, second))
    along, down, forward = (right_centre - left_centre).tolist()
    aside = float(np.hypot(down, forward))
    if aside > _SHARE * abs(along):
        raise InvalidInput(f"{names[1]} is {aside:.3g} m off the row of {names[0]}: pair not rectified", where=where)
    doffs = second[0, 2] - first[0, 2]
    return PairCalibration(_geometry(first, along, doffs, where), _kitti_size(entries, f"S{names[0][1]}", path))


def _pair_named(entries: Mapping[str, _Entry], path: Path, left: str | None) -> tuple[str, str]:
    """Return the names of the left and the right projection that are meant."""
    there = [name for name, right in _PAIRS.items() if {name, right} & entries.keys()]
    if left is None and len(there) > 1:
        raise InvalidInput("holds two pairs; name the left camera: P0 (gray) or P2 (colour)", where=str(path))
    name = left or there[0]
    if name not in _PAIRS:
        raise InvalidInput(f"the left camera is P0 or P2, found {name!r}", where=str(path))
    return name, _PAIRS[name]


def _kitti_size(entries: Mapping[str, _Entry], name: str, path: Path) -> tuple[int, int] | None:
    if name not in entries:
        return None
    width, height = _numbers(entries, name, 2, path).tolist()
    return int(width), int(height)


def _geometry(matrix: Array, baseline: float, doffs: float, where: str) -> StereoGeometry:
    fx, fy, cx, cy = (float(matrix[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2)))
    with Located(where):
        return StereoGeometry(fx, fy, cx, cy, float(baseline), float(doffs))


def _camera_matrix(entries: Mapping[str, _Entry], name: str, path: Path) -> Array:
    entry = _entry(entries, name, path)
    rows = entry.text.removeprefix("[").removesuffix("]").split(";")
    if not (entry.text.startswith("[") and entry.text.endswith("]") and len(rows) == 3):
        raise InvalidInput(f"{name} is not written as [fx 0 cx; 0 fy cy; 0 0 1]", where=entry.where)
    matrix = np.array([_parse(row, name, 3, entry.where) for row in rows])
    _require_pinhole(matrix, entry.where)
    return matrix


def _require_pinhole(matrix: Array, where: str) -> None:
    upright = not (matrix[0, 1] or matrix[1, 0]) and np.array_equal(matrix[2], (0, 0, 1))
    if not (upright and matrix[0, 0] > 0 and matrix[1, 1] > 0):
        raise InvalidInput("is not the camera matrix of a rectified image (fx 0 cx, 0 fy cy, 0 0 1)", where=where)


def _numbers(entries: Mapping[str, _Entry], name: str, count: int, path: Path) -> Array:
    entry = _entry(entries, name, path)
    return np.array(_parse(entry.text, name, count, entry.where))


def _whole(entries: Mapping[str, _Entry], name: str, path: Path) -> int:
    value = float(_numbers(entries, name, 1, path)[0])
    if value < 1 or value != int(value):
        raise InvalidInput(f"{name} {value:g} is not a number of pixels", where=entries[name].where)
    return int(value)


def _entry(entries: Mapping[str, _Entry], name: str, path: Path) -> _Entry:
    if name not in entries:
        raise InvalidInput(f"has no {name}", where=str(path))
    return entries[name]


def _parse(text: str, name: str, count: int, where: str) -> list[float]:
    """Return the finite numbers of a text, which must be `count`."""
    try:
        numbers = parse_numbers(text.split())
    except ValueError:
        numbers = []
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise InvalidInput(f"{name} needs {count} number{'s' * (count > 1)}, found {text!r}", where=where)
    return numbers


def require_pinhole(rectification: Rectification, option: str) -> OpenCVRectification:
    """Return R1 R2 P1 P2 Q; raises InvalidInput, naming the option that asks for them, unless it is a pinhole pair."""
    found = rectification.opencv()
    if found is None:
        raise InvalidInput(
            f"{option} is for pinhole images, these are {rectification.projection}: give --projection pinhole, or use "
            "--maps"
        )
    return found


def write_opencv(path: Path, rectification: Rectification) -> None:
    """Write R1 R2 P1 P2 Q and the size of the rectified images, as cv2.FileStorage reads them; metres.

    Raises InvalidInput as `require_pinhole` does, FileError.
    """
    found = require_pinhole(rectification, "--opencv")
    width, height = rectification.size
    items: dict[str, file_storage.Item] = {"image_width": width, "image_height": height}
    items |= {name: np.array(getattr(found, name)) for name in ("R1", "R2", "P1", "P2", "Q")}
    usage = "use cv2.initUndistortRectifyMap(K, D, R1, P1, size, cv2.CV_32FC1), of a fisheye cv2.fisheye's"
    files.write_text(path, file_storage.text_of(items, path.suffix, usage))


def as_ros(file: CameraFile, rectification: Rectification, right_T_left: Pose) -> CameraFile:
    """Return both cameras with the R and P of their rectified images, which `ros.write` keeps.

    Raises InvalidInput as `require_pinhole` does, and for a lens that ROS does not have.
    """
    found = require_pinhole(rectification, "--ros")
    names = rectification.left, rectification.right
    matrices = {names[0]: (found.R1, found.P1), names[1]: (found.R2, found.P2)}
    entries = {}
    for name, (rotation, projection) in matrices.items():
        block = {"rectification": rotation.ravel().tolist(), "projection": projection.ravel().tolist()}
        entries[name] = replace(file.cameras[name], extra={ros.VENDOR_KEY: block})
    pair = CameraFile(entries, {f"{names[1]}_T_{names[0]}": Transform(right_T_left)})
    return prepared(pair, ros.ROS, "--ros").file
