"""MATLAB's cameraParameters, cameraIntrinsics and stereoParameters as structs, and the files of Bouguet's toolbox.

MATLAB's are in a MAT-file (v5 to 7.3) or in JSON, and the centre of the top-left pixel is 1, 1. IntrinsicMatrix of old
releases is the transpose of K; which of the two a matrix is follows from where its zeros are. Objects have to be saved
as structs, toStruct(params). RotationOfCamera2 turns row vectors, PoseCamera2 column vectors; lengths are in
WorldUnits.
Source: MathWorks' documentation of cameraParameters, toStruct, cameraIntrinsicsToOpenCV.

Bouguet's Camera Calibration Toolbox writes Calib_Results.m and Calib_Results.mat. The centre of the top-left pixel is
0, 0. alpha_c, the skew, has to be 0. Of a pair, Calib_Results_stereo, om and T (mm) take points of the left camera to
the right one. Source: the toolbox's saving_calib.m, saving_stereo_calib.m.
"""

import io
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.cameras.model import Camera
from camcal.errors import Located
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform
from camcal.formats.cameras import mat
from camcal.formats.cameras.ocamcalib import polynomial_camera
from camcal.formats.cameras.record import CAMERA, LEFT, RIGHT, CameraFormat, Given, Source
from camcal.formats.cameras.syntax import assigned, json_text, json_values
from camcal.formats.cameras.values import Lenses, Values
from camcal.formats.documents import Document
from camcal.formats.emit import exact_text
from camcal.geometry import rotation as so3
from camcal.geometry.pose import JOINT, Pose

BOUGUET_LENSES = Lenses("kc opencv5 fx fy cx cy k1 k2 p1 p2 k3", instead="calibrate there without skew (est_alpha = 0)")

MATLAB_LENSES = Lenses(
    """
    standard opencv4 fx fy cx cy k1 k2 p1 p2
    standard opencv5 fx fy cx cy k1 k2 k3 p1 p2
    KB kannala_brandt4 fx fy cx cy k1 k2 k3 k4
    """,
    origin=1.0,
    instead="calibrate there with the standard model, or undistort the images there and give their camera",
)
_UNITS = {"": 1e-3, "mm": 1e-3, "millimeters": 1e-3, "cm": 1e-2, "centimeters": 1e-2, "m": 1.0, "meters": 1.0}
_TO_STRUCT = "save the struct, s = toStruct(params); save('camera.mat', 's', '-v7')"
_HEADER = b"MATLAB 5.0 MAT-file, written by camcal".ljust(116)


