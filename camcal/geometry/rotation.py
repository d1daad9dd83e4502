"""SO(3): exponential, logarithm, quaternions, Euler angles, with Jacobians; matrices that are no rotations.

Rotation vectors are (..., 3) in radians, rotation matrices (..., 3, 3), quaternions (..., 4) as w x y z, unit dual
quaternions (..., 8) as q + ε ½ t q. Everything is vectorised over leading axes. Below SERIES_ANGLE the closed forms
lose digits and series take over.

Three Euler angles are no rotation until three things are said with them: the order of the axes, whether the axes turn
along (intrinsic) or stand still (extrinsic), and the unit. An extrinsic order is the intrinsic one read backwards:
turns about the fixed x, y, z by a, b, c are those about the moving z, y, x by c, b, a.
Source: Chirikjian, Stochastic Models, Information Theory, and Lie Groups, vol. 2, ch. 10; Kavan, Collins, Žára,
O'Sullivan, Geometric Skinning with Approximate Dual Quaternion Blending, 2008; Diebel, Representing Attitude, 2006.
"""

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput

SERIES_ANGLE = 1e-4
_IDENTITY = np.eye(3)
MAX_ORTHONORMALITY_ERROR = 0.1  # orthonormality error beyond which the nearest rotation says nothing
LOCK = 1e-7  # rad; nearer to gimbal lock the outer angles are known to their sum or difference only
_AXES = "xyz"


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


def between(first: Array, last: Array, share: float | Array) -> Array:
    """Return the rotations (..., 3, 3) that are a share (...) of the even turn from one to another."""
    turn = log(last @ np.swapaxes(first, -1, -2))
    return np.asarray(exp(np.asarray(share)[..., None] * turn) @ first)


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
        return self.is_rotation(MAX_ORTHONORMALITY_ERROR)

    def fault(self, tolerance: float) -> str:
        """Return what is wrong in words, empty for a rotation."""
        if self.is_reflection:
            why = "a reflection: check for a flipped axis or a left-handed frame"
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
    if error > MAX_ORTHONORMALITY_ERROR or determinant < 0:
        return Orthogonality(error, determinant, np.nan)
    return Orthogonality(error, determinant, float(np.linalg.norm(matrix - nearest(matrix)) / np.sqrt(2)))


def to_dual_quaternion(rotation: Array, translation: Array) -> Array:
    """Return the dual quaternions (..., 8) of poses: the rotation's w x y z with w ≥ 0, then the dual part's.

    rotation: (..., 3, 3). translation: (..., 3), the dual part has half its unit.
    """
    real = to_quaternion(rotation)
    return np.concatenate([real, 0.5 * quaternion_product(_pure(translation), real)], axis=-1)


def from_dual_quaternion(dual: Array) -> tuple[Array, Array]:
    """Return the rotations (..., 3, 3) and translations (..., 3) of dual quaternions (..., 8) of any length but zero.

    What of the dual part lies along the real one is no motion and is left out.
    """
    dual = np.asarray(dual, dtype=float)
    length = np.linalg.norm(dual[..., :4], axis=-1, keepdims=True)
    real, moved = dual[..., :4] / length, dual[..., 4:] / length
    return from_quaternion(real), 2 * quaternion_product(moved, real * [1.0, -1.0, -1.0, -1.0])[..., 1:]


def dual_quaternion_error(dual: Array) -> Array:
    """Return how far the parts of dual quaternions (..., 8) are from at right angles: 0 for a motion."""
    real, moved = dual[..., :4], dual[..., 4:]
    return np.asarray(np.abs(np.sum(real * moved, axis=-1)))


def _pure(vector: Array) -> Array:
    vector = np.asarray(vector, dtype=float)
    return np.concatenate([np.zeros((*vector.shape[:-1], 1)), vector], axis=-1)


def quaternion_product(left: Array, right: Array) -> Array:
    """Return the Hamilton products (..., 4) of quaternions w x y z."""
    scalar = left[..., :1] * right[..., :1] - np.sum(left[..., 1:] * right[..., 1:], axis=-1, keepdims=True)
    vector = left[..., :1] * right[..., 1:] + right[..., :1] * left[..., 1:] + np.cross(left[..., 1:], right[..., 1:])
    return np.concatenate([scalar, vector], axis=-1)


