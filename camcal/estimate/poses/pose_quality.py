"""Quality of estimated poses: covariances, alternatives, statistics of residuals.

Covariances of poses; weakly determined ones as second moments along the profile of the likelihood.

Where a direction is known to a few degrees only, as of a tag seen from the front or of four points close together, the
pixels are not linear within its region: the valley of the error bends, and one side of it is flatter than the other.
The inverse normal matrix then says too little. There each of the two least known turns is followed to both sides with
the other five parameters at their best. Along that curve, the density is that of the pixels integrated over these five
by Laplace's method, and the second moment about the pose takes the place of the inverse normal matrix, to which it is
equal where the pixels are linear. Source: Tierney & Kadane, JASA 1986 (marginal densities).
"""

from collections.abc import Sequence
from math import exp, lgamma, log
from typing import NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.estimate.poses import states as se3
from camcal.estimate.poses.inliers import InlierCriterion
from camcal.estimate.poses.problem import PoseProblems, inverses, lowest
from camcal.estimate.poses.records import Alternative, PoseEstimate
from camcal.estimate.poses.states import NEAR_PLANE, Extents
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.solve.descent import REASONS
from camcal.solve.independent import Minima, Models

SINGULAR = 1e-10  # smallest eigenvalue of the scaled normal matrix of a pose that the points fix
_LINEAR, _OPEN = 0.02, 1.0  # rad: turns known better are linear, and those known less are not known at all
_MAX_CHI2_DIFFERENCE = 30.0  # χ² over the lowest, from where minima are not worth the time
_TURNS = 2  # the least known ones; the third is about the line of sight, and linear
_NODES = np.arange(-6.0, 7.0)  # standard deviations; the trapezoidal rule is exact for a normal density
_CORRECTIONS = 2  # Newton steps of the five other parameters at a node
_RISE = 1.0  # of the log density behind a low: another minimum begins


def covariances(problems: PoseProblems, minima: Minima, centres: Array, sigma: float) -> Array:
    """Return the covariances (S, 6, 6) of steps of frame_T_object, from minima of frame_T_centre.

    centres: (P, 3) the places in the objects' frames that the points of the problems are counted from. sigma: standard
    deviation of a whitened coordinate.
    """
    offsets = -centres[minima.which]
    result = sigma**2 * inverses(minima.models.normal)
    spread = np.einsum("sii->s", result[:, 3:, 3:])
    bent = np.flatnonzero((spread > _LINEAR**2) & (spread < _OPEN**2))
    if bent.size:
        least = np.full(len(problems.view), np.inf)
        np.minimum.at(least, minima.which, minima.cost)
        worth = 2 * (minima.cost - least[minima.which])[bent] <= _MAX_CHI2_DIFFERENCE * sigma**2
        bent = bent[worth & (scaled_eigenvalues(minima.models.normal[bent])[:, 0] > SINGULAR)]
    if bent.size:
        result[bent] += _excess(problems, minima.take(bent), offsets[bent], result[bent], sigma)
    return _moved(result, minima.states, offsets)


def scaled_eigenvalues(normal: Array) -> Array:
    """Return the eigenvalues (S, P), ascending, of normal matrices (S, P, P) scaled to a unit diagonal."""
    # a parameter on which nothing depends has an eigenvalue of 0
    scale = 1 / np.sqrt(np.maximum(np.einsum("sii->si", normal), np.finfo(float).tiny))
    return np.linalg.eigvalsh(normal * scale[:, :, None] * scale[:, None, :])


def _moved(covariances: Array, states: Array, offsets: Array) -> Array:
    """Return the covariances (S, 6, 6) of a_T_c of those of states a_T_b, with the origin of c at offsets (S, 3)."""
    moves = se3.shift_jacobians(states, offsets)
    return np.asarray(moves @ covariances @ moves.transpose(0, 2, 1))


