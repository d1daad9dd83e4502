"""COLMAP's cameras.txt and cameras.bin, and rigs.txt or rigs.bin beside them: cameras 1, 2 as camera_1, camera_2.

The centre of the top-left pixel is 0.5, 0.5. A rig has sensor_from_rig of every sensor but the first: a quaternion w x
y z and a translation. Source: colmap's doc/format.rst, src/colmap/sensor/models.h, scene/reconstruction_io_utils.
"""

import math
import re
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from camcal import files
from camcal.errors import FileError, InvalidInput
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform, pose_between
from camcal.formats.cameras.record import CAMERA, CameraFormat, Given, Source, camera_of, recognise
from camcal.formats.cameras.values import Lenses, Values
from camcal.formats.documents import Document
from camcal.formats.emit import exact_text
from camcal.geometry import rotation as so3
from camcal.geometry.pose import JOINT, Pose

LENSES = Lenses(
    """
    SIMPLE_PINHOLE pinhole f cx cy
    PINHOLE pinhole fx fy cx cy
    SIMPLE_RADIAL opencv4 f cx cy k1
    RADIAL opencv4 f cx cy k1 k2
    OPENCV opencv4 fx fy cx cy k1 k2 p1 p2
    FULL_OPENCV opencv8 fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6
    SIMPLE_RADIAL_FISHEYE kannala_brandt4 f cx cy k1
    RADIAL_FISHEYE kannala_brandt4 f cx cy k1 k2
    OPENCV_FISHEYE kannala_brandt4 fx fy cx cy k1 k2 k3 k4
    SIMPLE_FISHEYE kannala_brandt4 f cx cy
    FISHEYE kannala_brandt4 fx fy cx cy
    FOV fov fx fy cx cy w=omega
    THIN_PRISM_FISHEYE thin_prism_fisheye fx fy cx cy k1 k2 p1 p2 k3 k4 sx1 sy1
    RAD_TAN_THIN_PRISM_FISHEYE fisheye624 fx fy cx cy k0 k1 k2 k3 k4 k5 p0 p1 s0 s1 s2 s3
    SIMPLE_DIVISION division f cx cy k=lambda
    DIVISION division fx fy cx cy k=lambda
    EUCM eucm fx fy cx cy alpha beta
    EQUIRECTANGULAR panorama w h
    """,
    origin=0.5,
    instead="run COLMAP with --ImageReader.camera_model OPENCV or OPENCV_FISHEYE, or give its undistorted images",
)
PANORAMA = "EQUIRECTANGULAR"
_IDS = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV", "FOV",
        "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE",
        "SIMPLE_DIVISION", "DIVISION", "SIMPLE_FISHEYE", "FISHEYE", "EUCM", "EQUIRECTANGULAR")  # fmt: skip
_SENSORS = ("CAMERA", "IMU")  # by their numbers in binary files
_COUNTS = {row.word: len(row.keys) for row in LENSES.rows}
_HEAD = """# Camera list with one line of data per camera:
#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]
# {}
# Number of cameras: {}
"""
_RIG_HEAD = """# Rig calib list with one line of data per calib:
#   RIG_ID, NUM_SENSORS, REF_SENSOR_TYPE, REF_SENSOR_ID, SENSORS[] as (SENSOR_TYPE, SENSOR_ID, HAS_POSE, [QW, QX, QY, \
QZ, TX, TY, TZ])
# Number of rigs: 1
"""

Line = tuple[int, list[str]]