@dataclass(frozen=True)
class EulerOrder:
    """Which axes are turned about, first to last, such as 'zyx'; intrinsic: about axes that have turned along."""

    axes: str
    intrinsic: bool = True

    def __post_init__(self) -> None:
        axes = self.axes
        if len(axes) != 3 or not set(axes) <= set(_AXES) or axes[0] == axes[1] or axes[1] == axes[2]:
            raise InvalidInput(
                f"{axes!r} is not an order of Euler angles: three of x, y, z without repetition in a row, such as zyx"
            )

    @classmethod
    def named(cls, text: str) -> "EulerOrder":
        """Return the order of letters: capital ones, ZYX, are intrinsic, small ones, xyz, extrinsic."""
        if text not in (text.upper(), text.lower()):
            raise InvalidInput(f"{text!r}: write ZYX for intrinsic angles, xyz for extrinsic ones")
        return cls(text.lower(), text == text.upper())

    @property
    def name(self) -> str:
        """The letters that `named` takes: capital ones for an intrinsic order."""
        return self.axes.upper() if self.intrinsic else self.axes

    @property
    def turning(self) -> str:
        """The axes in the order of the intrinsic turns that are the same rotation."""
        return self.axes if self.intrinsic else self.axes[::-1]


def from_euler(angles: Array, order: EulerOrder) -> Array:
    """Return the rotation matrices (..., 3, 3) of Euler angles (..., 3) in radians."""
    angles = np.asarray(angles, dtype=float)
    turns = angles if order.intrinsic else angles[..., ::-1]
    first, second, third = (_about(axis, turns[..., place]) for place, axis in enumerate(order.turning))
    return np.asarray(first @ second @ third)


def to_euler(rotation: Array, order: EulerOrder) -> tuple[Array, Array]:
    """Return the Euler angles (..., 3) in radians of rotation matrices (..., 3, 3), and where they are locked (...).

    They are in the order of their axes; the middle angle is in -π/2 … π/2 for three different axes and in 0 … π where
    the first and last are the same. In gimbal lock only the sum or difference of the outer angles is known, and the
    last one is set to 0.
    """
    r = np.asarray(rotation, dtype=float)
    i, j, k = (_AXES.index(axis) for axis in order.turning)
    if i == k:
        k = 3 - i - j
        sign = _parity(i, j)
        sine = np.hypot(r[..., i, j], r[..., i, k])
        middle, off_lock = np.arctan2(sine, r[..., i, i]), sine
        first = np.arctan2(r[..., j, i], -sign * r[..., k, i])
        last_axis = i
    else:
        sign = _parity(i, j)
        cosine = np.hypot(r[..., i, i], r[..., i, j])
        middle, off_lock = np.arctan2(sign * r[..., i, k], cosine), cosine
        first = np.arctan2(-sign * r[..., j, k], r[..., k, k])
        last_axis = k
    locked = off_lock < LOCK
    first = np.where(locked, _first_where_locked(r, i, j, order), first)
    # the first turn undone, the row of the middle axis knows nothing of the middle turn
    row = np.swapaxes(_about(_AXES[i], first), -1, -2)[..., j : j + 1, :] @ r
    other = 3 - last_axis - j
    last = np.asarray(np.arctan2(-_parity(last_axis, j) * row[..., 0, other], row[..., 0, j]))
    last = np.where(locked & order.intrinsic, 0.0, last)
    turns = np.stack([first, middle, last], -1)
    return turns if order.intrinsic else turns[..., ::-1], locked


def _first_where_locked(r: Array, i: int, j: int, order: EulerOrder) -> Array:
    """Return the first turn where the angle said last is 0: that of the column of the middle axis, or none at all."""
    if not order.intrinsic:
        return np.zeros(r.shape[:-2])
    other = 3 - i - j
    return np.asarray(np.arctan2(_parity(i, j) * r[..., other, j], r[..., j, j]))


def _parity(first: int, second: int) -> int:
    """Return 1 if the axis `second` follows `first` in the circle x y z, -1 if it goes before it."""
    return 1 if (second - first) % 3 == 1 else -1


def _about(axis: str, angle: Array) -> Array:
    """Return the rotation matrices (..., 3, 3) by angles (...) about a coordinate axis."""
    p = (_AXES.index(axis) + 1) % 3
    q = (p + 1) % 3
    cosine, sine = np.cos(angle), np.sin(angle)
    result = np.zeros((*np.shape(angle), 3, 3))
    result[..., 3 - p - q, 3 - p - q] = 1
    result[..., p, p] = result[..., q, q] = cosine
    result[..., q, p], result[..., p, q] = sine, -sine
    return result
