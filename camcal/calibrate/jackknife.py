"""Influence of views: weights and covariance of estimates, and model selection by cross-validation.

What a view does to an estimate is known without solving again, in one step from its last linear solve (the jackknife's
one step). Where single points of the board are estimated too, they follow: they are determined anew without the view,
which the others then determine worse than all views did. Taken for determined as well as before, they would hide what a
view does that sees the board in a way of its own.

Estimates that take errors within views for noise, or model them, are all unbiased; which of them varies least depends
on what the errors really are. The weights are those under which leaving out views moves the weighted lens least, over
the image that the corners cover. Source: Hansen & Racine, Jackknife model averaging, Journal of Econometrics 167, 2012.

The covariance is that of the scatter from view to view, CR3, which needs no model of the errors and errs on the safe
side, and of the scatter of the estimates about their mean.
Source: MacKinnon, Nielsen & Webb, Journal of Econometrics 232, 2023; Buckland, Burnham & Augustin, Biometrics 53, 1997.

Of lens models each is estimated from all corners. Under the lens that the other views give, posed anew, every corner of
a view is predicted. Corners count by a Student distribution with a floor, so that those that the lens cannot describe
cost much, but no more than an outlier does.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from camcal.arrays import Array, FloatArray
from camcal.calibrate.effects import Posterior
from camcal.calibrate.estimator import Estimate
from camcal.calibrate.problem import State
from camcal.geometry import rotation as so3
from camcal.solve.dense import minimise_nonnegative
from camcal.solve.least_squares import assemble, part_of
from camcal.solve.steps import Block, Factors

_LARGEST = 0.99  # leverage of a view: what it alone determines cannot be distinguished from the others
# Times the variance that equal views would have, at most: CR3 has 1 / (1 - leverage), which grows without end where one
# view determines something all but alone.
_SAFETY = 3.0
_NEARLY = 1 - 1e-6  # of a view is left out, so that the others determine whatever there is
_ROUNDING = 1e-12  # of the diagonal
_ABOVE_ALL = 1e300  # the square of a row that no other one follows

_FINEST = 1e-9  # of the spread's trace: that weights are determined
_ALIKE = 10.0  # views that count for estimates of equal scatter
_FEW = 7.0  # views that hardly show what errors they share

_DOF = 4.0  # of the Student distribution
_OUTLIERS, _REACH = 0.01, 20.0  # the share of corners that may be anywhere within so many pixels
_LEAST_SIGMA, _MOST_SIGMA, _MOST_PX = 1e-4, 20.0, 1e100  # px
_STEPS, _SAME = 200, 1e-9


class Solution(Protocol):
    """An estimate, of one camera or of several, as far as averages ask for it."""

    @property
    def problem(self) -> "SharedParameters": ...
    @property
    def state(self) -> Any: ...
    @property
    def factors(self) -> Factors: ...
    @property
    def linearised(self) -> Any: ...
    @property
    def posterior(self) -> Posterior: ...


class SharedParameters(Protocol):
    """A problem whose views share parameters (D,) of known precision (D, D) before the data."""

    def shared_values(self, state: Any, /) -> Array: ...
    def prior_precision(self, state: Any, /) -> Array: ...
    def observed(self, state: Any, /) -> Sequence[Block]: ...


def influence(estimate: Solution) -> Array:
    """Return the changes (G, D) of the parameters that all views share, lens and terms of the board's shape, when each
    of the views is left out, in one step from the last linear solve; scaled so that their squares add up to CR3.
    """
    factors, covariance = estimate.factors, estimate.posterior.shared
    root = np.linalg.cholesky(covariance)
    if len(factors.shared_root) > len(covariance):
        kept, scores = _without_each(estimate)
        shares, light = root.T @ kept @ root, np.zeros(len(scores), bool)
    else:
        scores = factors.group_scores()
        leverages = root.T @ factors.group_information() @ root
        shares = np.eye(len(root)) - leverages
        # the largest leverage is no more than their sum: of such a view nothing is limited below
        light = np.trace(leverages, axis1=1, axis2=2) < 1 - 1 / _SAFETY
    pulls = scores @ root
    pulls[light] = np.linalg.solve(shares[light], pulls[light, :, None])[..., 0]
    values, vectors = np.linalg.eigh(shares[~light])
    left = np.clip(values, 1 - _LARGEST, 1)
    turned = np.einsum("gki,gk->gi", vectors, pulls[~light]) / np.maximum(left, np.sqrt(left / _SAFETY))
    pulls[~light] = np.einsum("gki,gi->gk", vectors, turned)
    count = len(scores)
    return np.asarray(np.sqrt((count - 1) / count) * pulls @ root.T)


def _without_each(estimate: Solution) -> tuple[Array, Array]:
    """Return the information (G, D, D) on the shared parameters without each of the views, and the gradients (G, D)
    that it stands against, single points of the board eliminated from both.

    Observations and factors have to be of one state: parts of views are small differences of large products.
    """
    factors, dense = estimate.factors, len(estimate.posterior.shared)
    matrix, scores = factors.shared_root @ factors.shared_root.T, factors.group_scores()
    blocks, size = estimate.problem.observed(estimate.linearised), len(matrix)
    points_first = np.roll(np.arange(size), -dense)
    kept, pulls = np.empty((len(scores), dense, dense)), np.empty((len(scores), dense))
    # the last rows of a Cholesky factor are the factor of the Schur complement, and of a row below L⁻¹ times that
    bordered = np.full((size + 1, size + 1), _ABOVE_ALL)
    for view, score in enumerate(scores):
        others = matrix - _NEARLY * _information(blocks, factors.reduced[view], view)
        others[range(size), range(size)] += _ROUNDING * np.diag(matrix)
        bordered[:size, :size] = others[points_first[:, None], points_first]
        bordered[size, :size] = bordered[:size, size] = score[points_first]
        root, last = np.split(np.linalg.cholesky(bordered)[size - dense :, size - dense : size], [dense])
        kept[view], pulls[view] = root @ root.T, root @ last[0]
    return kept, pulls


def _information(blocks: Sequence[Block], reduced: Array, view: int) -> Array:
    """Return the part (S, S) of a view in the Schur complement.

    blocks: rows of all views. reduced: (g, S) of the view, see Factors.
    """
    own = []
    for block in blocks:
        runs = [view] if block.groups is None else np.flatnonzero(block.groups == view)
        own += [replace(part_of(block, slice(run, run + 1)), groups=np.zeros(1, np.intp)) for run in runs]
    size, shared = reduced.shape
    return np.asarray(assemble(own, shared, 1, size).shared_shared - reduced.T @ reduced)


def image_metric(displacements: Array) -> Array:
    """Return the metric (K, K) in which a change of the lens has the mean square of what it moves in the image, px².

    displacements: (N, 2, K) of the image by the lens parameters, see cameras.directions.
    """
    flat = displacements.reshape(-1, displacements.shape[2])
    return np.asarray(flat.T @ flat / len(displacements))


def weights_of(left_out: Sequence[Array], metric: Array, evidence: float = 1.0, products: Array | None = None) -> Array:
    """Return the weights of estimates, none negative, that sum to one.

    left_out: of each estimate (G, D), see `influence`. metric: (K, K) of the lens, the first K of D parameters.
    evidence: 0…1, the share of the weights; the rest goes to the first estimate. products: (G, k, k) px² of what is to
    be small, view by view; None: the scatter of the estimates over the image.
    Each estimate's own scatter counts once more with ten views, and less with more of them: from a few views it is not
    known well, and weights fitted to chance would vary more than equal ones.
    """
    spreads = _spreads(left_out, metric) if products is None else products
    weights = _least_spread(spreads.sum(axis=0), len(spreads), noisy=products is not None)
    return _weighted_by_evidence(weights, evidence)


def _spreads(left_out: Sequence[Array], metric: Array) -> Array:
    """Return the products (G, k, k), px², of what leaving out a view does to each of k estimates."""
    moved = np.stack(left_out)[:, :, : len(metric)]
    return np.asarray(np.einsum("agi,ij,bgj->gab", moved, metric, moved, optimize=True))


def _least_spread(spread: Array, views: int, *, noisy: bool = False) -> Array:
    """Return the weights of estimates for products (k, k) summed over a number of views; noisy: which have something in
    common that no weights can take away.
    """
    finest = _FINEST * np.trace(spread) * np.eye(len(spread))
    if noisy:
        ones = np.ones(len(spread))
        spread = spread - 1 / (ones @ np.linalg.solve(spread + finest, ones))
    spread = spread + _ALIKE / views * np.diag(np.diag(spread))
    # of weights that sum to one the minimum of wᵀ S w lies in the direction of that of ½ wᵀ S w - Σ w
    weights = minimise_nonnegative(spread + finest, np.ones(len(spread)))
    return np.asarray(weights / weights.sum())


def _weighted_by_evidence(weights: Array, evidence: float) -> Array:
    return np.asarray((1 - evidence) * np.eye(1, len(weights))[0] + evidence * weights)


def covariance_of(
    estimates: Sequence[Solution],
    left_out: Sequence[Array],
    metric: Array,
    weights: Array,
    evidence: float = 1.0,
    blocks: Sequence[slice] = (),
    products: Array | None = None,
) -> Array:
    """Return the covariance (D, D) of the weighted parameters, lens and terms of the board's shape.

    Its scale over the image is that of the scatter from view to view and of the estimates about their mean, no less
    than the estimates claim. Its shape is that of the same scatter, which G views determine in as many directions only,
    drawn towards the claimed one as by D further views. blocks: of the metric's parameters, each with a scale of its
    own, drawn as by as many further views as it has parameters. products: as of `weights_of`. Without evidence for
    errors within views, the claimed one is right and CR3 too large, unless the views are too few to show such errors.
    """
    claimed = np.tensordot(weights, np.stack([own.posterior.shared for own in estimates]), axes=1)
    others = _weights_of_others(left_out, metric, evidence, products)
    scatter = _scatter(estimates, left_out, weights, others)
    lens, views, size = len(metric), len(left_out[0]), len(claimed)
    # Scales of single blocks are of what a block has besides the blocks before it. Were they of blocks themselves,
    # errors that cancel between blocks no longer would, and a depth, which they leave alone, would be uncertain.
    root = np.linalg.cholesky(claimed + _ROUNDING * np.diag(np.diag(claimed))) if blocks else np.eye(size)
    scatter, claims = (np.linalg.solve(root, np.linalg.solve(root, own).T) for own in (scatter, claimed))
    metric = root[:lens].T @ metric @ root[:lens]

    def ratio(chosen: slice) -> float:
        scatter_px, claimed_px = (
            float(np.sum(own[chosen, chosen] * metric[chosen, chosen])) for own in (scatter, claims)
        )
        # of corners without noise both may be rounding, of either sign
        return scatter_px / claimed_px if min(scatter_px, claimed_px) > 0 else 1.0

    ratios, further = np.full(size, ratio(slice(None))), np.full(size, float(size))
    for chosen in blocks:
        ratios[chosen], further[chosen] = ratio(chosen), chosen.stop - chosen.start
    scale = np.sqrt(ratios)
    of_scatter, of_claimed = np.sqrt(views / (views + further)), scale * np.sqrt(further / (views + further))
    mixed = np.outer(of_scatter, of_scatter) * scatter + np.outer(of_claimed, of_claimed) * claims
    least = np.maximum(1 / scale, 1.0)
    mixed = root @ (np.outer(least, least) * mixed) @ root.T
    doubted = evidence + (1 - evidence) * min((_FEW / views) ** 2, 1.0)
    result = doubted * mixed + (1 - doubted) * claimed
    return np.asarray((result + result.T) / 2)  # sums of strongly correlated parameters are symmetric to rounding only


def _weights_of_others(left_out: Sequence[Array], metric: Array, evidence: float, products: Array | None) -> Array:
    """Return the weights (G, k) that the other views than each give; arguments as of `weights_of`."""
    spreads = _spreads(left_out, metric) if products is None else products
    total, others, noisy = spreads.sum(axis=0), len(spreads) - 1, products is not None
    return np.array(
        [_weighted_by_evidence(_least_spread(total - own, others, noisy=noisy), evidence) for own in spreads]
    )


def _scatter(estimates: Sequence[Solution], left_out: Sequence[Array], weights: Array, others: Array) -> Array:
    """Return the scatter (D, D) from view to view, each view with the weights (G, k) that the others give, as weights
    that suit all views make their scatter small; that of the estimates, as what they disagree in is not known better;
    and what priors leave open, which no view shows.
    """
    moved = np.einsum("ga,agi->gi", others, np.stack(left_out))
    shared = np.array([own.problem.shared_values(own.state) for own in estimates])
    apart = shared - weights @ shared
    priors = [own.posterior.shared @ own.problem.prior_precision(own.state) @ own.posterior.shared for own in estimates]
    total = moved.T @ moved + (weights * apart.T) @ apart
    return np.asarray(total + np.tensordot(weights, np.stack(priors), axes=1))


def averaged(states: Sequence[State], weights: Array) -> State:
    """Return the weighted mean of states of one problem; rotations are averaged about the first one's."""

    def mean(values: Sequence[Array]) -> Array:
        return np.asarray(np.tensordot(weights, np.stack(values), axes=1))

    first = states[0].rotations
    turns = mean([so3.log(first.transpose(0, 2, 1) @ state.rotations) for state in states])
    return State(
        mean([state.parameters for state in states]),
        first @ so3.exp(turns),
        mean([state.translations for state in states]),
        mean([state.shape for state in states]),
        mean([state.offsets for state in states]),
    )


