"""The calibrations of devices as JSON: DepthAI (OAK), RealSense, PhotonVision.

DepthAI: the cameras of a device by their sockets, with the place of each beside another. extrinsics take points of a
camera to toCameraSocket, centimetres: to_T_camera. Fourteen coefficients in OpenCV's order, of a fisheye (cameraType 1)
the first four. Source: depthai-shared's CameraInfo, Extrinsics; depthai-core's CalibrationHandler.
RealSense: rs2_intrinsics of one camera or several by their names. Source: librealsense's rs_types.h: modified and
inverse Brown-Conrady are other functions than OpenCV's, unless all their coefficients are 0.
PhotonVision: OpenCV's matrices as {rows, cols, type, data}. Source: its CameraCalibrationCoefficients, JsonMatOfDouble.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform, pose_between
from camcal.formats.cameras.record import CAMERA, CameraFormat, Given, Source, name_of, opencv_usage
from camcal.formats.cameras.syntax import json_text, json_values
from camcal.formats.cameras.values import OPENCV_LENSES, Lenses, Values
from camcal.geometry.pose import JOINT, Pose

DEPTHAI_LENSES = Lenses("\n".join(OPENCV_LENSES.splitlines()[-2:]))  # fourteen coefficients, and a fisheye's
_CENTIMETRES = 100.0

REALSENSE_LENSES = Lenses("""
    none pinhole fx fy ppx=cx ppy=cy coeff=0? coeff=0? coeff=0? coeff=0? coeff=0?
    brown_conrady opencv5 fx fy ppx=cx ppy=cy k1? k2? p1? p2? k3?
    kannala_brandt4 kannala_brandt4 fx fy ppx=cx ppy=cy k1 k2 k3 k4 coeff=0?
    inverse_brown_conrady pinhole fx fy ppx=cx ppy=cy coeff=0? coeff=0? coeff=0? coeff=0? coeff=0?
    modified_brown_conrady pinhole fx fy ppx=cx ppy=cy coeff=0? coeff=0? coeff=0? coeff=0? coeff=0?
    ftheta fov fx fy ppx=cx ppy=cy w=omega coeff=0? coeff=0? coeff=0? coeff=0?
""")  # fmt: skip
_NUMBERED = ("none", "modified_brown_conrady", "inverse_brown_conrady", "ftheta", "brown_conrady", "kannala_brandt4")

PHOTONVISION_LENSES = Lenses("\n".join(OPENCV_LENSES.splitlines()[:2]))  # it calibrates with five or eight coefficients
_COEFFICIENTS = ("distCoeffs", "cameraExtrinsics")  # the older name of the coefficients


def read_depthai(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the calibrated cameras; raises InvalidInput, MissingSize, FileError."""
    values = json_values(sources[0])
    pairs = values.data["cameraData"]
    if not isinstance(pairs, list) or not all(isinstance(each, list) and len(each) == 2 for each in pairs):
        raise values.wrong("cameraData", "is not a list of sockets and their cameras")
    named = {_name(socket): Values(values.document, f"cameraData.{socket}", data) for socket, data in pairs}
    known = {name: each for name, each in named.items() if isinstance(each.data, dict) and "intrinsicMatrix" in each}
    cameras = {name: CameraEntry(_depthai_camera(each, given)) for name, each in known.items()}
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


def _depthai_camera(values: Values, given: Given) -> Any:
    size = (values.side("width"), values.side("height")) if values.data.get("width") else None
    size = given.size(size, values.document.where)
    fisheye = values.data.get("cameraType") in (1, "FISHEYE")
    coefficients = values.numbers("distortionCoeff") if "distortionCoeff" in values else np.zeros(0)
    numbers = coefficients[:4] if fisheye else np.concatenate([coefficients, np.zeros(max(14 - len(coefficients), 0))])
    every = Values(values.document, values.path, {**values.data, "distortionCoeff": numbers.tolist()})
    rows = DEPTHAI_LENSES.of(values, "cameraType", "fisheye" if fisheye else "opencv")
    return DEPTHAI_LENSES.matrix(every, "intrinsicMatrix", "distortionCoeff", rows, size)


