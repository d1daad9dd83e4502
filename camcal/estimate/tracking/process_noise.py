"""Process noise and vibration from the evidence of a track: MacKay's rule, and the choice between models; jitter.

Jitter is what is left of each pose when its two neighbours have predicted it. Shakes have three independent causes: the
camera turns about its own centre, the object is shifted, the object is turned. Each has a variance that all frames
share.
"""

import numpy as np

from camcal.arrays import Array, FloatArray
from camcal.dataclass import dataclass, replace
from camcal.errors import InvalidInput
from camcal.estimate.tracking.motion import FreeMotion, MotionState, difference
from camcal.estimate.tracking.pixel_batch import BatchTrack, Chains, Spread, solve, spread_of
from camcal.geometry import rotation as so3

_START = 2e-3  # rad, or share of the distance: initial value
_STRIDE = 1.5  # exponent of a step: the plain rule creeps


@dataclass(frozen=True)
class Jitter:
    """Root mean square of the noise of a pose: translation in m, rotation in rad; NaN for fewer than three poses."""

    translation: float
    rotation: float


def jitter(stamps: Array, rotations: Array, translations: Array, chains: Array) -> Jitter:
    """Return the jitter of poses.

    stamps: (N,) s. rotations: (N, 3, 3). translations: (N, 3), m. chains: (N,) poses of one number belong together.
    A pose between two others is compared with the point between them at its time; white noise of standard deviation σ
    gives σ, a smooth motion next to nothing.
    """
    inner = np.flatnonzero((chains[2:] == chains[1:-1]) & (chains[1:-1] == chains[:-2])) + 1
    if not len(inner):
        return Jitter(float("nan"), float("nan"))
    before, after = inner - 1, inner + 1
    share = ((stamps[inner] - stamps[before]) / (stamps[after] - stamps[before]))[:, None]
    between = translations[before] + share * (translations[after] - translations[before])
    turn = so3.log(rotations[after] @ rotations[before].swapaxes(-1, -2))
    halfway = so3.exp(share * turn) @ rotations[before]
    scale = np.sqrt(1 + share**2 + (1 - share) ** 2)
    shifts = (translations[inner] - between) / scale
    turns = so3.log(rotations[inner] @ halfway.swapaxes(-1, -2)) / scale
    return Jitter(*(float(np.sqrt(np.mean(np.sum(each**2, axis=1)))) for each in (shifts, turns)))


@dataclass(frozen=True)
class JitterStd:
    """Standard deviations of shakes: camera_turn (rad), object_shift (m), object_turn (rad), all per axis."""

    camera_turn: float = 0.0
    object_shift: float = 0.0
    object_turn: float = 0.0

    @classmethod
    def guess(cls, distance: float) -> "JitterStd":
        """Return an initial value for an object that is so far (m) away."""
        return cls(_START, _START * distance / 3, _START)

    @property
    def any(self) -> bool:
        """Whether anything shakes."""
        return max(self.camera_turn, self.object_shift, self.object_turn) > 0

    def covariance(self, translations: Array) -> FloatArray:
        """Return the covariances (N, 6, 6) of the shakes of poses; translations: (N, 3) m."""
        return np.asarray(sum(self._parts(translations)))

    def _parts(self, translations: Array) -> list[Array]:
        arm = np.concatenate([-so3.hat(translations), np.tile(np.eye(3), (len(translations), 1, 1))], axis=1)
        shift, turn = np.zeros((6, 6)), np.zeros((6, 6))
        shift[:3, :3] = turn[3:, 3:] = np.eye(3)
        every = np.ones((len(translations), 1, 1))
        return [
            self.camera_turn**2 * arm @ arm.swapaxes(-1, -2),
            self.object_shift**2 * shift * every,
            self.object_turn**2 * turn * every,
        ]

    def likelier(self, translations: Array, pulls: Array, informed: Array) -> "JitterStd":
        """Return the shaking of the next step to the highest evidence.

        pulls: (N, 6), Σ⁻¹ times the shakes as they were found. informed: (N, 6, 6) of `Spread`. MacKay's rule for one
        variance, cause by cause: σ² ← σ² Σ jᵀ Σ⁻¹ Σᵢ Σ⁻¹ j / Σ tr Σᵢ (H' - H' C H'), Σᵢ the cause's part of Σ.
        """
        result = []
        for name, part in zip(("camera_turn", "object_shift", "object_turn"), self._parts(translations), strict=True):
            squares = float(np.einsum("ni,nij,nj->", pulls, part, pulls))
            known = float(np.einsum("nij,nji->", informed, part))
            factor = squares / max(known, 0.05 * squares, 1e-12)
            result.append(getattr(self, name) * float(np.clip(factor**_STRIDE, 0.02, 20.0)) ** 0.5)
        return JitterStd(*result)


