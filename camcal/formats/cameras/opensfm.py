"""OpenSfM's and ODM's cameras.json, camera_models.json and reconstruction.json.

Lengths are in units of the longer side, and the principal point is counted from the middle of the image. Poses of
images are not read. Source: opensfm's src/geometry/src/camera.cc, io.py.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from camcal import files
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.formats.cameras.lenses import Lenses
from camcal.formats.cameras.record import CameraFormat, Given, Source, name_of
from camcal.formats.cameras.syntax import json_text, json_values
from camcal.formats.cameras.values import Values

_CORE = "focal_x=fx focal_y=fy c_x=cx c_y=cy"
LENSES = Lenses(
    f"""
    perspective opencv4 focal=f k1? k2?
    simple_radial opencv4 {_CORE} k1
    radial opencv4 {_CORE} k1 k2
    brown opencv5 {_CORE} k1 k2 p1 p2 k3
    fisheye kannala_brandt4 focal=f k1? k2?
    fisheye_opencv kannala_brandt4 {_CORE} k1 k2 k3 k4
    fisheye62 fisheye62 {_CORE} k1 k2 k3 k4 k5 k6 p1 p2
    fisheye624 opensfm_fisheye624 {_CORE} k1 k2 k3 k4 k5 k6 p1 p2 s0 s1 s2 s3
    dual dual focal=f k1 k2 transition
    spherical panorama
    """,
    centred=True,
    of_longer_side=True,
    instead="set camera_projection_type: BROWN or FISHEYE_OPENCV, or give the undistorted images",
)


def read(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the cameras; raises InvalidInput for a lens that camcal does not have, MissingSize, FileError."""
    text = re.sub(r"\A\s*\[(.*)\]\s*\Z", r"\1", sources[0].text, flags=re.DOTALL)  # a list of one reconstruction
    values = json_values(sources[0]._replace(text=text))
    values = values.below("cameras") if "cameras" in values else values
    cameras: dict[str, CameraEntry] = {}
    for key, data in values.data.items():
        if isinstance(data, dict) and "projection_type" in data:
            each = values.below(key)
            rows = LENSES.of(each, "projection_type", each.text("projection_type"))
            size = (each.side("width"), each.side("height")) if "width" in each else None
            size = given.size(size, values.document.where)
            name = name_of(key) if name_of(key) not in cameras else f"camera_{len(cameras)}"
            cameras[name] = CameraEntry(
                LENSES.keyed(_with_one_focal(each), rows, size), extra={"x_opensfm": {"id": key}}
            )
    if not cameras:
        raise values.wrong("", "has no camera with a projection_type: give cameras.json")
    return CameraFile(cameras)


def _with_one_focal(values: Values) -> Values:
    """Return values in which a focal length without an axis stands for both, as older versions write it."""
    data = dict(values.data)
    for key in ("focal_x", "focal_y"):
        data.setdefault(key, data.get("focal"))
    return Values(values.document, values.path, data)


def write(path: Path, file: CameraFile) -> None:
    """Write the cameras under their ids, or their names; raises FileError."""
    data: dict[str, Any] = {}
    for name, entry in file.cameras.items():
        lens, numbers = LENSES.written(entry.camera)
        own = entry.extra.get("x_opensfm")
        width, height = entry.camera.image_size
        key = own["id"] if isinstance(own, dict) and "id" in own else f"v2 {name} camcal {width} {height} {lens.word} 0"
        data[str(key)] = {"projection_type": lens.word, "width": width, "height": height, **numbers}
    files.write_text(path, json_text(data))


def usage(file: CameraFile) -> str:
    """Return where the file goes, and what ODM leaves out of it."""
    lost = any(len(LENSES.written(entry.camera)[1]) > 4 and "k4" in entry.camera.model.parameter_names
               for entry in file.cameras.values())  # fmt: skip
    return FORMAT.note + ("; ODM drops k4 of such a lens" if lost else "")


FORMAT = CameraFormat(
    name="opensfm",
    title="OpenSfM cameras",
    suffixes=(".json",),
    models=LENSES.models,
    read=read,
    write=write,
    usage=usage,
    lenses=LENSES,
    poses="not read",
    note="rename it to camera_models_overrides.json, or give it to ODM with --cameras",
)
