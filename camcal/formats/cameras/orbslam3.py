"""Settings of ORB-SLAM3 (File.version 1.0, and those before): a camera, or a pair with the place of the second.

Stereo.T_c1_c2 takes points of the second camera to the first, metres: left_T_right; IMU.T_b_c1 those of the first to
the body. Older settings have the cameras of a pair as LEFT.K, D, R, P and RIGHT…, as ROS has them, beside the rectified
Camera.fx. Numbers have a dot, as Settings.cc asks for. Source: ORB_SLAM3's src/Settings.cc.
"""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from camcal import files
from camcal.errors import InvalidInput
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform, pose_between
from camcal.formats.cameras import file_storage, ros
from camcal.formats.cameras.record import CAMERA, LEFT, RIGHT, CameraFormat, Given, Source
from camcal.formats.cameras.values import Lenses, Values
from camcal.formats.documents import parse_foreign
from camcal.geometry.pose import JOINT

IMU = "imu"
LENSES = Lenses(
    """
    PinHole opencv5 fx fy cx cy k1? k2? p1? p2? k3?
    Rectified pinhole fx fy cx cy
    KannalaBrandt8 kannala_brandt4 fx fy cx cy k1 k2 k3 k4
    """
)
_OF_PAIR = Lenses(
    "PinHole opencv5 fx fy cx cy k1? k2? p1? p2? k3?\nPinHole opencv8 fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6"
)


def read(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the cameras of a settings file with their transforms; raises InvalidInput, MissingSize, FileError."""
    text = re.sub(r"^([ \t]*[\w.]+):(?=[\[\d\"-])", r"\1: ", sources[0].text, flags=re.MULTILINE)  # as OpenCV
    values = Values(parse_foreign(text, str(sources[0].path)))
    if "LEFT.K" in values:
        return _older_pair(values, given)
    word = values.text("Camera.type") or "PinHole"
    rows = LENSES.of(values, "Camera.type", word)
    size = (values.side("Camera.width"), values.side("Camera.height")) if "Camera.width" in values else None
    size = given.size(size, values.document.where)
    prefixes = [each for each in ("Camera1.", "Camera2.", "Camera.") if f"{each}fx" in values]
    if not prefixes:
        raise values.wrong("", "has no Camera1.fx")
    names = (LEFT, RIGHT) if len(prefixes) > 1 else (CAMERA,)
    cameras = {
        name: CameraEntry(LENSES.keyed(values, rows, size, prefix))
        for name, prefix in zip(names, prefixes, strict=False)
    }
    transforms = {}
    if "Stereo.T_c1_c2" in values and len(cameras) == 2:
        transforms[f"{RIGHT}{JOINT}{LEFT}"] = Transform(values.rigid("Stereo.T_c1_c2").inverse())
    if (key := next((key for key in ("IMU.T_b_c1", "Tbc") if key in values), None)) is not None:
        transforms[f"{IMU}{JOINT}{names[0]}"] = Transform(values.rigid(key))
    return CameraFile(cameras, transforms, warnings=tuple(values.warnings))


def _older_pair(values: Values, given: Given) -> CameraFile:
    """Return the cameras LEFT and RIGHT, as they are before rectification."""
    cameras, places = {}, []
    for name, side in ((LEFT, "LEFT"), (RIGHT, "RIGHT")):
        if f"{side}.K" not in values:
            continue
        size = (values.side(f"{side}.width"), values.side(f"{side}.height")) if f"{side}.width" in values else None
        numbers = np.concatenate([values.camera_matrix(f"{side}.K"), values.numbers(f"{side}.D")])
        size = given.size(size, values.document.where)
        cameras[name] = CameraEntry(_OF_PAIR.listed(values, f"{side}.D", _OF_PAIR.rows, size, numbers))
        if f"{side}.R" in values and f"{side}.P" in values:
            turn = values.pose(f"{side}.R", values.matrix(f"{side}.R", 3, 3), np.zeros(3)).rotation
            places.append(ros.Rectified(np.array(turn), values.matrix(f"{side}.P", 3, 4)))
    pair = {f"{RIGHT}{JOINT}{LEFT}": Transform(places[1].placed_from(places[0]))} if len(places) == 2 else {}
    return CameraFile(cameras, pair, warnings=tuple(values.warnings))


def write(path: Path, file: CameraFile) -> None:
    """Write the camera part of a settings file; raises InvalidInput for a pair of two kinds or sizes, FileError."""
    names, cameras = list(file.cameras), [entry.camera for entry in file.cameras.values()]
    written = [LENSES.written(camera) for camera in cameras]
    if len({lens.word for lens, _ in written}) > 1 or len({camera.image_size for camera in cameras}) > 1:
        raise InvalidInput(
            "a pair has one lens model and one size; write the cameras one by one, FILE#NAME", where=str(path)
        )
    items: dict[str, file_storage.Item] = {"File.version": "1.0", "Camera.type": written[0][0].word}
    for number, (_, numbers) in enumerate(written, 1):
        items |= {f"Camera{number}.{key}": value for key, value in numbers.items()}
    if len(names) == 2:
        pose = pose_between(file, names[0], names[1])
        if pose is None:
            raise InvalidInput(f"no transform joins {names[0]} and {names[1]}", where=str(path))
        items["Stereo.T_c1_c2"] = pose.matrix()
    if (body := pose_between(file, IMU, names[0])) is not None:
        items["IMU.T_b_c1"] = body.matrix()
    items |= dict(zip(("Camera.width", "Camera.height"), cameras[0].image_size, strict=True))
    items |= {"Camera.fps": 30, "Camera.RGB": 1}
    text = file_storage.text_of(items, ".yaml", usage(file)).replace("   dt: d\n", "   dt: f\n")  # which it asks for
    files.write_text(path, text)


def usage(file: CameraFile) -> str:
    """Return what has to be added, and which versions read a pair of fisheyes wrongly."""
    pair = len(file.cameras) == 2 and any("k4" in entry.camera.model.parameter_names for entry in file.cameras.values())
    doubt = "; some versions take Camera1.k1 to k4 for the second camera, too: check Settings.cc" if pair else ""
    return f"{ORBSLAM3.note}{doubt}"


ORBSLAM3 = CameraFormat(
    name="orbslam3",
    title="ORB-SLAM3 settings",
    suffixes=(".yaml", ".yml"),
    models=LENSES.models,
    read=read,
    write=write,
    usage=usage,
    lenses=LENSES,
    most_cameras=2,
    frames=frozenset({IMU}),
    poses="Stereo.T_c1_c2: left_T_right; IMU.T_b_c1: body_T_left",
    note="set Camera.fps, and add the settings of ORBextractor, IMU and Viewer",
)
