"""Which lens model predicts views best that it was not estimated from, with a margin for what chance may do.

Each candidate is estimated from all corners. What leaving out a view does to an estimate is known without solving again
(the jackknife's one step): under the lens that the other views give, posed anew, every corner of the view is predicted.
Corners count by a Student distribution with a floor, so that those that the lens cannot describe cost much, but no more
than an outlier does.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from camcal.arrays import Array
from camcal.calibrate.averaging import influence
from camcal.calibrate.estimator import Estimate

_DOF = 4.0  # of the Student distribution
_OUTLIERS, _REACH = 0.01, 20.0  # the share of corners that may be anywhere within so many pixels
_LEAST_SIGMA, _MOST_SIGMA = 1e-4, 20.0  # px
# By how much a model must predict better: nats a corner, and standard errors of the difference between views. Than the
# preferred one by much, or less if that is clearer; than a simpler one by little: a lens that is described badly at the
# edge of the image costs its few corners there no more.
GAIN = 0.10
_MUCH, _LITTLE = ((GAIN, 1.5), (0.02, 2.5)), ((0.005, 1.5),)


@dataclass(frozen=True, eq=False)
class Contender:
    """A lens model and how well it predicts: scores (V,) log likelihoods of the views; sigma_px: the scale of the
    errors of a coordinate, 0.85 standard deviations of Gaussian ones.

    reason: why it has no score, None if it has.
    """

    name: str
    scores: Array | None = None
    corners: int = 0
    sigma_px: float | None = None
    reason: str | None = None

    @property
    def score(self) -> float:
        """The log likelihood of a corner on average, nat; -inf without one."""
        return float(self.scores.sum()) / self.corners if self.scores is not None else -np.inf


def contender(name: str, plain: Estimate) -> Contender:
    """Return how well an estimate predicts the corners (V, P) that there are."""
    present = plain.problem.observations.present
    distances = _left_out(plain)[present]
    sigma, density = _likeliest(distances)
    scores = np.zeros(present.shape)
    scores[present] = density
    return Contender(name, scores.sum(axis=1), int(present.sum()), sigma)


def chosen(contenders: Sequence[Contender], preferred: str) -> Contender:
    """Return the contender to use; contenders: the simplest first.

    The preferred one stays unless the best predicts much better; else the simplest one that the best does not beat.
    """
    best = max(contenders, key=lambda own: own.score)
    first = next((own for own in contenders if own.name == preferred), None)
    if first is not None and not _beats(best, first, _MUCH):
        return first
    return next(own for own in contenders if not _beats(best, own, _LITTLE))


def _beats(one: Contender, other: Contender, margins: Sequence[tuple[float, float]]) -> bool:
    """Return whether a contender predicts better than another by any of the margins: nats a corner, standard errors."""
    if one.scores is None or other.scores is None:
        return one.scores is not None
    gains = one.scores - other.scores
    error = float(np.std(gains, ddof=1)) * np.sqrt(len(gains)) if len(gains) > 1 else np.inf
    return any(gains.sum() > max(least * one.corners, errors * error) for least, errors in margins)


def _left_out(plain: Estimate) -> Array:
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
    changes = influence(plain) / np.sqrt((views - 1) / views)
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
    """

    def density(log_sigma: float) -> Array:
        variance = np.exp(2 * log_sigma)
        squared = np.minimum(distances, 1e150) ** 2 / (_DOF * variance)
        student = (1 + squared) ** (-_DOF / 2 - 1) / (2 * np.pi * variance)
        return np.asarray(np.log((1 - _OUTLIERS) * student + _OUTLIERS / (np.pi * _REACH**2)))

    found = minimize_scalar(
        lambda log_sigma: -float(density(log_sigma).sum()),
        bounds=(np.log(_LEAST_SIGMA), np.log(_MOST_SIGMA)),
        method="bounded",
        options={"xatol": 1e-6},
    )
    return float(np.exp(found.x)), density(float(found.x))
