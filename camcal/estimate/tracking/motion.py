"""Free motion of a body on SO(3) × R³: prediction of pose and velocity, its covariance, and the steps between states.

A state is a pose, its velocities (R' = hat(w) R) and, in Singer's model, their accelerations. Rotation and translation
move independently. The covariance of a state is of its error: steps of the pose in the order tx ty tz rx ry rz,
R ← Exp(δr) R, then of the velocities, then of the accelerations. Every function takes any leading axes.
Source: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, sections 6.2.2
(white-noise acceleration) and 8.2 (Singer 1970: accelerations that fade with a time constant).
"""

from typing import NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.estimate.poses.states import rotation_vectors
from camcal.geometry import rotation as so3

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_SPEED = 2.0  # 1/s, of the distance: standard deviation of an unknown velocity
_TURN = 2 * np.pi  # rad/s, the same of an unknown rate
_PLACE, _ANGLE = 0.5, 2.0  # of the distance, and rad: of an unknown pose
POSE, VELOCITY = slice(0, 6), slice(6, 12)
_PER_AXIS = np.repeat([0, 1], 3)


class MotionState(NamedTuple):
    """rotations (..., 3, 3), translations (..., 3) and rates (..., m, 6): velocities, then accelerations."""

    rotations: Array
    translations: Array
    rates: Array

    def at(self, index: Array | slice | int) -> "MotionState":
        """Return the states at some indices of the first axis."""
        return MotionState(self.rotations[index], self.translations[index], self.rates[index])

    def moved(self, step: Array) -> "MotionState":
        """Return the states moved by steps (..., 6 + 6 m)."""
        rates = step[..., 6:].reshape(self.rates.shape)
        return MotionState(
            so3.exp(step[..., 3:6]) @ self.rotations, self.translations + step[..., :3], self.rates + rates
        )


@dataclass(frozen=True)
class FreeMotion:
    """What drives the motion: white noise of densities (translation, rotation).

    fading: None for white-noise acceleration, densities in m²/s³ and rad²/s³; or the time constant (s) of
    accelerations, densities in m²/s⁵ and rad²/s⁵.
    """

    densities: tuple[float, float]
    fading: float | None = None

    @property
    def order(self) -> int:
        """The number of rates: 1, or 2 with accelerations."""
        return 1 if self.fading is None else 2

    @property
    def size(self) -> int:
        """The number of a state's degrees of freedom."""
        return 6 + 6 * self.order

    def axis_transition(self, dt: Array) -> Array:
        """Return how a coordinate and its rates (..., 1 + m, 1 + m) go on over dt (...) seconds."""
        result = np.zeros((*dt.shape, self.order + 1, self.order + 1))
        result[..., 0, 0] = 1.0
        if self.fading is None:
            result[..., 0, 1], result[..., 1, 1] = dt, 1.0
            return result
        kept = np.exp(-dt / self.fading)
        result[..., 0, 1], result[..., 1, 1] = dt, 1.0
        result[..., 0, 2] = self.fading * (dt - self.fading * (1 - kept))
        result[..., 1, 2] = self.fading * (1 - kept)
        result[..., 2, 2] = kept
        return result

    def axis_covariance(self, dt: Array) -> Array:
        """Return the covariance (..., 1 + m, 1 + m) that noise of density 1 adds to a coordinate over dt (...) s."""
        if self.fading is None:
            powers = [dt**3 / 3, dt**2 / 2, dt**2 / 2, dt]
            return np.stack(powers, axis=-1).reshape(*dt.shape, 2, 2)
        result = np.zeros((*dt.shape, 3, 3))
        for node, weight in zip(_NODES, _WEIGHTS, strict=True):
            column = self.axis_transition(dt * (1 + node) / 2)[..., :, 2]
            result += (weight * dt / 2)[..., None, None] * column[..., :, None] * column[..., None, :]
        return result

    def covariance(self, dt: Array) -> Array:
        """Return the covariance (..., S, S) of what noise does to a state over dt (...) seconds."""
        return self._of_axes(self.axis_covariance(dt), np.array(self.densities))

    def information(self, dt: Array) -> Array:
        """Return the inverses (..., S, S) of the covariances."""
        return self._of_axes(np.linalg.inv(self.axis_covariance(dt)), 1 / np.array(self.densities))

    def _of_axes(self, axis: Array, factors: Array) -> Array:
        """Return the matrices (..., S, S) of six coordinates with the same (..., 1 + m, 1 + m), times their factors."""
        result = np.zeros((*axis.shape[:-2], self.size, self.size))
        every = np.arange(6)
        for row in range(self.order + 1):
            for column in range(self.order + 1):
                result[..., 6 * row + every, 6 * column + every] = axis[..., row, column, None] * factors[_PER_AXIS]
        return result

    def forecast(self, state: MotionState, dt: Array) -> tuple[MotionState, Array]:
        """Return the states dt (...) seconds later, and the transitions (..., S, S) of their errors."""
        axis = self.axis_transition(dt)
        step = (axis[..., 0, 1:, None] * state.rates).sum(axis=-2)
        rates = axis[..., 1:, 1:] @ state.rates
        turned = so3.exp(step[..., 3:])
        later = MotionState(turned @ state.rotations, state.translations + step[..., :3], rates)
        return later, self._transition(axis, turned, so3.exp_jacobian(step[..., 3:]))

    def _transition(self, axis: Array, turned: Array, jacobian: Array) -> Array:
        result = np.zeros((*turned.shape[:-2], self.size, self.size))
        every, shift = np.arange(6), np.arange(3)
        result[..., shift, shift] = 1.0
        result[..., 3:6, 3:6] = turned
        for column in range(1, self.order + 1):
            at = 6 * column
            result[..., shift, at + shift] = axis[..., 0, column, None]
            result[..., 3:6, at + 3 : at + 6] = axis[..., 0, column, None, None] * jacobian
            for row in range(1, self.order + 1):
                result[..., 6 * row + every, at + every] = axis[..., row, column, None]
        return result

    def unknown(self, distance: float) -> Array:
        """Return the variances (S,) of a state of which nothing is known but the distance (m) of the object."""
        result = np.empty(self.size)
        result[:3], result[3:6] = (_PLACE * distance) ** 2, _ANGLE**2
        result[6:9], result[9:12] = (_SPEED * distance) ** 2, _TURN**2
        if self.fading is not None:
            stationary = np.array(self.densities)[_PER_AXIS] * self.fading / 2
            result[12:] = stationary
        return result


def difference(after: MotionState, before: MotionState) -> Array:
    """Return the steps (..., S) that lead from states to others."""
    turn = rotation_vectors(after.rotations @ before.rotations.swapaxes(-1, -2))
    rates = (after.rates - before.rates).reshape(*after.rates.shape[:-2], -1)
    return np.concatenate([after.translations - before.translations, turn, rates], axis=-1)
