"""A single pose as text: the ways to write it as a row of numbers, and files of them.

| form | numbers |
|---|---|
| matrix | 16 or 12, row by row; 9 are a rotation alone |
| quat:wxyz, quat:xyzw | tx ty tz and a quaternion in that order; 4 are a rotation alone |
| rvec, rvec:deg | tx ty tz and a rotation vector; 3 are a rotation alone |
| euler:ZYX:deg, euler:xyz:rad, … | tx ty tz and three angles, capitals intrinsic; 3 are a rotation alone |
| dual-quat | w x y z of the rotation, then of the dual part |
| tum | time tx ty tz qx qy qz qw, or without the time |
| kitti | 12, a matrix row by row |
| colmap | qw qx qy qz tx ty tz |
| ros | x y z qx qy qz qw |

Metres, and radians unless the form says deg.
"""

import re
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

import numpy as np

from camcal import files
from camcal.arrays import Array, FloatArray
from camcal.dataclass import dataclass
from camcal.errors import FileError, InvalidInput, Located
from camcal.formats import emit
from camcal.geometry import rotation as so3
from camcal.geometry.pose import NamedTransform, Pose, frames_of
from camcal.geometry.rotation import (
    EulerOrder,
    dual_quaternion_error,
    examine,
    from_dual_quaternion,
    from_euler,
    to_dual_quaternion,
    to_euler,
)
from camcal.parsing import LARGEST, is_number, parse_numbers

ROUNDED = 1e-3  # how far a rotation may be from one: texts have few digits
LARGEST_ANGLE = 1e6  # rad; of a larger one less than the digits of a text are left once whole turns are taken off
FORMS = ("matrix", "quat:wxyz", "quat:xyzw", "rvec", "euler:ZYX:deg", "dual-quat", "tum", "kitti", "colmap", "ros")

_COUNTS = {
    "matrix": (16, 12, 9),
    "quat": (7, 4),
    "rvec": (6, 3),
    "euler": (6, 3),
    "dual-quat": (8,),
    "tum": (8, 7),
    "kitti": (12,),
    "colmap": (7,),
    "ros": (7,),
}
_QUATERNIONS = {"wxyz": (0, 1, 2, 3), "xyzw": (3, 0, 1, 2)}  # where w, x, y, z stand
_UNITS = {"rad": 1.0, "deg": np.pi / 180}
_BOTTOM = (0.0, 0.0, 0.0, 1.0)
_ELEMENTARY = re.compile(r"R([xyz])\(\s*([^\s()]*?)\s*(deg|rad)?\s*\)")
_SEPARATORS = re.compile(r"[\s,;\[\]()]+")
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*_T_[A-Za-z0-9_]+\b")
_IN_A_LINE = (7, 8, 12, 16)  # numbers
_LIMIT = 1 << 20
_COMMENT_MARK = "#"


@dataclass(frozen=True, eq=False)
class LoosePose:
    """A pose as it was written, which may be none: matrix (3, 3), translation (3,) m.

    norm: of the quaternion, None where it was written otherwise. strays: the largest number that should be 0: of the
    last row against 0 0 0 1, or of a dual quaternion's real part along its dual one.
    """

    matrix: FloatArray
    translation: FloatArray
    norm: float | None = None
    strays: float = 0.0

    @cached_property
    def fault(self) -> str:
        """What is wrong in words, empty if it is a pose but for rounding."""
        if self.norm is not None and abs(self.norm - 1) > ROUNDED:
            return f"quaternion norm is not 1 but {self.norm:.6g}"
        if self.strays > ROUNDED:
            return f"what should be 0 0 0 1, or at right angles, is off by {self.strays:.3g}"
        return examine(self.matrix).fault(ROUNDED)

    def pose(self) -> Pose:
        """Return the nearest pose; raises InvalidInput if it is farther than rounding explains."""
        if self.fault:
            raise InvalidInput(self.fault)
        return Pose(so3.nearest(self.matrix), self.translation)


