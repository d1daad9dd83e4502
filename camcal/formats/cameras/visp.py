"""ViSP's camera XML: one camera or several, each with a lens that has distortion or none.

kud is k1 in camcal's model; kdu, of the inverse, is an approximation that is not read and is written as -kud. The file
may hold both lenses of one camera: that with distortion is read. Source: visp's vpXmlParserCamera, vpCameraParameters.
"""

from collections.abc import Sequence
from pathlib import Path

from camcal import files
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.formats.cameras.lenses import Lenses
from camcal.formats.cameras.record import CameraFormat, Given, Source, name_of
from camcal.formats.cameras.syntax import xml_lines, xml_root, xml_values

LENSES = Lenses("""
    perspectiveProjWithoutDistortion pinhole px=fx py=fy u0=cx v0=cy
    perspectiveProjWithDistortion opencv4 px=fx py=fy u0=cx v0=cy kud=k1
    ProjWithKannalaBrandtDistortion kannala_brandt4 px=fx py=fy u0=cx v0=cy k1 k2 k3 k4 k5=0
""")  # fmt: skip


def read(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the cameras; raises InvalidInput, MissingSize, FileError."""
    root = xml_root(sources[0])
    cameras: dict[str, CameraEntry] = {}
    for element in root.iter("camera"):
        head = xml_values(sources[0], element)
        models = [xml_values(sources[0], each) for each in element.findall("model")]
        if not models:
            continue
        values = max(models, key=lambda each: "WithoutDistortion" not in each.text("type"))
        rows = LENSES.of(values, "type", values.text("type"))
        size = (head.side("image_width"), head.side("image_height")) if "image_width" in head else None
        size = given.size(size, head.document.where)
        name = name_of(head.text("name"))
        name = name if name not in cameras else f"{name}_{len(cameras)}"
        cameras[name] = CameraEntry(LENSES.keyed(values, rows, size))
    if not cameras:
        raise xml_values(sources[0], root).wrong(
            "", "has no camera with a model: calibrate it with visp-calibrate-camera"
        )
    return CameraFile(cameras)


def write(path: Path, file: CameraFile) -> None:
    """Write the cameras; raises FileError."""
    lines = ['<?xml version="1.0"?>', f"<!-- {FORMAT.note} -->", "<root>"]
    for name, entry in file.cameras.items():
        lens, numbers = LENSES.written(entry.camera)
        width, height = entry.camera.image_size
        inverse = {"kdu": -numbers["kud"]} if "kud" in numbers else {}
        model = {"type": lens.word, **numbers, **inverse}
        camera = {"name": name, "image_width": width, "image_height": height, "model": model}
        lines += xml_lines({"camera": camera}, "  ")
    files.write_text(path, "\n".join([*lines, "</root>", ""]))


FORMAT = CameraFormat(
    name="visp",
    title="ViSP XML",
    suffixes=(".xml",),
    models=LENSES.models,
    read=read,
    write=write,
    lenses=LENSES,
    note="kdu, of the inverse, is -kud, the first term only: undistort with kud",
)
