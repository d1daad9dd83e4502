"""OCamCalib's calib_results.txt, read only, the cameras of VINS-Fusion (camodocal), and polynomial cameras of both.

OCamCalib has the centre as row and column, and [c d; e 1] acts on (row, column); there and in VINS-Fusion the
polynomial is that of a third axis backward, so that its first coefficient is below zero. In VINS-Fusion and MATLAB
[c d; e 1] acts on (u, v); MATLAB counts pixels from 1. The inverse polynomial is an approximation and is not read.
Source: Scaramuzza's OCamCalib toolbox, cam2world.c; camodocal, ScaramuzzaCamera.cc; MATLAB's fisheyeIntrinsics.

VINS-Fusion has one camera a file; body_T_cam0 stands in the configuration and is not read. KANNALA_BRANDT counts its
coefficients from k2. Source: camodocal's camera_models, src/camera_models/*.cc.
"""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.formats.cameras.record import CAMERA, CameraFormat, Given, Source, name_of, read_only
from camcal.formats.cameras.values import Lenses, Values
from camcal.formats.documents import parse_foreign
from camcal.formats.emit import exact_text

_MOST = 5  # coefficients, of the powers 0 to 4

VINS_LENSES = Lenses("""
    PINHOLE opencv4 fx fy cx cy k1 k2 p1 p2
    PINHOLE_FULL opencv8 fx fy cx cy k1 k2 k3 k4 k5 k6 p1 p2
    KANNALA_BRANDT kannala_brandt4 mu=fx mv=fy u0=cx v0=cy k2=k1 k3=k2 k4=k3 k5=k4
    MEI mei gamma1=fx gamma2=fy u0=cx v0=cy xi k1 k2 p1 p2
""")  # fmt: skip
_SECTIONS = ("mirror_parameters", "distortion_parameters", "projection_parameters")


def polynomial_camera(
    size: tuple[int, int], polynomial: Array, stretch: Array, centre: tuple[float, float], where: str
) -> Camera:
    """Return the camera whose rays are (x, y, -Σ a_i r^i), u, v = stretch (2, 2) · (x, y) + centre, all in pixels.

    polynomial: (N,) the a_i, a_0 < 0, a_1 = 0. Raises InvalidInput for any other, and for more than five.
    """
    padded = np.pad(polynomial, (0, max(_MOST - len(polynomial), 0)))
    focal = -float(padded[0])
    if not (focal > 0 and padded[1] == 0 and len(padded) == _MOST and (np.diag(stretch) > 0).all()):
        what = "is no polynomial of degree 2 to 4 without a linear term, whose first coefficient is that of a lens"
        raise InvalidInput(f"{what}: calibrate with --model ocam", where=where)
    terms = -padded[2:] * focal ** np.arange(1, 4)
    core = [focal * stretch[0, 0], focal * stretch[1, 1], *centre]
    shears = [stretch[0, 1] / stretch[0, 0], stretch[1, 0] / stretch[1, 1]]
    return Camera(model_named("ocam"), size, np.array([*core, *terms, *shears]))


def read_ocamcalib(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the camera; raises InvalidInput for what is missing, or of a lens that camcal does not have."""
    where = str(sources[0].path)
    lines = [line for line in sources[0].text.splitlines() if re.match(r"\s*[-+.\d]", line)]
    try:
        numbers = [np.array([float(word) for word in line.split()]) for line in lines[:5]]
        (count, *polynomial), _, (row, column), (c, d, e), (height, width) = (each.tolist() for each in numbers)
    except ValueError as error:
        what = "has not polynomial, inverse, center, affine parameters and image size, each on its line of numbers"
        raise InvalidInput(what, where=where) from error
    if count != len(polynomial) or not np.isfinite(np.concatenate(numbers)).all():
        raise InvalidInput(f"has {len(polynomial)} coefficients where it counts {count:g}, or no numbers", where=where)
    size = given.size((int(width), int(height)), where)
    stretch = np.array([[1.0, e], [d, c]])
    return CameraFile(
        {CAMERA: CameraEntry(polynomial_camera(size, np.array(polynomial), stretch, (column, row), where))}
    )


OCAMCALIB = CameraFormat(
    name="ocamcalib",
    title="OCamCalib calib_results.txt",
    suffixes=(),
    models=("ocam",),
    read=read_ocamcalib,
    write=read_only("OCamCalib"),
)


def read_vins(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the camera; raises InvalidInput for a lens that camcal does not have, MissingSize, FileError."""
    values = Values(parse_foreign(sources[0].text, str(sources[0].path)))
    if values.text("model_type").lower() == "scaramuzza":
        return CameraFile({name_of(values.text("camera_name")): CameraEntry(_polynomial(values, given))})
    rows = VINS_LENSES.of(values, "model_type", values.text("model_type"))
    parts = [values.below(section).data for section in _SECTIONS if section in values]
    every = Values(values.document, "", {key: item for part in parts for key, item in part.items()})
    size = (values.side("image_width"), values.side("image_height")) if "image_width" in values else None
    camera = VINS_LENSES.keyed(every, rows, given.size(size, values.document.where))
    return CameraFile({name_of(values.text("camera_name")): CameraEntry(camera)})


def _polynomial(values: Values, given: Given) -> Camera:
    terms, affine = values.below("poly_parameters"), values.below("affine_parameters")
    polynomial = np.array([terms.number(f"p{power}") for power in range(5)])
    stretch = np.array([[affine.number("ac"), affine.number("ad")], [affine.number("ae"), 1.0]])
    size = given.size((values.side("image_width"), values.side("image_height")), values.document.where)
    centre = affine.number("cx"), affine.number("cy")
    return polynomial_camera(size, polynomial, stretch, centre, values.document.where)


def write_vins(path: Path, file: CameraFile) -> None:
    """Write a camera; raises FileError."""
    ((name, entry),) = file.cameras.items()
    lens, numbers = VINS_LENSES.written(entry.camera)
    width, height = entry.camera.image_size
    lines = ["%YAML:1.0", "---", f"# {VINS.note}", f"model_type: {lens.word}", f"camera_name: {name}"]
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


VINS = CameraFormat(
    name="vins",
    title="VINS-Fusion camera",
    suffixes=(".yaml", ".yml"),
    models=VINS_LENSES.models,
    read=read_vins,
    write=write_vins,
    lenses=VINS_LENSES,
    most_cameras=1,
    poses="not in the file (configuration: body_T_cam0)",
    note="name this file under cam0_calib, and write body_T_cam0 into the configuration",
)
