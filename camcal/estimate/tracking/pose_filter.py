"""An error-state Kalman filter of poses that move at nearly constant velocity, on SO(3) × R³, and its smoothers.

A belief is a pose, its velocities (R' = hat(w) R) and the covariance of the error: steps of the pose in the order
tx ty tz rx ry rz, R ← Exp(δr) R, then those of the velocities. Every function takes any leading axes, so that many
filters run at once. Rotation and translation move independently: on SE(3) a turning object would follow a helix about
the origin. What later frames say of earlier poses comes from the fixed-interval smoother and, for a bounded delay, the
fixed-lag one.
Source: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, sections 5.2 and
6.2.2 (continuous white-noise acceleration); Solà, Quaternion kinematics for the error-state Kalman filter, 2017; Rauch,
Tung, Striebel 1965.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.geometry import rotation as so3

SIZE = 12
_SPEED = 2.0  # 1/s, of the distance: standard deviation of an unknown velocity
_TURN = 2 * np.pi  # rad/s, the same of an unknown rate
_POSE, _RATES, _ALL = np.arange(6), np.arange(6, 12), np.arange(SIZE)
_IDENTITY = np.eye(3)
_NEAR_HALF_TURN = -0.9  # cosine of an angle; there the sine says little


class FilterState(NamedTuple):
    """rotations (..., 3, 3), translations (..., 3), velocities (..., 6) m/s and rad/s, covariances (..., 12, 12)."""

    rotations: Array
    translations: Array
    velocities: Array
    covariances: Array

    def each(self, change: Callable[[Array], Array]) -> "FilterState":
        """Return the belief with every array changed."""
        return FilterState(*map(change, self))


class Candidates(NamedTuple):
    """What one frame offers, the best first.

    rotations: (..., C, 3, 3). translations: (..., C, 3). covariances: (..., C, 6, 6). penalties: (..., C), infinite
    where there is no candidate.
    """

    rotations: Array
    translations: Array
    covariances: Array
    penalties: Array


class GatingResult(NamedTuple):
    """What became of a frame's candidates.

    chosen: (...) the index of the candidate examined. accepted: (...) whether it was inside the gate and used.
    nis: (...) squared innovation over its covariance, infinite without a candidate. whitened: (..., 6) innovation.
    cost: (...) -2 log likelihood of the candidate, up to a constant; 0 without one.
    """

    chosen: Array
    accepted: Array
    nis: Array
    whitened: Array
    cost: Array


def start(rotations: Array, translations: Array, covariances: Array) -> FilterState:
    """Return the beliefs of first poses and their covariances (..., 6, 6), with velocities unknown."""
    beliefs = np.zeros((*translations.shape[:-1], SIZE, SIZE))
    beliefs[..., :6, :6] = covariances
    beliefs[..., _RATES, _RATES] = _unknown_rates(translations)
    return FilterState(rotations, translations, np.zeros((*translations.shape[:-1], 6)), beliefs)


def after_jerk(belief: FilterState) -> FilterState:
    """Return the beliefs with velocities as unknown as at a start: they may have become any others since."""
    covariances = belief.covariances.copy()
    covariances[..., _RATES, _RATES] += _unknown_rates(belief.translations)
    return belief._replace(covariances=covariances)


def _unknown_rates(translations: Array) -> Array:
    """Return the variances (..., 6) of unknown velocities at translations (..., 3)."""
    speed = _SPEED * np.linalg.norm(translations, axis=-1)[..., None]
    return np.concatenate([np.tile(speed, 3), np.full((*speed.shape[:-1], 3), _TURN)], -1) ** 2


def transition(turn: Array, turned: Array, dt: Array) -> Array:
    """Return how errors (..., 12) grow over dt (...) seconds, as (..., 12, 12).

    turn: (..., 3) rad in that time. turned: (..., 3, 3) its rotation. An error of the rate turns with the pose, which
    is the left Jacobian; three terms of it are enough for a covariance.
    """
    result = np.zeros((*turn.shape[:-1], SIZE, SIZE))
    result[..., _ALL, _ALL] = 1.0
    skew, seconds = so3.hat(turn), dt[..., None, None]
    result[..., :3, 6:9] = seconds * _IDENTITY
    result[..., 3:6, 3:6] = turned
    result[..., 3:6, 9:] = seconds * (_IDENTITY + skew / 2 + skew @ skew / 6)
    return result


def process_covariance(noise: Array, dt: Array) -> Array:
    """Return the covariance (..., 12, 12) that white-noise acceleration of density `noise` (..., 2) adds over dt (...).

    noise: of translation, m²/s³, and of rotation, rad²/s³. Two steps give what one step of their length gives, so
    missing frames change nothing.
    """
    density, dt = np.repeat(noise, 3, axis=-1), dt[..., None]
    result = np.zeros((*np.broadcast_shapes(density.shape, dt.shape)[:-1], SIZE, SIZE))
    result[..., _POSE, _POSE] = density * dt**3 / 3
    result[..., _POSE, _RATES] = result[..., _RATES, _POSE] = density * dt**2 / 2
    result[..., _RATES, _RATES] = density * dt
    return result


def predict(belief: FilterState, noise: Array, dt: Array) -> tuple[FilterState, Array]:
    """Return the beliefs dt (...) seconds later, and the transition (..., 12, 12) of their errors."""
    step = belief.velocities * dt[..., None]
    turned = so3.exp(step[..., 3:])
    growth = transition(step[..., 3:], turned, dt)
    covariances = growth @ belief.covariances @ growth.swapaxes(-1, -2) + process_covariance(noise, dt)
    return FilterState(
        turned @ belief.rotations, belief.translations + step[..., :3], belief.velocities, covariances
    ), growth


def moved(belief: FilterState, step: Array, covariances: Array) -> FilterState:
    """Return the beliefs with their mean moved by steps (..., 12) and with other covariances."""
    return FilterState(
        so3.exp(step[..., 3:6]) @ belief.rotations,
        belief.translations + step[..., :3],
        belief.velocities + step[..., 6:],
        covariances,
    )


def update(belief: FilterState, seen: Candidates, gate: float) -> tuple[FilterState, GatingResult]:
    """Return the beliefs after the likeliest candidate of a frame, unchanged where that lies outside the gate.

    gate: bound of the NIS, which is χ² with 6 degrees of freedom if the filter is right. The likeliest candidate has
    the smallest sum of NIS and penalty. Joseph's form keeps the covariance positive.
    """
    between = seen.rotations @ belief.rotations[..., None, :, :].swapaxes(-1, -2)
    shifts = seen.translations - belief.translations[..., None, :]
    innovations = np.concatenate([shifts, rotation_vectors(between)], axis=-1)
    roots = np.linalg.cholesky(belief.covariances[..., None, :6, :6] + seen.covariances)
    whitening = np.linalg.inv(roots)
    whitened = (whitening @ innovations[..., None])[..., 0]
    nis = np.where(np.isfinite(seen.penalties), (whitened**2).sum(axis=-1), np.inf)
    chosen = np.argmin(nis + seen.penalties, axis=-1)
    nis, penalty, whitened = _picked(nis, chosen), _picked(seen.penalties, chosen), _picked(whitened, chosen)
    accepted = nis < gate
    logarithm = 2 * np.log(np.diagonal(_picked(roots, chosen), axis1=-2, axis2=-1)).sum(axis=-1)
    cost = np.where(np.isfinite(nis), nis + penalty + logarithm, 0.0)
    # K ν = P Hᵀ S⁻¹ ν, with S⁻¹ = Wᵀ W and W ν whitened
    half = belief.covariances[..., :6] @ _picked(whitening, chosen).swapaxes(-1, -2)
    half = np.where(accepted[..., None, None], half, 0.0)
    gain = half @ _picked(whitening, chosen)
    kept = np.eye(SIZE) - np.concatenate([gain, np.zeros_like(gain)], axis=-1)
    covariances = kept @ belief.covariances @ kept.swapaxes(-1, -2)
    covariances += gain @ _picked(seen.covariances, chosen) @ gain.swapaxes(-1, -2)
    covariances = (covariances + covariances.swapaxes(-1, -2)) / 2
    after = moved(belief, (half @ whitened[..., None])[..., 0], covariances)
    return after, GatingResult(chosen, accepted, nis, whitened, cost)


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


def _picked(values: Array, chosen: Array) -> Array:
    """Return values (..., …) of the chosen (...) candidates from those of all (..., C, …)."""
    axis = chosen.ndim
    at = np.reshape(chosen, (*chosen.shape, *(1,) * (values.ndim - axis - 1)))
    result = values[(slice(None),) * axis + (0,)]
    for candidate in range(1, values.shape[axis]):
        result = np.where(at == candidate, values[(slice(None),) * axis + (candidate,)], result)
    return np.asarray(result)


class Run(NamedTuple):
    """A filter's beliefs at M successive frames, along the first axis of every array.

    filtered: after each frame. predicted: before it; the first is the filtered one. growth: (M, 12, 12) how errors
    grew from the frame before; the first is of no use.
    """

    filtered: FilterState
    predicted: FilterState
    growth: Array


def smoothed(run: Run) -> FilterState:
    """Return the beliefs (M, …) at every frame given all frames."""
    result = [run.filtered.each(lambda values: values[-1])]
    for frame in range(len(run.growth) - 2, -1, -1):
        result.append(_back(run, np.array(frame), result[-1]))
    return FilterState(*(np.stack(parts[::-1]) for parts in zip(*result, strict=True)))


def smoothed_with_lag(run: Run, lag: int) -> FilterState:
    """Return the beliefs (M, …) at every frame given the frames up to `lag` later ones, the last ones given all."""
    last = len(run.growth) - 1
    frames = np.arange(last + 1)
    newest = np.minimum(frames + lag, last)
    result = run.filtered.each(lambda values: values[newest])
    for behind in range(lag):
        at = newest - 1 - behind
        going = at >= frames
        back = _back(run, at[going], result.each(lambda values: values[going]))  # noqa: B023 - used at once
        for whole, part in zip(result, back, strict=True):
            whole[going] = part
    return result


def _back(run: Run, frame: Array, later: FilterState) -> FilterState:
    """Return the beliefs at frames (...) from what became of the beliefs at the frames after them."""
    filtered = run.filtered.each(lambda values: values[frame])
    expected = run.predicted.each(lambda values: values[frame + 1])
    growth = run.growth[frame + 1]
    gain = np.linalg.solve(expected.covariances, growth @ filtered.covariances).swapaxes(-1, -2)
    covariances = filtered.covariances + gain @ (later.covariances - expected.covariances) @ gain.swapaxes(-1, -2)
    step = (gain @ _difference(later, expected)[..., None])[..., 0]
    return moved(filtered, step, (covariances + covariances.swapaxes(-1, -2)) / 2)


def _difference(after: FilterState, before: FilterState) -> Array:
    """Return the step (..., 12) from one mean to another."""
    turn = so3.log(after.rotations @ before.rotations.swapaxes(-1, -2))
    shift = after.translations - before.translations
    return np.concatenate([shift, turn, after.velocities - before.velocities], axis=-1)
