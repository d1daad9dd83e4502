"""KITTI's calib.txt of rectified images (P0 … P3) and calib_cam_to_cam.txt of the raw ones (S, K, D, R, T): read only.

P = K [1 | t] has the place of a rectified camera beside camera 0; R_0n, T_0n take points of camera 0 to camera n,
metres. Source: the development kits of odometry and raw data.
"""

from collections.abc import Sequence

import numpy as np

from camcal.formats.camera_file import CameraEntry, CameraFile, Transform
from camcal.formats.cameras.lenses import Lenses
from camcal.formats.cameras.record import CameraFormat, Given, Source, read_only
from camcal.formats.cameras.syntax import assigned
from camcal.formats.cameras.values import Values
from camcal.geometry.pose import JOINT, Pose

LENSES = Lenses("""
    P pinhole fx fy cx cy
    K opencv5 fx fy cx cy k1 k2 p1 p2 k3
""")  # fmt: skip


def read(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the cameras cam0, cam1, …; raises InvalidInput, MissingSize for rectified ones without --size."""
    values = assigned(sources[0], r"^[ \t]*(\w+):(.*)$")
    raw = [index for index in range(4) if f"K_0{index}" in values]
    where = values.document.where
    cameras, places = {}, {}
    for index in raw or [index for index in range(4) if _projection(values, index) in values]:
        name = f"cam{index}"
        if raw:
            size = given.size(values.sides(f"S_0{index}") if f"S_0{index}" in values else None, where)
            camera = LENSES.matrix(values, f"K_0{index}", f"D_0{index}", LENSES.rows[1:], size)
            turn = values.matrix(f"R_0{index}", 3, 3)
            places[name] = values.pose(f"R_0{index}", turn, values.numbers(f"T_0{index}", 3))
        else:
            matrix = values.matrix(_projection(values, index), 3, 4)
            every = Values(values.document, "", {"P": matrix[:, :3].tolist()})
            camera = LENSES.matrix(every, "P", "", LENSES.rows[:1], given.size(None, where))
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


FORMAT = CameraFormat(
    name="kitti",
    title="KITTI calib.txt",
    suffixes=(),
    models=LENSES.models,
    read=read,
    write=read_only("KITTI"),
    lenses=LENSES,
    poses="P: camera_T_cam0; R_0n, T_0n: camera_T_cam0",
)
