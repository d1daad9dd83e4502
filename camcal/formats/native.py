"""camcal's own camera file: one YAML that every command reads (docs/formats.md).

Units are in the keys or are pixels, metres and radians; pixel (0, 0) is the centre of the top-left pixel.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.cameras.catalogue import MODELS
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.formats import (
    covariance,
    emit,
    native_board_shape,
    native_entry,
    native_transforms,
    native_warnings,
    provenance,
    strict_yaml,
)
from camcal.formats.camera_file import (
    CameraEntry,
    CameraFile,
    JointCovariance,
    Noise,
    ProjectionStd,
    Transform,
    ValidRegion,
    Verdict,
)
from camcal.formats.schema import VENDOR, did_you_mean, flag, integer, mapping, number, plain, text
from camcal.formats.strict_yaml import Fault, child

__all__ = [
    "CameraEntry",
    "CameraFile",
    "JointCovariance",
    "Noise",
    "ProjectionStd",
    "Transform",
    "ValidRegion",
    "Verdict",
    "check",
    "read",
    "read_camera",
    "write",
]

FORMAT = "camcal-calibration"
VERSION = 1
COMMENT = "camcal camera file. Units: pixels, metres, radians. Pixel (0, 0) = centre of the top-left pixel.\n"
TRANSFORMS = "a_T_b takes points in b to points in a."

_JOINT = mapping({}, covariance.KEYS)
_FILE = mapping(
    {"format": text, "version": integer(1), "cameras": mapping({}, others=native_entry.check)},
    {
        "transforms": mapping({}, others=plain),  # native_transforms.check needs the cameras' names as well
        "joint_covariance": _JOINT,
        "board_shape": native_board_shape.check,
        "provenance": provenance.check,
        "converted_from": mapping(
            {"file": text, "format": text}, {"exact": flag, "refit_rms_px": number(0), "refit_max_px": number(0)}
        ),
    },
)


def read(path: Path) -> CameraFile:
    """Return the content of a camera file, with warnings about what looks wrong in it.

    Raises InvalidInput with a line for every rule it breaks, FileError if it cannot be read or is no YAML.
    """
    return from_document(strict_yaml.load(path, check), path.parent)


def from_document(document: strict_yaml.Document, folder: Path) -> CameraFile:
    """Return the camera file of a document that has passed `check`; folder: where the file lies."""
    cameras: dict[str, CameraEntry] = {}
    findings: list[Fault] = []
    for name, data in document["cameras"].items():
        cameras[name], unknown = native_entry.read(data, folder)
        findings += native_warnings.without_uncertainty(child("cameras", name), unknown)
    file = CameraFile(
        cameras,
        transforms=native_transforms.read(document.get("transforms", {})),
        joint_covariance=_read_joint(document.get("joint_covariance"), folder),
        board_shape=native_board_shape.read(document["board_shape"], folder) if "board_shape" in document else None,
        provenance=document.get("provenance", {}),
        converted_from=document.get("converted_from", {}),
        extra={key: value for key, value in document.items() if key.startswith(VENDOR)},
    )
    findings += native_warnings.findings(file)
    return replace(file, warnings=tuple(map(document.message, findings)))


def read_camera(path: Path, name: str | None = None) -> Camera:
    """Return one camera of a file; the name may be left out where there is only one.

    Raises InvalidInput if it is not clear which one is meant.
    """
    return select(read(path), name, str(path)).camera


def select(file: CameraFile, name: str | None, where: str) -> CameraEntry:
    """Return the camera of that name, or the only one."""
    names = list(file.cameras)
    if name is None and len(names) > 1:
        one = f"{where}#{names[0]}"
        raise InvalidInput(f"holds {len(names)} cameras ({', '.join(names)}); say which, such as {one}", where=where)
    if name is not None and name not in names:
        raise InvalidInput(f"no camera {name!r}{did_you_mean(name, names)}", where=where)
    return file.cameras[name or names[0]]


def write(path: Path, file: CameraFile) -> None:
    """Write a camera file: the same content gives the same bytes, and what is written passes `check`.

    Raises InvalidInput if the content breaks a rule, FileError if the file cannot be written.
    """
    data = _plain(_block(file, path))
    comment = COMMENT + TRANSFORMS if file.transforms else COMMENT
    content = emit.document(data, comment)
    strict_yaml.parse(content, str(path), check)
    files.write_text(path, content)


def check(data: Any, path: str = "") -> Iterator[Fault]:
    """Check the data of a camera file."""
    stranger = _why_not_ours(data)
    if stranger is not None:
        yield stranger
        return
    yield from _FILE(data, path)
    cameras, transforms, joint = (data.get(key, {}) for key in ("cameras", "transforms", "joint_covariance"))
    if not isinstance(cameras, dict):
        return
    if not cameras:
        yield Fault("cameras", "no camera; a file has at least one")
    for name in cameras:
        yield from native_transforms.check_name(name, child("cameras", name))
    yield from native_transforms.check(transforms, "transforms", list(cameras))
    if isinstance(transforms, dict) and not any(_JOINT(joint, "")):
        yield from covariance.check(joint, "joint_covariance", list(_joint_names(cameras, transforms)))


def _why_not_ours(data: Mapping[str, Any]) -> Fault | None:
    if "format" not in data:
        return Fault("", f"not a camera file of camcal: 'format: {FORMAT}' is missing")
    if data["format"] != FORMAT:
        return Fault("format", f"{data['format']!r}; a camera file has {FORMAT}")
    version = data.get("version")
    if isinstance(version, int) and version > VERSION:
        return Fault("version", f"version {version} is newer than this camcal (reads {VERSION}); upgrade camcal")
    return None


def _joint_names(cameras: Mapping[str, Any], transforms: Mapping[str, Any]) -> Iterator[str]:
    """Yield the names a joint covariance may speak of: left.fx, right_T_left.tx."""
    for name, data in cameras.items():
        model = data.get("model") if isinstance(data, dict) else None
        parameters = MODELS[model].parameter_names if isinstance(model, str) and model in MODELS else ()
        yield from (f"{name}.{parameter}" for parameter in parameters)
    yield from (f"{name}.{step}" for name in transforms for step in native_transforms.STEP)


def _read_joint(data: Mapping[str, Any] | None, folder: Path) -> JointCovariance | None:
    if not data:
        return None
    names = data.get("covariance_order") or list(data.get("std", {}))
    known, _ = covariance.read(data, names, folder)
    return None if known is None else JointCovariance(tuple(names), known)


def _block(file: CameraFile, path: Path) -> dict[str, Any]:
    joint = file.joint_covariance
    return {
        "format": FORMAT,
        "version": VERSION,
        "cameras": {name: native_entry.block(entry, path) for name, entry in file.cameras.items()},
        "transforms": native_transforms.block(file.transforms) or None,
        "joint_covariance": covariance.block(joint.names, joint.matrix, path) if joint else None,
        "board_shape": native_board_shape.block(file.board_shape, path) if file.board_shape else None,
        "converted_from": file.converted_from or None,
        "provenance": file.provenance or None,
        **file.extra,
    }


def _plain(value: Any) -> Any:
    """Return data as dicts, lists and Python scalars, keys whose value is None left out."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items() if item is not None}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    return str(value) if isinstance(value, Path) else value
