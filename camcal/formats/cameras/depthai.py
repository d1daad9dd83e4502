"""DepthAI's (OAK) calibration JSON: the cameras of a device by their sockets, with the place of each beside another.

extrinsics take points of a camera to toCameraSocket, centimetres: to_T_camera. Fourteen coefficients in OpenCV's order,
of a fisheye (cameraType 1) the first four. Source: depthai-shared's CameraInfo, Extrinsics; depthai-core's
CalibrationHandler.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform, pose_between
from camcal.formats.cameras.lenses import OPENCV_LENSES, Lenses
from camcal.formats.cameras.record import CameraFormat, Given, Source, opencv_usage
from camcal.formats.cameras.syntax import json_text, json_values
from camcal.formats.cameras.values import Values
from camcal.geometry.pose import JOINT, Pose

LENSES = Lenses("\n".join(OPENCV_LENSES.splitlines()[-2:]))  # fourteen coefficients, and a fisheye's
_CENTIMETRES = 100.0


def read(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the calibrated cameras; raises InvalidInput, MissingSize, FileError."""
    values = json_values(sources[0])
    pairs = values.data["cameraData"]
    if not isinstance(pairs, list) or not all(isinstance(each, list) and len(each) == 2 for each in pairs):
        raise values.wrong("cameraData", "is not a list of sockets and their cameras")
    named = {_name(socket): Values(values.document, f"cameraData.{socket}", data) for socket, data in pairs}
    known = {name: each for name, each in named.items() if isinstance(each.data, dict) and "intrinsicMatrix" in each}
    cameras = {name: CameraEntry(_camera(each, given)) for name, each in known.items()}
    if not cameras:
        raise values.wrong("cameraData", "has no calibrated camera: calibrate the device first")
    file = CameraFile(cameras)
    for name, each in known.items():
        place = each.below("extrinsics") if "extrinsics" in each else each
        target = _name(place.data.get("toCameraSocket", -1))
        if target in cameras and target != name and pose_between(file, target, name) is None:
            shift = place.below("translation")
            translation = np.array([shift.number(axis) for axis in "xyz"]) / _CENTIMETRES
            pose = place.pose("rotationMatrix", place.matrix("rotationMatrix", 3, 3), translation)
            file = CameraFile(cameras, {**file.transforms, f"{target}{JOINT}{name}": Transform(pose)})
    return file


def _name(socket: object) -> str:
    return f"cam_{chr(ord('a') + socket)}" if isinstance(socket, int) and 0 <= socket < 26 else "cam_none"


def _camera(values: Values, given: Given) -> Any:
    size = (values.side("width"), values.side("height")) if values.data.get("width") else None
    size = given.size(size, values.document.where)
    fisheye = values.data.get("cameraType") in (1, "FISHEYE")
    coefficients = values.numbers("distortionCoeff") if "distortionCoeff" in values else np.zeros(0)
    numbers = coefficients[:4] if fisheye else np.concatenate([coefficients, np.zeros(max(14 - len(coefficients), 0))])
    every = Values(values.document, values.path, {**values.data, "distortionCoeff": numbers.tolist()})
    rows = LENSES.of(values, "cameraType", "fisheye" if fisheye else "opencv")
    return LENSES.matrix(every, "intrinsicMatrix", "distortionCoeff", rows, size)


def write(path: Path, file: CameraFile) -> None:
    """Write the cameras to sockets A, B, …, each with its place beside the one before; raises FileError."""
    names = list(file.cameras)
    data = []
    for socket, (name, entry) in enumerate(file.cameras.items()):
        lens, numbers = LENSES.written(entry.camera)
        pose = pose_between(file, names[socket - 1], name) if socket else None
        coefficients = list(numbers.values())[4:]
        width, height = entry.camera.image_size
        camera = {
            "cameraType": int(lens.word == "fisheye"),
            "distortionCoeff": [*coefficients, *(0.0,) * (14 - len(coefficients))],
            "extrinsics": _extrinsics(pose, socket - 1),
            "height": height,
            "intrinsicMatrix": entry.camera.K.tolist(),
            "lensPosition": 0,
            "specHfovDeg": 0.0,
            "width": width,
        }
        data.append([socket, camera])
    files.write_text(
        path, json_text({"batchName": "", "boardName": "", "boardRev": "", "cameraData": data, "version": 7})
    )


def _extrinsics(pose: Pose | None, target: int) -> dict[str, Any]:
    turn, shift = (np.eye(3), np.zeros(3)) if pose is None else (pose.rotation, pose.translation * _CENTIMETRES)
    moved = dict(zip("xyz", map(float, shift), strict=True))
    return {
        "rotationMatrix": np.asarray(turn).tolist(),
        "specTranslation": moved,
        "toCameraSocket": -1 if pose is None else target,
        "translation": moved,
    }


FORMAT = CameraFormat(
    name="depthai",
    title="DepthAI calibration",
    suffixes=(".json",),
    models=LENSES.models,
    read=read,
    write=write,
    usage=opencv_usage,
    lenses=LENSES,
    poses="extrinsics: toCameraSocket_T_camera, cm",
)
