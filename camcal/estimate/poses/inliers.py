"""Robust poses: alternating inlier selection and refinement until both are consistent.

For views in which many points are wrong, the first poses come from random triplets of points. Triplets are drawn until,
with the confidence asked for, one had no outlier; the best poses are settled with their inliers as soon as they are
found. Sources: Torr & Zisserman, MLESAC, 2000 (the truncated error as score, here from pixels through the lens); Chum,
Matas & Kittler, Locally Optimized RANSAC, DAGM 2003.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from camcal.arrays import Array
from camcal.estimate.poses import states as se3
from camcal.estimate.poses.moments import inverses
from camcal.estimate.poses.problem import PoseProblems, different, distinct, firsts, lowest
from camcal.estimate.poses.starts import poses_of_triplets
from camcal.estimate.poses.states import NEAR_PLANE, Extents
from camcal.geometry import rotation as so3
from camcal.solve.independent import Minima

_TURNS = 30  # each lowers the truncated cost, so that none comes twice
_KEPT = 4
_SAME = 1e-3
# Of the lengths of pixels' errors with σ = 1, whose squares are χ² with two degrees of freedom:
WIDTH = 3.4391  # what 99.73 % stay below, as a single coordinate stays below 3 σ
MEDIAN = 1.38629  # of the squares
KEPT_VARIANCE = 0.98399  # that of what stays below WIDTH

# The largest squared residuals (S, 1) of inliers, by those (S, N) of all points, and the starts (S,) they are of
Limits = Callable[[Array, Array], Array]

# random samples
MOST = 20000  # triplets: enough for 93 % of outliers at a confidence of 0.999
_CORNERS = 3  # points of a triplet
_ROUND, _LONG_ROUND = 96, 1024  # triplets drawn at a time
_TOGETHER = 4  # problems whose triplets are solved at once, which stay in the processor's cache
_SCORED = 256  # points that score the poses of triplets; all points score the settled ones
_PROMISING = 4  # poses of a round that are settled
_ROUNDED = 1e-4  # share of a score that rounding may change


@dataclass(frozen=True)
class InlierCriterion:
    """When points agree with a pose: threshold, the largest residual, whitened or in px; least, how many it takes.

    threshold: of all problems, or (P,) of each. whole: problems of fewer points keep all of them, as too few to tell a
    wrong one.
    """

    threshold: float | Array
    least: int
    whole: int = 0
    in_pixels: bool = False

    def squared(self, problems: PoseProblems, states: Array, which: Array) -> tuple[Array, ...]:
        """Return the squared residuals (S, N) that the threshold is for, as `PoseProblems.squared`."""
        found = problems.squared(states, which)
        if not self.in_pixels:
            return found
        pairs = zip(found, problems.packed_views, strict=True)
        return tuple(squared * packed.variances()[problems.view[which]] for squared, packed in pairs)

    def limits(self, problems: PoseProblems, which: Array) -> Array:
        """Return the largest squared residuals (S, 1) of inliers of problems (S,)."""
        limits = np.broadcast_to(np.square(self.threshold), len(problems.view))[which]
        return np.where(problems.counts[which] < self.whole, np.inf, limits)[:, None]


@dataclass(frozen=True, eq=False)
class RefitPoses:
    """Poses (S, 3, 4) that fit the points of their masks, (S, N) a camera, and no others are within the threshold.

    which: (S,) the problems. truncated: (S,) ½ Σ min(r², threshold²), infinite with too few points.
    """

    states: Array
    which: Array
    masks: tuple[Array, ...]
    truncated: Array

    def take(self, chosen: Array) -> "RefitPoses":
        """Return some of the poses."""
        masks = tuple(mask[chosen] for mask in self.masks)
        return RefitPoses(self.states[chosen], self.which[chosen], masks, self.truncated[chosen])

    def of(self, which: Array) -> "RefitPoses":
        """Return the same as poses of other problems (S,)."""
        return replace(self, which=which)

    def different(self) -> "RefitPoses":
        """Return the lowest few without repetitions, in the order of the problems and the lowest first."""
        sound = self.take(np.isfinite(self.truncated))
        return sound.take(distinct(sound.states, sound.which, sound.truncated, _SAME, _KEPT))

    def joined(self, other: "RefitPoses") -> "RefitPoses":
        """Return the poses of both."""
        masks = tuple(np.concatenate(pair) for pair in zip(self.masks, other.masks, strict=True))
        parts = ((self.states, other.states), (self.which, other.which), (self.truncated, other.truncated))
        states, which, truncated = (np.concatenate(pair) for pair in parts)
        return RefitPoses(states, which, masks, truncated)

    def lowest(self) -> "RefitPoses":
        """Return the first of each problem, of poses in the order of `different`."""
        return self.take(firsts(self.which))


def refit_inliers(problems: PoseProblems, states: Array, which: Array, criterion: InlierCriterion) -> RefitPoses:
    """Return where starts (S, 3, 4) of problems (S,) settle with their inliers."""
    if not which.size:
        return RefitPoses(
            states, which, tuple(np.zeros((0, mask.shape[1]), bool) for mask in problems.masks), np.zeros(0)
        )
    limits = criterion.limits(problems, which)
    # a start of three points is not near enough for all
    masks = _below(problems, states, which, 4 * limits, criterion)
    states, masks, squares = _in_turns(problems, states, which, masks, lambda _, chosen: limits[chosen], criterion)
    truncated = _truncated(problems, states, which, squares, limits)
    enough = np.asarray(sum(mask.sum(axis=1) for mask in masks)) >= criterion.least
    return RefitPoses(states, which, masks, np.where(enough, truncated, np.inf))


def likeliest_threshold(problems: PoseProblems, masks: tuple[Array, ...], areas: Array, sigma: float) -> Array:
    """Return the whitened residual (P,) up to which a point is more likely right than wrong.

    That is d² = 2 ln[A (1 - ε) / (2π σ² ε)]: wrong pixels are anywhere in areas A (P,), px², and their share ε is that
    of the points outside the masks. sigma: standard deviation of a whitened coordinate.
    """
    inliers, variance = np.zeros(len(areas)), np.zeros(len(areas))
    for packed, mask, every in zip(problems.packed_views, masks, problems.masks, strict=True):
        inliers += mask.sum(axis=1)
        variance += np.where(every, packed.variances()[problems.view], 0.0).sum(axis=1)
    # as if half a point more of either kind had been seen: none is certain
    odds = (inliers + 0.5) / (np.maximum(problems.counts - inliers, 0) + 0.5)
    typical = sigma**2 * variance / np.maximum(problems.counts, 1)
    with np.errstate(divide="ignore"):
        squared = 2 * (np.log(areas) + np.log(odds) - np.log(2 * np.pi * typical))
    return np.asarray(sigma * np.sqrt(np.maximum(squared, WIDTH**2)))


def squared_as_new(problems: PoseProblems, minima: Minima, sigma: float) -> tuple[Array, ...]:
    """Return rᵀ S⁻¹ r + σ² ln |S| (S, N) of whitened residuals r of all points of the problems, for every camera.

    σ² S is the covariance of r at a right point that the pose was not fitted to, S = I + J H⁻¹ Jᵀ; compared with the
    limit of the likeliest threshold, the sum tells whether the point is one. sigma: of a whitened coordinate.
    """
    found, inverse = [], inverses(minima.models.normal)
    for packed, mask in zip(problems.packed_views, problems.masks, strict=True):
        rows, _, _ = packed.rows(minima.states, problems.view[minima.which], mask[minima.which])
        moves, (u, v) = rows[:, :6], rows[:, 6]
        spread = np.einsum("ipsn,spq,jqsn->ijsn", moves, inverse, moves, optimize=True)
        first, both, last = 1 + spread[0, 0], spread[0, 1], 1 + spread[1, 1]
        determinant = first * last - both * both
        squared = (last * u * u - 2 * both * u * v + first * v * v) / determinant + sigma**2 * np.log(determinant)
        found.append(np.where(mask[minima.which], np.nan_to_num(squared, nan=np.inf), np.inf))
    return tuple(found)


def trimmed_refit(problems: PoseProblems, states: Array, which: Array, criterion: InlierCriterion) -> Array:
    """Return starts (S, 3, 4) freed of a few wrong points, which lift all residuals of a plain fit over the threshold.

    What counts as wrong follows the median of each problem's residuals, down to the threshold.
    """
    least = criterion.limits(problems, which)

    def limits(squared: Array, chosen: Array) -> Array:
        seen = np.where(np.isfinite(squared), squared, np.nan)
        return np.asarray(np.maximum(least[chosen], WIDTH**2 / MEDIAN * np.nanmedian(seen, axis=1, keepdims=True)))

    squared = np.concatenate(criterion.squared(problems, states, which), axis=1)
    masks = _below(problems, states, which, limits(squared, np.arange(len(which))), criterion)
    return _in_turns(problems, states, which, masks, limits, criterion)[0]


def truncated_cost(
    problems: PoseProblems,
    states: Array,
    which: Array,
    criterion: InlierCriterion,
    squares: tuple[Array, ...] | None = None,
) -> Array:
    """Return ½ Σ min(r², limit) (S,) of all points of the problems; squares: their r² (S, N), where known."""
    if squares is None:
        squares = criterion.squared(problems, states, which)
    return _truncated(problems, states, which, squares, criterion.limits(problems, which))


def _truncated(problems: PoseProblems, states: Array, which: Array, squares: tuple[Array, ...], limits: Array) -> Array:
    total = np.zeros(len(which))
    for squared, mask in zip(squares, problems.masks, strict=True):
        total += 0.5 * np.where(mask[which], np.minimum(squared, limits), 0.0).sum(axis=1)
    return total if problems.anchor is None else total + problems.anchor.models(states, problems.view[which]).cost


def _in_turns(
    problems: PoseProblems,
    states: Array,
    which: Array,
    masks: tuple[Array, ...],
    limits: Limits,
    criterion: InlierCriterion,
) -> tuple[Array, tuple[Array, ...], tuple[Array, ...]]:
    """Return states (S, 3, 4), masks and squared residuals (S, N) after fits to the masks and new masks by the fits,
    until these stay.
    """
    states, unsettled = states.copy(), np.arange(len(which))
    squares = tuple(np.empty(mask.shape) for mask in masks)
    for _ in range(_TURNS):
        here = which[unsettled]
        own = problems.take(here).masked(tuple(mask[unsettled] for mask in masks))
        states[unsettled] = own.minimise(states[unsettled], np.arange(len(here)), rough=True).states
        squared = criterion.squared(problems, states[unsettled], here)
        most, changed = limits(np.concatenate(squared, axis=1), unsettled), np.zeros(len(here), dtype=bool)
        for mask, every, each, kept in zip(masks, problems.masks, squared, squares, strict=True):
            kept[unsettled] = each
            new = _agreeing(each, most) & every[here]
            changed |= np.any(new != mask[unsettled], axis=1)
            mask[unsettled] = new
        unsettled = unsettled[changed]
        if not unsettled.size:
            break
    return states, masks, squares


def _below(
    problems: PoseProblems, states: Array, which: Array, limits: Array, criterion: InlierCriterion
) -> tuple[Array, ...]:
    """Return the masks (S, N) of points of the problems whose squared residuals keep to the limits (S, 1)."""
    parts = zip(criterion.squared(problems, states, which), problems.masks, strict=True)
    return tuple(_agreeing(squared, limits) & mask[which] for squared, mask in parts)


def _agreeing(squared: Array, limits: Array) -> Array:
    return np.asarray((squared <= limits) & np.isfinite(squared))


def choose(
    problems: PoseProblems, found: RefitPoses, extents: Extents, criterion: InlierCriterion
) -> tuple[PoseProblems, Minima]:
    """Return the problems of the inliers of the lowest poses, and their minima, that pose the lowest of each.

    The pose that a plane is mistaken for competes as well. A problem for which nothing was found has no minima.
    """
    best = found.different().lowest()
    best = best.take(extents.flatness[problems.view[best.which]] < NEAR_PLANE)
    eye = problems.packed_views[0].eye
    mirrored = extents.reflected(best.states, problems.view[best.which], eye)
    rivals = _supported(problems, mirrored, best, criterion)
    found = found.joined(refit_inliers(problems, mirrored[rivals], best.which[rivals], criterion)).different()
    for _ in range(_TURNS):
        own, minima = _on_best(problems, found, mirrored, best.which)
        ahead = minima.take(lowest(minima))
        overtaken = ahead.take(~se3.near(ahead.states, found.lowest().states, _SAME))
        if not len(overtaken.which):  # else a rival fits the best one's inliers better: it has its own
            break
        found = found.joined(refit_inliers(problems, overtaken.states, overtaken.which, criterion)).different()
    return own, minima


def _supported(problems: PoseProblems, states: Array, best: RefitPoses, criterion: InlierCriterion) -> Array:
    """Return the mask (S,) of states near to which are half as many points as agree with the best poses (S,)."""
    near = _below(problems, states, best.which, 4 * criterion.limits(problems, best.which), criterion)
    count, most = (np.asarray(sum(mask.sum(axis=1) for mask in masks)) for masks in (near, best.masks))
    return 2 * count >= most


def _on_best(problems: PoseProblems, found: RefitPoses, others: Array, of_others: Array) -> tuple[PoseProblems, Minima]:
    """Return the problems of the inliers of the lowest poses, and their minima from others and from what was found that
    half as many points agree with.
    """
    chosen = found.lowest()
    masks = tuple(np.zeros_like(mask) for mask in problems.masks)
    for mask, inliers in zip(masks, chosen.masks, strict=True):
        mask[chosen.which] = inliers
    own = problems.masked(masks)
    count = np.asarray(sum(mask.sum(axis=1) for mask in found.masks))
    found = found.take(2 * count >= own.counts[found.which])
    states, which = np.concatenate([found.states, others]), np.concatenate([found.which, of_others])
    return own, different(own.minimise(states, which))


@dataclass(frozen=True)
class Sampling:
    """How samples are drawn: confidence that one had no outlier; seed, the same for every view."""

    confidence: float
    seed: int


def sampled(problems: PoseProblems, which: Array, criterion: InlierCriterion, sampling: Sampling) -> RefitPoses:
    """Return settled poses of some problems, the lowest few of each.

    All problems take turns together: what a fit or a triplet costs in calls, it costs for all of them at once.
    """
    own = problems.take(which)
    searches = [_Search.of(own, problem, criterion, sampling.seed) for problem in range(len(which))]
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
            searches[problem].needed = _needed(count, own.counts[problem], sampling.confidence)
    return found.of(which[found.which])


@dataclass(eq=False)
class _Search:
    """The random triplets of one problem: how many were drawn and are needed, and the lowest score of a pose so far.

    points: indices of those that each camera has.
    """

    scorer: "_Scorer"
    rng: np.random.Generator
    points: list[Array]
    best: float
    drawn: int = 0
    needed: float = MOST

    @classmethod
    def of(cls, problems: PoseProblems, problem: int, criterion: InlierCriterion, seed: int) -> "_Search":
        rng, points = np.random.default_rng(seed), [np.flatnonzero(mask[problem]) for mask in problems.masks]
        scorer = _Scorer.of(problems, int(problems.view[problem]), points, criterion, rng)
        return cls(scorer, rng, points, scorer.unsupported)

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
        scores = self.scorer.scores(states)
        first = np.argsort(scores, kind="stable")[:_PROMISING]
        if not first.size or scores[first[0]] >= self.best:
            return states[:0]
        self.best = scores[first[0]]
        return states[first[scores[first] < self.scorer.unsupported]]


def _needed(inliers: int, count: int, confidence: float) -> float:
    """Return how many triplets of `count` points to draw so that one had no outlier."""
    clean = min(float(np.prod([(inliers - k) / (count - k) for k in range(_CORNERS)])), 1 - 1e-12)
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


@dataclass(frozen=True, eq=False)
class _Scorer:
    """The truncated error of many poses of one view, from some of its points where there are many.

    A point is off by J y / (d · y) to first order, where y is the point in the camera, d its pixel's ray and J the
    derivative of pixels at d, where J d = 0: that is enough to tell what is within the limit, and takes one product.
    factors: (3 N, 13) of the rows of poses and a one, in single precision.
    """

    factors: Array
    limit: np.float32

    @classmethod
    def of(
        cls,
        problems: PoseProblems,
        view: int,
        points: list[Array],
        criterion: InlierCriterion,
        rng: np.random.Generator,
    ) -> "_Scorer":
        factors = []
        for packed, every in zip(problems.packed_views, points, strict=True):
            some = np.sort(rng.choice(every, _SCORED, replace=False)) if len(every) > _SCORED else every
            chosen = packed.take(np.array([view])).only(some)
            factors.append(chosen.sight_factors(np.sqrt(chosen.variances()) if criterion.in_pixels else 1.0))
        rows = np.concatenate(factors, axis=1, dtype=np.float32).reshape(-1, factors[0].shape[-1])
        return cls(rows, np.float32(criterion.threshold) ** 2)

    @property
    def unsupported(self) -> float:
        """The score of a pose that no point supports but the three it was made from."""
        return float(self.limit) * (len(self.factors) // 3 - _CORNERS) * (1 - _ROUNDED)

    def scores(self, states: Array) -> Array:
        """Return the scores (S,) of states (S, 3, 4), the lowest best."""
        rows = np.ones((13, len(states)), np.float32)
        rows[:12] = states.reshape(-1, 12).T
        with np.errstate(all="ignore"):
            u, v, depth = (self.factors @ rows).reshape(3, len(self.factors) // 3, len(states))
            squared = (u * u + v * v) / np.square(np.maximum(depth, 0.0))
            return np.asarray(np.fmin(squared, self.limit).sum(axis=0))
