"""ROS camera_info as .ini (videre): the fields of `ros` in sections, of one camera.

Source: image_common/camera_calibration_parsers/src/parse_ini.cpp.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from camcal import files
from camcal.arrays import Array
from camcal.formats.camera_file import CameraFile
from camcal.formats.cameras import ros
from camcal.formats.cameras.record import CameraFormat, Given, Source, name_of, opencv_usage
from camcal.formats.cameras.values import Values
from camcal.formats.documents import Document
from camcal.formats.emit import exact_text

_KEYS = {
    "width": "image_width",
    "height": "image_height",
    "camera matrix": "camera_matrix",
    "distortion": "distortion_coefficients",
    "rectification": "rectification_matrix",
    "projection": "projection_matrix",
}


def read(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the camera; raises InvalidInput for whatever is missing or wrong."""
    data: dict[str, Any] = {}
    key = ""
    numbers: list[str] = []
    for line in sources[0].text.splitlines():
        words = line.split()
        if not words or line.lstrip()[0] in "#;":
            continue
        if line.startswith("["):
            data["camera_name"] = line.strip("[] \t")
        elif line.strip().lower() in _KEYS:
            key, numbers = _KEYS[line.strip().lower()], []
            data[key] = numbers
        elif key:
            numbers += words
    count = len(data.get("distortion_coefficients", ()))
    data["distortion_model"] = ros.PLUMB_BOB if count < 8 else ros.RATIONAL
    values = Values(Document(str(sources[0].path), data, {}))
    return CameraFile(
        {name_of(values.text("camera_name")): ros.entry_of(values, given)}, warnings=tuple(values.warnings)
    )


def write(path: Path, file: CameraFile) -> None:
    """Write a camera; raises FileError."""
    ((name, entry),) = file.cameras.items()
    camera, rectified = entry.camera, ros.kept(entry) or ros.of_one(entry.camera)
    lines = [f"# {opencv_usage(file)}", "[image]", ""]
    lines += ["width", str(camera.image_size[0]), "", "height", str(camera.image_size[1]), "", f"[{name}]", ""]
    lines += ["camera matrix", *_rows(camera.K), "", "distortion", *_rows(camera.parameters[4:][None]), ""]
    lines += ["rectification", *_rows(rectified.rotation), "", "projection", *_rows(rectified.projection), ""]
    files.write_text(path, "\n".join(lines))


def _rows(matrix: Array) -> list[str]:
    return [" ".join(map(exact_text, row)) for row in matrix.tolist()]


ROS_INI = CameraFormat(
    name="ros_ini",
    title="ROS camera_info .ini",
    suffixes=(".ini",),
    models=("opencv5", "opencv8"),
    read=read,
    write=write,
    usage=opencv_usage,
    most_cameras=1,
    poses="R, P: as ROS",
)
