"""RealSense's rs2_intrinsics as JSON, one camera or several by their names.

Source: librealsense's rs_types.h: modified and inverse Brown-Conrady are other functions than OpenCV's, unless all
their coefficients are 0.
"""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from camcal import files
from camcal.cameras.model import Camera
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.formats.cameras.lenses import Lenses
from camcal.formats.cameras.record import CAMERA, CameraFormat, Given, Source, name_of
from camcal.formats.cameras.syntax import json_text, json_values
from camcal.formats.cameras.values import Values

LENSES = Lenses("""
    none pinhole fx fy ppx=cx ppy=cy coeff=0? coeff=0? coeff=0? coeff=0? coeff=0?
    brown_conrady opencv5 fx fy ppx=cx ppy=cy k1? k2? p1? p2? k3?
    kannala_brandt4 kannala_brandt4 fx fy ppx=cx ppy=cy k1 k2 k3 k4 coeff=0?
    inverse_brown_conrady pinhole fx fy ppx=cx ppy=cy coeff=0? coeff=0? coeff=0? coeff=0? coeff=0?
    modified_brown_conrady pinhole fx fy ppx=cx ppy=cy coeff=0? coeff=0? coeff=0? coeff=0? coeff=0?
    ftheta fov fx fy ppx=cx ppy=cy w=omega coeff=0? coeff=0? coeff=0? coeff=0?
""")  # fmt: skip
_NUMBERED = ("none", "modified_brown_conrady", "inverse_brown_conrady", "ftheta", "brown_conrady", "kannala_brandt4")


def read(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the cameras; raises InvalidInput for a lens that camcal does not have, MissingSize, FileError."""
    values = json_values(sources[0])
    if "ppx" in values:
        return CameraFile({CAMERA: CameraEntry(_camera(values, given))})
    below = {key: values.below(key) for key, item in values.data.items() if isinstance(item, dict)}
    below = {key: each.below("intrinsics") if "intrinsics" in each else each for key, each in below.items()}
    found = {name_of(key): CameraEntry(_camera(each, given)) for key, each in below.items() if "ppx" in each}
    if not found:
        raise values.wrong("", "has no intrinsics with ppx: give those of rs-enumerate-devices -c")
    return CameraFile(found)


def _camera(values: Values, given: Given) -> Camera:
    told = values.data.get("model", values.data.get("distortion_model", "none"))
    word = _NUMBERED[told] if isinstance(told, int) and 0 <= told < len(_NUMBERED) else str(told).lower()
    word = re.sub(r"^(?:rs2_)?distortion[._]", "", word.replace(" ", "_").replace("-", "_"))
    key = "coeffs" if "coeffs" in values else "distortion_coeffs"
    coefficients = values.numbers(key) if key in values else np.zeros(5)
    numbers = np.array([values.number(name) for name in ("fx", "fy", "ppx", "ppy")])
    size = (values.side("width"), values.side("height")) if "width" in values else None
    size = given.size(size, values.document.where)
    return LENSES.listed(values, key, LENSES.of(values, "model", word), size, np.concatenate([numbers, coefficients]))


def write(path: Path, file: CameraFile) -> None:
    """Write a camera; raises FileError."""
    (entry,) = file.cameras.values()
    lens, numbers = LENSES.written(entry.camera)
    width, height = entry.camera.image_size
    core = {key: numbers[key] for key in ("ppx", "ppy", "fx", "fy")}
    coefficients = [value for key, value in numbers.items() if key not in core]
    coefficients += [0.0] * (5 - len(coefficients))
    files.write_text(
        path, json_text({"width": width, "height": height, **core, "model": lens.word, "coeffs": coefficients})
    )


FORMAT = CameraFormat(
    name="realsense",
    title="RealSense intrinsics",
    suffixes=(".json",),
    models=LENSES.models,
    read=read,
    write=write,
    lenses=LENSES,
    most_cameras=1,
    note="rs2_intrinsics; the camera itself keeps its own calibration",
)
