"""Fits of groups of views: to all points, or to inliers."""

from collections.abc import Sequence
from functools import reduce

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass, replace
from camcal.estimate.poses import states as se3
from camcal.estimate.poses.inliers import (
    KEPT_VARIANCE,
    MEDIAN,
    WIDTH,
    InlierCriterion,
    RefitPoses,
    choose,
    likeliest_threshold,
    refit_inliers,
    squared_as_new,
    trimmed_refit,
    truncated_cost,
)
from camcal.estimate.poses.packed_correspondences import Group
from camcal.estimate.poses.pose_quality import ResidualNoise
from camcal.estimate.poses.problem import ROUNDING, Anchor, PoseProblems, anchors, lowest, pose_minima
from camcal.estimate.poses.records import PoseOptions
from camcal.estimate.poses.samples import poses_of_samples
from camcal.estimate.poses.starts import FEW
from camcal.estimate.poses.states import Extents
from camcal.solve.independent import Minima, joined

MIN_POINTS = 4
_MIN_POINTS_FOR_OUTLIER = 6  # points of which one can be told to be wrong by the others
_ESTIMATIONS = 3  # of noise and inliers in turns
_EQUAL = 1e-6  # share by which the costs of poses that are the same may differ
_FAR = 25.0  # times the limit of a squared residual: from there, no point is thought to be right
_RARE = 1e-5  # probability of a right view beyond the limit of its squared residuals; real corners have long tails
_FEWEST_VIEWS, _VIEW_ROUNDS = 6, 20
_TURNS = 3  # of the share of wrong points, or of the noise, and what follows from it

Starts = tuple[Array, Array]  # states (S, 3, 4) and the items (S,) they are of
_NO_STARTS: Starts = np.zeros((0, 3, 4)), np.zeros(0, np.intp)


@dataclass(frozen=True, eq=False)
class PoseFit:
    """The minima of a group's problems, one problem an item with one minimum or more.

    found: the poses with inliers of their own that these were chosen from, of items of which not all points count.
    """

    group: Group
    problems: PoseProblems
    minima: Minima
    extents: Extents
    found: RefitPoses | None = None

    def take(self, chosen: Array) -> "PoseFit":
        """Return the fit of some of the items."""
        renumbered = np.full(len(self.group.items), -1)
        renumbered[chosen] = np.arange(len(chosen))
        problems = self.problems.take(chosen)
        minima = self.minima.take(renumbered[self.minima.which] >= 0)
        minima = replace(minima, which=renumbered[minima.which])
        return PoseFit(self.group.take(chosen), problems, minima, self.extents)

    def starts(self) -> Starts:
        """Return the states (S, 3, 4) that may lead to the best pose, and their items (S,)."""
        if self.found is None:
            return self.minima.states, self.minima.which
        sound = np.isfinite(self.found.truncated)
        states, which = self.found.states[sound], self.found.which[sound]
        return np.concatenate([self.minima.states, states]), np.concatenate([self.minima.which, which])

    def with_items(self, items: Array, problems: PoseProblems, minima: Minima, found: RefitPoses) -> "PoseFit":
        """Return the fit with the problems, minima and poses found of some items replaced."""
        masks = tuple(mask.copy() for mask in self.problems.masks)
        for mask, new in zip(masks, problems.masks, strict=True):
            mask[items] = new
        others = self.minima.take(~np.isin(self.minima.which, items))
        together = joined(others, replace(minima, which=items[minima.which]))
        together = together.take(np.argsort(together.which, kind="stable"))
        found = found.of(items[found.which])
        if self.found is not None:
            found = self.found.take(~np.isin(self.found.which, items)).joined(found)
        return replace(self, problems=self.problems.masked(masks), minima=together, found=found)


def fits_of(groups: Sequence[Group], options: PoseOptions) -> tuple[list[PoseFit], ResidualNoise | None]:
    """Return the fits of groups, and the noise if that is known already."""
    given = None if options.scale is None else ResidualNoise(options.scale)
    if options.outliers == "none":
        return [_plain(group, options) for group in groups], given
    known = given is not None or options.threshold_px is not None
    criterion = criterion_of(options, 1.0 if given is None else given.sigma)
    if options.outliers == "many":
        fits = [_from_samples(group, options, criterion) for group in groups]
    else:
        fits = [_plain(group, options) for group in groups]
        criterion = criterion if known else criterion_of(options, _robust_noise(fits))
        fits = [_agreeing(fit, options, criterion) for fit in fits]
    if options.threshold_px is not None:
        return fits, given
    noise = given
    if noise is None:
        for _ in range(_ESTIMATIONS):
            criterion = criterion_of(options, _robust_noise(fits))
            fits = [_agreeing(fit, options, criterion) for fit in fits]
        noise = pooled(fits, criterion, whole=criterion.whole)
    fits = [_likeliest(fit, options, noise.sigma) for fit in fits]
    return fits, given or pooled(fits, whole=criterion.whole)


