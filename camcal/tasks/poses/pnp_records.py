"""From estimates to what is written of them."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.estimate.pnp import PoseEstimate
from camcal.formats.poses.record import PoseRecord
from camcal.tasks.poses.pnp_views import Observation


def record_of(
    estimate: PoseEstimate,
    observation: Observation,
    cameras: Mapping[str | None, Camera],
    *,
    all_solutions: bool,
    matched: bool = False,
) -> PoseRecord:
    """Return what is known of one pose; cameras: by the names that the views have. Of the other minima only the
    likeliest is kept unless all are asked for. matched: the points were matched, so that most may be wrong; those of a
    board or of tags are not.
    """
    lengths = np.linalg.norm(estimate.residuals[estimate.inliers], axis=1)
    ids = np.concatenate(observation.ids)
    return PoseRecord(
        estimate.transform,
        estimate.covariance,
        estimate.noise_covariance,
        _status(estimate, matched),
        rms_px=estimate.rms_px,
        max_px=float(lengths.max()),
        n_points=len(estimate.inliers),
        n_inliers=estimate.used,
        p_wrong=estimate.p_wrong,
        error_ratio=_error_ratio(estimate, observation),
        alternatives=estimate.alternatives if all_solutions else estimate.alternatives[:1],
        outliers=tuple(ids[~estimate.inliers].tolist()),
        planarity=_finite(estimate.planarity),
        least_depth=_finite(estimate.least_depth),
        tilt_rad=estimate.tilt_rad,
        image_share=_image_share(estimate.inliers, observation, cameras),
        condition=_finite(estimate.condition),
    )


def _status(estimate: PoseEstimate, matched: bool) -> str:
    few = not matched and 2 * estimate.used < len(estimate.inliers)
    if few and estimate.status == "ok":
        return f"weak: {estimate.used} of {len(estimate.inliers)} points agree, fewer than half"
    return estimate.status


def typical_sigma(estimates: Sequence[PoseEstimate]) -> float:
    """Return the root mean square, px, of the standard deviations of the inliers' coordinates."""
    counts = np.array([max(estimate.used, 1) for estimate in estimates])
    return float(np.sqrt(np.average([estimate.sigma_px**2 for estimate in estimates], weights=counts)))


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _error_ratio(estimate: PoseEstimate, observation: Observation) -> float | None:
    """Return the root of χ² of the pose over that of the alternative; None without one."""
    if not estimate.alternatives:
        return None
    own = squared(estimate.residuals, observation)[estimate.inliers].sum() / estimate.noise_scale**2
    other = own + estimate.alternatives[0].chi_square_difference
    return float(np.sqrt(own / other)) if other > 0 else 1.0


def squared(residuals: Array, observation: Observation) -> Array:
    """Return the squared lengths (N,) of residuals (N, 2), whitened where the pixels have covariances."""
    ends = np.cumsum([len(view.points) for view in observation.views])[:-1]
    parts = []
    for view, part in zip(observation.views, np.split(residuals, ends), strict=True):
        weights = np.tile(np.eye(2), (len(part), 1, 1)) if view.covariance is None else np.linalg.inv(view.covariance)
        parts.append(np.einsum("ni,nij,nj->n", part, weights, part))
    return np.concatenate(parts)


def _image_share(inliers: Array, observation: Observation, cameras: Mapping[str | None, Camera]) -> float:
    """Return the share of the image that the box around the inliers takes, the largest of a rig's cameras."""
    ends = np.cumsum([len(view.points) for view in observation.views])[:-1]
    shares = []
    for view, mask in zip(observation.views, np.split(inliers, ends), strict=True):
        extent = np.ptp(view.pixels[mask], axis=0) if mask.any() else np.zeros(2)
        shares.append(float(np.prod(extent / cameras[view.camera].image_size)))
    return max(shares)
