"""Transforms and the calibration of a rig as text and as plain data."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.rigs.record import ExposureMotion, RigCalibration
from camcal.estimate.pose_average import PoseAverage
from camcal.formats import pose_text
from camcal.formats.pose_text import Form
from camcal.geometry import rotation as so3
from camcal.geometry.frame_graph import Loop
from camcal.geometry.pose import NamedTransform, Pose
from camcal.quality.rig_geometry import PairGeometry, baseline, rotation_angle
from camcal.report.calibration import time_lines
from camcal.report.table import Column, number_text, value_and_std, values_and_stds

_PLACES = 6  # of metres, degrees and quaternions of no known uncertainty
_QUATERNION = ("qw", "qx", "qy", "qz")

CAMERA_COLUMNS = (
    Column("camera"),
    Column("lens model"),
    Column("size", priority=3),
    Column("fx", "px"),
    Column("± std"),
    Column("views"),
    Column("corners", priority=2),
    Column("RMS", "px"),
    Column("noise", "px", priority=1),
)
TRANSFORM_COLUMNS = (
    Column("transform"),
    Column("baseline", "mm"),
    Column("± std"),
    Column("rotation", "deg"),
    Column("± std"),
)
PAIR_COLUMNS = (
    Column("pair"),
    Column("baseline", "mm"),
    Column("± std"),
    Column("rotation", "deg", priority=2),
    Column("± std", priority=2),
    Column("vergence", "deg"),
    Column("common field", "%"),
    Column("epipolar error", "px", priority=1),
)
DEPTH_COLUMNS = (
    Column("distance", "m"),
    Column("baselines", priority=1),
    Column("by matching", "mm"),
    Column("by calibration", "mm"),
    Column("common field", "%", priority=2),
)


def plain(transform: NamedTransform, form: Form | None) -> dict[str, Any]:
    """Return a transform as plain data for --json; name: None where it has none."""
    pose, covariance = transform.pose, transform.covariance
    return {
        "name": transform.name or None,
        "R": pose.rotation,
        "t": pose.translation,
        "quaternion": dict(zip(_QUATERNION, so3.to_quaternion(pose.rotation).tolist(), strict=True)),
        "rotation_vector": pose.vector(),
        "std": None if covariance is None else _std(covariance),
        "covariance": covariance,
        "form": None if form is None else str(form),
        "numbers": None if form is None else form.numbers(pose),
        "gimbal_lock": form is not None and form.locked(pose),
    }


def plain_loop(loop: Loop) -> dict[str, Any]:
    """Return how far a loop is from closing as plain data for --json."""
    return {
        "factors": loop.names,
        "offset_m": loop.offset,
        "angle_deg": float(np.degrees(loop.angle)),
        "chi_square": loop.chi_square,
    }


def transform_lines(transform: NamedTransform, form: Form | None, *, verbose: bool = False) -> list[str]:
    """Return a transform as lines: bare numbers in a form, or words with standard deviations, verbose with R too."""
    if form is not None:
        return pose_text.text_of(transform, form).splitlines()
    pose = transform.pose
    std = None if transform.covariance is None else _std(transform.covariance)
    quaternion = so3.to_quaternion(pose.rotation)
    found = [_title(transform), _row("t, m", pose.translation, None if std is None else std[:3])]
    turned = None if std is None else np.degrees(std[3:])
    found.append(_row("rotation vector, deg", np.degrees(pose.vector()), turned))
    found.append(_row("quaternion w x y z", quaternion, None))
    if verbose:
        found += [_row("R" if not row else "", numbers, None) for row, numbers in enumerate(pose.rotation)]
    return found


def loop_lines(loops: Sequence[Loop]) -> list[str]:
    """Return how far loops are from closing and what this means for the way that was taken, in words."""
    found = [_loop_line(loop) for loop in loops]
    rule = "the path with the fewest transforms is used; loops check the others"
    return [*found, rule] if found else []


def _loop_line(loop: Loop) -> str:
    chi_square = "" if loop.chi_square is None else f", χ² = {loop.chi_square:.3g} with 6 degrees of freedom"
    far = f"{1000 * loop.offset:.3g} mm and {np.degrees(loop.angle):.3g}°{chi_square}"
    return f"the loop {' * '.join(loop.names)} closes to {far}"


def average_line(mean: PoseAverage, *, weighted: bool) -> str:
    """Return what a mean is of, in words."""
    how = "weighted by their covariances" if weighted else "all alike"
    if mean.chi_square is None:
        return f"the mean of {len(mean.weights)} poses, {how}; ± from their scatter"
    consistency = f"χ² = {mean.chi_square:.4g}, {mean.degrees_of_freedom} degrees of freedom"
    return f"the mean of {len(mean.weights)} poses, {how}; {consistency}"


def estimate_rows(estimates: Sequence[NamedTransform], mean: PoseAverage) -> list[list[object]]:
    """Return a row for each pose: where it stands, its weight, mm and degrees from the mean."""
    return [
        [item.where or item.name, float(weight), 1000 * float(offset), float(np.degrees(angle))]
        for item, weight, offset, angle in zip(estimates, mean.weights, mean.offsets, mean.angles, strict=True)
    ]


def _title(transform: NamedTransform) -> str:
    if not transform.name:
        return f"{transform.where or 'pose'}:"
    return f"{transform.name}: takes points in {transform.source} to points in {transform.target}"


def _row(name: str, numbers: Array, std: Array | None) -> str:
    numbers = np.round(numbers, _PLACES if std is None else 12) + 0.0
    if std is None:
        return f"  {name:<20}  {' '.join(f'{number:.9g}' for number in numbers)}"
    return f"  {name:<20}  {'  ± '.join(values_and_stds(numbers, std))}"


def _std(covariance: Array) -> Array:
    return np.asarray(np.sqrt(np.maximum(np.diag(covariance), 0.0)))


def camera_rows(calibration: RigCalibration) -> list[list[object]]:
    """Return what is listed of every camera under CAMERA_COLUMNS."""
    rows: list[list[object]] = []
    for name, own in calibration.calibrations.items():
        camera = own.camera
        focal = value_and_std(camera.value("fx"), camera.std("fx"))
        size = "{}x{}".format(*camera.image_size)
        figures = [len(own.used), len(own.residuals), f"{own.rms_px:.3f}", f"{own.sigma_px:.3f}"]
        rows.append([name, camera.model.name, size, *focal, *figures])
    return rows


def transform_rows(calibration: RigCalibration) -> list[list[object]]:
    """Return what is listed of every transform under TRANSFORM_COLUMNS; lengths in mm, angles in degrees."""
    rows: list[list[object]] = []
    for name, pose in calibration.transforms.items():
        covariance = calibration.transform_covariance(name)
        length, angle = baseline(pose, covariance), rotation_angle(pose, covariance)
        degree = float(np.degrees(1.0))
        cells = [
            *value_and_std(1e3 * length.value, _times(1e3, length.std)),
            *value_and_std(degree * angle.value, _times(degree, angle.std)),
        ]
        rows.append([name, *cells])
    return rows


def lines(calibration: RigCalibration) -> Iterator[str]:
    """Yield what is said of a rig beside its tables, a line each."""
    if calibration.epipolar_rms_px is not None:
        yield f"Epipolar error {calibration.epipolar_rms_px:.3f} px RMS"
    if calibration.motion is not None:
        yield motion_words(calibration.motion)
    for name, (scale, std) in calibration.scales.items():
        value, spread = value_and_std(scale, std)
        yield f"Board{name and f' {name}'}: {value} ± {spread} times its nominal size, by the measured distances"
    yield from time_lines(calibration.times)
    for name, why in calibration.unlinked.items():
        yield f"not linked: {name}: {why}"


def pair_rows(pairs: Sequence[PairGeometry]) -> list[list[object]]:
    """Return what is listed of pairs of cameras under PAIR_COLUMNS."""
    rows: list[list[object]] = []
    for pair in pairs:
        length = value_and_std(1e3 * pair.baseline.value, _times(1e3, pair.baseline.std))
        angle = value_and_std(np.degrees(pair.rotation.value), _times(float(np.degrees(1.0)), pair.rotation.std))
        vergence = f"{'+' if pair.converging else '-'}{np.degrees(pair.vergence):.2f}"
        common = " / ".join(f"{100 * share:.0f}" for share in pair.common)
        epipolar = "" if pair.epipolar_px is None else f"{pair.epipolar_px:.2g}"
        rows.append([f"{pair.first}, {pair.second}", *length, *angle, vergence, common, epipolar])
    return rows


def depth_rows(pair: PairGeometry) -> list[list[object]]:
    """Return what is listed of the depth errors of a pair under DEPTH_COLUMNS, of distances with points in both images;
    empty cells where the calibration has no covariance.
    """
    return [
        [
            f"{own.distance:.3g}",
            f"{own.distance / pair.baseline.value:.3g}",
            *("" if std is None else number_text(1e3 * std, 2) for std in (own.matching, own.calibration)),
            f"{100 * own.common:.0f}",
        ]
        for own in pair.depths
        if own.matching is not None
    ]


def _times(factor: float, std: float | None) -> float | None:
    return None if std is None else factor * std


def motion_words(motion: ExposureMotion) -> str:
    """Return how far the board moved between the exposures of a capture, in words."""
    median, largest = 1e3 * motion.median, 1e3 * motion.largest
    return f"The board moved {median:.2g} mm (median) between the exposures of a capture, at most {largest:.2g} mm"


def scales_data(scales: Mapping[str, tuple[float, float]]) -> dict[str, dict[str, float]]:
    """Return the scales of boards by their names as plain data."""
    return {name or "board": {"scale": value, "std": std} for name, (value, std) in scales.items()}


def motion_data(motion: ExposureMotion | None) -> dict[str, float] | None:
    """Return the motion of the board between exposures as plain data, m."""
    if motion is None:
        return None
    return {"std_m": motion.std, "median_m": motion.median, "largest_m": motion.largest}


def transform_data(pose: Pose, covariance: Array) -> dict[str, Any]:
    """Return a transform with its baseline and rotation as plain data; m, degrees."""
    length, angle = baseline(pose, covariance), rotation_angle(pose, covariance)
    return {
        "R": pose.rotation.tolist(),
        "t": pose.translation.tolist(),
        "covariance": covariance.tolist(),
        "baseline_m": length.value,
        "baseline_std_m": length.std,
        "rotation_deg": float(np.degrees(angle.value)),
        "rotation_std_deg": None if angle.std is None else float(np.degrees(angle.std)),
    }