def read_bouguet(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the camera, or the two of a pair; raises InvalidInput, MissingSize."""
    pattern = r"^[ \t]*(\w+)[ \t]*=[ \t]*(\[[^\]]*\]|[-+\d.eE]+)[ \t]*;"
    return bouguet_camera(assigned(sources[0]._replace(text=re.sub(r"%.*", "", sources[0].text)), pattern), given)


def bouguet_camera(values: Values, given: Given) -> CameraFile:
    """Return the cameras of the variables of the toolbox; raises as `read` does."""
    sides = {LEFT: "_left", RIGHT: "_right"} if "fc_left" in values else {CAMERA: ""}
    size = (values.side("nx"), values.side("ny")) if "nx" in values and "ny" in values else None
    size = given.size(size, values.document.where)
    cameras = {}
    for name, side in sides.items():
        if f"alpha_c{side}" in values and values.number(f"alpha_c{side}"):
            raise values.wrong(f"alpha_c{side}", f"skew is in no lens model of camcal: {BOUGUET_LENSES.instead}")
        core = values.numbers(f"fc{side}", 2), values.numbers(f"cc{side}", 2)
        coefficients = values.numbers(f"kc{side}", 4, 5) if f"kc{side}" in values else np.zeros(5)
        numbers = np.concatenate([*core, coefficients, np.zeros(5 - len(coefficients))])
        cameras[name] = CameraEntry(BOUGUET_LENSES.listed(values, f"kc{side}", BOUGUET_LENSES.rows, size, numbers))
    transforms = {}
    if "om" in values and len(cameras) == 2:
        pose = Pose(so3.exp(values.numbers("om", 3)), values.numbers("T", 3) * 1e-3)
        transforms[f"{RIGHT}{JOINT}{LEFT}"] = Transform(pose)
    return CameraFile(cameras, transforms)


def write_bouguet(path: Path, file: CameraFile) -> None:
    """Write a camera; raises FileError."""
    (entry,) = file.cameras.values()
    fx, fy, cx, cy, *kc = map(exact_text, BOUGUET_LENSES.written(entry.camera)[1].values())
    width, height = entry.camera.image_size
    lines = [f"% {BOUGUET.note}", f"fc = [ {fx} ; {fy} ];", f"cc = [ {cx} ; {cy} ];", "alpha_c = 0.0;"]
    lines += [f"kc = [ {' ; '.join(kc)} ];", f"nx = {width};", f"ny = {height};", ""]
    files.write_text(path, "\n".join(lines))


BOUGUET = CameraFormat(
    name="bouguet",
    title="Bouguet Calib_Results.m",
    suffixes=(".m",),
    models=BOUGUET_LENSES.models,
    read=read_bouguet,
    write=write_bouguet,
    lenses=BOUGUET_LENSES,
    most_cameras=1,
    poses="om, T: right_T_left, mm, read only",
    note="cc counts from 0 at the centre of the top-left pixel, 1 less than MATLAB's own functions",
)


def read_matlab(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the camera, or the two of a stereo pair; raises InvalidInput, MissingSize, FileError."""
    values = _values(sources[0])
    if "fc" in values and "cc" in values:
        return bouguet_camera(values, given)
    found = _first(values, ("CameraParameters1",))
    if found is not None:
        cameras = {
            side: CameraEntry(_matlab_camera(found.below(f"CameraParameters{number}"), given))
            for number, side in ((1, LEFT), (2, RIGHT))
        }
        return CameraFile(cameras, _matlab_pair(found), warnings=tuple(found.warnings))
    found = _first(values, ("K", "IntrinsicMatrix", "MappingCoefficients", "FocalLength", "Intrinsics"))
    if found is None:
        raise values.wrong("", f"holds no camera as a struct: {_TO_STRUCT}")
    if "Intrinsics" in found:
        found = found.below("Intrinsics")
    return CameraFile({CAMERA: CameraEntry(_matlab_camera(found, given))}, warnings=tuple(found.warnings))


def _values(source: Source) -> Values:
    where = str(source.path)
    if not source.binary and source.text.lstrip()[:1] == "{":
        return json_values(source)
    with Located(where):
        return Values(Document(where, mat.variables(files.read_bytes(source.path)), {}))


def _first(values: Values, keys: Sequence[str]) -> Values | None:
    """Return the values that have one of these keys: the whole, or what one variable holds."""
    inner = [values.below(key) for key, item in values.data.items() if isinstance(item, dict)]
    return next((each for each in (values, *inner) if any(key in each for key in keys)), None)


def _matlab_camera(values: Values, given: Given) -> Camera:
    size = None
    if values.data.get("ImageSize"):
        height, width = values.sides("ImageSize")
        size = width, height
    size = given.size(size, values.document.where)
    if "MappingCoefficients" in values:
        first, *others = (-values.numbers("MappingCoefficients", 4)).tolist()
        x, y = (values.numbers("DistortionCenter", 2) - MATLAB_LENSES.origin).tolist()
        stretch = values.matrix("StretchMatrix", 2, 2) if "StretchMatrix" in values else np.eye(2)
        return polynomial_camera(size, np.array([first, 0.0, *others]), stretch, (x, y), values.document.where)
    for key in ("K", "IntrinsicMatrix"):
        if key in values:
            matrix = values.matrix(key, 3, 3)
            data = {**values.data, "matrix": (matrix.T if matrix[2, :2].any() else matrix).tolist()}
    if "K" not in values and "IntrinsicMatrix" not in values:
        (fx, fy), (cx, cy) = values.numbers("FocalLength", 2), values.numbers("PrincipalPoint", 2)
        data = {
            **values.data,
            "matrix": [[fx, values.number("Skew") if "Skew" in values else 0, cx], [0, fy, cy], [0, 0, 1]],
        }
    kannala = "DistortionCoefficients" in values
    radial = values.numbers("RadialDistortion", 2, 3).tolist() if "RadialDistortion" in values else [0.0, 0.0]
    tangential = values.numbers("TangentialDistortion", 2).tolist() if "TangentialDistortion" in values else [0.0, 0.0]
    numbers = values.numbers("DistortionCoefficients", 4).tolist() if kannala else [*radial, *tangential]
    every = Values(values.document, values.path, {**data, "coefficients": numbers})
    return MATLAB_LENSES.matrix(
        every, "matrix", "coefficients", MATLAB_LENSES.of(values, "", "KB" if kannala else "standard"), size
    )


def _matlab_pair(values: Values) -> dict[str, Transform]:
    unit = values.text("WorldUnits") or values.below("CameraParameters1").text("WorldUnits")
    scale = _UNITS.get(unit.lower(), 1e-3)
    if "PoseCamera2" in values:
        pose = values.below("PoseCamera2")
        turn, shift = pose.matrix("R", 3, 3), pose.numbers("Translation", 3)
    elif "RotationOfCamera2" in values:
        turn, shift = values.matrix("RotationOfCamera2", 3, 3).T, values.numbers("TranslationOfCamera2", 3)
    else:
        return {}
    return {f"{RIGHT}{JOINT}{LEFT}": Transform(values.pose("RotationOfCamera2", turn, shift * scale))}


def write_matlab(path: Path, file: CameraFile) -> None:
    """Write a camera as a struct, or as JSON where the suffix says so; raises FileError."""
    (entry,) = file.cameras.values()
    lens, numbers = MATLAB_LENSES.written(entry.camera)
    width, height = entry.camera.image_size
    matrix = [[numbers["fx"], 0.0, numbers["cx"]], [0.0, numbers["fy"], numbers["cy"]], [0.0, 0.0, 1.0]]
    data: dict[str, Any] = {"K": matrix, "ImageSize": [float(height), float(width)]}
    if lens.word == "KB":
        data["DistortionCoefficients"] = [numbers[f"k{order}"] for order in range(1, 5)]
    else:
        data["RadialDistortion"] = [numbers[key] for key in ("k1", "k2", "k3") if key in numbers]
        data["TangentialDistortion"] = [numbers["p1"], numbers["p2"]]
    if path.suffix.lower() == ".json":
        files.write_text(path, json_text({"comment": matlab_usage(file), **data}))
        return
    files.write_bytes(path, _mat(data, matlab_usage(file)))


def matlab_usage(file: CameraFile) -> str:
    """Return with which functions of MATLAB the camera of a file is used; a fisheye's count as OpenCV does."""
    if any(entry.camera.model.name == "kannala_brandt4" for entry in file.cameras.values()):
        return "fisheye: cameraIntrinsicsFromOpenCV with K(1:2,3) - 1, DistortionCoefficients and ImageSize (R2024a)"
    return "cameraIntrinsics([K(1,1) K(2,2)], [K(1,3) K(2,3)], ImageSize, RadialDistortion=…, TangentialDistortion=…)"


def _mat(data: Mapping[str, Any], comment: str) -> bytes:
    """Return a MAT-file with the struct `camera`, the same bytes for the same data."""
    from scipy.io import savemat

    stream: Any = io.BytesIO()
    savemat(stream, {"camera": {**{key: np.array(item) for key, item in data.items()}, "comment": comment}})
    return _HEADER + bytes(stream.getvalue()[116:])


MATLAB = CameraFormat(
    name="matlab",
    title="MATLAB camera parameters",
    suffixes=(".mat", ".json"),
    models=MATLAB_LENSES.models,
    read=read_matlab,
    write=write_matlab,
    usage=matlab_usage,
    lenses=MATLAB_LENSES,
    most_cameras=1,
    poses="RotationOfCamera2, PoseCamera2: right_T_left, read only",
    note="cameraIntrinsics(focal lengths, centre, ImageSize, RadialDistortion=…, TangentialDistortion=…)",
)
