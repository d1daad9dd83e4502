"""Open3D's PinholeCameraIntrinsic as JSON: intrinsic_matrix column by column, without distortion.

Source: Open3D's cpp/open3d/camera/PinholeCameraIntrinsic.cpp.
"""

from collections.abc import Sequence
from pathlib import Path

from camcal import files
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.formats.cameras.lenses import Lenses
from camcal.formats.cameras.record import CAMERA, CameraFormat, Given, Source
from camcal.formats.cameras.syntax import json_text, json_values
from camcal.formats.cameras.values import Values

LENSES = Lenses("pinhole pinhole fx fy cx cy")


def read(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the camera; raises InvalidInput, MissingSize, FileError."""
    values = json_values(sources[0])
    size = (values.side("width"), values.side("height")) if "width" in values else None
    size = given.size(size, values.document.where)
    matrix = values.numbers("intrinsic_matrix", 9).reshape(3, 3)
    every = Values(values.document, "", {"intrinsic_matrix": matrix.T.tolist()})
    return CameraFile({CAMERA: CameraEntry(LENSES.matrix(every, "intrinsic_matrix", "", LENSES.rows, size))})


def write(path: Path, file: CameraFile) -> None:
    """Write a camera; raises FileError."""
    (entry,) = file.cameras.values()
    width, height = entry.camera.image_size
    matrix = entry.camera.K.T.ravel().tolist()
    files.write_text(path, json_text({"width": width, "height": height, "intrinsic_matrix": matrix}))


FORMAT = CameraFormat(
    name="open3d",
    title="Open3D intrinsics",
    suffixes=(".json",),
    models=LENSES.models,
    read=read,
    write=write,
    lenses=LENSES,
    most_cameras=1,
    note="for undistorted images: undistort them with camcal undistort",
)
