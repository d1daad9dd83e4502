"""A single pose as text: a matrix of 4 × 4 or 3 × 4 numbers, or a line of the TUM format."""

from pathlib import Path

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.errors import FileError, InvalidInput
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose

_LIMIT = 1 << 20
_BOTTOM = (0.0, 0.0, 0.0, 1.0)
_ROUNDED = 1e-3  # how far a rotation may be from orthonormal: texts have few digits


def read(path: Path) -> Pose:
    """Return the pose of a file: 16 or 12 numbers, row by row, or the 8 of TUM (time tx ty tz qx qy qz qw), metres.

    Lines that begin with # are passed over. Raises FileError if it holds something else than numbers, InvalidInput if
    they are no pose, or more than one.
    """
    lines = [line for line in files.read_text(path, _LIMIT).splitlines() if not line.lstrip().startswith("#")]
    try:
        numbers = np.array(" ".join(lines).replace(",", " ").split(), float)
    except ValueError as error:
        raise FileError("holds something else than the numbers of a pose", where=str(path)) from error
    if not np.isfinite(numbers).all():
        raise InvalidInput("a pose has finite numbers", where=str(path))
    try:
        return _pose(numbers)
    except InvalidInput as error:
        raise InvalidInput(error.message, where=str(path)) from error


def _pose(numbers: Array) -> Pose:
    if len(numbers) == 8:
        x, y, z, w = numbers[4:]
        if abs(np.linalg.norm(numbers[4:]) - 1) > _ROUNDED:
            raise InvalidInput("the quaternion qx qy qz qw does not have length 1")
        return Pose(so3.from_quaternion(np.array([w, x, y, z])), numbers[1:4])
    if len(numbers) not in (12, 16):
        raise InvalidInput(
            f"{len(numbers)} numbers; one pose has 16 or 12 (a matrix, row by row), or 8: time tx ty tz qx qy qz qw"
        )
    matrix = numbers.reshape(-1, 4)
    if len(matrix) == 4 and not np.allclose(matrix[3], _BOTTOM, atol=_ROUNDED):
        raise InvalidInput("the last row of a pose is 0 0 0 1")
    rotation = matrix[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > _ROUNDED or np.linalg.det(rotation) < 0:
        raise InvalidInput("the left 3 × 3 numbers are no rotation")
    return Pose(so3.nearest(rotation), matrix[:3, 3])