def _excess(problems: PoseProblems, minima: Minima, offsets: Array, linear: Array, sigma: float) -> Array:
    """Return what second moments about minima have more than their linear covariances (S, 6, 6)."""
    roots = np.linalg.cholesky(linear)
    inverse_roots = np.linalg.inv(roots)
    values, turns = np.linalg.eigh(linear[:, 3:, 3:])
    result = np.zeros_like(linear)
    for turn in range(2, 2 - _TURNS, -1):
        others = turns[:, :, [other for other in range(3) if other != turn]]
        along = np.einsum("sij,sj->si", linear[:, :, 3:], turns[:, :, turn]) / np.sqrt(values[:, turn, None])
        moments = _moments(problems, minima, offsets, along, others, sigma)
        # where the camera loses the object at once, nothing is known beyond the linear covariance
        moments = np.where(np.isfinite(moments).all(axis=(1, 2), keepdims=True), moments, linear)
        # what a curve says less than the linear covariance is an accident of its ends
        excess, axes = np.linalg.eigh(inverse_roots @ moments @ inverse_roots.transpose(0, 2, 1))
        axes = roots @ axes
        result += (axes * np.maximum(excess - 1, 0.0)[:, None, :]) @ axes.transpose(0, 2, 1)
    return result


def _moments(
    problems: PoseProblems, minima: Minima, offsets: Array, along: Array, others: Array, sigma: float
) -> Array:
    """Return the second moments (S, 6, 6) about minima of the curves that begin with the steps `along` (S, 6), of one
    standard deviation; others: (S, 3, 2) the axes of the turns that are free.

    The steps are those of poses with the origin at the offsets (S, 3), which bends them too, as steps of the minima.
    """
    count, nodes = len(along), len(_NODES)
    start, which = np.repeat(minima.states, nodes, axis=0), np.repeat(minima.which, nodes)
    free = np.zeros((count, 6, 5))
    free[:, :3, :3], free[:, 3:, 3:] = np.eye(3), others
    free = np.repeat(free, nodes, axis=0)
    states = se3.retract(start, (_NODES[:, None] * along[:, None]).reshape(-1, 6))
    for _ in range(_CORRECTIONS):
        models = problems.linearise(states, which)
        step, across, density = _across(models, free, sigma)
        states = se3.retract(states, step)
    offsets = np.repeat(offsets, nodes, axis=0)
    placed, about = se3.shifted(states, offsets), se3.shifted(start, offsets)
    turn = so3.log(placed[:, :, :3] @ about[:, :, :3].transpose(0, 2, 1))
    away = np.concatenate([placed[:, :, 3] - about[:, :, 3], turn], axis=1)
    second = away[:, :, None] * away[:, None, :] + _moved(sigma**2 * across, states, offsets)
    second = _moved(second, about, -offsets)
    weights = _weights(density.reshape(count, nodes))
    counted = np.where(weights[:, :, None, None] != 0, second.reshape(count, nodes, 6, 6), 0.0)
    return np.asarray(np.einsum("sk,skij->sij", weights, counted))


def _across(models: Models, free: Array, sigma: float) -> tuple[Array, Array, Array]:
    """Return the steps (T, 6) to the best of the free parameters, their inverse normal matrices (T, 6, 6), and the
    logarithms (T,) of the density integrated over them; free: (T, 6, 5).
    """
    inside = np.isfinite(models.cost)
    normal = np.where(inside[:, None, None], models.normal, np.eye(6))
    gradient = np.where(inside[:, None], models.gradient, 0.0)
    own = free.transpose(0, 2, 1) @ normal @ free
    across = free @ inverses(own) @ free.transpose(0, 2, 1)
    step = -np.einsum("tij,tj->ti", across, gradient)
    cost = models.cost + 0.5 * np.einsum("ti,ti->t", gradient, step)
    density = -cost / sigma**2 - 0.5 * np.linalg.slogdet(own)[1]
    return step, across, np.where(inside, density, -np.inf)


