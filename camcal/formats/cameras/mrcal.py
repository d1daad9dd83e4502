"""mrcal's .cameramodel: one camera a file, a Python mapping, with its place among the cameras that were solved for.

extrinsics, rt_cam_ref since 2.5, is a rotation vector and a translation, metres, that take points of the reference to
the camera. Of a rig a folder has a file for each camera. Source: mrcal's doc/cameramodels.org, mrcal/cameramodel.py.
"""

import ast
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.cameras.catalogue import model_of
from camcal.cameras.model import Camera
from camcal.cameras.spline import SplinedStereographic
from camcal.errors import FileError, InvalidInput
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform, ValidRegion, pose_between
from camcal.formats.cameras.record import CAMERA, LEFT, RIGHT, CameraFormat, Given, Source
from camcal.formats.cameras.values import Lenses, Size, Values
from camcal.formats.documents import Document
from camcal.formats.emit import exact_text
from camcal.geometry import rotation as so3
from camcal.geometry.pose import JOINT

REFERENCE = "reference"
_SPLINE = "_order={}_Nx={}_Ny={}_fov_x_deg={}"
_KNOTS = re.compile(_SPLINE.format(*[r"(\d{1,4})"] * 4) + r"\Z")
LENSES = Lenses(
    """
    LENSMODEL_PINHOLE pinhole fx fy cx cy
    LENSMODEL_OPENCV4 opencv4 fx fy cx cy k1 k2 p1 p2
    LENSMODEL_OPENCV5 opencv5 fx fy cx cy k1 k2 p1 p2 k3
    LENSMODEL_OPENCV8 opencv8 fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6
    LENSMODEL_OPENCV12 opencv12 fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4
    LENSMODEL_STEREOGRAPHIC stereographic fx fy cx cy
    LENSMODEL_SPLINED_STEREOGRAPHIC splined_stereographic *
    LENSMODEL_CAHVOR cahvor fx fy cx cy alpha beta r0 r1 r2
    LENSMODEL_CAHVORE cahvore fx fy cx cy alpha beta r0 r1 r2 e0 e1 e2
    """,
    instead="calibrate there with --lensmodel LENSMODEL_OPENCV8, or convert it with mrcal-convert-lensmodel",
)


