"""Euler angles: three turns about coordinate axes, in any of the twelve orders.

Three angles are no rotation until three things are said with them: the order of the axes, whether the axes turn along
(intrinsic) or stand still (extrinsic), and the unit. An extrinsic order is the intrinsic one read backwards: turns
about the fixed x, y, z by a, b, c are those about the moving z, y, x by c, b, a.
Source: Diebel, Representing Attitude, 2006.
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput

LOCK = 1e-7  # rad; nearer to gimbal lock the outer angles are known to their sum or difference only

_AXES = "xyz"


@dataclass(frozen=True)
class EulerOrder:
    """Which axes are turned about, first to last, such as 'zyx'; intrinsic: about axes that have turned along."""

    axes: str
    intrinsic: bool = True

    def __post_init__(self) -> None:
        axes = self.axes
        if len(axes) != 3 or not set(axes) <= set(_AXES) or axes[0] == axes[1] or axes[1] == axes[2]:
            raise InvalidInput(f"{axes!r} is no order of Euler angles: three of x, y, z, neighbours different, as zyx")

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


@dataclass(frozen=True, eq=False)
class EulerAngles:
    """Angles (..., 3) in radians, in the order of their axes, and where they are in gimbal lock (...).

    The middle angle is in -π/2 … π/2 for three different axes and in 0 … π where the first and last are the same.
    Locked: only the sum or difference of the outer angles is known, and the last one is set to 0.
    """

    angles: Array
    locked: Array


def from_euler(angles: Array, order: EulerOrder) -> Array:
    """Return the rotation matrices (..., 3, 3) of Euler angles (..., 3) in radians."""
    angles = np.asarray(angles, dtype=float)
    turns = angles if order.intrinsic else angles[..., ::-1]
    first, second, third = (_about(axis, turns[..., place]) for place, axis in enumerate(order.turning))
    return np.asarray(first @ second @ third)


def to_euler(rotation: Array, order: EulerOrder) -> EulerAngles:
    """Return the Euler angles of rotation matrices (..., 3, 3)."""
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
    last = _last(r, first, i, j, last_axis)
    last = np.where(locked & order.intrinsic, 0.0, last)
    turns = np.stack([first, middle, last], -1)
    return EulerAngles(turns if order.intrinsic else turns[..., ::-1], locked)


def _first_where_locked(r: Array, i: int, j: int, order: EulerOrder) -> Array:
    """Return the first turn where the angle said last is 0: that of the column of the middle axis, or none at all."""
    if not order.intrinsic:
        return np.zeros(r.shape[:-2])
    other = 3 - i - j
    return np.asarray(np.arctan2(_parity(i, j) * r[..., other, j], r[..., j, j]))


def _last(r: Array, first: Array, i: int, j: int, axis: int) -> Array:
    """Return the last turn, once the first is undone: the row of the middle axis knows nothing of the middle turn."""
    row = np.swapaxes(_about(_AXES[i], first), -1, -2)[..., j : j + 1, :] @ r
    other = 3 - axis - j
    return np.asarray(np.arctan2(-_parity(axis, j) * row[..., 0, other], row[..., 0, j]))


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
