"""Transforms as text, as plain numbers and as plain data."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from camcal.arrays import Array
from camcal.estimate.pose_average import PoseAverage
from camcal.formats import pose_text
from camcal.formats.pose_text import Form
from camcal.geometry import rotation as so3
from camcal.geometry.frame_graph import Loop
from camcal.geometry.pose import NamedTransform
from camcal.report.uncertain import values_and_stds

_PLACES = 6  # of metres, degrees and quaternions of no known uncertainty
_QUATERNION = ("qw", "qx", "qy", "qz")


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


def lines(transform: NamedTransform, form: Form | None, *, verbose: bool = False) -> list[str]:
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
