"""Multi-hypothesis tracking of a motion through the pixels of successive frames.

A frame of a small plane has two poses that explain it nearly as well. Every hypothesis is continued by both: from its
forecast and from every pose that the frame allows, damped Gauss-Newton steps descend χ² of the pixels plus that of the
forecast; every distinct end is a child. A frame may also show something else (the forecast goes on), and the motion may
start again. Costs are -2 ln of likelihoods, so that they compare; those that nobody can distinguish are merged.
Source: Reid 1979 (multiple hypotheses); Bell, Cathey 1993 (iterated Kalman update as Gauss-Newton).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.estimate.tracking.frames import DescentResults, FrameCosts, descend_frame, frame_minima
from camcal.estimate.tracking.measurements import ObjectPlane
from camcal.estimate.tracking.motion import POSE, FreeMotion, MotionState, difference
from camcal.geometry import rotation as so3

MOST = 10  # hypotheses that are kept
MAX_COST = 28.0  # above the best cost: e^-14 is no rival
ANEW = 18.4  # cost of a motion that starts again: -2 ln 1e-4
FLIPPED = 9.2  # cost of having taken the other pose near the frontal view: -2 ln 1e-2 a frame
_FRONTAL = np.radians(15.0)  # tilt below which that may have happened unseen
RARE = 0.02  # share of frames that show something else
_SAME = 1.0  # squared Mahalanobis distance of states that are one
_BLUNT = 100.0  # so that no pixel is taken for wrong
_UNSEEN = 1e-3  # of the forecast's information: what pixels say at least, all of them may be wrong
_IDENTITY = np.eye(6)

MEASURED, MISSED, WRONG, BEGUN = range(4)  # what a frame was to a hypothesis


class Candidates(NamedTuple):
    """Poses that single frames allow: rotations (N, C, 3, 3), translations (N, C, 3), there (N, C)."""

    rotations: Array
    translations: Array
    there: Array


class Hypotheses(NamedTuple):
    """K hypotheses after a frame: states, covariances (K, S, S), costs (K) and what came before.

    forecasts, forecast_covariances: of the frame, before it was seen, transitions (K, S, S) to them. parents: (K) of
    the frame before. kinds: (K). surprises: (K, 6) whitened innovations, NaN where the frame was not used.
    """

    states: MotionState
    covariances: Array
    costs: Array
    forecasts: MotionState
    forecast_covariances: Array
    transitions: Array
    parents: Array
    kinds: Array
    surprises: Array

    def take(self, index: Array) -> "Hypotheses":
        """Return some of the hypotheses, in that order."""
        states, covariances, costs, forecasts, *rest = self
        return Hypotheses(
            states.at(index), covariances[index], costs[index], forecasts.at(index), *(part[index] for part in rest)
        )


Forward = Sequence[
    Hypotheses | None
]  # what all hypotheses were after each of N frames, None before the first detection


class WrongFrames(NamedTuple):
    """What speaks for it that frames show something else: costs (N) of their minima and curvatures (N, 6, 6) there.

    The pixels of another pose fit as well as those of any object. unknown: (6,) variances of where it may be.
    """

    costs: Array
    curvatures: Array
    unknown: Array

    @classmethod
    def of(cls, frames: FrameCosts, candidates: Candidates, unknown: Array) -> "WrongFrames":
        """Return that of frames, by the first pose of each."""
        single = candidates.rotations[:, 0], candidates.translations[:, 0]
        return cls(frame_minima(frames, *single), frames.linearised(*single, _BLUNT)[2], unknown)

    def costs_at(self, frame: int, forecast: Array) -> Array:
        """Return the costs (K) of a frame by covariances (K, 6, 6) of forecasts.

        Another pose may be anywhere, and where the object itself may be by the forecast: else a loose forecast, as of
        an unknown velocity, would lose against it.
        """
        volumes = np.linalg.slogdet(_IDENTITY + (np.diag(self.unknown) + forecast) @ self.curvatures[frame])[1]
        return np.asarray(self.costs[frame] + volumes - 2 * np.log(RARE))


def follow(
    frames: FrameCosts,
    candidates: Candidates,
    stamps: Array,
    motion: FreeMotion,
    jitter_std: Array,
    distance: float,
    max_gap: float,
    flat: ObjectPlane | None = None,
) -> Forward:
    """Return the hypotheses after each frame.

    stamps: (N,) s. jitter_std: (N, 6, 6) covariance of what shakes each pose on its own. distance: (m) usual one of the
    object. max_gap: s without a detection after which the motion starts again. flat: the object's plane, if it has one.
    """
    result: list[Hypotheses | None] = []
    now: Hypotheses | None = None
    seen_at = -np.inf
    wrong = WrongFrames.of(frames, candidates, motion.unknown(distance)[POSE])
    for index in range(len(frames)):
        there = bool(candidates.there[index].any())
        if there and (now is None or stamps[index] - seen_at > max_gap):
            now = _begun(frames.at(index), _allowed(candidates, index), motion, jitter_std[index], distance, now)
        elif now is not None:
            dt = np.array(stamps[index] - stamps[index - 1])
            now = _forecast(now, motion, dt)
            if there and flat is not None:
                now = with_mirrored(now, flat)
            if there:
                allowed = _allowed(candidates, index)
                now = _seen(
                    now,
                    frames.at(index),
                    allowed=allowed,
                    motion=motion,
                    jitter_std=jitter_std[index],
                    distance=distance,
                    wrong=wrong.costs_at(index, now.covariances[:, POSE, POSE]),
                )
        if there:
            seen_at = stamps[index]
        result.append(now)
    return result


def _allowed(candidates: Candidates, index: int) -> tuple[Array, Array]:
    there = candidates.there[index]
    return candidates.rotations[index, there], candidates.translations[index, there]


def _begun(
    frame: FrameCosts,
    allowed: tuple[Array, Array],
    motion: FreeMotion,
    jitter_std: Array,
    distance: float,
    before: Hypotheses | None,
) -> Hypotheses:
    """Return the hypotheses that begin at a frame, with every pose it allows; `before` ends there."""
    rotations, translations = allowed
    count = len(rotations)
    states = MotionState(rotations, translations, np.zeros((count, motion.order, 6)))
    spread = np.tile(np.diag(motion.unknown(distance)), (count, 1, 1))
    parents = np.zeros(count, dtype=int) if before is None else np.full(count, np.argmin(before.costs))
    start = 0.0 if before is None else float(before.costs.min())
    expected = _expected(states, spread, np.full(count, start), parents, np.full(count, BEGUN))
    ends = _descended(expected, frame, states, jitter_std)
    return _kept(_children(expected, ends, jitter_std))


def _expected(states: MotionState, spread: Array, costs: Array, parents: Array, kinds: Array) -> Hypotheses:
    """Return hypotheses of which the frame has still to be seen."""
    unseen = np.full((len(costs), 6), np.nan)
    growth = np.zeros_like(spread)
    return Hypotheses(
        states,
        spread,
        costs=costs,
        forecasts=states,
        forecast_covariances=spread,
        transitions=growth,
        parents=parents,
        kinds=kinds,
        surprises=unseen,
    )


def _forecast(now: Hypotheses, motion: FreeMotion, dt: Array) -> Hypotheses:
    """Return the hypotheses at the next frame, before it is seen."""
    count = len(now.costs)
    dt = np.full(count, dt)
    states, growth = motion.forecast(now.states, dt)
    spread = growth @ now.covariances @ growth.swapaxes(-1, -2) + motion.covariance(dt[:1])
    expected = _expected(states, spread, now.costs, np.arange(count), np.full(count, MISSED))
    return expected._replace(transitions=growth)


def with_mirrored(expected: Hypotheses, flat: ObjectPlane) -> Hypotheses:
    """Return hypotheses and, of those that are nearly frontal, mirrored ones that are not among them.

    Around the frontal view a pose has two lobes of likelihood that run into each other. A hypothesis is a normal
    density about one of them, and may be the wrong one when they part.
    """
    states = expected.states
    frontal = flat.tilt(states.rotations, states.translations) < _FRONTAL
    frontal &= expected.costs < expected.costs.min() + MAX_COST - FLIPPED
    if not frontal.any():
        return expected
    twins = expected.take(np.flatnonzero(frontal))
    mirrored = flat.mirrored_states(twins.states)
    apart = so3.angle_between(mirrored.rotations[:, None], states.rotations).min(axis=1)
    own = so3.angle_between(mirrored.rotations, twins.states.rotations)
    new = apart > 0.5 * own
    if not new.any():
        return expected
    twins, mirrored = twins.take(np.flatnonzero(new)), mirrored.at(new)
    # nothing goes back from a mirrored pose to what came before it
    twins = twins._replace(
        states=mirrored,
        forecasts=mirrored,
        transitions=np.zeros_like(twins.transitions),
        costs=twins.costs + FLIPPED,
    )
    return _joined([expected, twins])


def _seen(
    expected: Hypotheses,
    frame: FrameCosts,
    allowed: tuple[Array, Array],
    motion: FreeMotion,
    jitter_std: Array,
    distance: float,
    wrong: Array,
) -> Hypotheses:
    """Return what becomes of hypotheses with a frame: seen, something else at a cost (K), or begun again."""
    ends = _descended(expected, frame, _starts(expected, allowed), jitter_std)
    children = _children(expected, ends, jitter_std)
    parts = [children]
    if float(ends.costs.min()) > frame.coordinates * float(frame.there.sum()) + ANEW:
        parts.append(expected._replace(costs=expected.costs + wrong, kinds=np.full(len(expected.costs), WRONG)))
        parts.append(_anew(expected, frame, allowed, motion, jitter_std, distance))
    return _kept(_joined(parts))


def _anew(
    expected: Hypotheses,
    frame: FrameCosts,
    allowed: tuple[Array, Array],
    motion: FreeMotion,
    jitter_std: Array,
    distance: float,
) -> Hypotheses:
    """Return the children of the best hypothesis if nothing of its forecast holds."""
    best = expected.take(np.array([int(np.argmin(expected.costs))]))
    unknown = np.diag(motion.unknown(distance))
    best = best._replace(
        covariances=best.covariances + unknown,
        forecast_covariances=best.covariances + unknown,
        costs=best.costs + ANEW,
        kinds=np.array([BEGUN]),
    )
    return _children(best, _descended(best, frame, _starts(best, allowed), jitter_std), jitter_std)


def _starts(expected: Hypotheses, allowed: tuple[Array, Array]) -> MotionState:
    """Return the (K (1 + C)) poses to descend from: each hypothesis's forecast, then what the frame allows."""
    rotations, translations = allowed
    count, each = len(expected.costs), 1 + len(rotations)
    states = expected.states
    every = np.broadcast_to(rotations, (count, *rotations.shape))
    places = np.broadcast_to(translations, (count, *translations.shape))
    return MotionState(
        np.concatenate([states.rotations[:, None], every], axis=1).reshape(-1, 3, 3),
        np.concatenate([states.translations[:, None], places], axis=1).reshape(-1, 3),
        np.repeat(states.rates, each, axis=0),
    )


