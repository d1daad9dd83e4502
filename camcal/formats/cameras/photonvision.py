"""PhotonVision's camera calibrations: JSON with OpenCV's matrices as {rows, cols, type, data}.

Source: photonvision's CameraCalibrationCoefficients, JsonMatOfDouble.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from camcal import files
from camcal.arrays import Array
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.formats.cameras.lenses import OPENCV_LENSES, Lenses
from camcal.formats.cameras.record import CAMERA, CameraFormat, Given, Source, opencv_usage
from camcal.formats.cameras.syntax import json_text, json_values

LENSES = Lenses("\n".join(OPENCV_LENSES.splitlines()[:2]))  # it calibrates with five or eight coefficients
_COEFFICIENTS = ("distCoeffs", "cameraExtrinsics")  # the older name of the coefficients


def read(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the camera; raises InvalidInput, MissingSize, FileError."""
    values = json_values(sources[0])
    size = None
    if "resolution" in values:
        resolution = values.below("resolution")
        size = resolution.side("width"), resolution.side("height")
    size = given.size(size, values.document.where)
    key = next((key for key in _COEFFICIENTS if key in values), _COEFFICIENTS[0])
    if values.data.get("isFisheye") is True:
        raise values.wrong("isFisheye", "a version of 2023 with fisheyes is not read: calibrate again with a later one")
    camera = LENSES.matrix(values, "cameraIntrinsics", key, LENSES.rows, size)
    return CameraFile({CAMERA: CameraEntry(camera)})


def write(path: Path, file: CameraFile) -> None:
    """Write a camera; raises FileError."""
    (entry,) = file.cameras.values()
    _, numbers = LENSES.written(entry.camera)
    width, height = entry.camera.image_size
    data = {
        "resolution": {"width": float(width), "height": float(height)},
        "cameraIntrinsics": _matrix(entry.camera.K),
        "distCoeffs": {"rows": 1, "cols": len(numbers) - 4, "type": 6, "data": list(numbers.values())[4:]},
        "calobjectWarp": [0.0, 0.0],
        "observations": [],
        "calobjectSize": {"width": 0.0, "height": 0.0},
        "calobjectSpacing": 0.0,
        "lensmodel": "LENSMODEL_OPENCV",  # of any number of coefficients
    }
    files.write_text(path, json_text(data))


def _matrix(matrix: Array) -> dict[str, Any]:
    rows, columns = matrix.shape
    return {"rows": rows, "cols": columns, "type": 6, "data": matrix.ravel().tolist()}


FORMAT = CameraFormat(
    name="photonvision",
    title="PhotonVision calibration",
    suffixes=(".json",),
    models=LENSES.models,
    read=read,
    write=write,
    usage=opencv_usage,
    lenses=LENSES,
    most_cameras=1,
)
