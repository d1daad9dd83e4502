"""Poses between what a frame's pixels say and what was expected: damped Gauss-Newton from many starts at once.

χ² of the pixels plus that of the step from the expected pose is descended, to begin with as if wrong pixels were right.
"""

from typing import NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.estimate.tracking.free_motion import MotionState
from camcal.estimate.tracking.pixel_costs import PixelFrames, linearised
from camcal.estimate.tracking.pose_filter import rotation_vectors
from camcal.geometry import rotation as so3

_ITERATIONS = 12
_TEMPERS = (16.0, 4.0)
_SETTLED = 1e-3  # decrease of the cost that is no longer worth a step
_SAME = 1.0  # squared Mahalanobis distance of ends that are one
_SAME_TURN = 0.2  # rad, no more than which they are apart
_SMALL = 1e-6  # rad², below which the series is used
_EYE = np.eye(6)


class Ends(NamedTuple):
    """Where descents ended: the hypothesis (E) each stems from, the cost, and the steps (E, 6) from what it expected.

    curvatures: (E, 6, 6) of the pixels' cost, half. slopes: (E, 6, 6) of the steps over steps of the pose.
    """

    parents: Array
    costs: Array
    steps: Array
    curvatures: Array
    slopes: Array


def descended(frame: PixelFrames, middles: MotionState, covariances: Array, starts: MotionState) -> Ends:
    """Return the distinct ends of descents on a frame's pixels and on what was expected of its pose.

    middles, covariances: (K, 6, 6) of what K hypotheses expect. starts: (K C), those of each hypothesis together.
    """
    count = len(covariances)
    parents = np.repeat(np.arange(count), len(starts.translations) // count)
    prior = np.linalg.inv(covariances)[parents]
    middle = middles.at(parents)
    rotations, translations = starts.rotations.copy(), starts.translations.copy()
    damping = np.full(len(parents), 1e-3)
    for temper in _TEMPERS:
        _, gradient, curvature = linearised(frame, rotations, translations, temper)
        step, slope = _pulled(rotations, translations, middle)
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
    return _distinct(Ends(parents, total, step, curvature, slope))


def _measured(
    frame: PixelFrames, rotations: Array, translations: Array, prior: Array, middle: MotionState
) -> tuple[Array, ...]:
    """Return poses with their cost, gradient and curvature on the pixels, step from the forecast and its slope."""
    cost, gradient, curvature = linearised(frame, rotations, translations)
    step, slope = _pulled(rotations, translations, middle)
    total = cost + (step * (prior @ step[..., None])[..., 0]).sum(axis=-1)
    return rotations, translations, total, gradient, curvature, step, slope


def _pulled(rotations: Array, translations: Array, middle: MotionState) -> tuple[Array, Array]:
    """Return the steps (E, 6) from forecasts to poses and how they change (E, 6, 6) with a step of the pose."""
    turn = rotation_vectors(rotations @ middle.rotations.swapaxes(-1, -2))
    square = (turn**2).sum(axis=-1)
    half = np.sqrt(np.maximum(square, _SMALL)) / 2
    factor = np.where(square < _SMALL, 1 / 12, (1 - half / np.tan(half)) / (4 * half**2))
    skew = so3.hat(turn)
    slope = np.zeros((len(turn), 6, 6))
    slope[:, :3, :3] = _EYE[:3, :3]
    # The inverse of the left Jacobian: Log(Exp(δ) Exp(v)) ≈ v + J⁻¹ δ.
    slope[:, 3:, 3:] = _EYE[:3, :3] - skew / 2 + factor[:, None, None] * (skew @ skew)
    return np.concatenate([translations - middle.translations, turn], axis=-1), slope


def _solved(
    gradient: Array, curvature: Array, prior: Array, step: Array, slope: Array, damping: Array
) -> tuple[Array, Array]:
    """Return the damped changes (E, 6) of poses and by how much (E) they should lower the cost."""
    weighted = slope.swapaxes(-1, -2) @ prior
    whole = curvature + weighted @ slope
    right = gradient + (weighted @ step[..., None])[..., 0]
    damped = whole + damping[:, None, None] * (whole * _EYE)
    change = -np.linalg.solve(damped, right[..., None])[..., 0]
    return change, -(right * change).sum(axis=-1)


def _distinct(ends: Ends) -> Ends:
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
    return Ends(*(part[kept] for part in ends))
