"""Fits of groups of views: to all points, or to those that agree."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from camcal.arrays import Array
from camcal.estimate.poses import states as se3
from camcal.estimate.poses.extent import Extents
from camcal.estimate.poses.groups import Group
from camcal.estimate.poses.inliers import (
    KEPT_VARIANCE,
    MEDIAN,
    WIDTH,
    Agreement,
    Settled,
    approached,
    choose,
    settle,
)
from camcal.estimate.poses.judgement import Noise
from camcal.estimate.poses.minima import anchors, lowest, pose_minima
from camcal.estimate.poses.problem import ROUNDING, Anchor, PoseProblems
from camcal.estimate.poses.records import PoseOptions
from camcal.estimate.poses.samples import Sampling, sampled
from camcal.solve.independent import Minima

MIN_POINTS = 4
_TELLING = 6  # points of which one can be told to be wrong by the others
_ESTIMATIONS = 3  # of noise and inliers in turns


@dataclass(frozen=True, eq=False)
class Fit:
    """The minima of a group's problems, one problem an item with one minimum or more."""

    group: Group
    problems: PoseProblems
    minima: Minima
    extents: Extents

    def take(self, chosen: Array) -> "Fit":
        """Return the fit of some of the items."""
        renumbered = np.full(len(self.group.items), -1)
        renumbered[chosen] = np.arange(len(chosen))
        problems = self.problems.take(chosen)
        minima = self.minima.take(renumbered[self.minima.which] >= 0)
        minima = replace(minima, which=renumbered[minima.which])
        return Fit(self.group.take(chosen), problems, minima, self.extents)


def fits_of(groups: Sequence[Group], options: PoseOptions) -> tuple[list[Fit], Noise | None]:
    """Return the fits of groups, and the noise if that is known already."""
    given = None if options.scale is None else Noise(options.scale)
    if options.outliers == "none":
        return [_plain(group, options) for group in groups], given
    known = given is not None or options.threshold_px is not None
    agreement = agreement_of(options, 1.0 if given is None else given.sigma)
    if options.outliers == "many":
        fits = [_from_samples(group, options, agreement) for group in groups]
    else:
        fits = [_plain(group, options) for group in groups]
        agreement = agreement if known else agreement_of(options, _robust_noise(fits))
        fits = [_agreeing(fit, options, agreement) for fit in fits]
    if known:
        return fits, given
    for _ in range(_ESTIMATIONS):
        agreement = agreement_of(options, _robust_noise(fits))
        fits = [_agreeing(fit, options, agreement) for fit in fits]
    return fits, pooled(fits, agreement)


def pooled(fits: Sequence[Fit], agreement: Agreement | None = None) -> Noise:
    """Return the noise that the residuals of all fits tell; agreement: what cut off the largest, if anything did."""
    squares, freedom, variances = 0.0, 0, 0.0
    for fit in fits:
        each = 2 * fit.problems.counts - 6
        cut = agreement is not None and fit.problems.counts >= agreement.whole
        squares += float(2 * fit.minima.cost[lowest(fit.minima)].sum())
        freedom += int(each.sum())
        variances += float(np.sum(each * np.where(cut, KEPT_VARIANCE, 1.0)))
    return Noise(max(float(np.sqrt(squares / max(variances, 1.0))), ROUNDING), freedom)


def points_needed(options: PoseOptions) -> int:
    """Return the number of points that a pose needs."""
    return MIN_POINTS if options.prior is None else MIN_POINTS - 1


def agreement_of(options: PoseOptions, sigma: float) -> Agreement:
    """Return what makes an inlier where the noise is sigma."""
    whole = _TELLING if options.outliers == "few" else 0
    if options.threshold_px is not None:
        return Agreement(options.threshold_px, points_needed(options), whole, in_pixels=True)
    return Agreement(WIDTH * sigma, points_needed(options), whole)


def _problems(group: Group, options: PoseOptions) -> PoseProblems:
    if options.prior is None or options.scale is None:
        return PoseProblems.of(group.sights)
    known = np.tile(se3.of_poses([options.prior.pose]), (len(group.items), 1, 1))
    moves = se3.shift_jacobians(known, group.centres)
    covariances = moves @ options.prior.covariance @ moves.transpose(0, 2, 1)
    information = options.scale**2 * np.linalg.inv(covariances)
    return PoseProblems.of(group.sights, Anchor(se3.shifted(known, group.centres), information))


def _plain(group: Group, options: PoseOptions) -> Fit:
    problems, extents = _problems(group, options), Extents.of(*group.points())
    return Fit(group, problems, pose_minima(problems, extents), extents)


def _from_samples(group: Group, options: PoseOptions, agreement: Agreement) -> Fit:
    problems, extents = _problems(group, options), Extents.of(*group.points())
    found = _samples(problems, problems.view, options, agreement)
    found.append(settle(problems, *anchors(problems), agreement))
    return Fit(group, *choose(problems, reduce(Settled.joined, found), extents, agreement), extents)


def _agreeing(fit: Fit, options: PoseOptions, agreement: Agreement) -> Fit:
    """Return the fit to the points that agree with one to others.

    If few points are wrong, the agreement is approached from the fit to all, and samples help where that fails.
    """
    problems = PoseProblems.of(fit.group.sights, fit.problems.anchor)
    states, which, few = fit.minima.states, fit.minima.which, options.outliers == "few"
    states = approached(problems, states, which, agreement) if few else states
    found = settle(problems, states, which, agreement)
    chosen, minima = choose(problems, found, fit.extents, agreement)
    lost = np.flatnonzero((2 * chosen.counts < problems.counts) & (problems.counts >= _TELLING))
    if few and lost.size:
        found = reduce(Settled.joined, _samples(problems, lost, options, agreement), found)
        chosen, minima = choose(problems, found, fit.extents, agreement)
    return Fit(fit.group, chosen, minima, fit.extents)


def _samples(problems: PoseProblems, which: Array, options: PoseOptions, agreement: Agreement) -> list[Settled]:
    sampling = Sampling(options.confidence, options.seed)
    return [sampled(problems, problem, agreement, sampling) for problem in which.tolist()]


def _robust_noise(fits: Sequence[Fit]) -> float:
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