def _weights(density: Array) -> Array:
    """Return the weights (S, K) of the nodes by the logarithms of their densities, zero beyond a low on either side.

    They are NaN where the density of the middle, the minimum itself, is zero.
    """
    middle = len(_NODES) // 2
    peak = density[:, middle, None]
    density = density - np.where(np.isfinite(peak), peak, np.nan)
    for side in (density[:, middle:], density[:, middle::-1]):
        beyond = np.maximum.accumulate(side > np.minimum.accumulate(side, axis=1) + _RISE, axis=1)
        side[beyond] = -np.inf
    weights = np.exp(np.minimum(density, 50.0))
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


_ROUNDED = 1e-6  # px: a noise below is the rounding of numbers, which differs from view to view


@dataclass(frozen=True)
class ResidualNoise:
    """Standard deviation of a whitened pixel coordinate; degrees_of_freedom: of its estimate, None if it was given."""

    sigma: float
    degrees_of_freedom: int | None = None

    def odds(self, difference: Array) -> Array:
        """Return how likely a minimum is whose χ² is larger by `difference` (S,), relative to the lowest.

        exp(-Δ/2) where the noise is known. Where ν degrees of freedom told it, that is integrated over what the noise
        may be: (1 + Δ/ν)^(-ν/2), which tends to the same; for one square tag, 1 over the ratio of the errors squared.
        """
        if self.degrees_of_freedom is None:
            return np.asarray(np.exp(-difference / 2))
        nu = max(self.degrees_of_freedom, 1)
        return np.asarray(np.maximum(1 + difference / nu, np.finfo(float).tiny) ** (-nu / 2))