def read(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the camera of a file, or the two of a pair of files; raises InvalidInput for another lens, FileError."""
    names = (CAMERA,) if len(sources) == 1 else (LEFT, RIGHT)
    cameras, transforms = {}, {}
    for name, source in zip(names, sources, strict=True):
        values = _values(source)
        word = values.text("lensmodel")
        rows = LENSES.of(values, "lensmodel", word.partition("_order=")[0])
        size = given.size(values.sides("imagersize") if "imagersize" in values else None, str(source.path))
        if rows[0].whole:
            camera = _splined(values, word, size)
        else:
            camera = LENSES.listed(values, "intrinsics", rows, size, values.numbers("intrinsics"))
        seen = "valid_intrinsics_region" if values.data.get("valid_intrinsics_region") else None
        region = None if seen is None else ValidRegion(polygon=values.matrix_of(seen))
        cameras[name] = CameraEntry(camera, valid=region)
        key = next((key for key in ("rt_cam_ref", "extrinsics") if key in values), None)
        if key is not None:
            numbers = values.numbers(key, 6)
            if numbers.any() or len(sources) > 1:
                pose = values.pose(key, so3.exp(numbers[:3]), numbers[3:])
                transforms[f"{name}{JOINT}{REFERENCE}"] = Transform(pose)
    return CameraFile(cameras, transforms)


def _splined(values: Values, word: str, size: Size) -> Camera:
    """Return the camera of a spline, whose knots stand in its name."""
    found = _KNOTS.search(word)
    if found is None:
        raise values.wrong("lensmodel", f"{word[:80]!r}: a spline is named …{_SPLINE.format(3, 30, 18, 150)}")
    degree, columns, rows, fov_x_deg = map(int, found.groups())
    try:
        model = model_of("splined_stereographic", {"knots": [columns, rows], "fov_x_deg": fov_x_deg, "degree": degree})
    except InvalidInput as error:
        raise values.wrong("lensmodel", error.message) from error
    numbers = values.numbers("intrinsics", len(model.parameter_names))
    values.require_focal("intrinsics", *numbers[:2].tolist())
    return Camera(model, size, numbers)


def _word(camera: Camera, word: str, where: str) -> str:
    """Return mrcal's name of a camera's lens model, that of a spline with its knots; raises FileError for a spline that
    mrcal cannot have.
    """
    own = camera.model
    if not isinstance(own, SplinedStereographic):
        return word
    if own.fov_x_deg != round(own.fov_x_deg):
        text = f"mrcal's splines have a whole number of degrees as fov_x_deg, not {own.fov_x_deg:g}"
        raise FileError(text, where=where)
    return word + _SPLINE.format(own.degree, *own.knots, round(own.fov_x_deg))


def _values(source: Source) -> Values:
    where = str(source.path)
    text, _, inputs = source.text.strip().partition("'optimization_inputs'")  # megabytes that say nothing of the lens
    text += re.sub(r"^\s*:\s*b?'[^']*'?,?", "", inputs) or "}" * bool(inputs)
    try:
        data = ast.literal_eval(text)
    except (SyntaxError, ValueError, TypeError, MemoryError, RecursionError) as error:
        line = f"{where}:{error.lineno}" if isinstance(error, SyntaxError) and error.lineno else where
        raise FileError("is truncated, or no mapping of Python's values", where=line) from error
    if not isinstance(data, dict):
        raise FileError("is no mapping of Python's values", where=where)
    plain = {str(key): list(item) if isinstance(item, tuple) else item for key, item in data.items()}
    return Values(Document(where, plain, {}))


def outputs(path: Path, file: CameraFile) -> tuple[Path, ...]:
    """Return the files that are written: the path itself, or in a folder one for each camera."""
    if path.suffix or files.is_stream(path):
        return (path,)
    return tuple(path / f"{name}.cameramodel" for name in file.cameras)


def write(path: Path, file: CameraFile) -> None:
    """Write one camera to a file, or all into a folder, with places counted from the first; raises FileError."""
    first = next(iter(file.cameras))
    if len(file.cameras) > 1 and path.suffix:
        raise FileError("mrcal has a file for each camera: give a folder", where=str(path))
    for target, (name, entry) in zip(outputs(path, file), file.cameras.items(), strict=True):
        pose = pose_between(file, name, REFERENCE) or pose_between(file, name, first)
        place = [0.0] * 6 if pose is None else [*so3.log(pose.rotation).tolist(), *pose.translation.tolist()]
        lens, numbers = LENSES.written(entry.camera)
        width, height = entry.camera.image_size
        word = _word(entry.camera, lens.word, str(target))
        lines = [f"# {MRCAL.note}", "{", f"    'lensmodel':  '{word}',"]
        lines += [
            f"    'intrinsics': [ {_numbers(list(numbers.values()))} ],",
            f"    'extrinsics': [ {_numbers(place)} ],",
        ]
        lines += [f"    'imagersize': [ {width}, {height} ],"]
        if entry.valid is not None and entry.valid.polygon is not None:
            corners = ", ".join(f"[ {_numbers(corner)} ]" for corner in np.asarray(entry.valid.polygon).tolist())
            lines += [f"    'valid_intrinsics_region': [ {corners} ],"]
        files.write_text(target, "\n".join([*lines, "}", ""]))


def _numbers(numbers: Sequence[Any]) -> str:
    return ", ".join(map(exact_text, numbers))


MRCAL = CameraFormat(
    name="mrcal",
    title="mrcal camera model",
    suffixes=(".cameramodel",),
    models=LENSES.models,
    read=read,
    write=write,
    outputs=outputs,
    lenses=LENSES,
    frames=frozenset({REFERENCE}),
    files=2,
    in_folder=True,
    poses="rt_cam_ref: camera_T_reference, Rodrigues vector",
    note="extrinsics take points of the reference to the camera; there are no optimization_inputs",
)
