"""Process noise: from the innovations of a filter, or from the evidence of a track with vibration.

The densities of white noise are those that make the innovations likeliest. The likelihood is that of the filter, each
frame's part bounded by that of an outlier. Candidates of the densities are tried side by side, and so are stretches of
the track.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from camcal.arrays import Array, FloatArray
from camcal.errors import InvalidInput
from camcal.estimate.tracking import pose_filter
from camcal.estimate.tracking.free_motion import FreeMotion, MotionState, difference
from camcal.estimate.tracking.jitter import JitterStd
from camcal.estimate.tracking.pixel_batch import BatchTrack, Chains, Spread, solved, spread_of
from camcal.estimate.tracking.pixel_costs import inlier_probabilities, squares
from camcal.estimate.tracking.pose_filter import Candidates, FilterState
from camcal.estimate.tracking.segments import LEAST, GateOptions, PoseMeasurements, Segment, candidates_at, follow

_STRETCH = 60  # frames; the first of each tells little
_STRETCHES = 16  # that are examined, spread evenly
_SPACINGS = (1.0, 0.25)  # decades between the densities tried: an initial value may lose the track, and is corrected
_FINEST, _ROUNDS = 0.25, 40
_UNKNOWN = 10.0  # decades: the likelihood is flat
_NOTICEABLE = 0.05  # of -2 log likelihood: less is no reason to go on towards no noise at all
_START_ROTATION = 1.0  # rad²/s³: a hand moves so
_START_TRANSLATION = 0.1  # 1/s³, of the squared distance
_AROUND = np.array([(0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)], dtype=float)

# the choice by evidence
FADING = 0.3  # s, in which accelerations fade
_CHOICE_ROUNDS, _ROUNDS_SHAKEN = 5, 8
_STEPS = 3  # of Gauss-Newton between two changes of the noise
_NO_WORSE = 2.0  # of -2 ln evidence, that a cause of shakes must be worth
_SETTLED = 0.5  # of -2 ln evidence, below which no round is made
_BETTER = 12.0  # of -2 ln evidence, by which a model with more in it must win
_SINGER_SCALE = 30.0  # 1/s², initial value of its densities over those of white noise


@dataclass(frozen=True)
class ProcessNoise:
    """Spectral densities of the white-noise acceleration: translation, m²/s³, and rotation, rad²/s³.

    factors: by which each may be off (one standard deviation), None where that is not known. fading: time constant (s)
    with which accelerations fade that this noise drives, in m²/s⁵ and rad²/s⁵; None where it is the acceleration.
    """

    translation: float
    rotation: float
    factors: tuple[float, float] | None = None
    fading: float | None = None

    def __post_init__(self) -> None:
        for name in ("translation", "rotation"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise InvalidInput(f"the process noise of {name} must be more than 0, found {value:g}")

    @property
    def densities(self) -> FloatArray:
        """Both as (2,)."""
        return np.array([self.translation, self.rotation])


class _Stretches(NamedTuple):
    """Stretches of a track side by side: beliefs (S, 1, …) at their starts, then time steps (S, 1) s and candidates."""

    starts: FilterState
    steps: list[Array]
    seen: list[Candidates]
    outlier_cost: float


def tuned(measurements: PoseMeasurements, following: GateOptions) -> ProcessNoise:
    """Return the densities under which the detections are likeliest; the first guess where nothing can be followed."""
    present = measurements.present
    distance = float(np.median(np.linalg.norm(measurements.translations[present, 0], axis=-1)))
    densities = np.array([_START_TRANSLATION * max(distance, 1e-6) ** 2, _START_ROTATION])
    deviation = np.full(2, _UNKNOWN)
    for spacing in _SPACINGS:
        stretches = _stretches(measurements, follow(measurements, densities, following))
        if stretches is None:
            break
        densities, deviation = _likeliest(stretches, densities, spacing, following.gate)
    (translation, rotation), (first, second) = map(float, densities), map(float, 10**deviation)
    return ProcessNoise(translation, rotation, (first, second))


def _stretches(measurements: PoseMeasurements, segments: Sequence[Segment]) -> _Stretches | None:
    """Return the stretches of the pieces, as many as are examined; None if there are none."""
    cuts = [cut for segment in segments for cut in _cut(segment)]
    if not cuts:
        return None
    chosen = [cuts[index] for index in np.unique(np.linspace(0, len(cuts) - 1, _STRETCHES).astype(int))]
    starts = FilterState(*map(np.stack, zip(*(start for start, _ in chosen), strict=True)))
    frames = np.array([[*part, *[-1] * (_STRETCH - len(part))] for _, part in chosen])
    steps = np.where(frames[:, 1:] < 0, 0.0, measurements.stamps[frames[:, 1:]] - measurements.stamps[frames[:, :-1]])
    seen = []
    for later in frames.T[1:]:
        candidates = candidates_at(measurements, later)
        penalties = np.where(later[:, None] < 0, np.inf, candidates.penalties)
        seen.append(Candidates(*(part[:, None] for part in candidates._replace(penalties=penalties))))
    return _Stretches(
        starts.each(lambda values: values[:, None]),
        [step[:, None] for step in steps.T],
        seen,
        measurements.outlier_cost,
    )


def _cut(segment: Segment) -> list[tuple[FilterState, Array]]:
    """Return the stretches of a piece: what was estimated at the first frame, and the indices of all."""
    cuts = []
    for first in range(0, len(segment.frames) - LEAST + 1, _STRETCH - 1):
        start = segment.run.filtered.each(lambda values: values[first])  # noqa: B023 - used at once
        cuts.append((start, segment.frames[first : first + _STRETCH]))
    return cuts


def _costs(stretches: _Stretches, densities: Array, bound: float) -> Array:
    """Return -2 log likelihood (Q,) of all stretches under each of densities (Q, 2), up to a constant."""
    shape = len(stretches.starts.translations), len(densities)
    belief = stretches.starts.each(lambda values: np.broadcast_to(values, (*shape, *values.shape[2:])))
    total = np.zeros(len(densities))
    for dt, seen in zip(stretches.steps, stretches.seen, strict=True):
        belief, _ = pose_filter.predict(belief, densities, dt)
        belief, verdict = pose_filter.update(belief, seen, bound)
        total += np.minimum(verdict.cost, stretches.outlier_cost).sum(axis=0)
    return total


def _likeliest(stretches: _Stretches, densities: Array, spacing: float, bound: float) -> tuple[Array, Array]:
    """Return the densities (2,) of the lowest cost, and the standard deviation (2,) of their decimal logarithms."""
    centre = np.log10(densities)
    for _ in range(_ROUNDS):
        costs = _costs(stretches, 10 ** (centre + spacing * _AROUND), bound)
        best = int(np.argmin(costs))
        if costs[best] < costs[0] - _NOTICEABLE:
            centre = centre + spacing * _AROUND[best]
        elif spacing > _FINEST:
            spacing /= 2
        else:
            break
    return _vertex(centre, spacing, costs)


def _vertex(centre: Array, spacing: float, costs: Array) -> tuple[Array, Array]:
    """Return the densities at the lowest points of parabolas through the costs around the best, and their spread."""
    low, high = costs[1::2] - costs[0], costs[2::2] - costs[0]
    curvature = np.maximum(low + high, np.finfo(float).tiny)
    step = np.clip((low - high) / (2 * curvature), -0.5, 0.5)
    return 10 ** (centre + spacing * step), np.minimum(spacing * np.sqrt(2 / curvature), _UNKNOWN)


@dataclass(frozen=True, eq=False)
class NoiseFit:
    """A track with the noise that explains it best, and its covariances."""

    track: BatchTrack
    spread: Spread
    jitter_std: JitterStd

    @property
    def evidence(self) -> float:
        """-2 ln of the evidence of all chains."""
        return float(self.track.evidence.sum())


def fit_noise(
    chains: Chains,
    motion: FreeMotion,
    states: MotionState,
    jitter_std: JitterStd,
    *,
    tune: bool = True,
    rounds: int = _CHOICE_ROUNDS,
) -> NoiseFit:
    """Return the track with the densities and shaking at the highest evidence, from given ones on.

    tune: whether densities may change; what does not shake at the beginning never does.
    """
    chains = _shaken(chains, states, jitter_std)
    track = solved(chains, motion, states)
    spread = spread_of(track)
    for _ in range(rounds):
        if tune:
            motion = replace(motion, densities=tuned_densities(track, spread))
        if jitter_std.any:
            used = chains.used
            places = track.states.translations[used]
            jitter_std = jitter_std.likelier(places, track.pulls[used], spread.informed[used])
            chains = _shaken(chains, track.states, jitter_std)
        elif not tune:
            break
        before = float(track.evidence.sum())
        track = solved(chains, motion, track.states, _STEPS, track.pulls)
        spread = spread_of(track)
        if abs(float(track.evidence.sum()) - before) < _SETTLED:
            break
    found = NoiseFit(track, spread, jitter_std)
    if not jitter_std.any:
        return found
    # While the noise was sought, pixels that fit may have been given up: the start may lead to a better end.
    again = solved(chains, motion, states)
    return min(found, NoiseFit(again, spread_of(again), jitter_std), key=lambda each: each.evidence)


def _shaken(chains: Chains, states: MotionState, jitter_std: JitterStd) -> Chains:
    return replace(chains, jitter_std=jitter_std.covariance(states.translations) if jitter_std.any else None)


def with_fading(found: NoiseFit, fading: float | None) -> tuple[Chains, FreeMotion, MotionState]:
    """Return a track's chains, motion and states for the other model of the motion, accelerations unknown."""
    track = found.track
    scale = _SINGER_SCALE if fading is not None else 1 / _SINGER_SCALE
    densities = tuple(float(scale * each) for each in track.motion.densities)
    motion = FreeMotion((densities[0], densities[1]), fading)
    rates = np.zeros((len(track.chains.used), motion.order, 6))
    rates[:, 0] = track.states.rates[:, 0]
    chains = track.chains
    distance = float(np.median(np.linalg.norm(track.states.translations, axis=1)))
    unknown = motion.unknown(distance)
    anchors = np.where((chains.anchors[:, :1] > 0), 1 / unknown, 0.0)
    chains = replace(chains, unknown=unknown, anchors=anchors)
    return chains, motion, track.states._replace(rates=rates)


