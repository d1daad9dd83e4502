"""SO(3): exponential, logarithm, quaternions, elementary rotations, with Jacobians; matrices that are none.

Rotation vectors are (..., 3) in radians, rotation matrices (..., 3, 3), quaternions (..., 4) as w x y z, unit dual
quaternions (..., 8) as q + ε ½ t q. Everything is vectorised over leading axes. Below SERIES_ANGLE the closed forms
lose digits and series take over.
Source: Chirikjian, Stochastic Models, Information Theory, and Lie Groups, vol. 2, ch. 10; Kavan, Collins, Žára,
O'Sullivan, Geometric Skinning with Approximate Dual Quaternion Blending, 2008.
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array

SERIES_ANGLE = 1e-4
_IDENTITY = np.eye(3)
HOPELESS = 0.1  # orthonormality error beyond which the nearest rotation says nothing


def hat(vector: Array) -> Array:
    """Return the skew matrices (..., 3, 3) with hat(a) @ b = a × b."""
    result = np.zeros((*vector.shape, 3))
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    result[..., 0, 1], result[..., 0, 2] = -z, y
    result[..., 1, 0], result[..., 1, 2] = z, -x
    result[..., 2, 0], result[..., 2, 1] = -y, x
    return result


def _of_sine(angle: Array) -> Array:
    """Return sin θ/θ."""
    small = angle < SERIES_ANGLE
    safe = np.where(small, 1.0, angle)
    return np.where(small, 1 - angle * angle / 6, np.sin(safe) / safe)


def _of_cosine(angle: Array) -> Array:
    """Return (1 - cos θ)/θ²."""
    # 1 - cos θ = 2 sin²(θ/2), which does not cancel
    return np.asarray(0.5 * _of_sine(angle / 2) ** 2)


def _beyond_sine(angle: Array) -> Array:
    """Return (θ - sin θ)/θ³."""
    square, safe = angle * angle, np.where(angle < SERIES_ANGLE, 1.0, angle)
    # θ - sin θ cancels: below 0.1 the series to θ⁸ is the accurate one.
    series = 1 / 6 - square / 120 + square**2 / 5040 - square**3 / 362880 + square**4 / 39916800
    return np.where(angle < 0.1, series, (safe - np.sin(safe)) / safe**3)


def exp(vector: Array) -> Array:
    """Return the rotation matrices (..., 3, 3) of rotation vectors (..., 3)."""
    half = 0.5 * np.sqrt((vector * vector).sum(axis=-1))[..., None, None]
    skew, sine = hat(vector), _of_sine(half)
    # sin θ/θ and (1 - cos θ)/θ² by half the angle, without cancelling
    return np.asarray(_IDENTITY + sine * np.cos(half) * skew + 0.5 * sine**2 * (skew @ skew))


def exp_jacobian(vector: Array) -> Array:
    """Return the left Jacobian J (..., 3, 3): Exp(v + δ) ≈ Exp(J δ) Exp(v)."""
    angle = np.sqrt((vector * vector).sum(axis=-1))[..., None, None]
    skew = hat(vector)
    return np.asarray(_IDENTITY + _of_cosine(angle) * skew + _beyond_sine(angle) * (skew @ skew))


def log(rotation: Array) -> Array:
    """Return the rotation vectors (..., 3), of length at most π, of rotation matrices (..., 3, 3).

    By way of the quaternion, which stays accurate at 0 and at π.
    """
    quaternion = to_quaternion(rotation)
    imaginary = quaternion[..., 1:]
    length = np.linalg.norm(imaginary, axis=-1)
    small = length < SERIES_ANGLE
    angle = 2 * np.arctan2(length, quaternion[..., 0])
    scale = np.where(small, 2 + length**2 / 3, angle / np.where(small, 1.0, length))
    return np.asarray(scale[..., None] * imaginary)


def to_quaternion(rotation: Array) -> Array:
    """Return unit quaternions w x y z (..., 4) with w ≥ 0 of rotation matrices (..., 3, 3).

    Source: Bar-Itzhack, New method for extracting the quaternion from a rotation matrix, 2000 (the column of the
    4 × 4 matrix with the largest diagonal).
    """
    r = np.asarray(rotation, dtype=float)
    m = {(i, j): r[..., i, j] for i in range(3) for j in range(3)}
    matrix = np.stack(
        [
            np.stack([1 + m[0, 0] + m[1, 1] + m[2, 2], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]], -1),
            np.stack([m[2, 1] - m[1, 2], 1 + m[0, 0] - m[1, 1] - m[2, 2], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]], -1),
            np.stack([m[0, 2] - m[2, 0], m[0, 1] + m[1, 0], 1 - m[0, 0] + m[1, 1] - m[2, 2], m[1, 2] + m[2, 1]], -1),
            np.stack([m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], 1 - m[0, 0] - m[1, 1] + m[2, 2]], -1),
        ],
        -2,
    )
    best = np.argmax(np.diagonal(matrix, axis1=-2, axis2=-1), axis=-1)
    quaternion = np.take_along_axis(matrix, best[..., None, None], axis=-2)[..., 0, :]
    quaternion = quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)
    return np.asarray(np.where(quaternion[..., :1] < 0, -quaternion, quaternion))


def from_quaternion(quaternion: Array) -> Array:
    """Return rotation matrices (..., 3, 3) of quaternions w x y z (..., 4) of any length but zero."""
    q = np.asarray(quaternion, dtype=float)
    w, x, y, z = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def about_x(angle: float) -> Array:
    """Return the rotation matrix (3, 3) by `angle` radians about x."""
    return exp(np.array([angle, 0.0, 0.0]))


def about_y(angle: float) -> Array:
    """Return the rotation matrix (3, 3) by `angle` radians about y."""
    return exp(np.array([0.0, angle, 0.0]))


def about_z(angle: float) -> Array:
    """Return the rotation matrix (3, 3) by `angle` radians about z."""
    return exp(np.array([0.0, 0.0, angle]))


def nearest(matrix: Array) -> Array:
    """Return the rotation matrices (..., 3, 3) closest to `matrix` in the Frobenius norm."""
    u, _, vt = np.linalg.svd(matrix)
    sign = np.sign(np.linalg.det(u @ vt))
    u = u.copy()
    u[..., :, 2] *= sign[..., None]
    return np.asarray(u @ vt)


def angle_between(first: Array, second: Array) -> Array:
    """Return the angles (...), 0 … π rad, of the turns from rotation matrices (..., 3, 3) to others: their distance."""
    return np.asarray(np.linalg.norm(log(second @ np.swapaxes(first, -1, -2)), axis=-1))


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
    return Orthogonality(error, determinant, float(np.linalg.norm(matrix - nearest(matrix)) / np.sqrt(2)))


def to_dual_quaternion(rotation: Array, translation: Array) -> Array:
    """Return the dual quaternions (..., 8) of poses: the rotation's w x y z with w ≥ 0, then the dual part's.

    rotation: (..., 3, 3). translation: (..., 3), the dual part has half its unit.
    """
    real = to_quaternion(rotation)
    return np.concatenate([real, 0.5 * _product(_pure(translation), real)], axis=-1)


def from_dual_quaternion(dual: Array) -> tuple[Array, Array]:
    """Return the rotations (..., 3, 3) and translations (..., 3) of dual quaternions (..., 8) of any length but zero.

    What of the dual part lies along the real one is no motion and is left out.
    """
    dual = np.asarray(dual, dtype=float)
    length = np.linalg.norm(dual[..., :4], axis=-1, keepdims=True)
    real, moved = dual[..., :4] / length, dual[..., 4:] / length
    return from_quaternion(real), 2 * _product(moved, _conjugate(real))[..., 1:]


def dual_quaternion_error(dual: Array) -> Array:
    """Return how far the parts of dual quaternions (..., 8) are from at right angles: 0 for a motion."""
    real, moved = dual[..., :4], dual[..., 4:]
    return np.asarray(np.abs(np.sum(real * moved, axis=-1)))


def _pure(vector: Array) -> Array:
    vector = np.asarray(vector, dtype=float)
    return np.concatenate([np.zeros((*vector.shape[:-1], 1)), vector], axis=-1)


def _conjugate(quaternion: Array) -> Array:
    return np.asarray(quaternion * np.array([1.0, -1, -1, -1]))


def _product(left: Array, right: Array) -> Array:
    """Return the Hamilton products (..., 4) of quaternions w x y z."""
    scalar = left[..., :1] * right[..., :1] - np.sum(left[..., 1:] * right[..., 1:], axis=-1, keepdims=True)
    vector = left[..., :1] * right[..., 1:] + right[..., :1] * left[..., 1:] + np.cross(left[..., 1:], right[..., 1:])
    return np.concatenate([scalar, vector], axis=-1)
