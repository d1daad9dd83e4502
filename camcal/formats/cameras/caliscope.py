"""caliscope's camera_array.toml: cameras by their numbers; see `anipose`, whose keys it has.

Source: caliscope's persistence.py and cameras/camera_array.py.
"""

from collections.abc import Sequence
from pathlib import Path

from camcal import files
from camcal.formats.camera_file import CameraFile
from camcal.formats.cameras import anipose
from camcal.formats.cameras.record import CameraFormat, Given, Source, opencv_usage
from camcal.formats.cameras.syntax import toml_text, toml_values


def read(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the calibrated cameras with their places in the world; raises InvalidInput, MissingSize, FileError."""
    values = toml_values(sources[0])
    tables = values.below("cameras") if "cameras" in values else values
    known = {key: tables.below(key) for key in tables.data if isinstance(tables.data[key], dict)}
    calibrated = {f"cam_{key.removeprefix('cam_')}": table for key, table in known.items() if "matrix" in table}
    return anipose.cameras_of(values, calibrated, given)


def write(path: Path, file: CameraFile) -> None:
    """Write the cameras as 0, 1, …; raises FileError."""
    tables = {
        f"cameras.{index}": {
            "cam_id": index,
            "rotation_count": 0,
            "ignore": False,
            **table,
            "fisheye": table.get("fisheye", False),
        }
        for index, (_, table) in enumerate(anipose.tables_of(file))
    }
    files.write_text(path, toml_text(tables, opencv_usage(file)))


FORMAT = CameraFormat(
    name="caliscope",
    title="caliscope camera_array.toml",
    suffixes=(".toml",),
    models=anipose.LENSES.models,
    read=read,
    write=write,
    usage=opencv_usage,
    lenses=anipose.LENSES,
    frames=frozenset({anipose.WORLD}),
    poses="rotation, translation: camera_T_world, Rodrigues vector",
)
