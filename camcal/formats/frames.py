"""Files of named transforms: YAML or JSON of camcal's own, the transforms of a camera file, the poses of a pose file.

    transforms:
      base_T_cam: {R: 3 rows of 3, t: [1.0, 0.0, 0.5]}
      cam_T_tag: {quaternion: {qw: 1.0, qx: 0.0, qy: 0.0, qz: 0.0}, t: [0.0, 0.0, 2.0], covariance: 6 rows of 6}
      cam_T_lidar: {euler: {axes: ZYX, deg: [90.0, 0.0, -90.0]}, t: [0.0, 0.1, 0.0], std: [6 numbers]}

The rotation is one of R, quaternion, rotation_vector (rad), rotation_vector_deg, euler, or matrix, which has the
translation too. Unlike in a camera file, transforms may form loops.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput, Located
from camcal.formats import cameras, emit, native, poses
from camcal.formats.camera_file import named_transform
from camcal.formats.covariance import QUATERNION, why_no_covariance
from camcal.formats.documents import Check, Document, Fault, child, load_either
from camcal.formats.native import check_name
from camcal.formats.pose_text import Form, LoosePose, form_named
from camcal.formats.poses import record as plain_poses
from camcal.formats.schema import COVARIANCE_OF_POSE, STD, integer, items, mapping, matrix, number, one_of, text
from camcal.geometry import rotation as so3
from camcal.geometry.pose import NamedTransform, Pose, frames_of

FORMAT = "camcal-frames"
VERSION = 1
SUFFIXES = (".yaml", ".yml", ".json")
COMMENT = "camcal frames. Lengths: metres; angles: radians. a_T_b takes points in b to points in a."

_QUATERNIONS = (QUATERNION, ("w", "x", "y", "z"))
_EULER = mapping({"axes": text}, {"deg": items(number(), 3), "rad": items(number(), 3)})
_ROTATIONS: Mapping[str, Check] = {
    "R": matrix(3, 3),
    "quaternion": lambda data, path: mapping(dict.fromkeys(_quaternion_names(data), number()))(data, path),
    "rotation_vector": items(number(), 3),
    "rotation_vector_deg": items(number(), 3),
    "euler": _EULER,
    "matrix": items(items(number(), 4), 3, 4),
}
_UNCERTAIN: Mapping[str, Check] = {"covariance": COVARIANCE_OF_POSE, "std": items(STD, 6)}
_TRANSFORM = mapping({}, {**_ROTATIONS, "t": items(number(), 3), **_UNCERTAIN})


@dataclass(frozen=True, eq=False)
class LooseTransform:
    """A transform as it was written, which may have no rotation. name: empty where none is given."""

    name: str
    pose: LoosePose
    covariance: Array | None
    where: str

    @classmethod
    def of(cls, transform: NamedTransform) -> "LooseTransform":
        """Return a transform that has a rotation."""
        pose = LoosePose(transform.pose.rotation, transform.pose.translation)
        return cls(transform.name, pose, transform.covariance, transform.where)

    def named(self) -> NamedTransform:
        """Return the transform; raises InvalidInput, saying where, if it has no rotation."""
        try:
            pose = self.pose.pose()
        except InvalidInput as error:
            what = f"{self.name}: {error.message}" if self.name else error.message
            raise InvalidInput(what, where=self.where) from error
        target, source = frames_of(self.name) if self.name else ("", "")
        return NamedTransform(target, source, pose, self.covariance, self.where)


def read(path: str | Path) -> tuple[NamedTransform, ...]:
    """Return the transforms of a file, in its order; poses of a pose file all have one name, `where` has the image.

    Raises FileError if it cannot be read or is of another type, InvalidInput with the line of every fault.
    """
    path = Path(path)
    if files.suffix_of(path) == ".csv":
        return _of_poses(path)
    if cameras.format_of(path).name != cameras.OWN:
        return _of_cameras(path, lambda _key: str(path))
    document = load_either(path)
    match document.get("format"):
        case native.FORMAT:
            return _of_cameras(path, lambda key: _where(document, key))
        case plain_poses.FORMAT:
            return _of_poses(path)
    return tuple(item.named() for item in _own(document))


def _of_cameras(path: Path, place: Callable[[str], str]) -> tuple[NamedTransform, ...]:
    """Return the transforms of a camera file; place: what a message calls the place of a key path."""
    file = cameras.read(path)
    return tuple(named_transform(file, name, lambda own: place(f"transforms.{own}")) for name in file.transforms)


def read_loose(path: Path) -> tuple[LooseTransform, ...]:
    """Return the transforms of a file as they are written, whether they are rotations or not.

    Raises as `read` does, but for rotations; those of a pose file are rotations or it is refused.
    """
    document = None if files.suffix_of(path) == ".csv" else load_either(path)
    if document is None or document.get("format") == plain_poses.FORMAT:
        return tuple(map(LooseTransform.of, _of_poses(path)))
    return _own(document)


def _of_poses(path: Path) -> tuple[NamedTransform, ...]:
    found = poses.read(path)
    if found.unit != "m":
        raise InvalidInput(f"its lengths are in {found.unit}, those of transforms in metres", where=str(path))
    target, source = frames_of(found.frames)
    return tuple(
        NamedTransform(target, source, record.transform, record.covariance, f"{path}#{pose_key}")
        for pose_key, record in found.estimates.items()
    )


def _own(document: Document) -> tuple[LooseTransform, ...]:
    whole = mapping(
        {"transforms": mapping({}, others=_check_transform)},
        {"format": one_of((FORMAT,), "format"), "version": integer(1)},
    )
    of_camera = document.get("format") == native.FORMAT
    data = {"transforms": document.get("transforms", {})} if of_camera else document.data
    if faults := list(whole(data, "")):
        raise document.error(faults)
    found = []
    for name, item in data["transforms"].items():
        with Located(where := _where(document, f"transforms.{name}")):
            found.append(LooseTransform(name, _pose(item), _covariance(item), where))
    return tuple(found)


def _where(document: Document, path: str) -> str:
    return f"{document.where}:{document.line(path)}" if document.lines else document.where


def _check_transform(data: Any, path: str) -> Iterator[Fault]:
    faults = [*_check_frames(path), *_TRANSFORM(data, path)] or [*_check_whole(data, path)]
    yield from faults


def _check_frames(path: str) -> Iterator[Fault]:
    name = path.removeprefix("transforms.")
    try:
        frames = frames_of(name)
    except InvalidInput as error:
        yield Fault(path, error.message)
        return
    for frame in frames:
        yield from check_name(frame, path)


def _check_whole(data: Mapping[str, Any], path: str) -> Iterator[Fault]:
    """Check that there is one rotation, one translation, and that both and the covariance are what they say."""
    given = [name for name in _ROTATIONS if name in data]
    if len(given) != 1:
        what = f"{' and '.join(given)} are redundant" if given else "no rotation"
        yield Fault(path, f"{what}; give one of {', '.join(_ROTATIONS)}")
    elif ("t" in data) == ("matrix" in data):
        yield Fault(path, "matrix has the translation: leave t out" if "t" in data else "missing key 't'")
    elif "euler" in data and (reason := _why_no_euler(data["euler"])):
        yield Fault(child(path, "euler"), reason)
    if set(_UNCERTAIN) <= data.keys():
        yield Fault(path, "covariance and std are redundant; leave std out")
    elif "covariance" in data and (reason := why_no_covariance(np.array(data["covariance"], dtype=float))):
        yield Fault(child(path, "covariance"), reason)


def _why_no_euler(data: Mapping[str, Any]) -> str | None:
    if ("deg" in data) == ("rad" in data):
        return "give the three angles as deg or as rad"
    try:
        form_named(f"euler:{data['axes']}:rad")
    except InvalidInput:
        return f"axes {data['axes']!r}: three of XYZ for intrinsic angles, three of xyz for extrinsic ones"
    return None


def _pose(data: Mapping[str, Any]) -> LoosePose:
    """Return the pose of data that has passed the checks."""
    if "matrix" in data:
        return form_named("matrix").parse(np.array(data["matrix"], dtype=float).ravel())
    if "R" in data:
        return LoosePose(np.array(data["R"], dtype=float), np.array(data["t"], dtype=float))
    return _rotation_form(data).parse(np.array([*data["t"], *_rotation_numbers(data)], dtype=float))


def _rotation_form(data: Mapping[str, Any]) -> Form:
    if "euler" in data:
        unit = "deg" if "deg" in data["euler"] else "rad"
        return form_named(f"euler:{data['euler']['axes']}:{unit}")
    if "quaternion" in data:
        return form_named("quat:wxyz")
    return form_named("rvec:deg" if "rotation_vector_deg" in data else "rvec")


def _rotation_numbers(data: Mapping[str, Any]) -> Sequence[float]:
    if "euler" in data:
        angles: Sequence[float] = data["euler"].get("deg") or data["euler"]["rad"]
        return angles
    if "quaternion" in data:
        return [data["quaternion"][name] for name in _quaternion_names(data["quaternion"])]
    numbers: Sequence[float] = data.get("rotation_vector") or data["rotation_vector_deg"]
    return numbers


def _quaternion_names(data: Any) -> tuple[str, ...]:
    """Return the keys that a quaternion has, w x y z with or without a q before them."""
    return _QUATERNIONS[1] if isinstance(data, dict) and "w" in data else _QUATERNIONS[0]


def _covariance(data: Mapping[str, Any]) -> Array | None:
    if "std" in data:
        return np.diag(np.array(data["std"], dtype=float) ** 2)
    return np.array(data["covariance"], dtype=float) if "covariance" in data else None


def write(path: str | Path, transforms: Sequence[NamedTransform], form: Form | None = None) -> None:
    """Write transforms as YAML or JSON by the file's suffix, rotations as `block` does.

    Raises InvalidInput for two transforms of one name, and as `block` does.
    """
    path = Path(path)
    names = [transform.name for transform in transforms]
    if len(set(names)) < len(names):
        raise InvalidInput(f"two transforms are named {max(names, key=names.count)!r}", where=str(path))
    data = {"format": FORMAT, "version": VERSION, "transforms": {item.name: block(item, form) for item in transforms}}
    files.write_text(path, emit.text_for(path, data, COMMENT))


def block(transform: NamedTransform, form: Form | None = None) -> dict[str, Any]:
    """Return a transform as plain data; form: of its rotation, None for R.

    Raises InvalidInput for a form other than a matrix, a quaternion, a rotation vector or Euler angles.
    """
    covariance = transform.covariance
    return {
        **({"R": transform.pose.rotation.tolist()} if form is None else _rotation_block(transform.pose, form)),
        "t": transform.pose.translation.tolist(),
        **({} if covariance is None else {"covariance": covariance.tolist()}),
    }


def _rotation_block(pose: Pose, form: Form) -> dict[str, Any]:
    numbers = form.numbers(pose)[3:].tolist()
    match form.kind:
        case "matrix":
            return {"R": pose.rotation.tolist()}
        case "quat":
            quaternion = so3.to_quaternion(pose.rotation).tolist()
            return {"quaternion": dict(zip(_QUATERNIONS[0], quaternion, strict=True))}
        case "rvec":
            return {"rotation_vector" if form.unit == "rad" else "rotation_vector_deg": numbers}
        case "euler" if form.euler is not None:
            return {"euler": {"axes": form.euler.name, form.unit: numbers}}
    raise InvalidInput(f"rotations in YAML and JSON are matrix, quat, rvec or euler, not {form}; write a .txt")
