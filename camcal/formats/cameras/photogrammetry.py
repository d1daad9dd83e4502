"""Cameras of photogrammetry and view synthesis: Metashape, nerfstudio and instant-ngp, OpenSfM and ODM.

Poses of images are not read from any of them.
Metashape's XML, the lens of Tools, Camera Calibration, and the sensors of a project or of exported cameras: cx, cy are
counted from the middle of the image, b1 is what fx has more than fy, and p1, p2 are swapped: Metashape's P1 multiplies
r² + 2x². Where a sensor has an initial and an adjusted calibration, the adjusted one is read; its covariance is, too.
Source: Metashape's user manual, appendix D (camera models).
transforms.json, the camera of all frames, or the cameras of single ones: the centre of the top-left pixel is 0.5, 0.5.
camera_model OPENCV or OPENCV_FISHEYE is nerfstudio's, is_fisheye instant-ngp's. A fisheye is written without p1 and
p2, which instant-ngp puts in the place of k3 and k4.
Source: nerfstudio's docs/quickstart/data_conventions.md, instant-ngp's src/nerf_loader.cu.
OpenSfM's cameras.json, camera_models.json and reconstruction.json: lengths are in units of the longer side, and the
principal point is counted from the middle of the image. Source: opensfm's src/geometry/src/camera.cc, io.py.
"""

import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from camcal import files
from camcal.cameras.model import Camera
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.formats.cameras.record import CAMERA, CameraFormat, Given, Source, name_of
from camcal.formats.cameras.syntax import json_text, json_values, xml_lines, xml_root, xml_values
from camcal.formats.cameras.values import Lens, Lenses, Values
from camcal.formats.documents import Document
from camcal.messages import Message

METASHAPE_LENSES = Lenses(
    """
    frame opencv5 f=fy cx? cy? b1=fx-fy? b2=0? k1? k2? k3? k4=0? p1=p2? p2=p1? p3=0? p4=0?
    fisheye kannala_brandt4 f=fy cx? cy? b1=fx-fy? b2=0? k1? k2? k3? k4? p1=0? p2=0?
    equidistant_fisheye kannala_brandt4 f=fy cx? cy? b1=fx-fy? b2=0? k1? k2? k3? k4? p1=0? p2=0?
    equisolid_fisheye equisolid f cx cy
    spherical panorama
    cylindrical cylinder_of_panorama f
    """,
    origin=0.5,
    centred=True,
    instead="optimise the cameras there without k4, b2, p3 and p4 and export again, or export undistorted images",
)

