"""Kalibr's camchain YAML: cameras cam0, cam1, …, each with the transform from the one before it; OpenVINS' as well.

T_cn_cnm1 takes points of camera n-1 to camera n, metres; T_cam_imu those of the IMU to the camera. rostopic,
cam_overlaps, timeshift_cam_imu and line_delay are kept (x_kalibr) and written again. Every number has a dot: Kalibr
refuses whole ones. OpenVINS' kalibr_imucam_chain.yaml is the same under the header of OpenCV, with T_imu_cam, the
inverse.
Sources: kalibr_common/python/kalibr_common/ConfigReader.py; open_vins' ov_core/src/utils/opencv_yaml_parse.h,
config/*/kalibr_imucam_chain.yaml.
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
from camcal.formats.cameras.record import CameraFormat, Given, Source
from camcal.formats.cameras.values import Lenses, Values
from camcal.formats.documents import parse_foreign
from camcal.geometry.pose import JOINT, Pose
from camcal.messages import Message

VENDOR_KEY = "x_kalibr"
IMU = "imu"
KALIBR_LENSES = Lenses(
    """
    pinhole-none pinhole fx fy cx cy
    pinhole-radtan opencv4 fx fy cx cy k1 k2 p1 p2
    pinhole-equidistant kannala_brandt4 fx fy cx cy k1 k2 k3 k4
    pinhole-fov fov fx fy cx cy w=omega
    omni-none mei xi fx fy cx cy
    omni-radtan mei xi fx fy cx cy k1 k2 p1 p2
    ds-none double_sphere xi alpha fx fy cx cy
    eucm-none eucm alpha beta fx fy cx cy
    """,
    instead="calibrate with --models pinhole-radtan or pinhole-equi",
)

_OTHER_WORDS = {"": "none", "radial-tangential": "radtan", "equi": "equidistant"}
_DISTORTION = re.compile(r"[kpw]\d?\Z")
_KEPT = ("rostopic", "cam_overlaps", "timeshift_cam_imu", "line_delay")
_CAMERA = re.compile(r"cam\d+\Z")
_ADVICE = "calibrate with --models pinhole-radtan or pinhole-equi"
_AGREE = 1e-3  # m and of R, to which T_cam_imu of several cameras agree with T_cn_cnm1

OPENVINS_LENSES = Lenses("""
    pinhole-none pinhole fx fy cx cy
    pinhole-radtan opencv4 fx fy cx cy k1 k2 p1 p2
    pinhole-equidistant kannala_brandt4 fx fy cx cy k1 k2 k3 k4
""")


def read_kalibr(sources: Sequence[Source], given: Given) -> CameraFile:
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
            transforms[f"{name}{JOINT}{before}"] = Transform(values[name].rigid("T_cn_cnm1"))
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
    pose = values.rigid(key)
    pose = pose if key == "T_cam_imu" else pose.inverse()
    known = pose_between(file, name, IMU)
    if known is None:
        return {f"{name}{JOINT}{IMU}": Transform(pose)}
    apart = float(np.abs(known.matrix() - pose.matrix()).max())
    if apart > _AGREE:
        text = f"differs from the chain by T_cn_cnm1 by {apart:.2g}: the chain is used"
        values.warn("inconsistent_chain", key, text)
    return {}


def _entry(values: Values, given: Given) -> CameraEntry:
    told = values.text("distortion_model")
    word = f"{values.text('camera_model')}-{_OTHER_WORDS.get(told, told)}"
    rows = KALIBR_LENSES.of(values, "camera_model", word)
    coefficients = values.numbers("distortion_coeffs") if values.data.get("distortion_coeffs") else np.zeros(0)
    size = given.size(values.sides("resolution") if "resolution" in values else None, values.document.where)
    numbers = np.concatenate([values.numbers("intrinsics"), coefficients])
    camera = KALIBR_LENSES.listed(values, "intrinsics", rows, size, numbers)
    kept = {key: values.data[key] for key in _KEPT if key in values}
    return CameraEntry(camera, extra={VENDOR_KEY: kept} if kept else {})


def write_kalibr(path: Path, file: CameraFile) -> None:
    """Write the cameras, in their order as cam0, cam1, …, with the transforms between them and from the IMU.

    Raises InvalidInput if a camera's place beside the one before is not known, FileError.
    """
    files.write_text(path, emit.document(chain_of(path, file), number=emit.exact_text))


def chain_of(path: Path, file: CameraFile) -> dict[str, Any]:
    """Return the data of a camchain; raises as `write` does."""
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
        lens, numbers = KALIBR_LENSES.written(entry.camera)
        camera_model, distortion_model = lens.word.split("-")
        block |= {
            "cam_overlaps": own.get("cam_overlaps", [other for other in range(len(names)) if other != index]),
            "camera_model": camera_model,
            "distortion_coeffs": [value for key, value in numbers.items() if _DISTORTION.match(key)],
            "distortion_model": distortion_model,
            "intrinsics": [value for key, value in numbers.items() if not _DISTORTION.match(key)],
            "resolution": list(entry.camera.image_size),
            "rostopic": own.get("rostopic", f"/cam{index}/image_raw"),
            **{key: own[key] for key in ("timeshift_cam_imu", "line_delay") if key in own},
        }
        data[f"cam{index}"] = block
    return data


KALIBR = CameraFormat(
    name="kalibr",
    title="Kalibr camchain",
    suffixes=(".yaml", ".yml"),
    models=KALIBR_LENSES.models,
    read=read_kalibr,
    write=write_kalibr,
    lenses=KALIBR_LENSES,
    frames=frozenset({IMU}),
    poses="T_cn_cnm1: camera_T_camera before; T_cam_imu: camera_T_imu",
)


def write_openvins(path: Path, file: CameraFile) -> None:
    """Write the cameras as `kalibr.write` does, with the place of each in the IMU; raises as that does."""
    chain = chain_of(path, file)
    for block in chain.values():
        if "T_cam_imu" in block:
            pose = Pose.from_matrix(np.array(block.pop("T_cam_imu")))
            block["T_imu_cam"] = pose.inverse().matrix().tolist()
    text = emit.document(chain, OPENVINS.note, number=emit.exact_text)
    files.write_text(path, text.replace(emit.HEADER, "%YAML:1.0\n---\n", 1))


OPENVINS = CameraFormat(
    name="openvins",
    title="OpenVINS camchain",
    suffixes=(".yaml", ".yml"),
    models=OPENVINS_LENSES.models,
    read=read_kalibr,
    write=write_openvins,
    lenses=OPENVINS_LENSES,
    frames=frozenset({IMU}),
    poses="T_imu_cam: imu_T_camera",
    note="name this file under relative_config_imucam; OpenVINS has no lens but pinhole-radtan and pinhole-equidistant",
)
