"""Tracking on the pixels or the poses of frames: multi-hypothesis filter, batch estimation, search for mirrored poses.

With a bounded look-ahead, a frame's pose is that of the hypothesis that is best so many frames later, smoothed back
along it (Rauch, Tung, Striebel 1965).
"""

from collections.abc import Sequence

import numpy as np

from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.dataclass import dataclass, replace
from camcal.errors import InsufficientData
from camcal.estimate.poses.records import Correspondences
from camcal.estimate.tracking import hypotheses, process_noise
from camcal.estimate.tracking.flips import FAR, search_alternatives
from camcal.estimate.tracking.frames import FrameCosts, PixelFrames
from camcal.estimate.tracking.hypotheses import BEGUN, MEASURED, Candidates, Forward, Hypotheses
from camcal.estimate.tracking.measurements import LEAST, ObjectPlane, PoseMeasurements
from camcal.estimate.tracking.motion import POSE, FreeMotion, MotionState, difference
from camcal.estimate.tracking.pixel_batch import Chains
from camcal.estimate.tracking.process_noise import JitterStd, NoiseFit, ProcessNoise
from camcal.geometry import rotation as so3

_START_TRANSLATION, _START_ROTATION = 0.3, 10.0  # initial value: m²/s³ of an object 1 m away (by its square), rad²/s³
_FEW = 6  # points up to which a frame's squares are summed for the noise; of more the median is taken
_NOISE_RANGE = 0.3, 3.0  # factors by which the noise may be corrected
_ENOUGH = 0.45  # share of right points in a frame that shows the object
_LEAST_NOISE = 1e-2  # px, or of covariances the factor's root: exact pixels have none
_FIRST = 30  # detections that tell how far away the object is
_LEAST_DISTANCE = 1e-6  # m; poses of a camera in its own frame may have none
_NOTED = 0.02  # a correction that is worth it


@dataclass(frozen=True, eq=False)
class PixelTrack:
    """The motion estimated from the pixels of N frames.

    used: (N,) the frames whose pixels count. linked: (N,) whether a frame's motion follows from that before it.
    jerked: (N,) whether the velocity became another at once before it. poses, velocities (N, 6) and covariances (N, 6,
    6) of the poses; p_wrong: (N,) the probability that another pose more than 10° away is the true one.
    contradicted: (N,) whether all frames together say another pose than a bounded look-ahead.
    surprises: (N, 6) whitened innovations of the forward pass, NaN where there are none.
    jitter_std: what shakes single poses. noise: of the motion.
    """

    used: Array
    linked: Array
    jerked: Array
    rotations: Array
    translations: Array
    velocities: Array
    covariances: Array
    p_wrong: Array
    contradicted: Array
    surprises: Array
    jitter_std: JitterStd
    noise: ProcessNoise


def pixel_frames(
    camera: Camera, views: Sequence[Correspondences | None], measurements: PoseMeasurements, noise_px: float | None
) -> tuple[PixelFrames, float]:
    """Return the pixels of frames with a pose, and the standard deviation of a coordinate that they have.

    views: the object's points and pixels in every frame, None where it was not found. noise_px: that standard
    deviation, of covariances the root of their factor; None to estimate it from the poses of single frames.
    """
    seen = [view if there else None for view, there in zip(views, measurements.present, strict=True)]
    frames = PixelFrames.of(camera, seen, 1.0)
    sigma = noise_px or max(_first_noise(frames, _candidates(measurements)), _LEAST_NOISE)
    return frames.with_noise(sigma), sigma


def usual_distance(measurements: PoseMeasurements) -> float:
    """Return the median distance of the object, m, of the first detections: a causal track knows no others.

    Raises InsufficientData if no frame has a pose.
    """
    if not measurements.present.any():
        raise InsufficientData("no detection in any frame")
    distances = np.linalg.norm(measurements.translations[measurements.present, 0][:_FIRST], axis=1)
    return max(float(np.median(distances)), _LEAST_DISTANCE)


