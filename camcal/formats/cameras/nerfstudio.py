"""transforms.json of nerfstudio and instant-ngp: the camera of all frames, or the cameras of single ones.

The centre of the top-left pixel is 0.5, 0.5. camera_model OPENCV or OPENCV_FISHEYE is nerfstudio's, is_fisheye
instant-ngp's. Poses of frames are not read. A fisheye is written without p1 and p2, which instant-ngp puts in the
place of k3 and k4. Source: nerfstudio's docs/quickstart/data_conventions.md, instant-ngp's src/nerf_loader.cu.
"""

import math
from collections.abc import Sequence
from pathlib import Path

from camcal import files
from camcal.cameras.model import Camera
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.formats.cameras.lenses import Lenses
from camcal.formats.cameras.record import CAMERA, CameraFormat, Given, Source
from camcal.formats.cameras.syntax import json_text, json_values
from camcal.formats.cameras.values import Values

LENSES = Lenses(
    """
    OPENCV pinhole fl_x=fx fl_y=fy cx cy
    OPENCV opencv4 fl_x=fx fl_y=fy cx cy k1? k2? p1? p2?
    OPENCV opencv5 fl_x=fx fl_y=fy cx cy k1? k2? k3? p1? p2? k4=0?
    OPENCV_FISHEYE kannala_brandt4 fl_x=fx fl_y=fy cx cy k1? k2? k3? k4?
    PINHOLE pinhole fl_x=fx fl_y=fy cx cy
    SIMPLE_PINHOLE pinhole fl_x=fx fl_y=fy cx cy
    EQUIRECTANGULAR panorama
    """,
    origin=0.5,
)
_OF_LENS = ("fl_x", "fl_y", "camera_angle_x", "camera_angle_y", "cx", "cy", "w", "h", "camera_model", "is_fisheye",
            "k1", "k2", "k3", "k4", "p1", "p2")  # fmt: skip


def read(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the camera of all frames, or those of single frames; raises InvalidInput, MissingSize, FileError."""
    values = json_values(sources[0])
    if "fl_x" in values or "camera_angle_x" in values:
        return CameraFile({CAMERA: CameraEntry(_camera(values, given))})
    found: dict[tuple[object, ...], Camera] = {}
    for frame in values.each("frames") if "frames" in values else ():
        key = tuple(map(str, (frame.data.get(name) for name in _OF_LENS)))
        if key not in found and "fl_x" in frame:
            found[key] = _camera(frame, given)
    if not found:
        raise values.wrong("", "has poses and no lens (fl_x): give the camera file that they were made with")
    names = [f"{CAMERA}_{place}" for place in range(1, len(found) + 1)] if len(found) > 1 else [CAMERA]
    return CameraFile({name: CameraEntry(each) for name, each in zip(names, found.values(), strict=True)})


def _camera(values: Values, given: Given) -> Camera:
    size = (values.side("w"), values.side("h")) if "w" in values and "h" in values else None
    size = given.size(size, values.document.where)
    data = dict(values.data)
    for axis, side, key, angle in ((0, size[0], "fl_x", "camera_angle_x"), (1, size[1], "fl_y", "camera_angle_y")):
        if data.get(key) is None and data.get(angle) is not None:
            if not 0 < values.number(angle) < math.pi:
                raise values.wrong(angle, "is not between 0 and pi")
            data[key] = side / 2 / math.tan(values.number(angle) / 2)
        if data.get(f"c{'xy'[axis]}") is None:
            data[f"c{'xy'[axis]}"] = side / 2
    data["fl_y"] = data.get("fl_y") or data.get("fl_x")
    word = values.text("camera_model") or ("OPENCV_FISHEYE" if values.data.get("is_fisheye") is True else "OPENCV")
    every = Values(values.document, values.path, data)
    return LENSES.keyed(every, LENSES.of(values, "camera_model", word), size)


def write(path: Path, file: CameraFile) -> None:
    """Write one camera as the head of a transforms.json, without frames; raises FileError."""
    (entry,) = file.cameras.values()
    lens, numbers = LENSES.written(entry.camera)
    width, height = entry.camera.image_size
    fisheye = lens.word == "OPENCV_FISHEYE"
    angles = {
        f"camera_angle_{axis}": 2 * math.atan(side / 2 / numbers[f"fl_{axis}"])
        for axis, side in (() if fisheye else (("x", width), ("y", height)))
    }
    data = {
        "comment": usage(file),
        "camera_model": lens.word,
        **({"is_fisheye": True} if fisheye else {}),
        "w": width,
        "h": height,
        **angles,
        **numbers,
        "frames": [],
    }
    files.write_text(path, json_text(data))


def usage(file: CameraFile) -> str:
    """Return what has to be added, and which of the two programs reads the lens."""
    (entry,) = file.cameras.values()
    _, numbers = LENSES.written(entry.camera)
    known = "; instant-ngp has no k3 of this lens" if "p1" in numbers and numbers.get("k3") else ""
    return f"{FORMAT.note}{known}"


FORMAT = CameraFormat(
    name="nerfstudio",
    title="nerfstudio transforms.json",
    suffixes=(".json",),
    models=LENSES.models,
    read=read,
    write=write,
    usage=usage,
    lenses=LENSES,
    most_cameras=1,
    poses="not read (frames: world_T_camera, OpenGL axes)",
    note="add frames: file_path and transform_matrix, world_T_camera with OpenGL axes (x right, y up, z back)",
)
