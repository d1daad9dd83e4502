"""aniposelib's calibration.toml, and caliscope's camera_array.toml, which has its keys in tables of another name.

aniposelib: cameras cam_0, cam_1, … with their places in the world; caliscope: cameras by their numbers. rotation, a
rotation vector, and translation, in the unit of the board, take points of the world to the camera. Four coefficients
are of a fisheye where fisheye = true, and k1 k2 p1 p2 elsewhere.
Sources: aniposelib's cameras.py (Camera.get_dict, CameraGroup.load); caliscope's persistence.py and
cameras/camera_array.py.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from camcal import files
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform, pose_between
from camcal.formats.cameras.record import CameraFormat, Given, Source, name_of, opencv_usage
from camcal.formats.cameras.syntax import toml_text, toml_values
from camcal.formats.cameras.values import OPENCV_LENSES, Lenses, Values
from camcal.geometry import rotation as so3
from camcal.geometry.pose import JOINT, Pose

WORLD = "world"
ANIPOSE_LENSES = Lenses(OPENCV_LENSES)


def read_anipose(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the cameras with their places in the world; raises InvalidInput, MissingSize, FileError."""
    values = toml_values(sources[0])
    return cameras_of(values, {key: values.below(key) for key, each in values.data.items() if _is_camera(each)}, given)


def _is_camera(table: Any) -> bool:
    return isinstance(table, dict) and "matrix" in table


def cameras_of(whole: Values, tables: Mapping[str, Values], given: Given) -> CameraFile:
    """Return the cameras of tables by their keys, in natural order."""
    cameras: dict[str, CameraEntry] = {}
    transforms = {}
    for key in sorted(tables, key=files.natural_key):
        table = tables[key]
        rows = ANIPOSE_LENSES.of(table, "fisheye", "fisheye" if table.data.get("fisheye") is True else "opencv")
        size = given.size(table.sides("size") if "size" in table else None, table.document.where)
        name = name_of(table.text("name"), fallback=name_of(key, f"cam_{len(cameras)}"))
        name = name if name not in cameras else f"{name}_{len(cameras)}"
        cameras[name] = CameraEntry(ANIPOSE_LENSES.matrix(table, "matrix", "distortions", rows, size))
        if "rotation" in table and "translation" in table:
            turn = so3.exp(table.numbers("rotation", 3))
            transforms[f"{name}{JOINT}{WORLD}"] = Transform(Pose(turn, table.numbers("translation", 3)))
    if not cameras:
        raise whole.wrong("", "has no camera with a matrix: calibrate it first")
    return CameraFile(cameras, transforms)


def tables_of(file: CameraFile) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the name of every camera and its table; places are counted from the world, or from the first camera."""
    first = next(iter(file.cameras))
    for name, entry in file.cameras.items():
        lens, numbers = ANIPOSE_LENSES.written(entry.camera)
        pose = pose_between(file, name, WORLD) or pose_between(file, name, first)
        table = {
            "name": name,
            "size": list(entry.camera.image_size),
            "matrix": entry.camera.K.tolist(),
            "distortions": list(numbers.values())[4:],
        }
        table |= {"fisheye": True} if lens.word == "fisheye" else {}
        if pose is not None:
            table |= {"rotation": so3.log(pose.rotation).tolist(), "translation": pose.translation.tolist()}
        yield name, table


def write_anipose(path: Path, file: CameraFile) -> None:
    """Write the cameras; raises FileError."""
    tables = {f"cam_{index}": table for index, (_, table) in enumerate(tables_of(file))}
    files.write_text(path, toml_text({**tables, "metadata": {"adjusted": False}}, opencv_usage(file)))


ANIPOSE = CameraFormat(
    name="anipose",
    title="anipose calibration.toml",
    suffixes=(".toml",),
    models=ANIPOSE_LENSES.models,
    read=read_anipose,
    write=write_anipose,
    usage=opencv_usage,
    lenses=ANIPOSE_LENSES,
    frames=frozenset({WORLD}),
    poses="rotation, translation: camera_T_world, Rodrigues vector",
)


def read_caliscope(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the calibrated cameras with their places in the world; raises InvalidInput, MissingSize, FileError."""
    values = toml_values(sources[0])
    tables = values.below("cameras") if "cameras" in values else values
    known = {key: tables.below(key) for key in tables.data if isinstance(tables.data[key], dict)}
    calibrated = {f"cam_{key.removeprefix('cam_')}": table for key, table in known.items() if "matrix" in table}
    return cameras_of(values, calibrated, given)


def write_caliscope(path: Path, file: CameraFile) -> None:
    """Write the cameras as 0, 1, …; raises FileError."""
    tables = {
        f"cameras.{index}": {
            "cam_id": index,
            "rotation_count": 0,
            "ignore": False,
            **table,
            "fisheye": table.get("fisheye", False),
        }
        for index, (_, table) in enumerate(tables_of(file))
    }
    files.write_text(path, toml_text(tables, opencv_usage(file)))


CALISCOPE = CameraFormat(
    name="caliscope",
    title="caliscope camera_array.toml",
    suffixes=(".toml",),
    models=ANIPOSE_LENSES.models,
    read=read_caliscope,
    write=write_caliscope,
    usage=opencv_usage,
    lenses=ANIPOSE_LENSES,
    frames=frozenset({WORLD}),
    poses="rotation, translation: camera_T_world, Rodrigues vector",
)
