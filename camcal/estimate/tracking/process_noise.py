"""How strongly a motion accelerates: the densities of white noise that make its own innovations likeliest.

The likelihood is that of the filter, each frame's part bounded by that of an outlier. Candidates of the densities are
tried side by side, and so are stretches of the track.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.estimate.tracking import pose_filter
from camcal.estimate.tracking.measurements import PoseMeasurements
from camcal.estimate.tracking.pose_filter import Belief, Candidates
from camcal.estimate.tracking.segments import LEAST, Following, Segment, candidates_at, follow

_STRETCH = 60  # frames; the first of each tells little
_STRETCHES = 16  # that are looked at, spread evenly
_SPACINGS = (1.0, 0.25)  # decades between the densities tried: a first guess may lose the track, and is corrected
_FINEST, _ROUNDS = 0.25, 40
_UNKNOWN = 10.0  # decades: the likelihood is flat
_NOTICEABLE = 0.05  # of -2 log likelihood: less is no reason to go on towards no noise at all
_START_ROTATION = 1.0  # rad²/s³: a hand moves so
_START_TRANSLATION = 0.1  # 1/s³, of the squared distance
_AROUND = np.array([(0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)], dtype=float)


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
    def densities(self) -> Array:
        """Both as (2,)."""
        return np.array([self.translation, self.rotation])


class _Stretches(NamedTuple):
    """Stretches of a track side by side: beliefs (S, 1, …) at their starts, then time steps (S, 1) s and candidates."""

    starts: Belief
    steps: list[Array]
    seen: list[Candidates]
    outlier_cost: float


def tuned(measurements: PoseMeasurements, following: Following) -> ProcessNoise:
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
    """Return the stretches of the pieces, as many as are looked at; None if there are none."""
    cuts = [cut for segment in segments for cut in _cut(segment)]
    if not cuts:
        return None
    chosen = [cuts[index] for index in np.unique(np.linspace(0, len(cuts) - 1, _STRETCHES).astype(int))]
    starts = Belief(*map(np.stack, zip(*(start for start, _ in chosen), strict=True)))
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


def _cut(segment: Segment) -> list[tuple[Belief, Array]]:
    """Return the stretches of a piece: what was believed at the first frame, and the indices of all."""
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