def predict_views(plain: Estimate, left_out: Array) -> tuple[FloatArray, float]:
    """Return how well an estimate predicts the corners that there are: log likelihoods (V,) of the views, and the scale
    of the errors of a coordinate, px, 0.85 standard deviations of Gaussian ones; left_out: see `influence`.
    """
    present = plain.problem.observations.present
    sigma, density = _likeliest(_left_out(plain, left_out)[present])
    scores = np.zeros(present.shape)
    scores[present] = density
    return scores.sum(axis=1), sigma


def _left_out(plain: Estimate, left_out: Array) -> Array:
    """Return the distances (V, P) px between corners and where the other views predict them; inf where they have no
    image.
    """
    problem, state = plain.problem, plain.state
    views, points = problem.observations.present.shape
    derivatives = problem.derivatives(state)
    residuals = np.nan_to_num(problem.residuals(state), nan=np.inf)
    # in pixels, all corners alike: covariances belong to the noise, not to how well a lens predicts
    block = replace(problem, observations=replace(problem.observations, whitening=None)).data(state, derivatives)
    count = len(plain.posterior.shared)
    dense = [part.values for part in block.shared if part.columns.ndim == 1]
    shared = np.concatenate(dense, axis=2).reshape(views, points, 2, -1) if dense else np.zeros((views, points, 2, 0))
    changes = left_out / np.sqrt((views - 1) / views)
    assert block.group is not None
    pose = block.group.reshape(views, points, 2, -1)
    moved = np.einsum("vpdk,vk->vpd", shared, changes[:, :count])
    weights = np.sqrt(problem.observations.weights)[:, :, None]
    by_pose, by_lens = (weights[..., None] * pose).reshape(views, 2 * points, -1), weights * moved
    normal = by_pose.transpose(0, 2, 1) @ by_pose + 1e-12 * np.eye(by_pose.shape[2])
    followed = np.linalg.solve(normal, by_pose.transpose(0, 2, 1) @ by_lens.reshape(views, -1, 1))[..., 0]
    predicted = residuals + (moved - np.einsum("vpdk,vk->vpd", pose, followed)).transpose(2, 0, 1)
    return np.asarray(np.where(np.isfinite(residuals).all(axis=0), np.hypot(*predicted), np.inf))


def _likeliest(distances: Array) -> tuple[float, Array]:
    """Return the scale of the Student distribution, px, under which distances (N,) are likeliest, and the logarithms of
    their densities.

    By expectation and maximisation: every distance is an outlier's by its share of the density, and else weighs as a
    Student distribution has it. Source: Lange, Little & Taylor, Robust statistical modeling using the t distribution,
    1989.
    """
    squares, outliers = np.minimum(distances, _MOST_PX) ** 2, _OUTLIERS / (np.pi * _REACH**2)
    variance = float(np.median(squares))
    for _ in range(_STEPS):
        before = variance = min(max(variance, _LEAST_SIGMA**2), _MOST_SIGMA**2)
        scaled = squares / (_DOF * variance)
        density = (1 - _OUTLIERS) * (1 + scaled) ** (-_DOF / 2 - 1) / (2 * np.pi * variance)
        share = density / (density + outliers)
        variance = float(np.sum(share * (_DOF + 2) / _DOF / (1 + scaled) * squares) / (2 * np.sum(share)))
        if abs(variance - before) < _SAME * before:
            break
    return float(np.sqrt(before)), np.log(density + outliers)
