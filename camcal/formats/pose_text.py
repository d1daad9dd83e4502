"""A single pose as text: numbers in one of the forms of `pose_forms`."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

from camcal import files
from camcal.errors import FileError, InvalidInput
from camcal.formats import emit
from camcal.formats.pose_forms import Form, LoosePose, form_named, guessed, is_row, numbers_in
from camcal.geometry.named import NamedTransform
from camcal.geometry.pose import Pose

Result = TypeVar("Result")

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*_T_[A-Za-z0-9_]+\b")
_IN_A_LINE = (7, 8, 12, 16)  # numbers
_LIMIT = 1 << 20
_REMARK = "#"


def read(path: Path, form: Form | None = None) -> Pose:
    """Return the pose of a file: 16 or 12 numbers, row by row, or the 8 of TUM (time tx ty tz qx qy qz qw), metres.

    form: what the numbers are, if not these and no remark says so. Lines that begin with # are passed over.
    Raises FileError if it holds something else than numbers, InvalidInput if they are no pose, or more than one.
    """
    return _at(path, lambda: read_loose(path, form).pose())


def read_loose(path: Path, form: Form | None = None) -> LoosePose:
    """Return the pose of a file as `read` does, but as it is written, which may be none."""
    text = files.read_text(path, _LIMIT)
    return _at(path, lambda: _parsed(text, form))


def name_in(path: Path) -> str:
    """Return the name a_T_b that a remark of the file, or else the file's own name, begins with; empty without one."""
    remarks = [line.lstrip("# \t") for line in files.read_text(path, _LIMIT).splitlines() if line.startswith(_REMARK)]
    found = (_NAME.match(words) for words in (*remarks, path.name))
    return next((match[0] for match in found if match), "")


def text_of(transform: NamedTransform, form: Form) -> str:
    """Return a transform as lines of numbers below a remark with its name and form, which `read` understands."""
    numbers = [emit.number_text(number).removesuffix(".0") for number in form.numbers(transform.pose)]
    width = 4 if form.kind == "matrix" else len(numbers)
    rows = [" ".join(numbers[start : start + width]) for start in range(0, len(numbers), width)]
    lock = ["# gimbal lock: the last angle is set to 0"] if form.locked(transform.pose) else []
    return "\n".join([f"# {transform.name or 'pose'}, {form}", *_tf_remark(transform, form), *lock, *rows]) + "\n"


def _tf_remark(transform: NamedTransform, form: Form) -> list[str]:
    if form.kind != "ros" or not transform.name:
        return []
    names = ("x", "y", "z", "qx", "qy", "qz", "qw")
    numbers = " ".join(
        f"--{name} {value:.12g}" for name, value in zip(names, form.numbers(transform.pose), strict=True)
    )
    frames = f"--frame-id {transform.target} --child-frame-id {transform.source}"
    return [f"# ros2 run tf2_ros static_transform_publisher {numbers} {frames}"]


def _parsed(text: str, form: Form | None) -> LoosePose:
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith(_REMARK)]
    if lines and not is_row(" ".join(lines)):
        raise FileError("holds something else than the numbers of a pose")
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


def _at(path: Path, work: Callable[[], Result]) -> Result:
    """Return the result of work on a file, whose errors get its name."""
    try:
        return work()
    except (FileError, InvalidInput) as error:
        raise type(error)(error.message, where=error.where or str(path)) from error