@dataclass(frozen=True)
class Form:
    """One of the ways. quaternion: wxyz or xyzw. unit: rad or deg, of rotation vectors and angles."""

    kind: str
    quaternion: str = "xyzw"
    euler: EulerOrder | None = None
    unit: str = "rad"

    def __str__(self) -> str:
        if self.euler is not None:
            kind = "intrinsic" if self.euler.intrinsic else "extrinsic"
            return f"euler:{self.euler.name}:{kind}:{self.unit}"
        words = {"quat": f":{self.quaternion}", "rvec": f":{self.unit}"}
        return self.kind + words.get(self.kind, "")

    def numbers(self, pose: Pose) -> FloatArray:
        """Return a pose as numbers, translation and rotation."""
        if self.kind in {"matrix", "kitti"}:
            return pose.matrix()[: 3 if self.kind == "kitti" else 4].ravel()
        if self.kind == "dual-quat":
            return to_dual_quaternion(pose.rotation, pose.translation)
        if self.kind == "colmap":
            return np.concatenate([so3.to_quaternion(pose.rotation), pose.translation])
        time = [0.0] if self.kind == "tum" else []
        return np.concatenate([time, pose.translation, self._rotation(pose)])

    def locked(self, pose: Pose) -> bool:
        """Return whether angles are in gimbal lock, so that others would say the same."""
        return self.euler is not None and bool(to_euler(pose.rotation, self.euler)[1])

    def _rotation(self, pose: Pose) -> Array:
        """Return the rotation as a quaternion, a rotation vector or angles."""
        if self.kind == "euler" and self.euler is not None:
            return to_euler(pose.rotation, self.euler)[0] / _UNITS[self.unit]
        if self.kind == "rvec":
            return pose.vector() / _UNITS[self.unit]
        quaternion = so3.to_quaternion(pose.rotation)
        return quaternion if self.quaternion == "wxyz" else np.roll(quaternion, -1)

    def parse(self, numbers: Array) -> LoosePose:
        """Return finite numbers; raises InvalidInput if there are more or fewer than the form has."""
        counts = _COUNTS[self.kind]
        if len(numbers) not in counts:
            wanted = " or ".join(map(str, counts))
            raise InvalidInput(f"{len(numbers)} numbers; a pose as {self.kind} has {wanted}")
        if not np.abs(numbers).max() < LARGEST:
            raise InvalidInput(f"a pose has numbers below {LARGEST:g}")
        match self.kind:
            case "matrix" | "kitti":
                return _of_matrix(numbers)
            case "dual-quat":
                norm = float(np.linalg.norm(numbers[:4]))
                if not norm > 0:
                    return LoosePose(np.full((3, 3), np.nan), np.zeros(3), norm)
                rotation, translation = from_dual_quaternion(numbers)
                return LoosePose(rotation, translation, norm, float(dual_quaternion_error(numbers)))
            case "colmap":
                return _of_quaternion(numbers[:4], numbers[4:])
            case "quat" | "tum" | "ros":
                order = _QUATERNIONS[self.quaternion]
                return _of_quaternion(numbers[-4:][list(order)], _before(numbers, 4))
        angles = _check(numbers[-3:] * _UNITS[self.unit])
        matrix = so3.exp(angles) if self.euler is None else from_euler(angles, self.euler)
        return LoosePose(matrix, _before(numbers, 3))


def form_named(text: str) -> Form:
    """Return the form of a name such as quat:wxyz or euler:ZYX:deg; raises InvalidInput for another one."""
    kind, *words = text.split(":")
    if kind not in _COUNTS:
        raise InvalidInput(f"form {text!r} is unknown; use one of {', '.join(FORMS)}")
    if kind == "quat":
        if len(words) != 1 or words[0] not in _QUATERNIONS:
            raise InvalidInput(f"form {text!r}: quaternion order missing, quat:wxyz or quat:xyzw")
        return Form(kind, quaternion=words[0])
    if kind == "euler":
        return _euler(text, words)
    if kind == "rvec" and len(words) <= 1 and set(words) <= set(_UNITS):
        return Form(kind, unit=(words or ["rad"])[0])
    if words:
        raise InvalidInput(f"form {text!r}: nothing allowed after {kind}")
    return Form(kind)


