"""camcal's own camera file: one YAML that every command reads (docs/formats.md).

Units are in the keys or are pixels, metres and radians; pixel (0, 0) is the centre of the top-left pixel.
What breaks no rule but looks wrong is a warning. Of the transforms, right_T_left takes points in left to points in
right:

    right_T_left:
      R:
        - [1.0, 0.0, 0.0]
        - [0.0, 1.0, 0.0]
        - [0.0, 0.0, 1.0]
      t: [-0.11, 0.0, 0.0]
      covariance: 6 rows of 6, order tx ty tz rx ry rz (optional)

A name is that of a camera or a free frame. Between any two frames there is at most one path.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.cameras.catalogue import model_of
from camcal.cameras.model import Camera
from camcal.cameras.validity import Fold, field_and_fold
from camcal.errors import InvalidInput
from camcal.formats import covariance, documents, emit, native_entry, provenance
from camcal.formats.camera_file import CameraEntry, CameraFile, JointCovariance, Transform
from camcal.formats.covariance import why_no_covariance
from camcal.formats.documents import Fault, child
from camcal.formats.native_entry import board_shape_block, check_board_shape, read_board_shape
from camcal.formats.schema import COVARIANCE_OF_POSE, VENDOR, flag, integer, items, mapping, matrix, number, plain, text
from camcal.geometry.pose import JOINT, Pose
from camcal.geometry.rotation import examine
from camcal.messages import Message
from camcal.parsing import nearest
from camcal.progress import SILENT, Progress, warn_of

FORMAT = "camcal-calibration"
VERSION = 1
COMMENT = "camcal camera file. Units: pixels, {}, radians. Pixel (0, 0) = centre of the top-left pixel.\n"
_LENGTHS = {"m": "metres", "squares": "squares of the board"}
TRANSFORMS = "a_T_b takes points in b to points in a."
FRAMES = ("imu", "body", "world", "board", "rig", "base", "gripper")
NAME = re.compile(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*\Z")
ORTHONORMAL = 1e-6

_OFF_CENTRE = 0.25  # of the image's side: more than any lens is decentred, less than a wrong resolution
_ASPECT = (0.9, 1.1)
_FIELD_DEG = (3.0, 200.0)
_LARGE_RMS = 1.0
_FEW_IMAGES = 10
_FAR = 20.0  # metres between two cameras; 20 and more are probably millimetres

_TRANSFORM = mapping({"R": matrix(3, 3), "t": items(number(), 3)}, {"covariance": COVARIANCE_OF_POSE})
_JOINT = mapping({}, covariance.KEYS)
_FILE = mapping(
    {"format": text, "version": integer(1), "cameras": mapping({}, others=native_entry.check)},
    {
        "transforms": mapping({}, others=plain),  # the check of transforms needs the cameras' names as well
        "joint_covariance": _JOINT,
        "board_shape": check_board_shape,
        "boards": mapping({}, others=check_board_shape),
        "provenance": provenance.check,
        "converted_from": mapping(
            {"file": text, "format": text}, {"exact": flag, "refit_rms_px": number(0), "refit_max_px": number(0)}
        ),
    },
)


def read(path: str | Path, progress: Progress = SILENT) -> CameraFile:
    """Return the content of a camera file, with warnings about implausible values and of cameras that are not to be
    trusted; progress is told of them.

    Raises InvalidInput with a line for every rule it breaks, FileError if it cannot be read or is no YAML.
    """
    path = Path(path)
    file = from_document(documents.load(path, check), path.parent)
    warn_of(file.warnings, progress)
    return file


def from_document(document: documents.Document, folder: Path) -> CameraFile:
    """Return the camera file of a document that has passed `check`; folder: where the file lies."""
    cameras: dict[str, CameraEntry] = {}
    found: list[Message] = []
    for name, data in document["cameras"].items():
        cameras[name], unknown = native_entry.read(data, folder)
        found += _without_uncertainty(child("cameras", name), unknown)
    file = CameraFile(
        cameras,
        transforms=_read_transforms(document.get("transforms", {})),
        joint_covariance=_read_joint(document.get("joint_covariance"), folder),
        board_shape=read_board_shape(document["board_shape"], folder) if "board_shape" in document else None,
        boards={name: read_board_shape(data, folder) for name, data in document.get("boards", {}).items()},
        provenance=document.get("provenance", {}),
        converted_from=document.get("converted_from", {}),
        extra={key: value for key, value in document.items() if key.startswith(VENDOR)},
    )
    found += implausible(file)
    return replace(file, warnings=tuple(map(document.located, found)))


def write(path: Path, file: CameraFile, *, exact: bool = False) -> None:
    """Write a camera file: the same content gives the same bytes, and what is written passes `check`.

    exact: numbers with all their digits, not with 12 significant ones.
    Raises InvalidInput if the content breaks a rule, FileError if the file cannot be written.
    """
    unit = "m" if file.board_shape is None else file.board_shape.board.unit
    comment = COMMENT.format(_LENGTHS[unit]) + (TRANSFORMS if file.transforms else "")
    content = emit.document(block(file, path), comment, emit.exact_text if exact else None)
    documents.parse(content, str(path), check)
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
        yield from check_name(name, child("cameras", name))
    boards = data.get("boards", {})
    for name in boards if isinstance(boards, dict) else ():
        yield from check_name(name, child("boards", name))
        if name in cameras:
            yield Fault(child("boards", name), f"a camera is called {name!r} as well")
    yield from _check_transforms(transforms, "transforms", [*cameras, *boards])
    if isinstance(transforms, dict) and not any(_JOINT(joint, "")):
        yield from covariance.check(joint, "joint_covariance", list(_joint_names(cameras, transforms)))


def _why_not_ours(data: Mapping[str, Any]) -> Fault | None:
    if "format" not in data:
        return Fault("", f"not a camera file: 'format: {FORMAT}' is missing")
    if data["format"] != FORMAT:
        return Fault("format", f"{data['format']!r}; a camera file has {FORMAT}")
    version = data.get("version")
    if isinstance(version, int) and version > VERSION:
        return Fault("version", f"version {version} is newer than this camcal (reads {VERSION}); upgrade camcal")
    return None


def _joint_names(cameras: Mapping[str, Any], transforms: Mapping[str, Any]) -> Iterator[str]:
    """Yield the names a joint covariance may speak of: left.fx, right_T_left.tx."""
    for name, data in cameras.items():
        parameters: tuple[str, ...] = ()
        if isinstance(data, dict):
            with suppress(KeyError, TypeError, InvalidInput):  # which the check of the camera reports
                parameters = model_of(data["model"], data.get("configuration")).parameter_names
        yield from (f"{name}.{parameter}" for parameter in parameters)
    yield from (f"{name}.{step}" for name in transforms for step in covariance.ORDER)


def _read_joint(data: Mapping[str, Any] | None, folder: Path) -> JointCovariance | None:
    if not data:
        return None
    names = data.get("covariance_order") or list(data.get("std", {}))
    known, _ = covariance.read(data, names, folder)
    return None if known is None else JointCovariance(tuple(names), known)


def block(file: CameraFile, path: Path) -> dict[str, Any]:
    """Return a camera file as plain data; path: where it is written to."""
    joint = file.joint_covariance
    return {
        "format": FORMAT,
        "version": VERSION,
        "cameras": {name: native_entry.block(entry, path) for name, entry in file.cameras.items()},
        "transforms": _transforms_block(file.transforms) or None,
        "joint_covariance": covariance.block(joint.names, joint.matrix, path) if joint else None,
        "board_shape": board_shape_block(file.board_shape, path) if file.board_shape else None,
        "boards": {name: board_shape_block(surface, path) for name, surface in file.boards.items()} or None,
        "converted_from": file.converted_from or None,
        "provenance": file.provenance or None,
        **file.extra,
    }


def _without_uncertainty(path: str, names: Sequence[str]) -> Iterator[Message]:
    """Yield that a camera's uncertainty cannot be used, if there are parameters without one."""
    if names:
        text = f"no uncertainty of {', '.join(names)}: the uncertainty block is not used"
        yield Message("incomplete_uncertainty", text, where=child(path, "uncertainty"))


