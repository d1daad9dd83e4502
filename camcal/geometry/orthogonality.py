"""How far nine numbers are from a rotation, in numbers."""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.geometry import rotation as so3

HOPELESS = 0.1  # orthonormality error beyond which the nearest rotation says nothing


@dataclass(frozen=True)
class Orthogonality:
    """What is wrong with a matrix (3, 3) as a rotation.

    error: the largest element of |R Rᵀ - I|. determinant: 1 of a rotation, -1 of a reflection. angle: how far the
    matrix is turned from the nearest rotation, rad, NaN where there is none worth the name.
    """

    error: float
    determinant: float
    angle: float

    @property
    def is_reflection(self) -> bool:
        """Whether a left-handed frame is made of a right-handed one."""
        return self.determinant < 0

    def is_rotation(self, tolerance: float) -> bool:
        """Return whether the matrix is a rotation but for rounding."""
        return self.error <= tolerance and not self.is_reflection

    @property
    def can_be_fixed(self) -> bool:
        """Whether the nearest rotation is what was meant."""
        return self.is_rotation(HOPELESS)

    def fault(self, tolerance: float) -> str:
        """Return what is wrong in words, empty for a rotation."""
        if self.is_reflection:
            why = "a reflection; is an axis flipped, or a frame left-handed?"
            return f"not a rotation: det = {self.determinant:.3g}, {why}"
        if self.is_rotation(tolerance):
            return ""
        nearest = f"; the nearest rotation differs by {np.degrees(self.angle):.2g}°" if self.can_be_fixed else ""
        return f"not a rotation: orthonormality error {self.error:.1e}{nearest}"


def examine(matrix: Array) -> Orthogonality:
    """Return how far a matrix (3, 3) of finite numbers is from a rotation."""
    with np.errstate(over="ignore", invalid="ignore"):  # of absurd numbers, which are no rotation
        error = float(np.nan_to_num(np.abs(matrix @ matrix.T - np.eye(3)).max(), nan=np.inf, posinf=np.inf))
        determinant = float(np.nan_to_num(np.linalg.det(matrix)))
    if error > HOPELESS or determinant < 0:
        return Orthogonality(error, determinant, np.nan)
    return Orthogonality(error, determinant, float(np.linalg.norm(matrix - so3.nearest(matrix)) / np.sqrt(2)))