NERFSTUDIO_LENSES = Lenses(
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

_CORE = "focal_x=fx focal_y=fy c_x=cx c_y=cy"
OPENSFM_LENSES = Lenses(
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


def read_metashape(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the camera of every calibrated sensor; raises InvalidInput, MissingSize, FileError."""
    root = xml_root(sources[0])
    found: dict[str, CameraEntry] = {}
    warnings: list[Message] = []
    for sensor in [root] if root.tag == "calibration" else root.iter("sensor"):
        calibrations = [sensor] if root is sensor else sensor.findall("calibration")
        best = max(calibrations, key=lambda each: each.get("class") == "adjusted", default=None)
        if best is None:
            continue
        values = xml_values(sources[0], best)
        name = name_of(sensor.get("label", ""))
        name = name if name not in found else f"{name}_{len(found)}"
        found[name] = _entry(values, sensor, best, given)
        if best.get("class") == "initial":
            values.warn("initial_calibration", "@class", "initial values: optimise the cameras in Metashape first")
        warnings += values.warnings
    if not found:
        what = "has no calibrated sensor: export cameras after alignment, or save the camera calibration"
        raise Values(Document(str(sources[0].path), {}, {})).wrong("", what)
    return CameraFile(found, warnings=tuple(warnings))


def _entry(values: Values, sensor: ET.Element, calibration: ET.Element, given: Given) -> CameraEntry:
    word = values.text("projection") or values.text("@type") or sensor.get("type", "frame")
    rows = METASHAPE_LENSES.of(values, "projection", word)
    size = next(_sizes(values, calibration, sensor), None)
    size = given.size(size, values.document.where)
    camera = METASHAPE_LENSES.keyed(values, rows, size)
    covariance = _metashape_covariance(values, sensor, calibration, camera, rows[0])
    return CameraEntry(Camera(camera.model, size, camera.parameters, covariance))


def _sizes(values: Values, *elements: ET.Element) -> Iterator[tuple[int, int]]:
    if "width" in values and "height" in values:
        yield values.side("width"), values.side("height")
    for element in elements:
        for resolution in element.findall("resolution"):
            data = Values(Document(values.document.where, dict(resolution.attrib), {}), "<resolution>")
            yield data.side("width"), data.side("height")


def _metashape_covariance(
    values: Values, sensor: ET.Element, calibration: ET.Element, camera: Camera, lens: Lens
) -> np.ndarray | None:
    """Return the covariance (K, K) of the parameters, None where there is none."""
    element = next(
        (each.find("covariance") for each in (calibration, sensor) if each.find("covariance") is not None), None
    )
    if element is None:
        return None
    names = (element.findtext("params") or "").split()
    below = Values(values.document, "<covariance>", {"coeffs": (element.findtext("coeffs") or "").split()})
    matrix = below.matrix("coeffs", len(names), len(names))
    jacobian = METASHAPE_LENSES.jacobian(camera, lens, names)
    return jacobian @ matrix @ jacobian.T


def write_metashape(path: Path, file: CameraFile) -> None:
    """Write a lens as Metashape's Camera Calibration loads it; raises FileError."""
    (entry,) = file.cameras.values()
    lens, numbers = METASHAPE_LENSES.written(entry.camera)
    width, height = entry.camera.image_size
    items = {"calibration": {"projection": lens.word, "width": width, "height": height, **numbers}}
    lines = ['<?xml version="1.0" encoding="UTF-8"?>', f"<!-- {METASHAPE.note} -->", *xml_lines(items)]
    files.write_text(path, "\n".join([*lines, ""]))


METASHAPE = CameraFormat(
    name="metashape",
    title="Agisoft Metashape XML",
    suffixes=(".xml",),
    models=METASHAPE_LENSES.models,
    read=read_metashape,
    write=write_metashape,
    lenses=METASHAPE_LENSES,
    most_cameras=1,
    poses="not read",
    note="load it in Tools, Camera Calibration; p1 and p2 are OpenCV's p2 and p1",
)


def read_nerfstudio(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the camera of all frames, or those of single frames; raises InvalidInput, MissingSize, FileError."""
    values = json_values(sources[0])
    if "fl_x" in values or "camera_angle_x" in values:
        return CameraFile({CAMERA: CameraEntry(_nerfstudio_camera(values, given))})
    found: dict[tuple[object, ...], Camera] = {}
    for frame in values.each("frames") if "frames" in values else ():
        key = tuple(map(str, (frame.data.get(name) for name in _OF_LENS)))
        if key not in found and "fl_x" in frame:
            found[key] = _nerfstudio_camera(frame, given)
    if not found:
        raise values.wrong("", "has poses and no lens (fl_x): give the camera file that they were made with")
    names = [f"{CAMERA}_{place}" for place in range(1, len(found) + 1)] if len(found) > 1 else [CAMERA]
    return CameraFile({name: CameraEntry(each) for name, each in zip(names, found.values(), strict=True)})


def _nerfstudio_camera(values: Values, given: Given) -> Camera:
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
    return NERFSTUDIO_LENSES.keyed(every, NERFSTUDIO_LENSES.of(values, "camera_model", word), size)


def write_nerfstudio(path: Path, file: CameraFile) -> None:
    """Write one camera as the head of a transforms.json, without frames; raises FileError."""
    (entry,) = file.cameras.values()
    lens, numbers = NERFSTUDIO_LENSES.written(entry.camera)
    width, height = entry.camera.image_size
    fisheye = lens.word == "OPENCV_FISHEYE"
    angles = {
        f"camera_angle_{axis}": 2 * math.atan(side / 2 / numbers[f"fl_{axis}"])
        for axis, side in (() if fisheye else (("x", width), ("y", height)))
    }
    data = {
        "comment": nerfstudio_usage(file),
        "camera_model": lens.word,
        **({"is_fisheye": True} if fisheye else {}),
        "w": width,
        "h": height,
        **angles,
        **numbers,
        "frames": [],
    }
    files.write_text(path, json_text(data))


def nerfstudio_usage(file: CameraFile) -> str:
    """Return what has to be added, and which of the two programs reads the lens."""
    (entry,) = file.cameras.values()
    _, numbers = NERFSTUDIO_LENSES.written(entry.camera)
    known = "; instant-ngp has no k3 of this lens" if "p1" in numbers and numbers.get("k3") else ""
    return f"{NERFSTUDIO.note}{known}"


NERFSTUDIO = CameraFormat(
    name="nerfstudio",
    title="nerfstudio transforms.json",
    suffixes=(".json",),
    models=NERFSTUDIO_LENSES.models,
    read=read_nerfstudio,
    write=write_nerfstudio,
    usage=nerfstudio_usage,
    lenses=NERFSTUDIO_LENSES,
    most_cameras=1,
    poses="not read (frames: world_T_camera, OpenGL axes)",
    note="add frames: file_path and transform_matrix, world_T_camera with OpenGL axes (x right, y up, z back)",
)


def read_opensfm(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the cameras; raises InvalidInput for a lens that camcal does not have, MissingSize, FileError."""
    text = re.sub(r"\A\s*\[(.*)\]\s*\Z", r"\1", sources[0].text, flags=re.DOTALL)  # a list of one reconstruction
    values = json_values(sources[0]._replace(text=text))
    values = values.below("cameras") if "cameras" in values else values
    cameras: dict[str, CameraEntry] = {}
    for key, data in values.data.items():
        if isinstance(data, dict) and "projection_type" in data:
            each = values.below(key)
            rows = OPENSFM_LENSES.of(each, "projection_type", each.text("projection_type"))
            size = (each.side("width"), each.side("height")) if "width" in each else None
            size = given.size(size, values.document.where)
            name = name_of(key) if name_of(key) not in cameras else f"camera_{len(cameras)}"
            cameras[name] = CameraEntry(
                OPENSFM_LENSES.keyed(_with_one_focal(each), rows, size), extra={"x_opensfm": {"id": key}}
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


def write_opensfm(path: Path, file: CameraFile) -> None:
    """Write the cameras under their ids, or their names; raises FileError."""
    data: dict[str, Any] = {}
    for name, entry in file.cameras.items():
        lens, numbers = OPENSFM_LENSES.written(entry.camera)
        own = entry.extra.get("x_opensfm")
        width, height = entry.camera.image_size
        key = own["id"] if isinstance(own, dict) and "id" in own else f"v2 {name} camcal {width} {height} {lens.word} 0"
        data[str(key)] = {"projection_type": lens.word, "width": width, "height": height, **numbers}
    files.write_text(path, json_text(data))


def opensfm_usage(file: CameraFile) -> str:
    """Return where the file goes, and what ODM leaves out of it."""
    lost = any(len(OPENSFM_LENSES.written(entry.camera)[1]) > 4 and "k4" in entry.camera.model.parameter_names
               for entry in file.cameras.values())  # fmt: skip
    return OPENSFM.note + ("; ODM drops k4 of such a lens" if lost else "")


OPENSFM = CameraFormat(
    name="opensfm",
    title="OpenSfM cameras",
    suffixes=(".json",),
    models=OPENSFM_LENSES.models,
    read=read_opensfm,
    write=write_opensfm,
    usage=opensfm_usage,
    lenses=OPENSFM_LENSES,
    poses="not read",
    note="rename it to camera_models_overrides.json, or give it to ODM with --cameras",
)