def check_name(name: str, path: str) -> Iterator[Fault]:
    """Check the name of a camera or a frame."""
    if not NAME.match(name) or JOINT in name:
        yield Fault(
            path, f"{name!r} is not a valid name: letters and digits joined by single '_', a letter first, no '_T_'"
        )


def _check_transforms(data: Any, path: str, cameras: Sequence[str]) -> Iterator[Fault]:
    """Check all transforms; cameras: the names that the file gives its cameras."""
    yield from mapping({}, others=_check_transform)(data, path)
    tree: dict[str, str] = {}  # frame -> the frame that stands for all that are connected with it
    for key in data if isinstance(data, dict) else ():
        faults = list(_check_frames(key, child(path, key), cameras)) or list(_connect(key, child(path, key), tree))
        yield from faults


def _check_transform(data: Any, path: str) -> Iterator[Fault]:
    faults = list(_TRANSFORM(data, path))
    yield from faults
    if faults:
        return
    yield from _check_rotation(np.array(data["R"], dtype=float), child(path, "R"))
    if "covariance" in data:
        reason = why_no_covariance(np.array(data["covariance"], dtype=float))
        yield from [Fault(child(path, "covariance"), reason)] if reason else ()


def _check_rotation(matrix: Array, path: str) -> Iterator[Fault]:
    found = examine(matrix)
    if fault := found.fault(ORTHONORMAL):
        advice = "; write R with 9 digits or more" if found.can_be_fixed else ""
        yield Fault(path, f"{fault}{advice}")


def _check_frames(key: str, path: str, cameras: Sequence[str]) -> Iterator[Fault]:
    frames = key.split(JOINT)
    if len(frames) != 2:
        yield Fault(path, f"{key!r} is not a transform name such as a_T_b (takes points in b to points in a)")
        return
    for name in frames:
        yield from check_name(name, path)
        meant = nearest(name, [*cameras, *FRAMES], likeness=0.8)
        # cam2 beside cam1 is another frame, rigth beside right is a slip of the pen
        if meant is not None and name.rstrip("0123456789") != meant.rstrip("0123456789"):
            yield Fault(path, f"no camera or frame {name!r}. Did you mean {meant!r}?")


