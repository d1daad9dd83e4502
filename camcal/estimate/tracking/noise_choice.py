"""What drives a motion and what shakes it: chosen by the evidence of the whole track."""

from dataclasses import dataclass, replace

import numpy as np

from camcal.arrays import Array
from camcal.estimate.tracking.free_motion import FreeMotion, MotionState, difference
from camcal.estimate.tracking.pixel_batch import BatchTrack, Chains, Spread, solved, spread_of
from camcal.estimate.tracking.pixel_costs import rightness, squares
from camcal.estimate.tracking.shaking import Shaking

FADING = 0.3  # s, in which accelerations fade
_ROUNDS, _ROUNDS_SHAKEN = 5, 8
_STEPS = 3  # of Gauss-Newton between two changes of the noise
_NO_WORSE = 2.0  # of -2 ln evidence, that a cause of shakes must be worth
_SETTLED = 0.5  # of -2 ln evidence, no longer worth a round
_BETTER = 12.0  # of -2 ln evidence, by which a model with more in it must win
_SINGER_SCALE = 30.0  # 1/s², first guess of its densities over those of white noise


@dataclass(frozen=True, eq=False)
class Explained:
    """A track with the noise that explains it best, and its covariances."""

    track: BatchTrack
    spread: Spread
    shaking: Shaking

    @property
    def evidence(self) -> float:
        """-2 ln of the evidence of all chains."""
        return float(self.track.evidence.sum())


def explained(
    chains: Chains,
    motion: FreeMotion,
    states: MotionState,
    shaking: Shaking,
    *,
    tune: bool = True,
    rounds: int = _ROUNDS,
) -> Explained:
    """Return the track with the densities and shaking at the highest evidence, from given ones on.

    tune: whether densities may change; what does not shake at the beginning never does.
    """
    chains = _shaken(chains, states, shaking)
    track = solved(chains, motion, states)
    spread = spread_of(track)
    for _ in range(rounds):
        if tune:
            motion = replace(motion, densities=tuned_densities(track, spread))
        if shaking.any:
            used = chains.used
            places = track.states.translations[used]
            shaking = shaking.likelier(places, track.pulls[used], spread.informed[used])
            chains = _shaken(chains, track.states, shaking)
        elif not tune:
            break
        before = float(track.evidence.sum())
        track = solved(chains, motion, track.states, _STEPS, track.pulls)
        spread = spread_of(track)
        if abs(float(track.evidence.sum()) - before) < _SETTLED:
            break
    found = Explained(track, spread, shaking)
    if not shaking.any:
        return found
    # While the noise was sought, pixels that fit may have been given up: the start may lead to a better end.
    again = solved(chains, motion, states)
    return min(found, Explained(again, spread_of(again), shaking), key=lambda each: each.evidence)


def _shaken(chains: Chains, states: MotionState, shaking: Shaking) -> Chains:
    return replace(chains, shaking=shaking.covariance(states.translations) if shaking.any else None)


def with_fading(found: Explained, fading: float | None) -> tuple[Chains, FreeMotion, MotionState]:
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


def chosen(found: Explained, *, distance: float, tune: bool = True) -> Explained:
    """Return the best of: as it is, with the other model of the motion, and the better of both with shakes."""
    best = found
    if tune:
        chains, motion, states = with_fading(found, FADING if found.track.motion.fading is None else None)
        best = min(found, explained(chains, motion, states, found.shaking), key=lambda each: each.evidence)
    if not best.shaking.any:
        track = best.track
        guess = Shaking.guess(distance)
        shaken = explained(track.chains, track.motion, track.states, guess, tune=tune, rounds=_ROUNDS_SHAKEN)
        if shaken.evidence < best.evidence - _BETTER:
            best = _simpler(shaken, tune=tune)
    return best


def _simpler(found: Explained, *, tune: bool) -> Explained:
    """Return the track without the causes of shakes that explain nothing."""
    for cause in ("object_turn", "object_shift", "camera_turn"):
        less = replace(found.shaking, **{cause: 0.0})
        if less.any and less != found.shaking:
            track = found.track
            tried = explained(track.chains, track.motion, track.states, less, tune=tune)
            if tried.evidence < found.evidence + _NO_WORSE:
                found = tried
    return found


def covariance_for(shaking: Shaking, translations: Array) -> Array:
    """Return the covariances (N, 6, 6) of shakes, zero where nothing shakes."""
    return shaking.covariance(translations) if shaking.any else np.zeros((len(translations), 6, 6))


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
    weights = np.where(used[:, None], rightness(track.chains.frames, squared), 0.0)
    spent = float(np.einsum("nij,nji->", track.curvatures[used], spread.poses[used]))
    freedom = 2 * float(weights.sum()) - spent
    return float(np.sqrt((weights * squared).sum() / max(freedom, 1.0)))
