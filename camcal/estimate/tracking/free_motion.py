"""Free motion of a body on SO(3) × R³: prediction of pose and velocity, its covariance, and interpolation.

A state is a pose, its velocities (R' = hat(w) R) and, in Singer's model, their accelerations. Rotation and translation
move independently. The covariance of a state is of its error: steps of the pose in the order tx ty tz rx ry rz,
R ← Exp(δr) R, then of the velocities, then of the accelerations. Every function takes any leading axes.
Source: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, sections 6.2.2
(white-noise acceleration) and 8.2 (Singer 1970: accelerations that fade with a time constant).

Poses between what a frame's pixels say and what was expected are found by damped Gauss-Newton from many starts at once:
χ² of the pixels plus that of the step from the expected pose is descended, to begin with as if wrong pixels were right.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.estimate.tracking.pixel_costs import FrameCosts, PixelFrames
from camcal.geometry import rotation as so3

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_SPEED = 2.0  # 1/s, of the distance: standard deviation of an unknown velocity
_TURN = 2 * np.pi  # rad/s, the same of an unknown rate
_PLACE, _ANGLE = 0.5, 2.0  # of the distance, and rad: of an unknown pose
POSE, VELOCITY = slice(0, 6), slice(6, 12)
_PER_AXIS = np.repeat([0, 1], 3)

# descents
_ITERATIONS = 12
_TEMPERATURES = (16.0, 4.0)
_SETTLED = 1e-3  # decrease of the cost that is below which no step is made
_SAME = 1.0  # squared Mahalanobis distance of ends that are one
_SAME_TURN = 0.2  # rad, no more than which they are apart
_SMALL = 1e-6  # rad², below which the series is used
_IDENTITY = np.eye(6)
_NEAR_HALF_TURN = -0.9  # cosine of an angle; there the sine says little


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


@dataclass(frozen=True)
class ObjectPlane:
    """The plane of an object: its normal (3,) and middle (3,)."""

    normal: Array
    middle: Array

    @classmethod
    def of(cls, frames: PixelFrames) -> "ObjectPlane | None":
        """Return the plane of all points of frames, None if they are in none."""
        points = np.unique(frames.points[frames.there], axis=0)
        middle = points.mean(axis=0)
        _, spreads, axes = np.linalg.svd(points - middle, full_matrices=False)
        return cls(axes[2], middle) if spreads[2] < 0.05 * spreads[1] else None

    def sight(self, rotations: Array, translations: Array) -> Array:
        """Return the unit directions (N, 3) from the camera to the middle."""
        seen = rotations @ self.middle + translations
        return np.asarray(seen / np.linalg.norm(seen, axis=-1, keepdims=True))

    def tilt(self, rotations: Array, translations: Array) -> Array:
        """Return the angles (N) between the normal and the line of sight, rad."""
        cosine = np.abs((self.sight(rotations, translations) * (rotations @ self.normal)).sum(axis=-1))
        return np.asarray(np.arccos(np.clip(cosine, 0, 1)))

    def mirrored(self, rotations: Array, translations: Array) -> tuple[Array, Array]:
        """Return the mirrored poses: the plane reflected across the line of sight."""
        sight = self.sight(rotations, translations)
        across = np.eye(3) - 2 * sight[:, :, None] * sight[:, None, :]
        turned = across @ rotations @ (np.eye(3) - 2 * np.outer(self.normal, self.normal))
        return turned, translations + (rotations - turned) @ self.middle

    def mirrored_states(self, states: MotionState) -> MotionState:
        """Return the mirrored poses of states, turning the way that mirrored motions turn."""
        sight = self.sight(states.rotations, states.translations)[:, None]
        rates = states.rates.copy()
        turning = rates[..., 3:]
        # a reflection by I - 2 v vᵀ takes ω to -(I - 2 v vᵀ) ω: a turn about the line of sight stays
        rates[..., 3:] = 2 * sight * (turning * sight).sum(axis=-1, keepdims=True) - turning
        return MotionState(*self.mirrored(states.rotations, states.translations), rates)


class DescentResults(NamedTuple):
    """Where descents ended: the hypothesis (E) each stems from, the cost, and the steps (E, 6) from what it expected.

    curvatures: (E, 6, 6) of the pixels' cost, half. slopes: (E, 6, 6) of the steps over steps of the pose.
    """

    parents: Array
    costs: Array
    steps: Array
    curvatures: Array
    slopes: Array


def descended(frame: FrameCosts, middles: MotionState, covariances: Array, starts: MotionState) -> DescentResults:
    """Return the distinct ends of descents on a frame's pixels and on what was expected of its pose.

    middles, covariances: (K, 6, 6) of what K hypotheses expect. starts: (K C), those of each hypothesis together.
    """
    count = len(covariances)
    parents = np.repeat(np.arange(count), len(starts.translations) // count)
    prior = np.linalg.inv(covariances)[parents]
    middle = middles.at(parents)
    rotations, translations = starts.rotations.copy(), starts.translations.copy()
    damping = np.full(len(parents), 1e-3)
    for temper in _TEMPERATURES:
        _, gradient, curvature = frame.linearised(rotations, translations, temper)
        step, slope = steps_from(rotations, translations, middle.rotations, middle.translations)
        change, _ = _solved(gradient, curvature, prior, step, slope, damping)
        rotations, translations = so3.exp(change[:, 3:]) @ rotations, translations + change[:, :3]
    now = _measured(frame, rotations, translations, prior, middle)
    active = np.arange(len(parents))
    for _ in range(_ITERATIONS):
        _, _, _, gradient, curvature, step, slope = (part[active] for part in now)
        change, promised = _solved(gradient, curvature, prior[active], step, slope, damping[active])
        going = promised > _SETTLED
        if not going.all():
            active, change = active[going], change[going]
            if not len(active):
                break
        tried = _measured(
            frame,
            so3.exp(change[:, 3:]) @ now[0][active],
            now[1][active] + change[:, :3],
            prior[active],
            middle.at(active),
        )
        gained = now[2][active] - tried[2]
        better = gained > 0
        for whole, part in zip(now, tried, strict=True):
            whole[active[better]] = part[better]
        damping[active] *= np.where(better, 0.2, 10.0)
        active = active[np.where(better, gained > _SETTLED, damping[active] < 1e3)]
        if not len(active):
            break
    _, _, total, _, curvature, step, slope = now
    return _distinct(DescentResults(parents, total, step, curvature, slope))


def _measured(
    frame: FrameCosts, rotations: Array, translations: Array, prior: Array, middle: MotionState
) -> tuple[Array, ...]:
    """Return poses with their cost, gradient and curvature on the pixels, step from the forecast and its slope."""
    cost, gradient, curvature = frame.linearised(rotations, translations)
    step, slope = steps_from(rotations, translations, middle.rotations, middle.translations)
    total = cost + (step * (prior @ step[..., None])[..., 0]).sum(axis=-1)
    return rotations, translations, total, gradient, curvature, step, slope


def steps_from(
    rotations: Array, translations: Array, middle_rotations: Array, middle_translations: Array
) -> tuple[Array, Array]:
    """Return the steps (..., 6) from middles to poses and how they change (..., 6, 6) with a step of the pose."""
    turn = rotation_vectors(rotations @ middle_rotations.swapaxes(-1, -2))
    square = (turn**2).sum(axis=-1)
    half = np.sqrt(np.maximum(square, _SMALL)) / 2
    factor = np.where(square < _SMALL, 1 / 12, (1 - half / np.tan(half)) / (4 * half**2))
    skew = so3.hat(turn)
    slope = np.zeros((*turn.shape[:-1], 6, 6))
    slope[..., :3, :3] = _IDENTITY[:3, :3]
    # The inverse of the left Jacobian: Log(Exp(δ) Exp(v)) ≈ v + J⁻¹ δ.
    slope[..., 3:, 3:] = _IDENTITY[:3, :3] - skew / 2 + factor[..., None, None] * (skew @ skew)
    return np.concatenate([translations - middle_translations, turn], axis=-1), slope


def rotation_vectors(rotations: Array) -> Array:
    """Return what so3.log returns for rotations (..., 3, 3), in a third of the time where none is near a half turn."""
    doubled = rotations - rotations.swapaxes(-1, -2)
    axes = np.stack([doubled[..., 2, 1], doubled[..., 0, 2], doubled[..., 1, 0]], axis=-1) / 2
    sine = np.sqrt((axes**2).sum(axis=-1))
    cosine = (np.trace(rotations, axis1=-2, axis2=-1) - 1) / 2
    if (cosine < _NEAR_HALF_TURN).any():
        return so3.log(rotations)
    small = sine < so3.SERIES_ANGLE
    scale = np.where(small, 1 + sine**2 / 6, np.arctan2(sine, cosine) / np.where(small, 1.0, sine))
    return np.asarray(scale[..., None] * axes)


def _solved(
    gradient: Array, curvature: Array, prior: Array, step: Array, slope: Array, damping: Array
) -> tuple[Array, Array]:
    """Return the damped changes (E, 6) of poses and by how much (E) they should lower the cost."""
    weighted = slope.swapaxes(-1, -2) @ prior
    whole = curvature + weighted @ slope
    right = gradient + (weighted @ step[..., None])[..., 0]
    damped = whole + damping[:, None, None] * (whole * _IDENTITY)
    change = -np.linalg.solve(damped, right[..., None])[..., 0]
    return change, -(right * change).sum(axis=-1)


def _distinct(ends: DescentResults) -> DescentResults:
    """Return the ends without those that another one of the same hypothesis is as good as."""
    order = np.lexsort((ends.costs, ends.parents))
    kept: list[int] = []
    for index in order:
        one = int(index)
        for other in kept:
            if ends.parents[other] == ends.parents[one]:
                apart = ends.steps[one] - ends.steps[other]
                if apart @ ends.curvatures[other] @ apart < _SAME and np.abs(apart[3:]).max() < _SAME_TURN:
                    break
        else:
            kept.append(one)
    return DescentResults(*(part[kept] for part in ends))
