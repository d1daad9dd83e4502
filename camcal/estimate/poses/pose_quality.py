"""Quality of estimated poses: covariances, alternatives, statistics of residuals."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, lgamma, log
from typing import NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.estimate.poses import states as se3
from camcal.estimate.poses.inliers import InlierCriterion
from camcal.estimate.poses.moments import covariances, inverses, scaled_eigenvalues
from camcal.estimate.poses.problem import PoseProblems, lowest
from camcal.estimate.poses.records import Alternative, PoseEstimate
from camcal.estimate.poses.states import NEAR_PLANE, Extents
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.solve.descent import REASONS
from camcal.solve.independent import Minima

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
        tilts = _tilts(self.problems, self.extents, best.states)
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


def _tilts(problems: PoseProblems, extents: Extents, states: Array) -> Array:
    """Return the angles (P,) between the planes' normals and the lines of sight from the first camera with points."""
    tilts = np.full(len(states), np.nan)
    for packed, mask in zip(problems.packed_views, problems.masks, strict=True):
        chosen = np.isnan(tilts) & mask.any(axis=1)
        tilts[chosen] = extents.tilt(states[chosen], problems.view[chosen], packed.eye)
    return tilts


def region_quantile(probability: float, dof: int | None, dimensions: int = 6) -> float:
    """Return the largest Mahalanobis distance squared of the region that holds the truth with this probability.

    χ² where the noise was given (dof None). Where it was estimated with `dof` degrees of freedom, Fisher's F
    times the dimensions: at few points χ² regions are far too small.
    """
    from scipy.stats import chi2, f

    if dof is None:
        return float(chi2.ppf(probability, dimensions))
    return float(dimensions * f.ppf(probability, dimensions, dof))