def pooled(fits: Sequence[PoseFit], criterion: InlierCriterion | None = None, *, whole: int = 0) -> ResidualNoise:
    """Return the noise that the residuals of all fits tell; criterion: what cut off the largest, if anything did.

    Minima that fit nearly as well as the lowest count by their probability: the lowest of two is less than the true
    one's on average, as it is the other one's part of the time. whole: views of fewer points have all of them, and of
    several such views those whose residuals are no noise of the others do not count.
    """
    best = [fit.minima.take(lowest(fit.minima)) for fit in fits]
    counts = [fit.problems.counts[minima.which] for fit, minima in zip(fits, best, strict=True)]
    count = np.concatenate([np.zeros(0, np.intp), *counts])
    each = 2 * count - 6
    shares = np.full(len(count), 1.0 if criterion is None else KEPT_VARIANCE)
    if criterion is not None:
        shares[count < criterion.whole] = 1.0
    squares = np.concatenate([np.zeros(0), *(2 * minima.cost for minima in best)])
    for _ in range(_TURNS):
        kept, cut = _sound_views(squares, each, shares, count < whole)
        variance = float(squares[kept].sum() / max((each * cut)[kept].sum(), 1.0))
        if not variance > 0:
            break
        squares = np.concatenate([_expected_squares(fit.minima, variance) for fit in fits])
    return ResidualNoise(max(float(np.sqrt(variance)), ROUNDING), int(each[kept].sum()))


def _sound_views(squares: Array, dof: Array, shares: Array, few: Array) -> tuple[Array, Array]:
    """Return which views (P,) count, and the share of the variance that their squares (P,) have on average.

    few: the views of which any may hold a wrong point. Such a one is off by more than what all but one in 100 000 right
    ones stay below, by the noise of those that count, to begin with by the median.
    """
    from scipy.special import chdtr, chdtri

    judged = few & (dof > 0)
    every = np.ones(len(squares), dtype=bool)
    if np.count_nonzero(judged) < _FEWEST_VIEWS:
        return every, shares
    limits = chdtri(np.maximum(dof, 1), _RARE)
    cut = np.where(judged, chdtr(dof + 2, limits) / chdtr(np.maximum(dof, 1), limits), shares)
    variance = float(np.median(squares[judged] / chdtri(dof[judged], 0.5)))
    kept = every
    for _ in range(_VIEW_ROUNDS):
        before, kept = kept, ~judged | (squares <= limits * variance)
        variance = float(squares[kept].sum() / max((dof * cut)[kept].sum(), 1.0))
        if np.array_equal(kept, before):
            break
    return kept, cut


def _expected_squares(minima: Minima, variance: float) -> Array:
    """Return the expected sums of squares (P,) of the problems, each at its minima by their probability."""
    first = lowest(minima)
    least = np.repeat(minima.cost[first], np.diff(first, append=len(minima.which)))
    odds = np.exp(-(minima.cost - least) / variance)
    squares = np.bincount(minima.which, 2 * odds * minima.cost)
    return np.asarray(squares[minima.which[first]] / np.bincount(minima.which, odds)[minima.which[first]])


def points_needed(options: PoseOptions) -> int:
    """Return the number of points that a pose needs."""
    return MIN_POINTS if options.prior is None else MIN_POINTS - 1


def criterion_of(options: PoseOptions, sigma: float) -> InlierCriterion:
    """Return what makes an inlier where the noise is sigma."""
    whole = _MIN_POINTS_FOR_OUTLIER if options.outliers == "few" else 0
    if options.threshold_px is not None:
        return InlierCriterion(options.threshold_px, points_needed(options), whole, in_pixels=True)
    return InlierCriterion(WIDTH * sigma, points_needed(options), whole)


def _problems(group: Group, options: PoseOptions) -> PoseProblems:
    if options.prior is None or options.scale is None:
        return PoseProblems.of(group.packed_views)
    known = np.tile(se3.of_poses([options.prior.pose]), (len(group.items), 1, 1))
    moves = se3.shift_jacobians(known, group.centres)
    covariances = moves @ options.prior.covariance @ moves.transpose(0, 2, 1)
    information = options.scale**2 * np.linalg.inv(covariances)
    return PoseProblems.of(group.packed_views, Anchor(se3.shifted(known, group.centres), information))