def form_of(text: str | None) -> Form | None:
    """Return the form of a name, None where none is given; see `form_named`."""
    return None if text is None else form_named(text)


def _euler(text: str, words: Sequence[str]) -> Form:
    """Return the form of Euler angles; what the letters say of intrinsic and extrinsic, words may say instead."""
    kinds = [word for word in words if word in {"intrinsic", "extrinsic"}]
    units = [word for word in words if word in _UNITS]
    axes = [word for word in words if word not in (*kinds, *units)]
    if len(axes) != 1 or len(units) != 1 or len(kinds) > 1:
        raise InvalidInput(
            f"form {text!r}: Euler angles need their axes and their unit, as euler:ZYX:deg (capitals: intrinsic, about "
            "axes that turn along) or euler:xyz:rad (small letters: extrinsic)"
        )
    order = EulerOrder(axes[0].lower(), kinds == ["intrinsic"]) if kinds else EulerOrder.named(axes[0])
    return Form("euler", euler=order, unit=units[0])


def guessed(count: int) -> Form:
    """Return the form that a count of numbers leaves no doubt of; raises InvalidInput where it does."""
    if count in _COUNTS["matrix"]:
        return Form("matrix")
    if count == 8:
        return Form("tum")
    possible = {7: "quat:wxyz, quat:xyzw, tum, ros or colmap", 4: "quat:wxyz or quat:xyzw"}
    angles = "rvec, or Euler angles such as euler:ZYX:deg"
    if count in {*possible, 6, 3}:
        raise InvalidInput(f"{count} numbers are ambiguous; choose a form: {possible.get(count, angles)}")
    raise InvalidInput(
        f"{count} numbers; one pose has 16 or 12 (a matrix, row by row), or 8: time tx ty tz qx qy qz qw"
    )


def is_row(text: str) -> bool:
    """Return whether a text is numbers with blanks, commas or brackets between them, and nothing else."""
    parts = [part for part in _SEPARATORS.split(text) if part]
    return bool(parts) and all(map(is_number, parts))


def numbers_in(text: str) -> Array:
    """Return the numbers of a row; raises InvalidInput if they are not finite, or the text is no row."""
    if not is_row(text):
        raise InvalidInput("not a list of numbers")
    numbers = np.array(parse_numbers(part for part in _SEPARATORS.split(text) if part))
    if not np.isfinite(numbers).all():
        raise InvalidInput("a pose needs finite numbers")
    return numbers


def is_elementary(text: str) -> bool:
    """Return whether a text is a turn about a coordinate axis, such as Rz(90deg)."""
    return _ELEMENTARY.fullmatch(text.strip()) is not None


def elementary(text: str) -> LoosePose:
    """Return the pose of a turn such as Rx(-30deg) or Rz(1.57 rad); raises InvalidInput for an angle without a unit."""
    found = _ELEMENTARY.fullmatch(text.strip())
    if found is None or found[3] is None or not is_number(found[2]):
        raise InvalidInput("a turn about an axis is an angle with its unit, such as Rz(90deg) or Rz(1.57rad)")
    (angle,) = _check(numbers_in(found[2]) * _UNITS[found[3]])
    turns = {"x": so3.about_x, "y": so3.about_y, "z": so3.about_z}
    return LoosePose(turns[found[1]](angle), np.zeros(3))


def _check(angles: Array) -> Array:
    """Return angles (N,) in radians; raises InvalidInput if one is too large to say a direction."""
    if not np.abs(angles).max() <= LARGEST_ANGLE:
        raise InvalidInput(f"an angle of more than {LARGEST_ANGLE:g} rad is not a valid rotation")
    return angles


def _before(numbers: Array, count: int) -> Array:
    """Return the translation before the last `count` numbers, zero where there is none."""
    return numbers[-count - 3 : -count] if len(numbers) > count else np.zeros(3)