def follow_frames(
    frames: FrameCosts,
    measurements: PoseMeasurements,
    flat: ObjectPlane | None,
    *,
    sigma: float | None = None,
    noise: ProcessNoise | None = None,
    lag: int | None = None,
    max_gap: float = 1.0,
) -> PixelTrack:
    """Return the motion of an object in the frame of its poses.

    measurements: the poses of single frames, to start from. flat: the plane of the object. sigma: standard deviation of
    a pixel coordinate that may be corrected, None if that of the frames holds. noise: of the motion, None to find it
    out. lag: frames of look-ahead, None for all.
    """
    distance = usual_distance(measurements)
    run = _Run(frames, _candidates(measurements), measurements.stamps, distance, max_gap, flat)
    motion = FreeMotion(
        (_START_TRANSLATION * distance**2, _START_ROTATION) if noise is None else (noise.translation, noise.rotation)
    )
    tune = noise is None
    first, _ = run.follow(motion, JitterStd(), tune=tune)
    best = process_noise.chosen(first, distance=distance, tune=tune)
    if sigma is not None:
        factor = float(np.clip(process_noise.noise_factor(best.track, best.spread), *_NOISE_RANGE))
        factor = max(factor, _LEAST_NOISE / sigma)
        if abs(factor - 1) > _NOTED:
            run = replace(run, frames=frames.with_noise(factor))
    second, forward = run.follow(best.track.motion, best.jitter_std, tune=tune)
    rivalled = _Path.of(forward, len(run.stamps) - 1).rivalled
    other = run.backwards(second, tune=tune) if rivalled else None
    found, p_wrong = search_alternatives(second, other, flat)
    if lag is None:
        return run.whole(forward, found, p_wrong, noise)
    return run.with_lag(forward, second, found, lag, noise)


def _candidates(measurements: PoseMeasurements) -> Candidates:
    return Candidates(measurements.rotations, measurements.translations, np.isfinite(measurements.penalties))


def _first_noise(frames: PixelFrames, candidates: Candidates) -> float:
    """Return the standard deviation of the pixels from single poses, by medians: some frames and pixels are wrong."""
    from scipy.stats import chi2

    squared = frames.squares(candidates.rotations[:, 0], candidates.translations[:, 0])
    values = []
    for count, row, there in zip(frames.counts, squared, frames.there, strict=True):
        if 4 <= count <= _FEW:
            values.append(float(row.sum()) / chi2.median(2 * int(count) - 6))
        elif count > _FEW:
            values.append(float(np.median(row[there])) / chi2.median(2) * count / (count - 3))
    return float(np.sqrt(np.median(values))) if values else 1.0


