"""Pose records from estimates, and warnings about units, outliers, noise and lens."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from camcal.arrays import Array
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.estimate.pnp import estimate_poses
from camcal.estimate.poses.records import Correspondences, PoseEstimate, PoseOptions
from camcal.formats.poses.record import PoseRecord
from camcal.messages import Message
from camcal.tasks.poses.pnp_views import Observation

_LIKELY_DISTANCE_M = (0.05, 100.0)  # outside, the points are likely not in metres
_GAP = 100.0  # between lengths of one object, or of two; millimetres and metres differ by 1000
_FEW = 3  # points that make a group of their own
_SUSPICIOUS_PX = 1.0  # RMS; less may be noise
_BETTER = 0.5  # share of the RMS that is left if the lens is the cause
_MOST_TRIED = 20  # views, to find that out
_TOO_LARGE, _UNLIKELY = 1.5, 1e-3  # times the noise that is given, and by chance
_OTHER_CAMERA = 2.0  # times what detection and calibration expect; uncertain lenses leave up to 1.64 in new views
_LITTLE = 10  # degrees of freedom; a standard deviation from fewer is off by a quarter and more


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
    shares = []  # of each camera's image, that the box around the inliers takes
    for view, mask in observation.by_view(estimate.inliers):
        extent = np.ptp(view.pixels[mask], axis=0) if mask.any() else np.zeros(2)
        shares.append(float(np.prod(extent / cameras[view.camera].image_size)))
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
        image_share=max(shares),
        condition=_finite(estimate.condition),
    )


def _status(estimate: PoseEstimate, matched: bool) -> str:
    few = not matched and 2 * estimate.used < len(estimate.inliers)
    if few and estimate.status == "ok":
        return f"weak: {estimate.used} of {len(estimate.inliers)} inliers, fewer than half"
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
    parts = []
    for view, part in observation.by_view(residuals):
        weights = np.tile(np.eye(2), (len(part), 1, 1)) if view.covariance is None else np.linalg.inv(view.covariance)
        parts.append(np.einsum("ni,nij,nj->n", part, weights, part))
    return np.concatenate(parts)


def of_units(estimates: Sequence[PoseEstimate], observations: Sequence[Observation]) -> list[Message]:
    """Return warnings of lengths that are unlikely to be metres, or not all in one unit."""
    distance = float(np.median([np.linalg.norm(estimate.transform.translation) for estimate in estimates]))
    nearest, farthest = _LIKELY_DISTANCE_M
    warnings = []
    if not nearest <= distance <= farthest:
        text = f"median distance of the object {distance:.3g} m: check that the points are in metres"
        warnings.append(Message("unlikely_distance", text, {"distance_m": distance}))
    mixed = [str(observation.pose_key) for observation in observations if _is_mixed(observation)]
    extents = np.array([np.linalg.norm(np.ptp(_points(observation), axis=0)) for observation in observations])
    if mixed:
        text = f"point spacings differ by a factor of more than {_GAP:g}: check that all points are in metres"
        warnings.append(Message("mixed_units", text, where=mixed[0]))
    elif extents.max() > _GAP * extents.min() > 0:
        small, large = (str(observations[int(place)].pose_key) for place in (extents.argmin(), extents.argmax()))
        spans = f"the points of {large} span {extents.max():.3g} m, those of {small} {extents.min():.3g} m"
        warnings.append(Message("mixed_units", f"{spans}: check that all are in metres"))
    return warnings


def _points(observation: Observation) -> Array:
    return np.concatenate([view.points for view in observation.views])


def _is_mixed(observation: Observation) -> bool:
    """Return whether the distances of neighbouring points fall into two groups that are far apart."""
    from scipy.spatial import cKDTree

    points = _points(observation)
    if len(points) < 2 * _FEW:
        return False
    nearest = np.sort(np.ravel(cKDTree(points).query(points, k=[2])[0]))
    apart = nearest[_FEW - 1 : len(points) - _FEW + 1]
    return bool((apart[1:] > _GAP * apart[:-1]).any())


def of_noise(
    estimates: Sequence[PoseEstimate],
    observations: Sequence[Observation],
    calibrated_px: float | None,
    *,
    expected: bool = False,
) -> list[Message]:
    """Return a warning of a noise that was estimated from little, or of a known one that the residuals exceed.

    calibrated_px: what the camera file says of it. expected: whether the pixels' covariances are those that detection
    and the calibration of the camera expect.
    """
    estimate = estimates[0]
    if estimate.degrees_of_freedom is None:
        return _of_given_noise(estimates, observations)
    if estimate.degrees_of_freedom >= _LITTLE:
        times = estimate.noise_scale
        if not expected or times < _OTHER_CAMERA or not _unlikely(times, estimate.degrees_of_freedom):
            return []
        text = (
            f"residuals are {times:.2g} x the noise that detection and calibration expect: the camera file may be of "
            "another camera, focus or zoom"
        )
        return [Message("other_camera", text, {"ratio": float(times)})]
    known = f" (calibration: {calibrated_px:.2g} px)" if calibrated_px else ""
    text = (
        f"noise and standard deviations from {estimate.degrees_of_freedom} degrees of freedom only: set --noise{known}"
    )
    return [Message("few_degrees_of_freedom", text, {"degrees_of_freedom": estimate.degrees_of_freedom})]


def _of_given_noise(estimates: Sequence[PoseEstimate], observations: Sequence[Observation]) -> list[Message]:
    pairs = list(zip(estimates, observations, strict=True))
    squares = sum(float(squared(each.residuals, observation)[each.inliers].sum()) for each, observation in pairs)
    dof = sum(2 * each.used - 6 for each in estimates)
    times = np.sqrt(squares / max(dof, 1)) / estimates[0].noise_scale
    if times < _TOO_LARGE or not _unlikely(times, dof):
        return []
    text = (
        f"residuals are {times:.2g} x the given noise (a-posteriori scale): standard deviations are too small, or the "
        "camera file is of another camera"
    )
    return [Message("residuals_exceed_noise", text, {"ratio": float(times)})]


def _unlikely(times: float, dof: int) -> bool:
    """Return whether residuals are so many times their noise by chance in one of a thousand cases at most."""
    from scipy.special import chdtrc

    return bool(chdtrc(max(dof, 1), dof * times**2) <= _UNLIKELY)


def of_outliers(estimates: Sequence[PoseEstimate], observations: Sequence[Observation]) -> list[Message]:
    """Return a warning where a pose follows from fewer than half of the points: the others may not be by chance."""
    pairs = zip(estimates, observations, strict=True)
    few = [(each, observation) for each, observation in pairs if 2 * each.used < len(each.inliers)]
    if not few:
        return []
    (first, observation), more = few[0], f", as in {len(few) - 1} more poses" if len(few) > 1 else ""
    text = (
        f"{first.used} of {len(first.inliers)} points are inliers{more}: check the order of u and v and the point ids, "
        "and see --draw"
    )
    return [
        Message("few_inliers", text, {"inliers": first.used, "points": len(first.inliers)}, str(observation.pose_key))
    ]


def of_rig(estimates: Sequence[PoseEstimate], observations: Sequence[Observation]) -> list[Message]:
    """Return a warning where nothing that one camera of a rig saw agrees with what the others saw."""
    odd: list[str] = []
    for estimate, observation in zip(estimates, observations, strict=True):
        pairs = observation.by_view(estimate.inliers)
        odd += [f"{observation.pose_key} of camera {view.camera}" for view, mask in pairs if not mask.any()]
    if not odd:
        return []
    more = f", as in {len(odd) - 1} more" if len(odd) > 1 else ""
    text = f"no inliers{more}: pose differs from that of the other cameras; check the rig file and the corner ids"
    return [Message("camera_without_inliers", text, {"images": len(odd)}, odd[0])]


def of_lens(
    camera: Camera, views: Sequence[Correspondences], estimates: Sequence[PoseEstimate], options: PoseOptions
) -> list[Message]:
    """Return a warning where the pixels fit a camera of the same focal lengths without distortion much better.

    They are then of images that are undistorted already. Outliers, which fit neither, are kept in on both sides.
    """
    plain = _without_distortion(camera)
    suspicious = any(each.rms_px > _SUSPICIOUS_PX or each.used < 0.8 * len(each.inliers) for each in estimates)
    if plain is None or not suspicious:
        return []
    all_in = replace(options, outliers="none")
    lens, pinhole = (_rms(each, views[:_MOST_TRIED], all_in) for each in (camera, plain))
    if lens is None or pinhole is None or not (lens > _SUSPICIOUS_PX and pinhole < _BETTER * lens):
        return []
    text = (
        f"reprojection RMS {lens:.2g} px, {pinhole:.2g} px without distortion: if the images are undistorted, use the "
        "camera file that 'camcal undistort' wrote"
    )
    return [Message("already_undistorted", text, {"rms_px": lens, "rms_without_distortion_px": pinhole})]


def _without_distortion(camera: Camera) -> Camera | None:
    """Return the pinhole camera of the same focal lengths and principal point, None where there is no distortion."""
    if camera.model.is_pinhole(camera.parameters):
        return None
    return Camera(model_named("pinhole"), camera.image_size, camera.parameters[:4])


def _rms(camera: Camera, views: Sequence[Correspondences], options: PoseOptions) -> float | None:
    found = [outcome.value for outcome in estimate_poses(camera, views, options) if outcome.value is not None]
    return float(np.sqrt(np.mean([estimate.rms_px**2 for estimate in found]))) if found else None