def _plain(group: Group, options: PoseOptions) -> PoseFit:
    problems = _problems(group, options)
    return PoseFit(group, problems, pose_minima(problems, group.extents), group.extents)


def _from_samples(group: Group, options: PoseOptions, criterion: InlierCriterion) -> PoseFit:
    problems, extents = _problems(group, options), group.extents
    found = [poses_of_samples(problems, problems.view, criterion, options)]
    found.append(refit_inliers(problems, *anchors(problems), criterion))
    # of so few points, samples are few as well, and may all miss a plane's second pose
    few = np.flatnonzero(problems.counts <= FEW)
    if few.size:
        minima = _plain(group.take(few), options).minima
        found.append(refit_inliers(problems, minima.states, few[minima.which], criterion))
    together = reduce(RefitPoses.joined, found)
    return PoseFit(group, *choose(problems, together, extents, criterion), extents, together)


def _agreeing(fit: PoseFit, options: PoseOptions, criterion: InlierCriterion) -> PoseFit:
    """Return the fit to the points that agree with one to others.

    If few points are wrong, the agreement is approached from the fit to all, and samples help where that fails.
    """
    every = PoseProblems.of(fit.group.packed_views, fit.problems.anchor)
    items = _disagreeing(fit, every, criterion)
    if not items.size:
        return fit
    problems, few, (states, which) = every.take(items), options.outliers == "few", fit.starts()
    states, which = _of_items(states, which, items)
    states = trimmed_refit(problems, states, which, criterion) if few else states
    found = refit_inliers(problems, states, which, criterion)
    chosen, minima = choose(problems, found, fit.extents, criterion)
    lost = np.flatnonzero((2 * chosen.counts < problems.counts) & (problems.counts >= _MIN_POINTS_FOR_OUTLIER))
    if few and lost.size:
        found = found.joined(poses_of_samples(problems, lost, criterion, options))
        chosen, minima = choose(problems, found, fit.extents, criterion)
    return fit.with_items(items, chosen, minima, found)


def _disagreeing(fit: PoseFit, every: PoseProblems, criterion: InlierCriterion) -> Array:
    """Return the items (I,) but for those whose best poses follow from the points that agree with them already."""
    best = fit.minima.take(lowest(fit.minima))
    squares, limits = criterion.squared(every, best.states, best.which), criterion.limits(every, best.which)
    if fit.found is not None:
        undecided = _undecided(fit, every, best, squares, criterion, fit.starts())
        return np.flatnonzero(undecided | (fit.problems.counts < criterion.least))
    quiet, inside = np.zeros(len(every.view), dtype=bool), np.ones(len(best.which), dtype=bool)
    for squared, mask in zip(squares, every.masks, strict=True):
        inside &= np.all((squared <= limits) | ~mask[best.which], axis=1)
    quiet[best.which] = inside & (every.counts[best.which] >= criterion.least)
    return np.flatnonzero(~quiet | (fit.problems.counts < every.counts))


def _likeliest(fit: PoseFit, options: PoseOptions, sigma: float) -> PoseFit:
    """Return the fit to all points that are more likely right than wrong; sigma: of a whitened coordinate.

    A limit that 99.73 % of right points keep to loses one in many views, the one that is off most: their poses would be
    worse than they claim, and those of views that have no point to spare would be missing. Only views with points left
    out change.
    """
    every = PoseProblems.of(fit.group.packed_views, fit.problems.anchor)
    spoilt = np.flatnonzero(fit.problems.counts < every.counts)
    if not spoilt.size:
        return fit
    areas = _areas(fit.group, options)
    criterion = _likeliest_agreement(every, fit.problems.masks, areas, options, sigma)
    best = fit.minima.take(lowest(fit.minima))
    squares = criterion.squared(every, best.states, best.which)
    parts = [fit.starts(), _readmit(fit, every, best, squares, criterion, sigma)]
    lost = np.flatnonzero(fit.problems.counts == 0)  # the views that have no pose so far: from all their points
    if lost.size:
        minima = _plain(fit.group.take(lost), options).minima
        parts.append((minima.states, lost[minima.which]))
    starts = np.concatenate([states for states, _ in parts]), np.concatenate([which for _, which in parts])
    items = spoilt[_undecided(fit, every, best, squares, criterion, starts)[spoilt]]
    if not items.size:
        return fit
    problems, (states, which) = every.take(items), _of_items(*starts, items)
    chosen = fit.problems.take(items)
    for _ in range(_TURNS):
        criterion = _likeliest_agreement(problems, chosen.masks, areas[items], options, sigma)
        before, found = chosen.counts, refit_inliers(problems, states, which, criterion)
        chosen, minima = choose(problems, found, fit.extents, criterion)
        if np.array_equal(chosen.counts, before):
            break
    return fit.with_items(items, chosen, minima, found)


