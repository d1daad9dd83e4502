"""Cameras of VINS-Fusion (camodocal): one camera a file; body_T_cam0 stands in the configuration and is not read.

KANNALA_BRANDT counts its coefficients from k2. Source: camodocal's camera_models, src/camera_models/*.cc.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from camcal import files
from camcal.cameras.model import Camera
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.formats.cameras.lenses import Lenses
from camcal.formats.cameras.ocamcalib import polynomial_camera
from camcal.formats.cameras.record import CameraFormat, Given, Source, name_of
from camcal.formats.cameras.values import Values
from camcal.formats.documents import parse_foreign
from camcal.formats.emit import exact_text

LENSES = Lenses("""
    PINHOLE opencv4 fx fy cx cy k1 k2 p1 p2
    PINHOLE_FULL opencv8 fx fy cx cy k1 k2 k3 k4 k5 k6 p1 p2
    KANNALA_BRANDT kannala_brandt4 mu=fx mv=fy u0=cx v0=cy k2=k1 k3=k2 k4=k3 k5=k4
    MEI mei gamma1=fx gamma2=fy u0=cx v0=cy xi k1 k2 p1 p2
""")  # fmt: skip
_SECTIONS = ("mirror_parameters", "distortion_parameters", "projection_parameters")


def read(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the camera; raises InvalidInput for a lens that camcal does not have, MissingSize, FileError."""
    values = Values(parse_foreign(sources[0].text, str(sources[0].path)))
    if values.text("model_type").lower() == "scaramuzza":
        return CameraFile({name_of(values.text("camera_name")): CameraEntry(_polynomial(values, given))})
    rows = LENSES.of(values, "model_type", values.text("model_type"))
    parts = [values.below(section).data for section in _SECTIONS if section in values]
    every = Values(values.document, "", {key: item for part in parts for key, item in part.items()})
    size = (values.side("image_width"), values.side("image_height")) if "image_width" in values else None
    camera = LENSES.keyed(every, rows, given.size(size, values.document.where))
    return CameraFile({name_of(values.text("camera_name")): CameraEntry(camera)})


def _polynomial(values: Values, given: Given) -> Camera:
    terms, affine = values.below("poly_parameters"), values.below("affine_parameters")
    polynomial = np.array([terms.number(f"p{power}") for power in range(5)])
    stretch = np.array([[affine.number("ac"), affine.number("ad")], [affine.number("ae"), 1.0]])
    size = given.size((values.side("image_width"), values.side("image_height")), values.document.where)
    centre = affine.number("cx"), affine.number("cy")
    return polynomial_camera(size, polynomial, stretch, centre, values.document.where)


def write(path: Path, file: CameraFile) -> None:
    """Write a camera; raises FileError."""
    ((name, entry),) = file.cameras.items()
    lens, numbers = LENSES.written(entry.camera)
    width, height = entry.camera.image_size
    lines = ["%YAML:1.0", "---", f"# {FORMAT.note}", f"model_type: {lens.word}", f"camera_name: {name}"]
    lines += [f"image_width: {width}", f"image_height: {height}"]
    core = [own.key for own in lens.keys if own.name in ("fx", "fy", "cx", "cy")]
    mirror = [key for key in numbers if key == "xi"]
    distortion = [key for key in numbers if key not in (*core, *mirror)]
    sections = dict(zip(_SECTIONS, (mirror, distortion, core), strict=True))
    if lens.word == "KANNALA_BRANDT":
        sections = {_SECTIONS[-1]: [*distortion, *core]}
    sections = {section: keys for section, keys in sections.items() if keys}
    for section, keys in sections.items():
        lines += [f"{section}:", *(f"   {key}: {exact_text(numbers[key])}" for key in keys)]
    files.write_text(path, "\n".join([*lines, ""]))


FORMAT = CameraFormat(
    name="vins",
    title="VINS-Fusion camera",
    suffixes=(".yaml", ".yml"),
    models=LENSES.models,
    read=read,
    write=write,
    lenses=LENSES,
    most_cameras=1,
    poses="not in the file (configuration: body_T_cam0)",
    note="name this file under cam0_calib, and write body_T_cam0 into the configuration",
)
