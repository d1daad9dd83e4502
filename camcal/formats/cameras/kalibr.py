"""Kalibr's camchain YAML: cameras cam0, cam1, …, each with the transform from the one before it.

T_cn_cnm1 takes points of camera n-1 to camera n, metres; T_cam_imu those of the IMU to the camera, T_imu_cam, as
OpenVINS writes it, the reverse. Lenses: pinhole with radtan, equidistant or none. rostopic, cam_overlaps,
timeshift_cam_imu and line_delay are kept (x_kalibr) and written again. Every number has a dot: Kalibr refuses whole
ones.
Source: kalibr_common/python/kalibr_common/ConfigReader.py.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.errors import InvalidInput
from camcal.formats import emit
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform, pose_between
from camcal.formats.cameras.record import CameraFormat, Given, Source, Values, camera_of
from camcal.formats.documents import parse_foreign
from camcal.geometry.pose import JOINT, Pose
from camcal.messages import Message

VENDOR_KEY = "x_kalibr"
IMU = "imu"
MODELS = {"pinhole": "none", "opencv4": "radtan", "kannala_brandt4": "equidistant"}

_LENSES = {word: model for model, word in MODELS.items()} | {"radial-tangential": "opencv4", "equi": "kannala_brandt4"}
_COUNTS = {"pinhole": 0, "opencv4": 4, "kannala_brandt4": 4}
_KEPT = ("rostopic", "cam_overlaps", "timeshift_cam_imu", "line_delay")
_CAMERA = re.compile(r"cam\d+\Z")
_ADVICE = "calibrate with --models pinhole-radtan or pinhole-equi"
_AGREE = 1e-3  # m and of R, to which T_cam_imu of several cameras agree with T_cn_cnm1


def read(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the cameras of a camchain with the transforms between them, cam1_T_cam0, and cam0_T_imu.

    Raises InvalidInput for a lens model that camcal does not have and for whatever is missing or wrong, FileError.
    """
    (source,) = sources
    document = parse_foreign(source.text, str(source.path))
    names = sorted((name for name in document if _CAMERA.match(name)), key=files.natural_key)
    if not names:
        raise InvalidInput("has no cam0", where=str(source.path))
    values = {name: Values(document).below(name) for name in names}
    transforms: dict[str, Transform] = {}
    for before, name in zip([None, *names], names, strict=False):
        if before is not None and "T_cn_cnm1" in values[name]:
            transforms[f"{name}{JOINT}{before}"] = Transform(_pose(values[name], "T_cn_cnm1"))
        elif before is not None:
            values[name].warnings += _apart(values[name], name)
    cameras = {name: _entry(each, given) for name, each in values.items()}
    for name, each in values.items():
        transforms |= _of_imu(each, name, CameraFile(cameras, transforms))
    return CameraFile(
        cameras, transforms, warnings=tuple(warning for each in values.values() for warning in each.warnings)
    )


def _apart(values: Values, name: str) -> list[Message]:
    if _has_imu(values):
        return []
    text = "no transform to another camera or the IMU"
    return [Message("unplaced_camera", text, where=f"{values.document.where}: {name}")]


def _has_imu(values: Values) -> bool:
    return "T_cam_imu" in values or "T_imu_cam" in values


def _of_imu(values: Values, name: str, file: CameraFile) -> dict[str, Transform]:
    """Return the transform from the IMU to a camera, if it is not known from the cameras before."""
    if not _has_imu(values):
        return {}
    key = "T_cam_imu" if "T_cam_imu" in values else "T_imu_cam"
    pose = _pose(values, key)
    pose = pose if key == "T_cam_imu" else pose.inverse()
    known = pose_between(file, name, IMU)
    if known is None:
        return {f"{name}{JOINT}{IMU}": Transform(pose)}
    apart = float(np.abs(known.matrix() - pose.matrix()).max())
    if apart > _AGREE:
        text = f"differs from the chain by T_cn_cnm1 by {apart:.2g}: the chain is used"
        values.warn("inconsistent_chain", key, text)
    return {}


def _pose(values: Values, key: str) -> Pose:
    matrix = values.matrix(key, 4, 4)
    if not np.allclose(matrix[3], (0, 0, 0, 1), rtol=0, atol=1e-9):
        raise values.wrong(key, f"its last row is {matrix[3].tolist()}, not 0 0 0 1")
    return values.pose(key, matrix[:3, :3], matrix[:3, 3])


def _entry(values: Values, given: Given) -> CameraEntry:
    kind = values.text("camera_model")
    if kind != "pinhole":
        raise values.wrong("camera_model", f"{kind!r} is not among camcal's lens models; pinhole is: {_ADVICE}")
    lens = values.text("distortion_model") or "none"
    if lens not in _LENSES:
        raise values.wrong("distortion_model", f"{lens!r} is not one of {', '.join(MODELS.values())}: {_ADVICE}")
    model = _LENSES[lens]
    fx, fy, cx, cy = values.numbers("intrinsics", 4).tolist()
    values.require_focal("intrinsics", fx, fy)
    count = _COUNTS[model]
    coefficients = values.numbers("distortion_coeffs", count) if count else np.zeros(0)
    size = given.size(values.sides("resolution") if "resolution" in values else None, values.document.where)
    kept = {key: values.data[key] for key in _KEPT if key in values}
    return CameraEntry(camera_of(model, size, (fx, fy, cx, cy), coefficients), extra={VENDOR_KEY: kept} if kept else {})


def write(path: Path, file: CameraFile) -> None:
    """Write the cameras, in their order as cam0, cam1, …, with the transforms between them and from the IMU.

    Raises InvalidInput if a camera's place beside the one before is not known, FileError.
    """
    data: dict[str, Any] = {}
    names = list(file.cameras)
    for index, (name, entry) in enumerate(file.cameras.items()):
        own = entry.extra.get(VENDOR_KEY)
        own = own if isinstance(own, dict) else {}
        block: dict[str, Any] = {}
        if index:
            pose = pose_between(file, name, names[index - 1])
            if pose is None:
                what = f"a camchain needs a transform between {name} and {names[index - 1]}"
                raise InvalidInput(f"{what}; write the cameras one by one, FILE#NAME", where=str(path))
            block["T_cn_cnm1"] = pose.matrix().tolist()
        if (of_imu := pose_between(file, name, IMU)) is not None:
            block["T_cam_imu"] = of_imu.matrix().tolist()
        camera = entry.camera
        block |= {
            "cam_overlaps": own.get("cam_overlaps", [other for other in range(len(names)) if other != index]),
            "camera_model": "pinhole",
            "distortion_coeffs": camera.parameters[4:].tolist(),
            "distortion_model": MODELS[camera.model.name],
            "intrinsics": camera.parameters[:4].tolist(),
            "resolution": list(camera.image_size),
            "rostopic": own.get("rostopic", f"/cam{index}/image_raw"),
            **{key: own[key] for key in ("timeshift_cam_imu", "line_delay") if key in own},
        }
        data[f"cam{index}"] = block
    files.write_text(path, emit.document(data, number=emit.exact_text))


FORMAT = CameraFormat(
    name="kalibr",
    title="Kalibr camchain",
    suffixes=(".yaml", ".yml"),
    models=tuple(MODELS),
    read=read,
    write=write,
    frames=frozenset({IMU}),
)