def _connect(key: str, path: str, tree: dict[str, str]) -> Iterator[Fault]:
    a, b = key.split(JOINT)
    root_a, root_b = tree.setdefault(a, a), tree.setdefault(b, b)
    if root_a == root_b:
        yield Fault(path, f"there is already a path between {a!r} and {b!r}; leave one transform out")
    tree.update({frame: root_a for frame, root in tree.items() if root == root_b})


def _read_transforms(data: Mapping[str, Any]) -> dict[str, Transform]:
    """Return the transforms of data that has passed `check`, by name."""
    return {
        name: Transform(Pose(np.array(item["R"], dtype=float), item["t"]), item.get("covariance"))
        for name, item in data.items()
    }


def _transforms_block(transforms: Mapping[str, Transform]) -> dict[str, Any]:
    """Return transforms as plain data."""
    return {
        name: {
            "R": item.pose.rotation.tolist(),
            "t": item.pose.translation.tolist(),
            "covariance": None if item.covariance is None else item.covariance.tolist(),
        }
        for name, item in transforms.items()
    }


def implausible(file: CameraFile) -> Iterator[Message]:
    """Yield warnings about a camera file, each with its key path in camcal's own format."""
    for name, entry in file.cameras.items():
        path = child("cameras", name)
        yield from _principal_point(entry.camera, child(path, "intrinsics"))
        ratio = entry.camera.value("fx") / entry.camera.value("fy")
        if not _ASPECT[0] <= ratio <= _ASPECT[1]:
            text = f"fx/fy = {ratio:.3g}: check the pixel aspect ratio (anamorphic or stretched video)"
            yield Message("unlikely_aspect", text, {"fx_over_fy": ratio}, child(path, "intrinsics"))
        if not entry.camera.model.is_view:  # a view, not a lens: it may show all around
            horizontal, fold = field_and_fold(entry.camera, entry.image_circle)
            if entry.camera.model.is_central:
                yield from _opening(horizontal, child(path, "intrinsics"))
            yield from _folding(fold, entry, child(path, "distortion"))
        yield from _quality(entry, child(path, "quality"))
        yield from untrustworthy(entry, child(path, "verdict"))
    for name, transform in file.transforms.items():
        distance = float(np.linalg.norm(transform.pose.translation))
        if distance > _FAR:
            place = child(child("transforms", name), "t")
            yield Message("unlikely_baseline", f"{distance:g} m: check the unit", {"distance_m": distance}, place)


def _principal_point(camera: Camera, path: str) -> Iterator[Message]:
    for name, side, what in zip(("cx", "cy"), camera.image_size, ("width", "height"), strict=True):
        value = camera.value(name)
        if abs(value - (side - 1) / 2) > _OFF_CENTRE * side:
            text = f"{name} = {value:g} for image {what} {side}: check that both are of one resolution"
            yield Message("unlikely_principal_point", text, {name: value, what: side}, child(path, name))


def _opening(field: float, path: str) -> Iterator[Message]:
    horizontal = math.degrees(field)
    if horizontal < _FIELD_DEG[0] or horizontal > _FIELD_DEG[1]:
        text = f"horizontal field of view {horizontal:.3g}°: check that fx and image_size are of one resolution"
        yield Message("unlikely_field_of_view", text, {"horizontal_deg": horizontal}, child(path, "fx"))


def _folding(fold: Fold, entry: CameraEntry, path: str) -> Iterator[Message]:
    if fold.folds:
        limit = f"distortion is not invertible beyond {fold.radius_px:.0f} px from the centre"
        end = "image corner is at" if entry.image_circle is None else "image circle reaches to"
        values = {"radius_px": fold.radius_px, "corner_px": fold.corner_px}
        yield Message("distortion_not_invertible", f"{limit}; the {end} {fold.corner_px:.0f} px", values, path)


def _quality(entry: CameraEntry, path: str) -> Iterator[Message]:
    rms, images = entry.quality.get("rms_px", 0.0), entry.quality.get("images_used", _FEW_IMAGES)
    if rms > _LARGE_RMS:
        text = f"reprojection RMS {rms:g} px (limit {_LARGE_RMS:g} px): calibrate again"
        yield Message("large_rms", text, {"rms_px": rms, "limit_px": _LARGE_RMS}, child(path, "rms_px"))
    if images < _FEW_IMAGES:
        text = f"{images} images: use {_FEW_IMAGES} or more"
        yield Message("few_images", text, {"images": images, "limit": _FEW_IMAGES}, child(path, "images_used"))


def untrustworthy(entry: CameraEntry, path: str) -> Iterator[Message]:
    """Yield a warning at a path if the file says that the calibration of a camera must not be trusted."""
    if entry.verdict is not None and not entry.verdict.trustworthy:
        reasons = " ".join("; ".join(entry.verdict.reasons).split())  # a warning is one line
        yield Message("untrustworthy", f"untrustworthy calibration: {reasons or 'no reason given'}", where=path)
