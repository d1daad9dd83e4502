"""The camera files of libraries of computer vision: BoofCV, Open3D, ViSP.

BoofCV's YAML: one lens, or a pair whose rightToLeft is left_T_right in the unit of the board, taken as metres. cx, cy
are counted from the corner of the top-left pixel, as its chessboard detector has done since version 0.35; files of
older versions do not say how they count. Source: BoofCV's CalibrationIO, DetectChessboardCornersX.
Open3D's PinholeCameraIntrinsic as JSON: intrinsic_matrix column by column, without distortion.
Source: Open3D's cpp/open3d/camera/PinholeCameraIntrinsic.cpp.
ViSP's XML: one camera or several, each with a lens that has distortion or none. kud is k1 in camcal's model; kdu, of
the inverse, is an approximation that is not read and is written as -kud. The file may hold both lenses of one camera:
that with distortion is read. Source: visp's vpXmlParserCamera, vpCameraParameters.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.formats import emit
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform, pose_between
from camcal.formats.cameras.record import CAMERA, LEFT, RIGHT, CameraFormat, Given, Source, name_of
from camcal.formats.cameras.syntax import json_text, json_values, xml_lines, xml_root, xml_values
from camcal.formats.cameras.values import Lens, Lenses, Values
from camcal.formats.documents import parse_foreign

BOOFCV_LENSES = Lenses(
    """
    pinhole pinhole fx fy cx cy skew=0?
    pinhole_radial_tangential opencv5 fx fy cx cy skew=0? k1? k2? t1=p1? t2=p2? k3?
    omnidirectional_universal mei fx fy cx cy skew=0? mirror_offset=xi k1? k2? t1=p1? t2=p2?
    kannala_brandt kannala_brandt4 fx fy cx cy skew=0? k1? k2? k3? k4?
    """,
    origin=0.5,
)
_BROWN, _FISHEYE = "pinhole_radial_tangential", "kannala_brandt"
_ASYMMETRIC = ("radial", "radial_trig", "tangent", "tangent_trig")

OPEN3D_LENSES = Lenses("pinhole pinhole fx fy cx cy")

VISP_LENSES = Lenses("""
    perspectiveProjWithoutDistortion pinhole px=fx py=fy u0=cx v0=cy
    perspectiveProjWithDistortion opencv4 px=fx py=fy u0=cx v0=cy kud=k1
    ProjWithKannalaBrandtDistortion kannala_brandt4 px=fx py=fy u0=cx v0=cy k1 k2 k3 k4 k5=0
""")  # fmt: skip


def read_boofcv(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the camera, or left and right; raises InvalidInput for a lens that camcal does not have, FileError."""
    values = Values(parse_foreign(sources[0].text, str(sources[0].path)))
    if "rightToLeft" not in values:
        values = values.below("intrinsic") if "intrinsic" in values else values
        return CameraFile({CAMERA: CameraEntry(_boofcv_camera(values, given))})
    place = values.below("rightToLeft")
    offset = np.array([place.number(axis) for axis in "xyz"])
    pose = place.pose("rotation", place.matrix("rotation", 3, 3), offset)
    entries = {side: CameraEntry(_boofcv_camera(values.below(side), given)) for side in (LEFT, RIGHT)}
    return CameraFile(entries, {f"{LEFT}_T_{RIGHT}": Transform(pose)}, warnings=tuple(place.warnings))


def _boofcv_camera(values: Values, given: Given) -> Camera:
    lenses = BOOFCV_LENSES.of(values, "model", values.text("model"))
    core = values.below("pinhole")
    size = given.size((core.side("width"), core.side("height")), values.document.where)
    numbers = dict(core.data) | {"mirror_offset": values.data.get("mirror_offset")}
    if lenses[0].word == _FISHEYE:
        # r = s1 θ + s2 θ³ + …: the first one belongs to the focal length
        first, *terms = values.numbers("symmetric").tolist() or [0.0]
        for key in _ASYMMETRIC:
            if key in values and np.any(values.numbers(key)):
                raise values.wrong(key, "is of an asymmetric lens, which camcal does not have: calibrate without it")
        if first <= 0:
            raise values.wrong("symmetric", "its first number is to be above 0")
        numbers |= {axis: core.number(axis) * first for axis in ("fx", "fy")}
        key, terms = "symmetric", [term / first for term in terms]
    else:
        lens = values.below("radial_tangential") if "radial_tangential" in values else values
        key, terms = "radial", lens.numbers("radial").tolist() if "radial" in lens else []
        numbers |= {name: lens.data.get(name) for name in ("t1", "t2")}
    most = sum(own.name[0] == "k" for own in lenses[0].keys)
    if any(terms[most:]):
        raise values.wrong("model", f"{key} has {len(terms)} terms; {lenses[0].word} is read with {most} of them")
    numbers |= {f"k{number}": term for number, term in enumerate(terms[:most], 1)}
    return BOOFCV_LENSES.keyed(Values(values.document, "", numbers), lenses, size)


