"""Whether a camera stands where it stood, by the poses of something that has not moved."""

from collections.abc import Sequence
from math import sqrt

import numpy as np

from camcal.arrays import Array, FloatArray, readonly
from camcal.dataclass import dataclass
from camcal.estimate.pose_average import average_poses
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose, compose_jacobians, inverse_jacobian
from camcal.quality.camera_comparison import CHANCE
from camcal.quality.camera_drift import Estimated
from camcal.records import Brief
from camcal.solve.losses import chi_square_beyond

_SIGMAS = 3.0  # standard deviations that a movement has to be at least, and that may be as large as its limit
_DIRECTIONS = (("left", "right"), ("up", "down"), ("back", "forward"))  # of the camera's x, y, z, - and +
_TURNS = (("down", "up"), ("left", "right"), ("anticlockwise", "clockwise"))  # about them, as the camera looks


@dataclass(frozen=True, eq=False)
class MountMovement(Brief):
    """How a camera has moved in its own axes of before: before_T_now.

    step: (6,) m and rad, shift and rotation vector. covariance: (6, 6). chance: of a larger one without any movement.
    """

    step: FloatArray
    covariance: FloatArray
    chance: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "step", readonly(self.step, (6,), "step"))
        object.__setattr__(self, "covariance", readonly(self.covariance, (6, 6), "covariance"))

    @property
    def shift(self) -> Estimated:
        """The length of the shift, m."""
        return self._length(slice(0, 3))

    @property
    def turn(self) -> Estimated:
        """The angle of the rotation, rad."""
        return self._length(slice(3, 6))

    def _length(self, part: slice) -> Estimated:
        values, covariance = self.step[part], self.covariance[part, part]
        length = float(np.linalg.norm(values))
        # of no movement the direction is any: the largest deviation holds then
        along = values / length if length > 0 else np.linalg.eigh(covariance)[1][:, -1]
        return Estimated(length, sqrt(max(float(along @ covariance @ along), 0.0)))

    def moved(self, most_shift: float, most_turn: float) -> bool:
        """Return whether the camera has moved by more than limits (m, rad), and by no chance."""
        far = [
            each.value > max(most, _SIGMAS * each.std)
            for each, most in ((self.shift, most_shift), (self.turn, most_turn))
        ]
        return self.chance < CHANCE and any(far)

    def shown(self, most_shift: float, most_turn: float) -> bool:
        """Return whether a movement as large as the limits would have shown."""
        return _SIGMAS * self.shift.std <= most_shift and _SIGMAS * self.turn.std <= most_turn

    @property
    def way_back(self) -> str:
        """Return how to move the camera back in words: parts that are known to be there, in its own axes."""
        back = -self.step
        std = np.sqrt(np.diag(self.covariance))
        shifts = [
            f"{1e3 * abs(back[axis]):.2g} mm {_DIRECTIONS[axis][int(back[axis] > 0)]}"
            for axis in range(3)
            if abs(back[axis]) > _SIGMAS * std[axis]
        ]
        turns = [
            f"{abs(np.degrees(back[3 + axis])):.2g}° {_TURNS[axis][int(back[3 + axis] > 0)]}"
            for axis in range(3)
            if abs(back[3 + axis]) > _SIGMAS * std[3 + axis]
        ]
        parts = [f"move it {', '.join(shifts)}"] * bool(shifts) + [f"turn it {', '.join(turns)}"] * bool(turns)
        return " and ".join(parts)


def mount_movement(before: Sequence[tuple[Pose, Array]], now: Sequence[tuple[Pose, Array]]) -> MountMovement:
    """Return how a camera has moved, by poses camera_T_object of one thing and their covariances (6, 6)."""
    (first, of_first), (second, of_second) = _mean(before), _mean(now)
    back = second.inverse()
    by_first, by_back = compose_jacobians(first, back)
    turned = inverse_jacobian(second)
    moved = first @ back
    covariance = by_first @ of_first @ by_first.T + by_back @ turned @ of_second @ turned.T @ by_back.T
    step = np.concatenate([moved.translation, so3.log(moved.rotation)])
    return MountMovement(step, covariance, chi_square_beyond(float(step @ np.linalg.solve(covariance, step)), 6))


def _mean(poses: Sequence[tuple[Pose, Array]]) -> tuple[Pose, Array]:
    """Return the mean of poses and its covariance, larger by as much as they scatter more than theirs say."""
    if len(poses) == 1:
        return poses[0]
    found = average_poses([pose for pose, _ in poses], [covariance for _, covariance in poses], robust=True)
    excess = (found.chi_square or 0.0) / found.degrees_of_freedom
    return found.pose, found.covariance * max(excess, 1.0)
