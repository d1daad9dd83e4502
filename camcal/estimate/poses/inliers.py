"""Robust poses: alternating inlier selection and refinement until both are consistent."""

from collections.abc import Callable

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass, replace
from camcal.estimate.poses import states as se3
from camcal.estimate.poses.problem import PoseProblems, different, distinct, firsts, inverses, lowest
from camcal.estimate.poses.states import NEAR_PLANE, Extents
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