def chosen(found: NoiseFit, *, distance: float, tune: bool = True) -> NoiseFit:
    """Return the best of: as it is, with the other model of the motion, and the better of both with shakes."""
    best = found
    if tune:
        chains, motion, states = with_fading(found, FADING if found.track.motion.fading is None else None)
        best = min(found, fit_noise(chains, motion, states, found.jitter_std), key=lambda each: each.evidence)
    if not best.jitter_std.any:
        track = best.track
        guess = JitterStd.guess(distance)
        shaken = fit_noise(track.chains, track.motion, track.states, guess, tune=tune, rounds=_ROUNDS_SHAKEN)
        if shaken.evidence < best.evidence - _BETTER:
            best = _simpler(shaken, tune=tune)
    return best


def _simpler(found: NoiseFit, *, tune: bool) -> NoiseFit:
    """Return the track without the causes of shakes that explain nothing."""
    for cause in ("object_turn", "object_shift", "camera_turn"):
        less = replace(found.jitter_std, **{cause: 0.0})
        if less.any and less != found.jitter_std:
            track = found.track
            tried = fit_noise(track.chains, track.motion, track.states, less, tune=tune)
            if tried.evidence < found.evidence + _NO_WORSE:
                found = tried
    return found


def covariance_for(jitter_std: JitterStd, translations: Array) -> Array:
    """Return the covariances (N, 6, 6) of shakes, zero where nothing shakes."""
    return jitter_std.covariance(translations) if jitter_std.any else np.zeros((len(translations), 6, 6))