def _likeliest_agreement(
    problems: PoseProblems, masks: tuple[Array, ...], areas: Array, options: PoseOptions, sigma: float
) -> InlierCriterion:
    threshold = likeliest_threshold(problems, masks, areas, sigma)
    return replace(criterion_of(options, sigma), threshold=threshold)


def _readmit(
    fit: PoseFit,
    every: PoseProblems,
    best: Minima,
    squares: tuple[Array, ...],
    criterion: InlierCriterion,
    sigma: float,
) -> Starts:
    """Return the best poses fitted to the points left out as well that they would not be far from, were these right.

    A pose of few points is uncertain where it has none: there, a right point may be many times the noise away from it.
    squares: (S, N) of all points' residuals at the best poses.
    """
    near, limits = np.zeros(len(best.which), dtype=bool), criterion.limits(every, best.which)
    for squared, mask in zip(squares, fit.problems.masks, strict=True):
        near |= np.any((squared <= _FAR * limits) & ~mask[best.which], axis=1)
    if not near.any():
        return _NO_STARTS
    best, limits = best.take(near), limits[near]
    masks, more = [], np.zeros(len(best.which), dtype=bool)
    for squared, mask in zip(squared_as_new(every, best, sigma), fit.problems.masks, strict=True):
        masks.append(mask[best.which] | (squared <= limits))
        more |= np.any(masks[-1] != mask[best.which], axis=1)
    if not more.any():
        return _NO_STARTS
    best = best.take(more)
    wider = every.take(best.which).masked(tuple(mask[more] for mask in masks))
    return wider.minimise(best.states, np.arange(len(best.which)), rough=True).states, best.which


def _undecided(
    fit: PoseFit,
    every: PoseProblems,
    best: Minima,
    squares: tuple[Array, ...],
    criterion: InlierCriterion,
    starts: Starts,
) -> Array:
    """Return the mask (P,) of problems whose inliers would change, or of which another start comes first."""
    limits, changed = criterion.limits(every, best.which), np.zeros(len(best.which), dtype=bool)
    parts = squares, every.masks, fit.problems.masks
    for squared, mask, inliers in zip(*parts, strict=True):
        changed |= np.any(((squared <= limits) & mask[best.which]) != inliers[best.which], axis=1)
    undecided = np.zeros(len(every.view), dtype=bool)
    undecided[best.which] = changed
    states, which = starts
    least = np.full(len(every.view), np.inf)
    least[best.which] = truncated_cost(every, best.states, best.which, criterion, squares)
    ahead = truncated_cost(every, states, which, criterion) < least[which] * (1 - _EQUAL)
    undecided[which[ahead]] = True
    return undecided


def _of_items(states: Array, which: Array, items: Array) -> tuple[Array, Array]:
    """Return the states (S, 3, 4) that belong to items, and the places (S,) of theirs among these."""
    chosen = np.isin(which, items)
    return states[chosen], np.searchsorted(items, which[chosen])


def _areas(group: Group, options: PoseOptions) -> Array:
    """Return the areas (W,), px², that wrong pixels are in: those of images, or on boards and tags what is theirs."""
    if options.outliers == "many":
        return np.full(len(group.items), max(float(np.prod(packed.camera.image_size)) for packed in group.packed_views))
    total, count = np.zeros(len(group.items)), np.zeros(len(group.items))
    for packed in group.packed_views:
        most, least = (
            function(np.where(packed.present, packed.pixels, sign * -np.inf), axis=2)
            for function, sign in ((np.max, 1), (np.min, -1))
        )
        total += np.prod(np.maximum(most - least, 0.0), axis=0)
        count += packed.present.sum(axis=1)
    return np.asarray(total / np.maximum(count, 1))


def _robust_noise(fits: Sequence[PoseFit]) -> float:
    """Return the noise by the median residual of all points that take part, at the lowest minima."""
    squares = [np.zeros(0)]
    for fit in fits:
        best = fit.minima.take(lowest(fit.minima))
        # of 2n residuals, six follow the pose
        left = np.maximum(1 - 3 / np.maximum(fit.problems.counts[best.which], 1), 0.25)
        for squared, mask in zip(fit.problems.squared(best.states, best.which), fit.problems.masks, strict=True):
            squares.append((squared / left[:, None])[mask[best.which]])
    together = np.concatenate(squares)
    return max(float(np.sqrt(np.median(together) / MEDIAN)), ROUNDING) if together.size else 1.0
