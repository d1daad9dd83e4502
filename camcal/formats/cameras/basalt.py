"""Basalt's calibration JSON: cameras cam0, cam1, … with their places on the IMU.

T_imu_cam takes points of a camera to the IMU, a quaternion x y z w and metres. What else Basalt's loader asks for
(noise and bias of an IMU, vignette) is written with its defaults. Source: basalt-headers' calibration.hpp,
serialization/headers.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform, pose_between
from camcal.formats.cameras.record import CameraFormat, Given, Source
from camcal.formats.cameras.syntax import json_text, json_values
from camcal.formats.cameras.values import Lenses, Values
from camcal.geometry import rotation as so3
from camcal.geometry.pose import JOINT, Pose

IMU = "imu"
LENSES = Lenses(
    """
    pinhole pinhole fx fy cx cy
    pinhole-radtan8 opencv8 fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6
    kb4 kannala_brandt4 fx fy cx cy k1 k2 k3 k4
    ds double_sphere fx fy cx cy xi alpha
    ucm ucm fx fy cx cy alpha
    eucm eucm fx fy cx cy alpha beta
    fov fov fx fy cx cy w=omega
    """,
    instead="calibrate there with --cam-types kb4",
)
_NO_IMU: dict[str, Any] = {
    "calib_accel_bias": [0.0] * 9,
    "calib_gyro_bias": [0.0] * 12,
    "imu_update_rate": 200.0,
    "accel_noise_std": [0.016] * 3,
    "gyro_noise_std": [0.000282] * 3,
    "accel_bias_std": [0.001] * 3,
    "gyro_bias_std": [0.0001] * 3,
    "cam_time_offset_ns": 0,
    "vignette": [],
}


def read(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the cameras with their places; raises InvalidInput for a lens that camcal does not have, FileError."""
    values = json_values(sources[0]).below("value0")
    sizes = values.data.get("resolution")
    cameras, transforms = {}, {}
    for index, each in enumerate(values.each("intrinsics")):
        rows = LENSES.of(each, "camera_type", each.text("camera_type"))
        size = None
        if isinstance(sizes, list) and index < len(sizes):
            size = Values(values.document, "resolution", {"size": sizes[index]}).sides("size")
        size = given.size(size, values.document.where)
        cameras[f"cam{index}"] = CameraEntry(LENSES.keyed(each.below("intrinsics"), rows, size))
    for name, place in zip(cameras, values.each("T_imu_cam") if "T_imu_cam" in values else (), strict=False):
        turn = so3.from_quaternion(np.array([place.number(f"q{axis}") for axis in "wxyz"]))
        shift = np.array([place.number(f"p{axis}") for axis in "xyz"])
        transforms[f"{IMU}{JOINT}{name}"] = Transform(Pose(turn, shift))
    return CameraFile(cameras, transforms)


def write(path: Path, file: CameraFile) -> None:
    """Write the cameras; places are counted from the IMU, or from the first camera; raises FileError."""
    first = next(iter(file.cameras))
    places, lenses, sizes = [], [], []
    for name, entry in file.cameras.items():
        lens, numbers = LENSES.written(entry.camera)
        pose = pose_between(file, IMU, name) or pose_between(file, first, name) or Pose.identity()
        quaternion = np.roll(so3.to_quaternion(pose.rotation), -1).tolist()
        values = [*pose.translation.tolist(), *quaternion]
        places.append(dict(zip(("px", "py", "pz", "qx", "qy", "qz", "qw"), values, strict=True)))
        lenses.append({"camera_type": lens.word, "intrinsics": numbers})
        sizes.append(list(entry.camera.image_size))
    data = {"T_imu_cam": places, "intrinsics": lenses, "resolution": sizes, **_NO_IMU}
    files.write_text(path, json_text({"value0": data}))


BASALT = CameraFormat(
    name="basalt",
    title="Basalt calibration",
    suffixes=(".json",),
    models=LENSES.models,
    read=read,
    write=write,
    lenses=LENSES,
    frames=frozenset({IMU}),
    poses="T_imu_cam: imu_T_camera, quaternion x y z w",
    note="noise and biases of the IMU are defaults: set them",
)
