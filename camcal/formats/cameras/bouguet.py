"""Calib_Results.m of Bouguet's Camera Calibration Toolbox; its Calib_Results.mat is read by `matlab`.

The centre of the top-left pixel is 0, 0, other than in MATLAB's own functions. alpha_c, the skew, has to be 0. Of a
pair, Calib_Results_stereo, om and T (mm) take points of the left camera to the right one. Source: the toolbox's
saving_calib.m, saving_stereo_calib.m.
"""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from camcal import files
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform
from camcal.formats.cameras.lenses import Lenses
from camcal.formats.cameras.record import CAMERA, LEFT, RIGHT, CameraFormat, Given, Source
from camcal.formats.cameras.syntax import assigned
from camcal.formats.cameras.values import Values
from camcal.formats.emit import exact_text
from camcal.geometry import rotation as so3
from camcal.geometry.pose import JOINT, Pose

LENSES = Lenses("kc opencv5 fx fy cx cy k1 k2 p1 p2 k3", instead="calibrate there without skew (est_alpha = 0)")


def read(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the camera, or the two of a pair; raises InvalidInput, MissingSize."""
    pattern = r"^[ \t]*(\w+)[ \t]*=[ \t]*(\[[^\]]*\]|[-+\d.eE]+)[ \t]*;"
    return camera_of(assigned(sources[0]._replace(text=re.sub(r"%.*", "", sources[0].text)), pattern), given)


def camera_of(values: Values, given: Given) -> CameraFile:
    """Return the cameras of the variables of the toolbox; raises as `read` does."""
    sides = {LEFT: "_left", RIGHT: "_right"} if "fc_left" in values else {CAMERA: ""}
    size = (values.side("nx"), values.side("ny")) if "nx" in values and "ny" in values else None
    size = given.size(size, values.document.where)
    cameras = {}
    for name, side in sides.items():
        if f"alpha_c{side}" in values and values.number(f"alpha_c{side}"):
            raise values.wrong(f"alpha_c{side}", f"skew is in no lens model of camcal: {LENSES.instead}")
        core = values.numbers(f"fc{side}", 2), values.numbers(f"cc{side}", 2)
        coefficients = values.numbers(f"kc{side}", 4, 5) if f"kc{side}" in values else np.zeros(5)
        numbers = np.concatenate([*core, coefficients, np.zeros(5 - len(coefficients))])
        cameras[name] = CameraEntry(LENSES.listed(values, f"kc{side}", LENSES.rows, size, numbers))
    transforms = {}
    if "om" in values and len(cameras) == 2:
        pose = Pose(so3.exp(values.numbers("om", 3)), values.numbers("T", 3) * 1e-3)
        transforms[f"{RIGHT}{JOINT}{LEFT}"] = Transform(pose)
    return CameraFile(cameras, transforms)


def write(path: Path, file: CameraFile) -> None:
    """Write a camera; raises FileError."""
    (entry,) = file.cameras.values()
    fx, fy, cx, cy, *kc = map(exact_text, LENSES.written(entry.camera)[1].values())
    width, height = entry.camera.image_size
    lines = [f"% {FORMAT.note}", f"fc = [ {fx} ; {fy} ];", f"cc = [ {cx} ; {cy} ];", "alpha_c = 0.0;"]
    lines += [f"kc = [ {' ; '.join(kc)} ];", f"nx = {width};", f"ny = {height};", ""]
    files.write_text(path, "\n".join(lines))


FORMAT = CameraFormat(
    name="bouguet",
    title="Bouguet Calib_Results.m",
    suffixes=(".m",),
    models=LENSES.models,
    read=read,
    write=write,
    lenses=LENSES,
    most_cameras=1,
    poses="om, T: right_T_left, mm, read only",
    note="cc counts from 0 at the centre of the top-left pixel, 1 less than MATLAB's own functions",
)
