"""Poses from random triplets of points, for views in which many points are wrong.

Triplets are drawn until, with the confidence asked for, one of any pose with more inliers would have had no outlier;
the best poses are settled with their inliers as soon as they are found.
Sources: Torr & Zisserman, MLESAC, 2000 (the truncated error as score, here of pixels linear in the pose); Chum, Matas &
Kittler, Locally Optimized RANSAC, DAGM 2003.
"""

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.estimate.poses import states as se3
from camcal.estimate.poses.inliers import InlierCriterion, RefitPoses, refit_inliers
from camcal.estimate.poses.problem import PoseProblems
from camcal.estimate.poses.records import PoseOptions
from camcal.estimate.poses.starts import poses_of_triplets
from camcal.geometry import rotation as so3

MOST = 20000  # triplets: enough for 93 % of outliers at a confidence of 0.999
_CORNERS = 3  # points of a triplet
_ROUND, _LONG_ROUND = 96, 1024  # triplets drawn at a time
_TOGETHER = 4  # problems whose triplets are solved at once, which stay in the processor's cache
_SCORED = 256  # points that score the poses of triplets; all points score the settled ones
_PROMISING = 4  # poses of a round that are settled
_ROUNDED = 1e-4  # share of a score that rounding may change


def poses_of_samples(
    problems: PoseProblems, which: Array, criterion: InlierCriterion, options: PoseOptions
) -> RefitPoses:
    """Return settled poses of some problems, the lowest few of each.

    options: the confidence that one sample had no outlier, and the seed, the same for every view.
    All problems take turns together: what a fit or a triplet costs in calls, it costs for all of them at once.
    """
    own = problems.take(which)
    searches = [_Search.of(own, problem, criterion, options.seed) for problem in range(len(which))]
    found = refit_inliers(own, np.zeros((0, 3, 4)), np.zeros(0, np.intp), criterion)
    while active := [problem for problem, search in enumerate(searches) if search.drawn < search.needed]:
        parts = []
        for start in range(0, len(active), _TOGETHER):
            together = active[start : start + _TOGETHER]
            states, of = _drawn(own, together, [searches[problem].draw() for problem in together])
            ends = np.searchsorted(of, together, side="right")
            for problem, some in zip(together, np.split(states, ends), strict=False):
                promising = searches[problem].promising(some)
                parts.append((promising, np.full(len(promising), problem)))
        states, of = (np.concatenate(each) for each in zip(*parts, strict=True))
        if not of.size:
            continue
        states = se3.stacked(so3.nearest(states[:, :, :3]), states[:, :, 3])
        found = found.joined(refit_inliers(own, states, of, criterion)).different()
        best = found.take(np.isin(found.which, of)).lowest()
        inliers = np.asarray(sum(mask.sum(axis=1) for mask in best.masks))
        for problem, count in zip(best.which, inliers, strict=True):
            searches[problem].needed = _needed(count, own.counts[problem], options.confidence)
    return found.of(which[found.which])


