"""Poses over time."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from camcal.arrays import Array, readonly
from camcal.errors import InvalidInput
from camcal.geometry.pose import Pose


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses a_T_b at increasing times; `frames` is their name, such as object_T_camera.

    stamps: (N,) s. rotations: (N, 3, 3). translations: (N, 3), m. covariances: (N, 6, 6) of the poses' steps, order
    tx ty tz rx ry rz, m and rad, or None. velocities: (N, 6) m/s and rad/s, R' = hat(w) R, or None.
    segments: (N,) whole numbers that never fall, poses of one segment belong together; None: all do.
    Raises InvalidInput unless stamps increase and every rotation is one.
    """

    frames: str
    stamps: Array
    rotations: Array
    translations: Array
    covariances: Array | None = None
    velocities: Array | None = None
    segments: Array | None = None

    def __post_init__(self) -> None:
        count = len(self.stamps)
        shapes = {"stamps": (count,), "rotations": (count, 3, 3), "translations": (count, 3)}
        optional = {"covariances": (count, 6, 6), "velocities": (count, 6), "segments": (count,)}
        shapes |= {name: shape for name, shape in optional.items() if getattr(self, name) is not None}
        for name, shape in shapes.items():
            object.__setattr__(self, name, readonly(getattr(self, name), shape, name))
        late = np.flatnonzero(~(np.diff(self.stamps) > 0))
        if len(late):
            raise InvalidInput(
                f"pose {late[0] + 1} at {self.stamps[late[0] + 1]:.9g} s is not later than the one before"
            )
        error = np.abs(self.rotations @ self.rotations.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2), initial=0.0)
        bad = np.flatnonzero(~((error < 1e-6) & (np.linalg.det(self.rotations) > 0)))
        if len(bad):
            raise InvalidInput(f"pose {bad[0]} has no rotation (orthonormality error {error[bad[0]]:.1e})")

    @classmethod
    def of(cls, frames: str, stamps: Array, poses: Sequence[Pose]) -> "Trajectory":
        """Return the trajectory of single poses."""
        rotations = np.array([pose.rotation for pose in poses]).reshape(-1, 3, 3)
        return cls(frames, stamps, rotations, np.array([pose.translation for pose in poses]).reshape(-1, 3))

    def __len__(self) -> int:
        return len(self.stamps)

    def pose(self, index: int) -> Pose:
        """Return one of the poses."""
        return Pose(self.rotations[index], self.translations[index])

    def rows(self, chosen: Array) -> "Trajectory":
        """Return some of the poses, by their indices (M,), which increase, or a mask (N,)."""
        names = ("stamps", "rotations", "translations", "covariances", "velocities", "segments")
        values = {name: getattr(self, name) for name in names}
        return replace(self, **{name: value[chosen] for name, value in values.items() if value is not None})
