"""Agisoft Metashape's XML: the lens of Tools, Camera Calibration, and the sensors of a project or of exported cameras.

cx, cy are counted from the middle of the image, b1 is what fx has more than fy, and p1, p2 are swapped: Metashape's P1
multiplies r² + 2x². Where a sensor has an initial and an adjusted calibration, the adjusted one is read; its covariance
is, too. Poses of images are not. Source: Metashape's user manual, appendix D (camera models).
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from camcal import files
from camcal.cameras.model import Camera
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.formats.cameras.lenses import Lens, Lenses
from camcal.formats.cameras.record import CameraFormat, Given, Source, name_of
from camcal.formats.cameras.syntax import xml_lines, xml_root, xml_values
from camcal.formats.cameras.values import Values
from camcal.formats.documents import Document
from camcal.messages import Message

LENSES = Lenses(
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


def read(sources: Sequence[Source], given: Given) -> CameraFile:
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
    rows = LENSES.of(values, "projection", word)
    size = next(_sizes(values, calibration, sensor), None)
    size = given.size(size, values.document.where)
    camera = LENSES.keyed(values, rows, size)
    covariance = _covariance(values, sensor, calibration, camera, rows[0])
    return CameraEntry(Camera(camera.model, size, camera.parameters, covariance))


def _sizes(values: Values, *elements: ET.Element) -> Iterator[tuple[int, int]]:
    if "width" in values and "height" in values:
        yield values.side("width"), values.side("height")
    for element in elements:
        for resolution in element.findall("resolution"):
            data = Values(Document(values.document.where, dict(resolution.attrib), {}), "<resolution>")
            yield data.side("width"), data.side("height")


def _covariance(
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
    jacobian = LENSES.jacobian(camera, lens, names)
    return jacobian @ matrix @ jacobian.T


def write(path: Path, file: CameraFile) -> None:
    """Write a lens as Metashape's Camera Calibration loads it; raises FileError."""
    (entry,) = file.cameras.values()
    lens, numbers = LENSES.written(entry.camera)
    width, height = entry.camera.image_size
    items = {"calibration": {"projection": lens.word, "width": width, "height": height, **numbers}}
    lines = ['<?xml version="1.0" encoding="UTF-8"?>', f"<!-- {FORMAT.note} -->", *xml_lines(items)]
    files.write_text(path, "\n".join([*lines, ""]))


FORMAT = CameraFormat(
    name="metashape",
    title="Agisoft Metashape XML",
    suffixes=(".xml",),
    models=LENSES.models,
    read=read,
    write=write,
    lenses=LENSES,
    most_cameras=1,
    poses="not read",
    note="load it in Tools, Camera Calibration; p1 and p2 are OpenCV's p2 and p1",
)
