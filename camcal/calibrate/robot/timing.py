"""A robot's poses over time, at the moments of images by another clock."""

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.robot.start import Poses, angle_mismatch
from camcal.dataclass import dataclass
from camcal.geometry import rotation as so3

_LATEST = 2.0  # s, by which two clocks are taken to differ at most
_SHARE = 0.25  # of the time that the poses take
_MOST = 2000  # delays that are tried


@dataclass(frozen=True, eq=False)
class Motion:
    """Poses base_T_hand (T,) at times (T,) s, in ascending order."""

    times: Array
    poses: Poses

    def at(self, times: Array) -> Poses:
        """Return the poses (N,) at other times, on the straightest way between two; the last one beyond the end."""
        first = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 2)
        before, after = self.poses.take(first), self.poses.take(first + 1)
        share = np.clip((times - self.times[first]) / (self.times[first + 1] - self.times[first]), 0.0, 1.0)
        moved = before.translations + share[:, None] * (after.translations - before.translations)
        return Poses(so3.between(before.rotations, after.rotations, share), moved)

    def velocities(self, times: Array) -> Array:
        """Return the velocities (N, 6) of the hand: m/s in the base, rad/s in its own frame."""
        half = float(np.median(np.diff(self.times))) / 2
        before, after = self.at(times - half), self.at(times + half)
        turns = so3.log(before.rotations.transpose(0, 2, 1) @ after.rotations)
        return np.concatenate([after.translations - before.translations, turns], axis=1) / (2 * half)

    def delay(self, times: Array, camera: Poses) -> float:
        """Return by how many s the poses are late against images at `times` (N,), to half an interval of the poses.

        camera: camera_T_board (N,) of the images.
        """
        step = float(np.median(np.diff(self.times)))
        reach = min(_LATEST, _SHARE * float(self.times[-1] - self.times[0]))
        count = int(min(reach / step, _MOST / 2))
        delays = np.linspace(-reach, reach, 2 * count + 1) if count else np.zeros(1)
        return float(min(delays, key=lambda delay: (angle_mismatch(self.at(times + delay), camera), abs(delay))))
