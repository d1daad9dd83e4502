"""EuRoC's sensor.yaml of a camera; T_BS takes points of the sensor to the body, metres: body_T_camera.

Source: the data set's cam0/sensor.yaml.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from camcal import files
from camcal.formats import emit
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform, pose_between
from camcal.formats.cameras.lenses import Lenses
from camcal.formats.cameras.record import CAMERA, CameraFormat, Given, Source
from camcal.formats.cameras.values import Values
from camcal.formats.documents import parse_foreign
from camcal.geometry.pose import JOINT

BODY = "body"
LENSES = Lenses("""
    none pinhole fx fy cx cy
    radial-tangential opencv4 fx fy cx cy k1 k2 p1 p2
    equidistant kannala_brandt4 fx fy cx cy k1 k2 k3 k4
""")  # fmt: skip


def read(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the camera with its place on the body; raises InvalidInput for another sensor, MissingSize, FileError."""
    values = Values(parse_foreign(sources[0].text, str(sources[0].path)))
    kind = values.text("sensor_type") or "camera"
    if kind != "camera" or "intrinsics" not in values:
        raise values.wrong("sensor_type", f"{kind!r} is no camera: give cam0/sensor.yaml")
    rows = LENSES.of(values, "distortion_model", values.text("distortion_model") or "none")
    size = given.size(values.sides("resolution") if "resolution" in values else None, values.document.where)
    coefficients = (
        values.numbers("distortion_coefficients") if values.data.get("distortion_coefficients") else np.zeros(0)
    )
    numbers = np.concatenate([values.numbers("intrinsics", 4), coefficients])
    camera = LENSES.listed(values, "distortion_coefficients", rows, size, numbers)
    pose = Transform(values.rigid("T_BS"))
    return CameraFile({CAMERA: CameraEntry(camera)}, {f"{BODY}{JOINT}{CAMERA}": pose}, warnings=tuple(values.warnings))


def write(path: Path, file: CameraFile) -> None:
    """Write a camera; its place is the identity where the file has no body; raises FileError."""
    ((name, entry),) = file.cameras.items()
    lens, numbers = LENSES.written(entry.camera)
    pose = pose_between(file, BODY, name)
    matrix = np.eye(4) if pose is None else pose.matrix()
    data = {
        "sensor_type": "camera",
        "comment": name,
        "T_BS": {"cols": 4, "rows": 4, "data": matrix.ravel().tolist()},
        "rate_hz": 20,
        "resolution": list(entry.camera.image_size),
        "camera_model": "pinhole",
        "intrinsics": list(numbers.values())[:4],
        "distortion_model": lens.word,
        "distortion_coefficients": list(numbers.values())[4:],
    }
    files.write_text(path, emit.document(data, FORMAT.note, number=emit.exact_text))


FORMAT = CameraFormat(
    name="euroc",
    title="EuRoC sensor.yaml",
    suffixes=(".yaml", ".yml"),
    models=LENSES.models,
    read=read,
    write=write,
    lenses=LENSES,
    most_cameras=1,
    frames=frozenset({BODY}),
    poses="T_BS: body_T_camera",
    note="T_BS takes points of the camera to the body; set rate_hz",
)