def read(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the cameras of cameras.txt or cameras.bin, with their places in the first rig of rigs.txt.

    Raises InvalidInput for a lens that camcal does not have and for whatever is missing or wrong, FileError.
    """
    where = str(sources[0].path)
    if sources[0].text.startswith("# Rig") or ((row := recognise(sources[0].text)) and "rigs.bin" in row.names):
        raise InvalidInput("holds no cameras: give cameras.txt first, and rigs.txt with --with", where=where)
    rows = list(_binary_rows(sources[0]) if _is_binary(sources[0]) else _lines(sources[0]))
    if not rows:
        raise InvalidInput("holds no cameras", where=where)
    names = {words[0]: f"{CAMERA}_{words[0]}" if len(rows) > 1 else CAMERA for _, words in rows}
    cameras = {names[words[0]]: _entry(where, line, words, given) for line, words in rows}
    if len(cameras) < len(rows):
        raise InvalidInput("two cameras have the same id", where=where)
    transforms = {}
    for source in sources[1:]:
        transforms = _rig(source, names)
    return CameraFile(cameras, transforms)


def _is_binary(source: Source) -> bool:
    return source.binary or "\0" in source.text


def _lines(source: Source) -> Iterator[Line]:
    for line, text in enumerate(source.text.splitlines(), 1):
        if text.strip() and not text.lstrip().startswith("#"):
            yield line, text.split()


def _entry(where: str, line: int, words: Sequence[str], given: Given) -> CameraEntry:
    place = f"{where}:{line}" if line else where
    if len(words) < 4 or not all(re.fullmatch(r"\d{1,9}", words[each]) for each in (0, 2, 3)):
        raise InvalidInput("is not CAMERA_ID MODEL WIDTH HEIGHT PARAMS", where=place)
    data = {"MODEL": words[1], "SIZE": words[2:4], "PARAMS": list(words[4:])}
    values = Values(Document(place, data, {}))
    size = given.size(values.sides("SIZE"), where)
    if words[1] == PANORAMA:
        width, height = values.numbers("PARAMS", 2).tolist()
        core = width / (2 * math.pi), height / math.pi, width / 2 - LENSES.origin, height / 2 - LENSES.origin
        return CameraEntry(camera_of("equirectangular", size, core, np.zeros(0)))
    rows = LENSES.of(values, "MODEL", words[1])
    return CameraEntry(LENSES.listed(values, "PARAMS", rows, size, values.numbers("PARAMS")))


def _binary_rows(source: Source) -> Iterator[Line]:
    data = source.text.encode("latin-1")
    place = 8
    try:
        for _ in range(struct.unpack_from("<Q", data)[0]):
            number, model, width, height = struct.unpack_from("<IiQQ", data, place)
            word = _IDS[model]
            numbers = struct.unpack_from(f"<{_COUNTS[word]}d", data, place + 24)
            place += 24 + 8 * len(numbers)
            yield 0, [str(number), word, str(width), str(height), *map(repr, numbers)]
    except (struct.error, IndexError) as error:
        raise FileError("is truncated, or not a COLMAP cameras.bin", where=str(source.path)) from error


def _rig(source: Source, names: dict[str, str]) -> dict[str, Transform]:
    """Return camera_T_camera_1 of the sensors of the first rig, as far as they have a pose."""
    line, words = (0, _binary_rig(source)) if _is_binary(source) else next(_lines(source), (1, []))
    values = Values(Document(f"{source.path}:{line}", {"SENSORS": words}, {}))
    try:
        first, rest, found = words[3], words[4:], {}
        while rest:
            sensor, has_pose = rest[1], rest[2] not in ("0", "False")
            numbers = Values(values.document, "SENSORS", {"POSE": rest[3:10]}).numbers("POSE", 7) if has_pose else None
            if numbers is not None and rest[0] == "CAMERA":
                pose = values.pose("SENSORS", so3.from_quaternion(numbers[:4]), numbers[4:])
                found[f"{names[sensor]}{JOINT}{names[first]}"] = Transform(pose)
            rest = rest[10 if has_pose else 3 :]
    except (IndexError, KeyError) as error:
        raise values.wrong("SENSORS", "is truncated, or names a camera that cameras.txt does not have") from error
    return found


def _binary_rig(source: Source) -> list[str]:
    """Return the first rig of rigs.bin in the words of rigs.txt."""
    data = source.text.encode("latin-1")
    try:
        _, rig, count, kind, sensor = struct.unpack_from("<QIIiI", data)
        words, place = [str(rig), str(count), _SENSORS[kind], str(sensor)], 24
        for _ in range(count - 1):
            kind, sensor, has_pose = struct.unpack_from("<iI?", data, place)
            pose = struct.unpack_from("<7d", data, place + 9) if has_pose else ()
            words += [_SENSORS[kind], str(sensor), str(int(has_pose)), *map(repr, pose)]
            place += 9 + 8 * len(pose)
    except (struct.error, IndexError) as error:
        raise FileError("is truncated, or not a COLMAP rigs.bin", where=str(source.path)) from error
    return words


def outputs(path: Path, file: CameraFile) -> tuple[Path, ...]:
    """Return cameras.txt or cameras.bin, and rigs.txt or rigs.bin beside it if the cameras make a rig."""
    rig = _placed(file) is not None and not files.is_stream(path)
    return (path, path.with_name(f"rigs{path.suffix.lower()}")) if rig else (path,)


def _placed(file: CameraFile) -> list[Pose] | None:
    """Return camera_T_first of every camera but the first, None if they make no rig."""
    first, *others = file.cameras
    poses = [pose_between(file, name, first) for name in others]
    return [pose for pose in poses if pose is not None] if poses and None not in poses else None


def write(path: Path, file: CameraFile) -> None:
    """Write the cameras, in their order as 1, 2, …, and the rig that they make; raises FileError."""
    written = [(entry.camera.image_size, *LENSES.written(entry.camera)) for entry in file.cameras.values()]
    if path.suffix.lower() == ".bin":
        content = struct.pack("<Q", len(written))
        for number, (size, lens, numbers) in enumerate(written, 1):
            content += struct.pack("<IiQQ", number, _IDS.index(lens.word), *size)
            content += struct.pack(f"<{len(numbers)}d", *numbers.values())
        files.write_bytes(path, content)
        for rigs in outputs(path, file)[1:]:
            files.write_bytes(rigs, _rig_bytes(_placed(file) or []))
        return
    lines = [
        " ".join([str(number), lens.word, *map(str, size), *map(exact_text, numbers.values())])
        for number, (size, lens, numbers) in enumerate(written, 1)
    ]
    files.write_text(path, _HEAD.format(COLMAP.note, len(lines)) + "\n".join(lines) + "\n")
    for rigs in outputs(path, file)[1:]:
        files.write_text(rigs, _RIG_HEAD + _rig_line(_placed(file) or []) + "\n")


def _rig_bytes(poses: Sequence[Pose]) -> bytes:
    content = struct.pack("<QIIiI", 1, 1, len(poses) + 1, _SENSORS.index("CAMERA"), 1)
    for number, pose in enumerate(poses, 2):
        content += struct.pack("<iI?", _SENSORS.index("CAMERA"), number, True)
        content += struct.pack("<7d", *so3.to_quaternion(pose.rotation), *pose.translation)
    return content


def _rig_line(poses: Sequence[Pose]) -> str:
    sensors = [
        f"CAMERA {number} 1 {' '.join(map(exact_text, np.r_[so3.to_quaternion(pose.rotation), pose.translation]))}"
        for number, pose in enumerate(poses, 2)
    ]
    return " ".join(["1", str(len(poses) + 1), "CAMERA 1", *sensors])


COLMAP = CameraFormat(
    name="colmap",
    title="COLMAP cameras.txt",
    suffixes=(".txt", ".bin"),
    models=LENSES.models,
    read=read,
    write=write,
    outputs=outputs,
    lenses=LENSES,
    poses="rigs.txt, rigs.bin: camera_T_rig, quaternion w x y z",
    files=2,
    note="cx, cy count from the corner of the image: 0.5 more than OpenCV's",
)