def _descended(expected: Hypotheses, frame: FrameCosts, starts: MotionState, jitter_std: Array) -> DescentResults:
    return descend_frame(frame, expected.states, expected.covariances[:, POSE, POSE] + jitter_std, starts)


def _children(expected: Hypotheses, ends: DescentResults, jitter_std: Array) -> Hypotheses:
    """Return the hypotheses that distinct ends make."""
    spread = expected.covariances[ends.parents]
    whole = spread[:, POSE, POSE] + jitter_std
    own = ends.slopes @ np.linalg.inv(ends.normal) @ ends.slopes.swapaxes(-1, -2)  # of the step from the forecast
    gain = np.linalg.solve(whole, spread[:, POSE]).swapaxes(-1, -2)
    change = (gain @ ends.steps[..., None])[..., 0]
    after = spread - gain @ (whole - own) @ gain.swapaxes(-1, -2)
    turned = so3.exp_jacobian(change[:, 3:6])  # steps of the forecast's rotation as steps of the new one
    after[:, 3:6] = turned @ after[:, 3:6]
    after[:, :, 3:6] = after[:, :, 3:6] @ turned.swapaxes(-1, -2)
    volume = np.linalg.slogdet(whole)[1] - np.linalg.slogdet(own)[1]
    return expected.take(ends.parents)._replace(
        states=expected.states.at(ends.parents).moved(change),
        covariances=(after + after.swapaxes(-1, -2)) / 2,
        costs=expected.costs[ends.parents] + ends.costs + volume,
        kinds=np.where(expected.kinds[ends.parents] == BEGUN, BEGUN, MEASURED),
        surprises=_surprises(whole, ends),
    )


