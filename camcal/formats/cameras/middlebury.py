"""calib.txt of Middlebury and ETH3D: a rectified pair, cam0 and cam1, baseline in mm: read only.

Source: vision.middlebury.edu/stereo/data/scenes2014.
"""

from collections.abc import Sequence

import numpy as np

from camcal.formats.camera_file import CameraEntry, CameraFile, Transform
from camcal.formats.cameras.lenses import Lenses
from camcal.formats.cameras.record import LEFT, RIGHT, CameraFormat, Given, Source, read_only
from camcal.formats.cameras.syntax import assigned
from camcal.geometry.pose import JOINT, Pose

LENSES = Lenses("pinhole pinhole fx fy cx cy")
_MILLIMETRES = 1e3


def read(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the pair; raises InvalidInput, MissingSize without width and height."""
    values = assigned(sources[0], r"^[ \t]*(\w+)[ \t]*=(.*)$")
    size = (values.side("width"), values.side("height")) if "width" in values else None
    size = given.size(size, values.document.where)
    sides = [(LEFT, "cam0"), (RIGHT, "cam1")]
    cameras = {
        name: CameraEntry(LENSES.matrix(values, key, "", LENSES.rows, size)) for name, key in sides if key in values
    }
    pose = Pose(np.eye(3), np.array([-values.number("baseline") / _MILLIMETRES, 0.0, 0.0]))
    return CameraFile(cameras, {f"{RIGHT}{JOINT}{LEFT}": Transform(pose)} if len(cameras) == 2 else {})


FORMAT = CameraFormat(
    name="middlebury",
    title="Middlebury calib.txt",
    suffixes=(),
    models=LENSES.models,
    read=read,
    write=read_only("Middlebury"),
    lenses=LENSES,
    most_cameras=2,
    poses="baseline: right_T_left along x, mm",
)