FADING = 0.3  # s, in which accelerations fade
_ROUNDS = 12
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
) -> NoiseFit:
    """Return the track with the densities and shaking at the highest evidence, from given ones on.

    tune: whether densities may change; what does not shake at the beginning never does.
    """
    chains = _shaken(chains, states, jitter_std)
    track = solve(chains, motion, states)
    best = NoiseFit(track, spread_of(track), jitter_std)
    for _ in range(_ROUNDS):
        track, jitter_std = best.track, best.jitter_std
        if tune and (chains.linked & ~chains.begun).any():
            motion = replace(motion, densities=tuned_densities(track, best.spread))
        elif not jitter_std.any:
            break
        if jitter_std.any:
            used = chains.used
            places = track.states.translations[used]
            jitter_std = jitter_std.likelier(places, track.pulls[used], best.spread.informed[used])
            chains = _shaken(chains, track.states, jitter_std)
        track = solve(chains, motion, track.states, _STEPS, track.pulls)
        if float(track.evidence.sum()) > best.evidence:  # pixels that fit were given up: the start may lead elsewhere
            track = solve(chains, motion, states)
        before, found = best.evidence, NoiseFit(track, spread_of(track), jitter_std)
        best = min(best, found, key=lambda each: each.evidence)
        if best.evidence > before - _SETTLED:
            break
    return best


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
        tried = fit_noise(track.chains, track.motion, track.states, guess, tune=tune)
        if tried.evidence < best.evidence - _BETTER:
            best = _simpler(tried, tune=tune)
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
    densities = [
        density * float(np.clip(squares / max(known, 1e-3 * squares, 1e-12), 0.05, 20.0))
        for density, (squares, known) in zip(track.motion.densities, _process_noise_seen(track, spread), strict=True)
    ]
    return densities[0], densities[1]


def density_factors(track: BatchTrack, spread: Spread) -> tuple[float, float]:
    """Return by which factors the densities may be off (one standard deviation): exp √(2 / (n - tr Q⁻¹ Cov e))."""
    first, second = (float(np.exp(np.sqrt(2 / max(known, 0.1)))) for _, known in _process_noise_seen(track, spread))
    return first, second


def _process_noise_seen(track: BatchTrack, spread: Spread) -> list[tuple[float, float]]:
    """Return eᵀQ⁻¹e and n - tr Q⁻¹ Cov e of translation and rotation: the squared noise, and what is known of it."""
    chains, motion = track.chains, track.motion
    regular = chains.linked & ~chains.begun
    information = motion.information(np.where(regular, chains.steps, 1.0))
    forecast, growth = motion.forecast(track.states.at(slice(None, -1)), chains.steps)
    off = difference(track.states.at(slice(1, None)), forecast)
    crossed = growth @ spread.beside
    unsure = spread.states[1:] + growth @ spread.states[:-1] @ growth.swapaxes(-1, -2)
    unsure -= crossed + crossed.swapaxes(-1, -2)
    result = []
    for axis in range(2):
        part = np.concatenate([6 * order + 3 * axis + np.arange(3) for order in range(motion.order + 1)])
        inner = information[regular][:, part[:, None], part]
        squares = float(np.einsum("ni,nij,nj->", off[regular][:, part], inner, off[regular][:, part]))
        known = inner.shape[0] * len(part) - float((inner * unsure[regular][:, part[:, None], part]).sum())
        result.append((squares, known))
    return result


def noise_factor(track: BatchTrack, spread: Spread) -> float:
    """Return by how much the pixels' standard deviations are too small, from the residuals of right pixels."""
    used = track.chains.used
    squared = track.chains.frames.squares(*track.poses)
    weights = np.where(used[:, None], track.chains.frames.inlier_probabilities(squared), 0.0)
    spent = float(np.einsum("nij,nji->", track.curvatures[used], spread.poses[used]))
    dof = track.chains.frames.coordinates * float(weights.sum()) - spent
    return float(np.sqrt((weights * squared).sum() / max(dof, 1.0)))