def _surprises(whole: Array, ends: DescentResults) -> Array:
    """Return the innovations (E, 6), whitened: at the end both pulls balance, and S = P + H⁻¹ for ν = S P⁻¹ d."""
    pull = np.linalg.solve(whole, ends.steps[..., None])
    prior = ends.slopes.swapaxes(-1, -2) @ np.linalg.inv(whole) @ ends.slopes
    measured = ends.slopes @ np.linalg.inv(ends.normal - (1 - _UNSEEN) * prior) @ ends.slopes.swapaxes(-1, -2)
    scale = np.sqrt(np.diagonal(whole + measured, axis1=-2, axis2=-1))
    root = np.linalg.cholesky((whole + measured) / (scale[:, :, None] * scale[:, None, :]))
    return np.asarray((root.swapaxes(-1, -2) @ (scale[..., None] * pull))[..., 0])


def _joined(parts: list[Hypotheses]) -> Hypotheses:
    states, covariances, costs, forecasts, spreads, *rest = zip(*parts, strict=True)
    return Hypotheses(
        _joined_states(states),
        np.concatenate(covariances),
        np.concatenate(costs),
        _joined_states(forecasts),
        np.concatenate(spreads),
        *map(np.concatenate, rest),
    )


def _joined_states(parts: Sequence[MotionState]) -> MotionState:
    return MotionState(*map(np.concatenate, zip(*parts, strict=True)))


def _kept(children: Hypotheses) -> Hypotheses:
    """Return the likeliest hypotheses, each with the weight of those that are the same as it."""
    order = np.argsort(children.costs, kind="stable")
    order = order[children.costs[order] < children.costs[order[0]] + MAX_COST]
    if len(order) == 1:
        return children.take(order)
    costs = children.costs.copy()
    kept: list[int] = []
    for index in map(int, order):
        if kept:
            apart = difference(children.states.at(np.array(kept)), children.states.at(np.full(len(kept), index)))
            far = np.linalg.solve(children.covariances[kept], apart[..., None])[..., 0]
            same = np.flatnonzero((far * apart).sum(axis=-1) < _SAME)
            if len(same):
                to = kept[same[0]]
                costs[to] = -2 * np.logaddexp(-costs[to] / 2, -costs[index] / 2)
                continue
        if len(kept) < MOST:
            kept.append(index)
    return children._replace(costs=costs).take(np.array(kept))