def write_depthai(path: Path, file: CameraFile) -> None:
    """Write the cameras to sockets A, B, …, each with its place beside the one before; raises FileError."""
    names = list(file.cameras)
    data = []
    for socket, (name, entry) in enumerate(file.cameras.items()):
        lens, numbers = DEPTHAI_LENSES.written(entry.camera)
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


DEPTHAI = CameraFormat(
    name="depthai",
    title="DepthAI calibration",
    suffixes=(".json",),
    models=DEPTHAI_LENSES.models,
    read=read_depthai,
    write=write_depthai,
    usage=opencv_usage,
    lenses=DEPTHAI_LENSES,
    poses="extrinsics: toCameraSocket_T_camera, cm",
)


def read_realsense(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the cameras; raises InvalidInput for a lens that camcal does not have, MissingSize, FileError."""
    values = json_values(sources[0])
    if "ppx" in values:
        return CameraFile({CAMERA: CameraEntry(_realsense_camera(values, given))})
    below = {key: values.below(key) for key, item in values.data.items() if isinstance(item, dict)}
    below = {key: each.below("intrinsics") if "intrinsics" in each else each for key, each in below.items()}
    found = {name_of(key): CameraEntry(_realsense_camera(each, given)) for key, each in below.items() if "ppx" in each}
    if not found:
        raise values.wrong("", "has no intrinsics with ppx: give those of rs-enumerate-devices -c")
    return CameraFile(found)


def _realsense_camera(values: Values, given: Given) -> Camera:
    told = values.data.get("model", values.data.get("distortion_model", "none"))
    word = _NUMBERED[told] if isinstance(told, int) and 0 <= told < len(_NUMBERED) else str(told).lower()
    word = re.sub(r"^(?:rs2_)?distortion[._]", "", word.replace(" ", "_").replace("-", "_"))
    key = "coeffs" if "coeffs" in values else "distortion_coeffs"
    coefficients = values.numbers(key) if key in values else np.zeros(5)
    numbers = np.array([values.number(name) for name in ("fx", "fy", "ppx", "ppy")])
    size = (values.side("width"), values.side("height")) if "width" in values else None
    size = given.size(size, values.document.where)
    return REALSENSE_LENSES.listed(
        values, key, REALSENSE_LENSES.of(values, "model", word), size, np.concatenate([numbers, coefficients])
    )


def write_realsense(path: Path, file: CameraFile) -> None:
    """Write a camera; raises FileError."""
    (entry,) = file.cameras.values()
    lens, numbers = REALSENSE_LENSES.written(entry.camera)
    width, height = entry.camera.image_size
    core = {key: numbers[key] for key in ("ppx", "ppy", "fx", "fy")}
    coefficients = [value for key, value in numbers.items() if key not in core]
    coefficients += [0.0] * (5 - len(coefficients))
    files.write_text(
        path, json_text({"width": width, "height": height, **core, "model": lens.word, "coeffs": coefficients})
    )


REALSENSE = CameraFormat(
    name="realsense",
    title="RealSense intrinsics",
    suffixes=(".json",),
    models=REALSENSE_LENSES.models,
    read=read_realsense,
    write=write_realsense,
    lenses=REALSENSE_LENSES,
    most_cameras=1,
    note="rs2_intrinsics; the camera itself keeps its own calibration",
)


def read_photonvision(sources: Sequence[Source], given: Given) -> CameraFile:
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
    camera = PHOTONVISION_LENSES.matrix(values, "cameraIntrinsics", key, PHOTONVISION_LENSES.rows, size)
    return CameraFile({CAMERA: CameraEntry(camera)})


def write_photonvision(path: Path, file: CameraFile) -> None:
    """Write a camera; raises FileError."""
    (entry,) = file.cameras.values()
    _, numbers = PHOTONVISION_LENSES.written(entry.camera)
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


PHOTONVISION = CameraFormat(
    name="photonvision",
    title="PhotonVision calibration",
    suffixes=(".json",),
    models=PHOTONVISION_LENSES.models,
    read=read_photonvision,
    write=write_photonvision,
    usage=opencv_usage,
    lenses=PHOTONVISION_LENSES,
    most_cameras=1,
)