def _of_matrix(numbers: Array) -> LoosePose:
    if len(numbers) == 9:
        return LoosePose(numbers.reshape(3, 3), np.zeros(3))
    matrix = numbers.reshape(-1, 4)
    strays = np.abs(matrix[3:] - _BOTTOM).max(initial=0.0)
    return LoosePose(matrix[:3, :3], matrix[:3, 3], strays=float(strays))


def _of_quaternion(quaternion: Array, translation: Array) -> LoosePose:
    """Return the pose of a quaternion w x y z and a translation."""
    norm = float(np.linalg.norm(quaternion))
    return LoosePose(so3.from_quaternion(quaternion) if norm > 0 else np.full((3, 3), np.nan), translation, norm)


def read(path: Path, form: Form | None = None) -> Pose:
    """Return the pose of a file: 16 or 12 numbers, row by row, or the 8 of TUM (time tx ty tz qx qy qz qw), metres.

    form: what the numbers are, if not these and no remark says so. Lines that begin with # are passed over.
    Raises FileError if it holds something else than numbers, InvalidInput if they are no pose, or more than one.
    """
    with Located(path):
        return read_loose(path, form).pose()


def read_loose(path: Path, form: Form | None = None) -> LoosePose:
    """Return the pose of a file as `read` does, but as it is written, which may be none."""
    text = files.read_text(path, _LIMIT)
    with Located(path):
        return _parse(text, form)


def name_in(path: Path) -> str:
    """Return the name a_T_b that a remark of the file, or else the file's own name, begins with; empty without one."""
    remarks = [
        line.lstrip("# \t") for line in files.read_text(path, _LIMIT).splitlines() if line.startswith(_COMMENT_MARK)
    ]
    found = (_NAME.match(words) for words in (*remarks, path.name))
    return next((match[0] for match in found if match), "")


def text_of(transform: NamedTransform, form: Form) -> str:
    """Return a transform as lines of numbers below a remark with its name and form, which `read` understands."""
    numbers = [emit.number_text(number).removesuffix(".0") for number in form.numbers(transform.pose)]
    width = 4 if form.kind == "matrix" else len(numbers)
    rows = [" ".join(numbers[start : start + width]) for start in range(0, len(numbers), width)]
    named = form.kind == "ros" and transform.name
    publish = [f"# {static_transform_publisher(transform.name, transform.pose)}"] if named else []
    lock = ["# gimbal lock: the last angle is set to 0"] if form.locked(transform.pose) else []
    return "\n".join([f"# {transform.name or 'pose'}, {form}", *publish, *lock, *rows]) + "\n"


def static_transform_publisher(frames: str, a_T_b: Pose) -> str:
    """Return the command that publishes a pose that does not change."""
    a, b = frames_of(frames)
    values = zip(("x", "y", "z", "qx", "qy", "qz", "qw"), Form("ros").numbers(a_T_b), strict=True)
    options = " ".join(f"--{name} {value:.12g}" for name, value in values)
    return f"ros2 run tf2_ros static_transform_publisher {options} --frame-id {a} --child-frame-id {b}"


def _parse(text: str, form: Form | None) -> LoosePose:
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith(_COMMENT_MARK)]
    if lines and not is_row(" ".join(lines)):
        raise FileError("not a list of numbers")
    numbers = numbers_in(" ".join(lines)) if lines else np.empty(0)
    if len(lines) > 1 and len(numbers) in {count * len(lines) for count in _IN_A_LINE}:
        raise InvalidInput(
            f"holds {len(lines)} poses, one a line, and a single one is read here; --trajectory of 'camcal transform "
            "convert' and 'average' takes all"
        )
    return (form or _form_in(text) or guessed(len(numbers))).parse(numbers)


def _form_in(text: str) -> Form | None:
    """Return the form that a remark such as '# base_T_cam, rvec:deg' says, None without one."""
    for name in re.findall(r"^# \w+, ([\w:-]+)$", text, re.MULTILINE):
        try:
            return form_named(name)
        except InvalidInput:
            continue
    return None
