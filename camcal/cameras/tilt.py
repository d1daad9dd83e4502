"""The tilted sensor: a homography of the distorted plane.

s (x_t, y_t, 1) = [R33 0 -R13; 0 R33 -R23; 0 0 1] R (x, y, 1) with R = Ry(tau_y) Rx(tau_x).
Source: Louhichi et al., Self-calibration of Scheimpflug cameras, 2007, with the signs of OpenCV.
"""

import math

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass


@dataclass(frozen=True)
class Tilt:
    """A sensor tilted by `about_x` and `about_y` (rad)."""

    about_x: float
    about_y: float

    def homography(self) -> Array:
        """Return the matrix (3, 3) from the distorted plane to the tilted one."""
        rotation = _about_y(self.about_y) @ _about_x(self.about_x)
        return np.asarray(_onto_sensor(rotation) @ rotation)

    def homography_derivatives(self) -> tuple[Array, Array]:
        """Return the derivatives (3, 3) of the homography by the two angles."""
        by_x, by_y = _about_x(self.about_x), _about_y(self.about_y)
        rotation = by_y @ by_x
        turned = by_y @ _about_x_derivative(self.about_x), _about_y_derivative(self.about_y) @ by_x
        one, other = (_onto_sensor(part, 0.0) @ rotation + _onto_sensor(rotation) @ part for part in turned)
        return one, other

    def undo(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return the coordinates (n,) before the tilt of coordinates after it."""
        x_before, y_before, scale = transform(np.linalg.inv(self.homography()), x, y)
        return x_before / scale, y_before / scale


def transform(matrix: Array, x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Return the three rows (n,) of matrix (3, 3) times (x, y, 1)."""
    first, second, third = (row[0] * x + row[1] * y + row[2] for row in matrix.tolist())
    return first, second, third


def _onto_sensor(rotation: Array, corner: float = 1.0) -> Array:
    """Return the perspective map onto the tilted plane; linear in `rotation` but for the corner."""
    r13, r23, r33 = rotation[:, 2]
    return np.array([[r33, 0.0, -r13], [0.0, r33, -r23], [0.0, 0.0, corner]])


def _about_x(angle: float) -> Array:
    cosine, sine = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, cosine, sine], [0.0, -sine, cosine]])


def _about_y(angle: float) -> Array:
    cosine, sine = math.cos(angle), math.sin(angle)
    return np.array([[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]])


def _about_x_derivative(angle: float) -> Array:
    return _about_x(angle + math.pi / 2) - np.diag([1.0, 0.0, 0.0])


def _about_y_derivative(angle: float) -> Array:
    return _about_y(angle + math.pi / 2) - np.diag([0.0, 1.0, 0.0])