def write_boofcv(path: Path, file: CameraFile) -> None:
    """Write a camera, or a pair; raises InvalidInput for a pair of fisheyes or without relative pose, FileError."""
    cameras = {name: entry.camera for name, entry in file.cameras.items()}
    first, *others = cameras.values()
    place = ""
    data = _block(first)
    if others:
        pose = pose_between(file, *cameras)
        whole = next(row for row in BOOFCV_LENSES.rows if row.word == _BROWN)
        pinholes = all(
            (row := BOOFCV_LENSES.row(camera)) and row.word in ("pinhole", _BROWN) for camera in cameras.values()
        )
        if pose is None or not pinholes:
            what = "without a transform between them" if pinholes else "that are not both pinholes with distortion"
            raise InvalidInput(f"BoofCV has no pairs {what}; write the cameras one by one, FILE#NAME", where=str(path))
        data = {"model": "stereo_camera", "version": 0}
        data |= {side: _block(camera, whole) for side, camera in zip((LEFT, RIGHT), cameras.values(), strict=True)}
        turn = ", ".join(map(emit.exact_text, pose.rotation.ravel().tolist()))
        shift = zip("xyz", pose.translation.tolist(), strict=True)
        place = "\n  ".join(
            ["rightToLeft:", f"rotation: [{turn}]", *(f"{axis}: {emit.exact_text(value)}" for axis, value in shift)]
        )
    files.write_text(path, emit.document(data, BOOFCV.note, number=emit.exact_text) + place + "\n" * bool(place))


def _block(camera: Camera, row: Lens | None = None) -> dict[str, Any]:
    lens, numbers = BOOFCV_LENSES.written(camera, row)
    width, height = camera.image_size
    core = {key: numbers.pop(key) for key in ("fx", "fy", "cx", "cy")}
    block = {"model": lens.word, "version": 0, "pinhole": {"width": width, "height": height, **core, "skew": 0.0}}
    terms = [value for key, value in numbers.items() if key[0] == "k"]
    if lens.word == _FISHEYE:
        return block | {"symmetric": [1.0, *terms], **{key: [] for key in _ASYMMETRIC}}
    if terms:
        block |= {key: numbers[key] for key in ("mirror_offset",) if key in numbers}
        block["radial_tangential"] = {"radial": terms, "t1": numbers["t1"], "t2": numbers["t2"]}
    return block


BOOFCV = CameraFormat(
    name="boofcv",
    title="BoofCV calibration",
    suffixes=(".yaml", ".yml"),
    models=BOOFCV_LENSES.models,
    read=read_boofcv,
    write=write_boofcv,
    lenses=BOOFCV_LENSES,
    most_cameras=2,
    poses="rightToLeft: left_T_right, in the unit of the board (metres here)",
    note="CalibrationIO.load reads this; cx and cy are counted from the corner of the top-left pixel",
)


def read_open3d(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the camera; raises InvalidInput, MissingSize, FileError."""
    values = json_values(sources[0])
    size = (values.side("width"), values.side("height")) if "width" in values else None
    size = given.size(size, values.document.where)
    matrix = values.numbers("intrinsic_matrix", 9).reshape(3, 3)
    every = Values(values.document, "", {"intrinsic_matrix": matrix.T.tolist()})
    return CameraFile(
        {CAMERA: CameraEntry(OPEN3D_LENSES.matrix(every, "intrinsic_matrix", "", OPEN3D_LENSES.rows, size))}
    )


def write_open3d(path: Path, file: CameraFile) -> None:
    """Write a camera; raises FileError."""
    (entry,) = file.cameras.values()
    width, height = entry.camera.image_size
    matrix = entry.camera.K.T.ravel().tolist()
    files.write_text(path, json_text({"width": width, "height": height, "intrinsic_matrix": matrix}))


OPEN3D = CameraFormat(
    name="open3d",
    title="Open3D intrinsics",
    suffixes=(".json",),
    models=OPEN3D_LENSES.models,
    read=read_open3d,
    write=write_open3d,
    lenses=OPEN3D_LENSES,
    most_cameras=1,
    note="for undistorted images: undistort them with camcal undistort",
)


def read_visp(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the cameras; raises InvalidInput, MissingSize, FileError."""
    root = xml_root(sources[0])
    cameras: dict[str, CameraEntry] = {}
    for element in root.iter("camera"):
        head = xml_values(sources[0], element)
        models = [xml_values(sources[0], each) for each in element.findall("model")]
        if not models:
            continue
        values = max(models, key=lambda each: "WithoutDistortion" not in each.text("type"))
        rows = VISP_LENSES.of(values, "type", values.text("type"))
        size = (head.side("image_width"), head.side("image_height")) if "image_width" in head else None
        size = given.size(size, head.document.where)
        name = name_of(head.text("name"))
        name = name if name not in cameras else f"{name}_{len(cameras)}"
        cameras[name] = CameraEntry(VISP_LENSES.keyed(values, rows, size))
    if not cameras:
        raise xml_values(sources[0], root).wrong(
            "", "has no camera with a model: calibrate it with visp-calibrate-camera"
        )
    return CameraFile(cameras)


def write_visp(path: Path, file: CameraFile) -> None:
    """Write the cameras; raises FileError."""
    lines = ['<?xml version="1.0"?>', f"<!-- {VISP.note} -->", "<root>"]
    for name, entry in file.cameras.items():
        lens, numbers = VISP_LENSES.written(entry.camera)
        width, height = entry.camera.image_size
        inverse = {"kdu": -numbers["kud"]} if "kud" in numbers else {}
        model = {"type": lens.word, **numbers, **inverse}
        camera = {"name": name, "image_width": width, "image_height": height, "model": model}
        lines += xml_lines({"camera": camera}, "  ")
    files.write_text(path, "\n".join([*lines, "</root>", ""]))


VISP = CameraFormat(
    name="visp",
    title="ViSP XML",
    suffixes=(".xml",),
    models=VISP_LENSES.models,
    read=read_visp,
    write=write_visp,
    lenses=VISP_LENSES,
    note="kdu, of the inverse, is -kud, the first term only: undistort with kud",
)
