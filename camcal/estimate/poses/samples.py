"""Poses from random triplets of points, for views in which many points are wrong.

Triplets are drawn until, with the confidence asked for, one had no outlier; the best poses are settled with their
inliers as soon as they are found. Sources: Torr & Zisserman, MLESAC, 2000 (the truncated error as score, here from
pixels through the lens); Chum, Matas & Kittler, Locally Optimized RANSAC, DAGM 2003.
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.estimate.poses import states as se3
from camcal.estimate.poses.inliers import Agreement, Settled, settle
from camcal.estimate.poses.problem import PoseProblems
from camcal.estimate.poses.sightings import Sightings
from camcal.estimate.poses.three_points import poses_of_triplets
from camcal.geometry import rotation as so3

MOST = 20000  # triplets: enough for 93 % of outliers at a confidence of 0.999
_CORNERS = 3  # points of a triplet
_ROUND, _LONG_ROUND = 96, 1024  # triplets drawn at a time
_SCORED = 256  # points that score the poses of triplets; all points score the settled ones
_PROMISING = 4  # poses of a round that are settled


@dataclass(frozen=True)
class Sampling:
    """How samples are drawn: confidence that one had no outlier; seed, the same for every view."""

    confidence: float
    seed: int


def sampled(problems: PoseProblems, problem: int, agreement: Agreement, sampling: Sampling) -> Settled:
    """Return settled poses of one problem, the lowest few."""
    own = problems.take(np.array([problem]))
    rng = np.random.default_rng(sampling.seed)
    scorer = _Scorer.of(own, agreement, rng)
    found = settle(own, np.zeros((0, 3, 4)), np.zeros(0, np.intp), agreement)
    best, drawn, needed = np.inf, 0, float(_ROUND)
    while drawn < min(needed, MOST):
        batch = int(np.clip(needed - drawn, _ROUND, _LONG_ROUND))
        states = _drawn(own, batch, rng)
        drawn += batch
        scores = scorer.scores(states)
        promising = np.argsort(scores, kind="stable")[:_PROMISING]
        if not promising.size or scores[promising[0]] >= best:
            needed = float(MOST) if np.isinf(best) else needed
            continue
        best = scores[promising[0]]
        chosen = se3.stacked(so3.nearest(states[promising, :, :3]), states[promising, :, 3])
        found = found.joined(settle(own, chosen, np.zeros(len(chosen), np.intp), agreement)).different()
        needed = _needed(found, int(own.counts[0]), sampling.confidence)
    return Settled(found.states, np.full(len(found.which), problem), found.masks, found.truncated)


def _needed(found: Settled, count: int, confidence: float) -> float:
    """Return how many triplets to draw so that one had no outlier, if the inliers are those of the best pose."""
    if not len(found.which):
        return float(MOST)
    inliers = sum(int(mask[0].sum()) for mask in found.masks)
    shares = [(inliers - k) / (count - k) for k in range(3)]
    clean = min(float(np.prod(shares)), 1 - 1e-12)
    return float(np.log1p(-confidence) / np.log1p(-clean)) if clean > 0 else float(MOST)


def _drawn(problems: PoseProblems, count: int, rng: np.random.Generator) -> Array:
    """Return the states (S, 3, 4), frame_T_object, of `count` random triplets of points of one camera each."""
    found, view = [np.zeros((0, 3, 4))], int(problems.view[0])
    sizes = np.array([mask[0].sum() for mask in problems.masks])
    choices = sizes * (sizes - 1.0) * (sizes - 2.0)
    shares = rng.multinomial(count, choices / max(choices.sum(), 1.0))
    for sight, mask, share in zip(problems.sights, problems.masks, shares, strict=True):
        points = np.flatnonzero(mask[0])
        if share and len(points) >= _CORNERS:
            found.append(_of_one_camera(sight, view, _triplets(points, int(share), rng)))
    return np.concatenate(found)


def _of_one_camera(sight: Sightings, view: int, triplets: Array) -> Array:
    rays, points = (each[:, view][:, triplets].transpose(1, 2, 0) for each in (sight.rays, sight.points))
    states, _ = poses_of_triplets(rays, points)
    return se3.compose(sight.inverse_frame, states)


def _triplets(points: Array, count: int, rng: np.random.Generator) -> Array:
    """Return `count` triplets (T, 3) of different points (N,)."""
    first = rng.integers(len(points), size=count)
    second = rng.integers(len(points) - 1, size=count)
    third = rng.integers(len(points) - 2, size=count)
    second += second >= first
    low, high = np.minimum(first, second), np.maximum(first, second)
    third += third >= low
    third += third >= high
    return np.asarray(points[np.stack([first, second, third], axis=1)])


@dataclass(frozen=True, eq=False)
class _Scorer:
    """The truncated error of many poses of one view, from some of its points where there are many."""

    problems: PoseProblems
    agreement: Agreement

    @classmethod
    def of(cls, problems: PoseProblems, agreement: Agreement, rng: np.random.Generator) -> "_Scorer":
        view = int(problems.view[0])
        sights = []
        for sight, mask in zip(problems.sights, problems.masks, strict=True):
            points = np.flatnonzero(mask[0])
            if len(points) > _SCORED:
                points = np.sort(rng.choice(points, _SCORED, replace=False))
            sights.append(sight.take(np.array([view])).only(points))
        chosen = PoseProblems.of(tuple(sights))
        return cls(chosen, agreement)

    def scores(self, states: Array) -> Array:
        """Return the scores (S,) of states (S, 3, 4), the lowest best."""
        which, limit = np.zeros(len(states), np.intp), self.agreement.threshold**2
        squared = self.agreement.squared(self.problems, states, which)
        return np.asarray(sum(np.minimum(each, limit).sum(axis=1) for each in squared))