@dataclass(frozen=True, eq=False)
class _Run:
    """What is followed: frames (noise 1), candidates, times, usual distance (m), the longest gap (s) and the plane."""

    frames: FrameCosts
    candidates: Candidates
    stamps: Array
    distance: float
    max_gap: float
    flat: ObjectPlane | None

    def follow(self, motion: FreeMotion, jitter_std: JitterStd, *, tune: bool) -> tuple[NoiseFit, Forward]:
        """Return the track that the best hypothesis leads to, from the first detection on."""
        forward = self.forward(motion, jitter_std)
        chains, states = self._chains(forward, motion)
        return process_noise.fit_noise(chains, motion, states, jitter_std, tune=tune), forward

    def forward(self, motion: FreeMotion, jitter_std: JitterStd) -> Forward:
        """Return the hypotheses after each frame."""
        return hypotheses.follow(
            self.frames,
            self.candidates,
            self.stamps,
            motion=motion,
            jitter_std=process_noise.covariance_for(jitter_std, self._places()),
            distance=self.distance,
            max_gap=self.max_gap,
            flat=self.flat,
        )

    def backwards(self, found: NoiseFit, *, tune: bool) -> NoiseFit:
        """Return the track that the frames in reverse lead to, with the noise of another one to begin with.

        A pass that begins with a wrong pose has found the right one by its end.
        """
        chains, count = found.track.chains, len(self.stamps)
        reverse = replace(
            self,
            frames=self.frames.at(np.arange(count)[::-1]),
            candidates=Candidates(*(part[::-1] for part in self.candidates)),
            stamps=-self.stamps[::-1],
        )
        path = _Path.of(reverse.forward(found.track.motion, found.jitter_std), count - 1)
        first, last = count - len(chains.used), count - path.first  # frames with a detection before and after
        states = MotionState(*(part.copy() for part in found.track.states))
        for whole, part in zip(states, path.states, strict=True):
            whole[: last - first] = part[::-1][first:]
        states.rates[: last - first, 0] *= -1
        return process_noise.fit_noise(chains, found.track.motion, states, found.jitter_std, tune=tune)

    def _places(self) -> Array:
        there = self.candidates.there[:, 0]
        return np.where(there[:, None], self.candidates.translations[:, 0], [0.0, 0.0, self.distance])

    def _chains(self, forward: Forward, motion: FreeMotion) -> tuple[Chains, MotionState]:
        path = _Path.of(forward, len(self.stamps) - 1)
        first = path.first
        stamps = self.stamps[first:]
        seen = np.flatnonzero(self.candidates.there[first:, 0])
        restarts = seen[1:][np.diff(stamps[seen]) > self.max_gap]
        starts = np.zeros(len(stamps), dtype=int)
        starts[restarts] = 1
        anchors = np.zeros((len(stamps), motion.size))
        unknown = motion.unknown(self.distance)
        anchors[[0, *restarts]] = 1 / unknown
        chains = Chains(
            self.frames.at(np.arange(first, len(self.stamps))),
            (path.kinds == MEASURED) | (path.kinds == BEGUN),
            steps=np.diff(stamps),
            chains=np.cumsum(starts),
            begun=(path.kinds[1:] == BEGUN) & (starts[1:] == 0),
            unknown=unknown,
            anchors=anchors,
            jitter_std=None,
        )
        return chains, path.states

    def whole(self, forward: Forward, found: NoiseFit, p_wrong: Array, noise: ProcessNoise | None) -> PixelTrack:
        """Return the estimate from all frames together."""
        track, chains = found.track, found.track.chains
        path = _Path.of(forward, len(self.stamps) - 1)
        rotations, translations = track.poses
        states = track.states._replace(rotations=rotations, translations=translations)
        right = chains.frames.inlier_probabilities(chains.frames.squares(rotations, translations)).sum(axis=1)
        used = chains.used & (right > _ENOUGH * chains.frames.there.sum(axis=1))
        parts = (used, states, found.spread.poses, p_wrong, np.zeros(len(used), dtype=bool), path.surprises)
        return self._given(found, parts, noise)

    def with_lag(
        self, forward: Forward, found: NoiseFit, whole: NoiseFit, lag: int, noise: ProcessNoise | None
    ) -> PixelTrack:
        """Return the estimate of each frame from the frames up to `lag` later ones."""
        states, covariances, p_wrong = look_ahead(forward, lag, FAR, self.frames.overstated_ahead)
        path = _Path.of(forward, len(self.stamps) - 1)
        known = forward[path.first :]
        kinds = np.array([MEASURED if each is None else int(each.kinds[np.argmin(each.costs)]) for each in known])
        shakes = process_noise.covariance_for(found.jitter_std, states.translations)
        used = (kinds == MEASURED) | (kinds == BEGUN)
        apart = so3.angle_between(states.rotations, whole.track.poses[0]) > FAR
        parts = (used, states, covariances[:, POSE, POSE] + shakes, p_wrong, apart, path.surprises)
        return self._given(found, parts, noise)

    def _given(
        self,
        found: NoiseFit,
        parts: tuple[Array, MotionState, Array, Array, Array, Array],
        noise: ProcessNoise | None,
    ) -> PixelTrack:
        """Return a track from what is known of its frames: in the order of the fields."""
        used, states, covariances, p_wrong, contradicted, surprises = parts
        first = len(self.stamps) - len(used)
        chains, motion = found.track.chains, found.track.motion
        translation, rotation = map(float, motion.densities)
        return PixelTrack(
            _padded(used, first),
            _padded(np.concatenate([[False], chains.linked]), first),
            jerked=_padded(np.concatenate([[False], chains.begun]), first),
            rotations=_padded(states.rotations, first),
            translations=_padded(states.translations, first),
            velocities=_padded(states.rates[:, 0], first),
            covariances=_padded(covariances, first),
            p_wrong=_padded(p_wrong, first),
            contradicted=_padded(contradicted, first),
            surprises=_padded(surprises, first),
            jitter_std=found.jitter_std,
            noise=noise
            or ProcessNoise(
                translation, rotation, process_noise.density_factors(found.track, found.spread), motion.fading
            ),
        )


def _padded(part: Array, first: int) -> Array:
    """Return values of all frames from those after the first detection."""
    if part.dtype == bool:
        return np.concatenate([np.zeros(first, dtype=bool), part])
    return np.concatenate([np.full((first, *part.shape[1:]), np.nan), part])


@dataclass(frozen=True, eq=False)
class _Path:
    """The course of the best hypothesis: what was known at M frames, from the first one on, and which led to it."""

    first: int
    known: list[tuple[Hypotheses, int]]

    @classmethod
    def of(cls, forward: Forward, last: int) -> "_Path":
        known: list[tuple[Hypotheses, int]] = []
        while last >= 0 and (here := forward[last]) is not None:
            which = int(known[-1][0].parents[known[-1][1]]) if known else int(np.argmin(here.costs))
            known.append((here, which))
            last -= 1
        return cls(last + 1, known[::-1])

    @property
    def states(self) -> MotionState:
        """The states (M), smoothed back."""
        return _smoothed(self.known)

    @property
    def kinds(self) -> Array:
        """What the frames (M) were to it."""
        return np.array([each.kinds[which] for each, which in self.known])

    @property
    def surprises(self) -> Array:
        """The whitened innovations (M, 6)."""
        return np.array([each.surprises[which] for each, which in self.known])

    @property
    def rivalled(self) -> bool:
        """Whether another pose was likely in more than a few frames: then it may have been given up too early."""
        frames = 0
        for each, which in self.known:
            if len(each.costs) > 1:
                rotations = each.states.rotations
                frames += bool((so3.angle_between(rotations, rotations[which]) > FAR).any())
        return frames >= LEAST