def tuned_densities(track: BatchTrack, spread: Spread) -> tuple[float, float]:
    """Return the densities of process noise of the next step to the highest evidence: q eᵀQ⁻¹e / (n - tr Q⁻¹ Cov e)."""
    chains, motion = track.chains, track.motion
    regular = chains.linked & ~chains.begun
    if not regular.any():
        return motion.densities
    information = motion.information(np.where(regular, chains.steps, 1.0))
    forecast, growth = motion.forecast(track.states.at(slice(None, -1)), chains.steps)
    off = difference(track.states.at(slice(1, None)), forecast)
    crossed = growth @ spread.beside
    unsure = spread.states[1:] + growth @ spread.states[:-1] @ growth.swapaxes(-1, -2)
    unsure -= crossed + crossed.swapaxes(-1, -2)
    result = []
    for axis, density in enumerate(motion.densities):
        part = np.concatenate([6 * order + 3 * axis + np.arange(3) for order in range(motion.order + 1)])
        inner = information[regular][:, part[:, None], part]
        squares = float(np.einsum("ni,nij,nj->", off[regular][:, part], inner, off[regular][:, part]))
        known = inner.shape[0] * len(part) - float((inner * unsure[regular][:, part[:, None], part]).sum())
        factor = squares / max(known, 1e-3 * squares, 1e-12)
        result.append(density * float(np.clip(factor, 0.05, 20.0)))
    return result[0], result[1]


def noise_factor(track: BatchTrack, spread: Spread) -> float:
    """Return by how much the pixels' standard deviations are too small, from the residuals of right pixels."""
    used = track.chains.used
    squared = squares(track.chains.frames, *track.poses)
    weights = np.where(used[:, None], inlier_probabilities(track.chains.frames, squared), 0.0)
    spent = float(np.einsum("nij,nji->", track.curvatures[used], spread.poses[used]))
    dof = 2 * float(weights.sum()) - spent
    return float(np.sqrt((weights * squared).sum() / max(dof, 1.0)))
