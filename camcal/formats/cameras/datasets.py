"""The calibrations of public data sets: KITTI, Middlebury and ETH3D, EuRoC.

KITTI, calib.txt of rectified images (P0 … P3) and calib_cam_to_cam.txt of the raw ones (S, K, D, R, T), read only:
P = K [1 | t] has the place of a rectified camera beside camera 0; R_0n, T_0n take points of camera 0 to camera n,
metres. Source: the development kits of odometry and raw data.
Middlebury and ETH3D, calib.txt, read only: a rectified pair, cam0 and cam1, baseline in mm.
Source: vision.middlebury.edu/stereo/data/scenes2014.
EuRoC, sensor.yaml of a camera: T_BS takes points of the sensor to the body, metres: body_T_camera.
Source: the data set's cam0/sensor.yaml.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from camcal import files
from camcal.formats import emit
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform, pose_between
from camcal.formats.cameras.record import CAMERA, LEFT, RIGHT, CameraFormat, Given, Source, read_only
from camcal.formats.cameras.syntax import assigned
from camcal.formats.cameras.values import Lenses, Values
from camcal.formats.documents import parse_foreign
from camcal.geometry.pose import JOINT, Pose

KITTI_LENSES = Lenses("""
    P pinhole fx fy cx cy
    K opencv5 fx fy cx cy k1 k2 p1 p2 k3
""")  # fmt: skip

MIDDLEBURY_LENSES = Lenses("pinhole pinhole fx fy cx cy")
_MILLIMETRES = 1e3

BODY = "body"
EUROC_LENSES = Lenses("""
    none pinhole fx fy cx cy
    radial-tangential opencv4 fx fy cx cy k1 k2 p1 p2
    equidistant kannala_brandt4 fx fy cx cy k1 k2 k3 k4
""")  # fmt: skip


def read_kitti(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the cameras cam0, cam1, …; raises InvalidInput, MissingSize for rectified ones without --size."""
    values = assigned(sources[0], r"^[ \t]*(\w+):(.*)$")
    raw = [index for index in range(4) if f"K_0{index}" in values]
    where = values.document.where
    cameras, places = {}, {}
    for index in raw or [index for index in range(4) if _projection(values, index) in values]:
        name = f"cam{index}"
        if raw:
            size = given.size(values.sides(f"S_0{index}") if f"S_0{index}" in values else None, where)
            camera = KITTI_LENSES.matrix(values, f"K_0{index}", f"D_0{index}", KITTI_LENSES.rows[1:], size)
            turn = values.matrix(f"R_0{index}", 3, 3)
            places[name] = values.pose(f"R_0{index}", turn, values.numbers(f"T_0{index}", 3))
        else:
            matrix = values.matrix(_projection(values, index), 3, 4)
            every = Values(values.document, "", {"P": matrix[:, :3].tolist()})
            camera = KITTI_LENSES.matrix(every, "P", "", KITTI_LENSES.rows[:1], given.size(None, where))
            places[name] = Pose(np.eye(3), np.linalg.solve(matrix[:, :3], matrix[:, 3]))
        cameras[name] = CameraEntry(camera)
    first = next(iter(cameras), "")
    transforms = {
        f"{name}{JOINT}{first}": Transform(pose @ places[first].inverse())
        for name, pose in places.items()
        if name != first
    }
    return CameraFile(cameras, transforms, warnings=tuple(values.warnings))


def _projection(values: Values, index: int) -> str:
    return f"P{index}" if f"P{index}" in values else f"P_rect_0{index}"


KITTI = CameraFormat(
    name="kitti",
    title="KITTI calib.txt",
    suffixes=(),
    models=KITTI_LENSES.models,
    read=read_kitti,
    write=read_only("KITTI"),
    lenses=KITTI_LENSES,
    poses="P: camera_T_cam0; R_0n, T_0n: camera_T_cam0",
)


def read_middlebury(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the pair; raises InvalidInput, MissingSize without width and height."""
    values = assigned(sources[0], r"^[ \t]*(\w+)[ \t]*=(.*)$")
    size = (values.side("width"), values.side("height")) if "width" in values else None
    size = given.size(size, values.document.where)
    sides = [(LEFT, "cam0"), (RIGHT, "cam1")]
    cameras = {
        name: CameraEntry(MIDDLEBURY_LENSES.matrix(values, key, "", MIDDLEBURY_LENSES.rows, size))
        for name, key in sides
        if key in values
    }
    pose = Pose(np.eye(3), np.array([-values.number("baseline") / _MILLIMETRES, 0.0, 0.0]))
    return CameraFile(cameras, {f"{RIGHT}{JOINT}{LEFT}": Transform(pose)} if len(cameras) == 2 else {})


MIDDLEBURY = CameraFormat(
    name="middlebury",
    title="Middlebury calib.txt",
    suffixes=(),
    models=MIDDLEBURY_LENSES.models,
    read=read_middlebury,
    write=read_only("Middlebury"),
    lenses=MIDDLEBURY_LENSES,
    most_cameras=2,
    poses="baseline: right_T_left along x, mm",
)


def read_euroc(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the camera with its place on the body; raises InvalidInput for another sensor, MissingSize, FileError."""
    values = Values(parse_foreign(sources[0].text, str(sources[0].path)))
    kind = values.text("sensor_type") or "camera"
    if kind != "camera" or "intrinsics" not in values:
        raise values.wrong("sensor_type", f"{kind!r} is no camera: give cam0/sensor.yaml")
    rows = EUROC_LENSES.of(values, "distortion_model", values.text("distortion_model") or "none")
    size = given.size(values.sides("resolution") if "resolution" in values else None, values.document.where)
    coefficients = (
        values.numbers("distortion_coefficients") if values.data.get("distortion_coefficients") else np.zeros(0)
    )
    numbers = np.concatenate([values.numbers("intrinsics", 4), coefficients])
    camera = EUROC_LENSES.listed(values, "distortion_coefficients", rows, size, numbers)
    pose = Transform(values.rigid("T_BS"))
    return CameraFile({CAMERA: CameraEntry(camera)}, {f"{BODY}{JOINT}{CAMERA}": pose}, warnings=tuple(values.warnings))


def write_euroc(path: Path, file: CameraFile) -> None:
    """Write a camera; its place is the identity where the file has no body; raises FileError."""
    ((name, entry),) = file.cameras.items()
    lens, numbers = EUROC_LENSES.written(entry.camera)
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
    files.write_text(path, emit.document(data, EUROC.note, number=emit.exact_text))


EUROC = CameraFormat(
    name="euroc",
    title="EuRoC sensor.yaml",
    suffixes=(".yaml", ".yml"),
    models=EUROC_LENSES.models,
    read=read_euroc,
    write=write_euroc,
    lenses=EUROC_LENSES,
    most_cameras=1,
    frames=frozenset({BODY}),
    poses="T_BS: body_T_camera",
    note="T_BS takes points of the camera to the body; set rate_hz",
)