@dataclass(frozen=True, eq=False)
class PoseQuality:
    """The minima of problems, one or more for each, in their order and the lowest first, and the noise they share.

    centres: (P, 3) the places in the objects' frames that the points of the problems are counted from.
    intrinsics: whether the uncertainty of the lenses, and of where cameras of a rig stand, counts. criterion: what made
    inliers, None where outliers were not searched for. rig_covariance: as in Rig, None for cameras that are independent
    and stand where they are said to.
    """

    problems: PoseProblems
    minima: Minima
    centres: Array
    noise: ResidualNoise
    extents: Extents
    intrinsics: bool
    criterion: InlierCriterion | None
    rig_covariance: Array | None = None

    def estimates(self, frames: str, counts: Sequence[Sequence[int]]) -> list[PoseEstimate]:
        """Return the estimates of the problems; counts: the points of every camera's view, the absent ones included."""
        first = lowest(self.minima)
        ends = np.append(first[1:], len(self.minima.which))
        total, noise = self._covariances()
        found = self._minima(np.repeat(first, ends - first), total, noise)
        best = self.minima.take(first)
        residuals, figures, typical = self._residuals(best.states, counts), self._figures(best), self._typical()
        chances, misfits = self._chances(typical), self._misfits(best)
        return [
            PoseEstimate(
                frames=frames,
                transform=found[at].transform,
                covariance=total[at],
                noise_covariance=noise[at],
                residuals=residuals[problem][0],
                inliers=residuals[problem][1],
                sigma_px=float(self.noise.sigma * typical[problem]),
                noise_scale=self.noise.sigma,
                degrees_of_freedom=self.noise.degrees_of_freedom,
                alternatives=tuple(found[at + 1 : ends[problem]]),
                converged=bool(best.converged[problem]),
                reason=REASONS[best.reason[problem]],
                planarity=figures[problem].planarity,
                least_depth=figures[problem].least_depth,
                tilt_rad=figures[problem].tilt_rad,
                condition=figures[problem].condition,
                chance=chances[problem],
                misfit=misfits[problem],
            )
            for problem, at in enumerate(first)
        ]

    def _covariances(self) -> tuple[Array, Array]:
        """Return the covariances (S, 6, 6) of the minima and the pixels' part of them."""
        noise = covariances(self.problems, self.minima, self.centres, self.noise.sigma)
        known = [packed.camera.covariance is not None for packed in self.problems.packed_views]
        if not self.intrinsics or (self.rig_covariance is None and not any(known)):
            return noise, noise
        if self.rig_covariance is None:
            lenses = _of_lenses(self.problems, self.minima)
        else:
            lenses = _of_rig(self.problems, self.minima, self.rig_covariance)
        moves = se3.shift_jacobians(self.minima.states, -self.centres[self.minima.which])
        return noise + moves @ lenses @ moves.transpose(0, 2, 1), noise

    def _minima(self, best: Array, total: Array, noise: Array) -> list[Alternative]:
        """Return what is said of every minimum; best: (S,) the lowest of the same problem."""
        difference = 2 * (self.minima.cost - self.minima.cost[best]) / self.noise.sigma**2
        odds = self.noise.odds(difference)
        shares = odds / np.bincount(best, odds)[best]
        states = se3.shifted(self.minima.states, -self.centres[self.minima.which])
        rows = zip(
            so3.nearest(states[:, :, :3]),
            states[:, :, 3],
            difference.tolist(),
            shares.tolist(),
            total,
            noise,
            strict=True,
        )
        return [Alternative(Pose(turn, place), *row) for turn, place, *row in rows]

    def _residuals(self, states: Array, counts: Sequence[Sequence[int]]) -> list[tuple[Array, Array]]:
        """Return the residuals (N, 2) and inliers (N,) of each problem, of all cameras one after another."""
        parts = []
        for camera, (packed, mask) in enumerate(zip(self.problems.packed_views, self.problems.masks, strict=True)):
            residuals = packed.residuals(states, self.problems.view).transpose(1, 2, 0)
            residuals[~packed.present[self.problems.view]] = np.nan
            ends = [count[camera] for count in counts]
            parts.append([(row[:end], inside[:end]) for row, inside, end in zip(residuals, mask, ends, strict=True)])
        if len(parts) == 1:
            return parts[0]
        return [
            (np.concatenate([row for row, _ in each]), np.concatenate([inside for _, inside in each]))
            for each in zip(*parts, strict=True)
        ]

    def _typical(self) -> Array:
        """Return the root mean square (P,), px, of the standard deviations that the pixels of problems come with."""
        total = np.zeros(len(self.problems.view))
        for packed, mask in zip(self.problems.packed_views, self.problems.masks, strict=True):
            total += np.where(mask, packed.variances()[self.problems.view], 0.0).sum(axis=1)
        return np.sqrt(total / np.maximum(self.problems.counts, 1))

    def _figures(self, best: Minima) -> list["_Figures"]:
        flatness = self.extents.flatness[self.problems.view]
        # of the planes' normals against the lines of sight from the first camera with points
        tilts = np.full(len(best.states), np.nan)
        for packed, mask in zip(self.problems.packed_views, self.problems.masks, strict=True):
            chosen = np.isnan(tilts) & mask.any(axis=1)
            tilts[chosen] = self.extents.tilt(best.states[chosen], self.problems.view[chosen], packed.eye)
        eigenvalues = scaled_eigenvalues(best.models.normal)
        columns = flatness, _least_depths(self.problems, best.states), eigenvalues[:, -1] / eigenvalues[:, 0], tilts
        rows = zip(*(column.tolist() for column in columns), strict=True)
        return [_Figures(flat, depth, cond, tilt if flat < NEAR_PLANE else None) for flat, depth, cond, tilt in rows]

    def _misfits(self, best: Minima) -> list[float]:
        dof = np.maximum(2 * self.problems.counts - (6 if self.problems.anchor is None else 0), 1)
        noise = max(self.noise.sigma, _ROUNDED)
        return [float(misfit) for misfit in np.sqrt(2 * best.cost / dof) / noise]

    def _chances(self, typical: Array) -> list[float]:
        """Return how many poses with as many inliers are expected among pixels anywhere in the image.

        Source: Moisan & Stival, A Probabilistic Criterion to Detect Rigid Point Matches Between Two Images, IJCV 2004
        (the number of false alarms), for samples of three points.
        """
        if self.criterion is None:
            return [0.0] * len(self.problems.view)
        limits = self.criterion.threshold * (np.ones_like(typical) if self.criterion.in_pixels else typical)
        points = sum(packed.present[self.problems.view].sum(axis=1) for packed in self.problems.packed_views)
        area = max(float(np.prod(packed.camera.image_size)) for packed in self.problems.packed_views)
        shares = np.minimum(np.pi * limits**2 / area, 1.0)
        rows = zip(np.asarray(points).tolist(), self.problems.counts.tolist(), shares.tolist(), strict=True)
        return [_chance(of, inliers, share) for of, inliers, share in rows]


