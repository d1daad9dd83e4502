"""BoofCV's YAML: one lens, or a pair whose rightToLeft is left_T_right in the unit of the board, taken as metres.

cx, cy are counted from the corner of the top-left pixel, as its chessboard detector has done since version 0.35; files
of older versions do not say how they count. Source: BoofCV's CalibrationIO, DetectChessboardCornersX.
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
from camcal.formats.cameras.lenses import Lens, Lenses
from camcal.formats.cameras.record import CAMERA, LEFT, RIGHT, CameraFormat, Given, Source
from camcal.formats.cameras.values import Values
from camcal.formats.documents import parse_foreign

LENSES = Lenses(
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


def read(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the camera, or left and right; raises InvalidInput for a lens that camcal does not have, FileError."""
    values = Values(parse_foreign(sources[0].text, str(sources[0].path)))
    if "rightToLeft" not in values:
        values = values.below("intrinsic") if "intrinsic" in values else values
        return CameraFile({CAMERA: CameraEntry(_camera(values, given))})
    place = values.below("rightToLeft")
    offset = np.array([place.number(axis) for axis in "xyz"])
    pose = place.pose("rotation", place.matrix("rotation", 3, 3), offset)
    entries = {side: CameraEntry(_camera(values.below(side), given)) for side in (LEFT, RIGHT)}
    return CameraFile(entries, {f"{LEFT}_T_{RIGHT}": Transform(pose)}, warnings=tuple(place.warnings))


def _camera(values: Values, given: Given) -> Camera:
    lenses = LENSES.of(values, "model", values.text("model"))
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
    return LENSES.keyed(Values(values.document, "", numbers), lenses, size)


def write(path: Path, file: CameraFile) -> None:
    """Write a camera, or a pair; raises InvalidInput for a pair of fisheyes or without relative pose, FileError."""
    cameras = {name: entry.camera for name, entry in file.cameras.items()}
    first, *others = cameras.values()
    place = ""
    data = _block(first)
    if others:
        pose = pose_between(file, *cameras)
        whole = next(row for row in LENSES.rows if row.word == _BROWN)
        pinholes = all((row := LENSES.row(camera)) and row.word in ("pinhole", _BROWN) for camera in cameras.values())
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
    files.write_text(path, emit.document(data, FORMAT.note, number=emit.exact_text) + place + "\n" * bool(place))


def _block(camera: Camera, row: Lens | None = None) -> dict[str, Any]:
    lens, numbers = LENSES.written(camera, row)
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


FORMAT = CameraFormat(
    name="boofcv",
    title="BoofCV calibration",
    suffixes=(".yaml", ".yml"),
    models=LENSES.models,
    read=read,
    write=write,
    lenses=LENSES,
    most_cameras=2,
    poses="rightToLeft: left_T_right, in the unit of the board (metres here)",
    note="CalibrationIO.load reads this; cx and cy are counted from the corner of the top-left pixel",
)