@dataclass(eq=False)
class _Search:
    """The random triplets of one problem: how many were drawn and are needed, and the lowest score of a pose so far.

    points: indices of those that each camera has. The score of a pose is its truncated error, from some of the points
    where there are many. A point is off by J y / (d · y) to first order, where y is the point in the camera, d its
    pixel's ray and J the derivative of pixels at d, where J d = 0: that is enough to tell what is within the limit, and
    takes one product. factors: (3 N, 13) of the rows of poses and a one, in single precision.
    """

    factors: Array
    limit: np.float32
    rng: np.random.Generator
    points: list[Array]
    best: float = np.inf
    drawn: int = 0
    needed: float = MOST

    @classmethod
    def of(cls, problems: PoseProblems, problem: int, criterion: InlierCriterion, seed: int) -> "_Search":
        rng, points = np.random.default_rng(seed), [np.flatnonzero(mask[problem]) for mask in problems.masks]
        view, factors = problems.view[[problem]], []
        for packed, every in zip(problems.packed_views, points, strict=True):
            some = np.sort(rng.choice(every, _SCORED, replace=False)) if len(every) > _SCORED else every
            chosen = packed.take(view).only(some)
            factors.append(chosen.sight_factors(np.sqrt(chosen.variances()) if criterion.in_pixels else 1.0))
        rows = np.concatenate(factors, axis=1, dtype=np.float32).reshape(-1, factors[0].shape[-1])
        return cls(rows, np.float32(criterion.threshold) ** 2, rng, points)

    def draw(self) -> list[Array]:
        """Return some more triplets (T, 3) of points of each camera."""
        count = int(np.clip(self.needed - self.drawn, _ROUND, _LONG_ROUND)) if self.drawn else _ROUND
        self.drawn += count
        sizes = np.array([len(points) for points in self.points])
        choices = sizes * (sizes - 1.0) * (sizes - 2.0)
        shares = self.rng.multinomial(count, choices / max(choices.sum(), 1.0))
        pairs = zip(self.points, np.where(sizes < _CORNERS, 0, shares).tolist(), strict=True)
        return [_triplets(points, share, self.rng) if share else np.zeros((0, 3), np.intp) for points, share in pairs]

    def promising(self, states: Array) -> Array:
        """Return the few best of states (S, 3, 4), none if an earlier one was better than these."""
        scores = self.scores(states)
        first = np.argsort(scores, kind="stable")[:_PROMISING]
        # the score of a pose that no point supports but the three it was made from
        unsupported = float(self.limit) * (len(self.factors) // 3 - _CORNERS) * (1 - _ROUNDED)
        if not first.size or scores[first[0]] >= min(self.best, unsupported):
            return states[:0]
        self.best = scores[first[0]]
        return states[first[scores[first] < unsupported]]

    def scores(self, states: Array) -> Array:
        """Return the scores (S,) of states (S, 3, 4), the lowest best."""
        rows = np.ones((13, len(states)), np.float32)
        rows[:12] = states.transpose(1, 2, 0).reshape(12, -1)
        with np.errstate(all="ignore"):
            seen = (self.factors @ rows).reshape(3, len(self.factors) // 3, len(states))
            squared, v, depth = seen
            np.maximum(depth, 0.0, out=depth)
            np.square(seen, out=seen)  # in place: new arrays of this size cost more than what is computed
            squared += v
            squared /= depth
            return np.asarray(np.fmin(squared, self.limit, out=squared).sum(axis=0))


def _needed(inliers: int, count: int, confidence: float) -> float:
    """Return how many triplets of `count` points to draw so that of a pose with more inliers, one had no outlier."""
    clean = min(float(np.prod([(inliers + 1 - k) / (count - k) for k in range(_CORNERS)])), 1 - 1e-12)
    return min(float(np.log1p(-confidence) / np.log1p(-clean)), MOST) if clean > 0 else MOST


def _drawn(problems: PoseProblems, which: list[int], triplets: list[list[Array]]) -> tuple[Array, Array]:
    """Return the states (S, 3, 4), frame_T_object, of the triplets of problems, and their problems (S,) in order."""
    parts = []
    for packed, of_camera in zip(problems.packed_views, zip(*triplets, strict=True), strict=True):
        of = np.repeat(which, [len(some) for some in of_camera])
        corners, view = np.concatenate(of_camera).T, problems.view[of]
        rays, points = (each[:, view, corners].transpose(2, 1, 0) for each in (packed.rays, packed.points))
        states, triplet = poses_of_triplets(rays, points)
        parts.append((packed.in_frame(states), of[triplet]))
    if len(parts) == len(which) == 1:
        return parts[0]
    states, of = (np.concatenate(each) for each in zip(*parts, strict=True))
    order = np.argsort(of, kind="stable")
    return states[order], of[order]


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