def _chance(points: int, inliers: int, share: float) -> float:
    """Return the number of poses expected; share: of the image's area that makes an inlier."""

    def log_choices(of: int, chosen: int) -> float:
        return lgamma(of + 1) - lgamma(chosen + 1) - lgamma(of - chosen + 1)

    log_sets = log(max(points - 3, 1)) + log_choices(points, inliers) + log_choices(inliers, 3)
    return exp(log_sets + (inliers - 3) * log(share))


class _Figures(NamedTuple):
    """Figures of a pose, as in PoseEstimate."""

    planarity: float
    least_depth: float
    condition: float
    tilt_rad: float | None


def _of_lenses(problems: PoseProblems, minima: Minima) -> Array:
    """Return G Σ Gᵀ (S, 6, 6) summed over the cameras with a covariance Σ, where G = -H⁻¹ Jᵀ J_K."""
    inverse = inverses(minima.models.normal)
    total = np.zeros_like(inverse)
    for camera, packed in enumerate(problems.packed_views):
        if packed.camera.covariance is not None:
            gain = inverse @ problems.by_lens(minima.states, minima.which, camera)
            total += gain @ packed.camera.covariance @ gain.transpose(0, 2, 1)
    return total


def _of_rig(problems: PoseProblems, minima: Minima, covariance: Array) -> Array:
    """Return G Σ Gᵀ (S, 6, 6), where G = -H⁻¹ Jᵀ J_C of what a rig's calibration knows with covariance Σ: of every
    camera its parameters and where it stands.
    """
    states, which = minima.states, minima.which
    by = [
        each(states, which, camera)
        for camera in range(len(problems.packed_views))
        for each in (problems.by_lens, problems.by_frame)
    ]
    gain = inverses(minima.models.normal) @ np.concatenate(by, axis=2)
    return np.asarray(gain @ covariance @ gain.transpose(0, 2, 1))


def _least_depths(problems: PoseProblems, states: Array) -> Array:
    """Return the smallest z (P,) of an inlier in the frame of a camera that sees it."""
    least = np.full(len(states), np.inf)
    for packed, mask in zip(problems.packed_views, problems.masks, strict=True):
        camera_T_object = se3.compose(se3.of_poses([packed.frame]), states)
        depth = np.einsum("sj,jsn->sn", camera_T_object[:, 2, :3], packed.points[:, problems.view])
        depth += camera_T_object[:, 2, 3:]
        least = np.minimum(least, np.where(mask, depth, np.inf).min(axis=1))
    return least


def region_quantile(probability: float, dof: int | None, dimensions: int = 6) -> float:
    """Return the largest Mahalanobis distance squared of the region that holds the truth with this probability.

    χ² where the noise was given (dof None). Where it was estimated with `dof` degrees of freedom, Fisher's F
    times the dimensions: at few points χ² regions are far too small.
    """
    from scipy.stats import chi2, f

    if dof is None:
        return float(chi2.ppf(probability, dimensions))
    return float(dimensions * f.ppf(probability, dimensions, dof))