def _smoothed(known: list[tuple[Hypotheses, int]]) -> MotionState:
    """Return the states (M) of a hypothesis and those that it stems from, smoothed back."""
    filtered, spread, expected, expected_spread, growth = (
        [part.at(which) if isinstance(part, MotionState) else part[which] for part, which in parts]
        for parts in zip(
            *([(each, which) for each in (one.states, one.covariances, *one[3:6])] for one, which in known),
            strict=True,
        )
    )
    gains = _gains(np.array(spread[:-1]), np.array(expected_spread[1:]), np.array(growth[1:]))
    states = filtered[-1:]
    for state, gain, forecast in zip(filtered[-2::-1], gains[::-1], expected[:0:-1], strict=True):
        states.append(state.moved(gain @ difference(states[-1], forecast)))
    return MotionState(*map(np.stack, zip(*states[::-1], strict=True)))


def _gains(spread: Array, expected_spread: Array, growth: Array) -> Array:
    """Return by how much (..., S, S) states move with what is learnt of the next ones, 0 where nothing links them."""
    return np.asarray(np.linalg.solve(expected_spread, growth @ spread).swapaxes(-1, -2))


def look_ahead(forward: Forward, lag: int, far: float, overstated: float) -> tuple[MotionState, Array, Array]:
    """Return the states (M), covariances (M, S, S) and chances (M) that another pose holds, from the first detection.

    far: angle (rad) from which on a pose is another one. overstated: by how much differences of costs are too large.
    """
    known = [hypotheses for hypotheses in forward if hypotheses is not None]
    last = len(known) - 1
    frames = np.arange(last + 1)
    newest = np.minimum(frames + lag, last)
    chosen = np.array([int(np.argmin(known[frame].costs)) for frame in newest])
    states, covariances = _gathered(known, newest, chosen, "states", "covariances")
    at = newest.copy()
    which = chosen.copy()
    while (going := at > frames).any():
        rows = np.flatnonzero(going)
        later, index = at[rows], which[rows]
        expected, expected_spread = _gathered(known, later, index, "forecasts", "forecast_covariances")
        growth = np.array([known[frame].transitions[one] for frame, one in zip(later, index, strict=True)])
        which[rows] = [int(known[frame].parents[one]) for frame, one in zip(later, index, strict=True)]
        at[rows] -= 1
        filtered, spread = _gathered(known, at[rows], which[rows], "states", "covariances")
        gain = _gains(spread, expected_spread, growth)
        step = (gain @ difference(states.at(rows), expected)[..., None])[..., 0]
        after = spread + gain @ (covariances[rows] - expected_spread) @ gain.swapaxes(-1, -2)
        for whole, part in zip(states, filtered.moved(step), strict=True):
            whole[rows] = part
        covariances[rows] = (after + after.swapaxes(-1, -2)) / 2
    return states, covariances, _wrong(known, newest, states.rotations, far, overstated)


def _gathered(
    known: list[Hypotheses], frames: Array, which: Array, states: str, covariances: str
) -> tuple[MotionState, Array]:
    """Return one hypothesis of each of some frames."""
    pairs = list(zip(frames, which, strict=True))
    chosen = [getattr(known[frame], states).at(one) for frame, one in pairs]
    spread = np.array([getattr(known[frame], covariances)[one] for frame, one in pairs])
    return MotionState(*map(np.stack, zip(*chosen, strict=True))), spread


def _wrong(known: list[Hypotheses], newest: Array, rotations: Array, far: float, overstated: float) -> Array:
    """Return the weight (M) of the hypotheses at the newest frames that were at another pose."""
    result = np.zeros(len(newest))
    for frame, last in enumerate(newest):
        hypotheses = known[last]
        if len(hypotheses.costs) == 1:
            continue
        weights = np.exp(-(hypotheses.costs - hypotheses.costs.min()) / (2 * overstated))
        which = np.arange(len(weights))
        for back in range(last, frame, -1):
            which = known[back].parents[which]
        apart = so3.angle_between(known[frame].states.rotations[which], rotations[frame]) > far
        result[frame] = weights[apart].sum() / weights.sum()
    return result
