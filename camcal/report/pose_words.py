"""Poses as text and tables."""

import math

import numpy as np

from camcal.arrays import Array
from camcal.formats.poses.record import PoseKey, PoseRecord, Poses
from camcal.report.table import Column
from camcal.report.uncertain import values_and_stds

MILLI = 1000.0
_STATUS = Column("status", wraps=True)
_NEAR = 1.5  # a-posteriori scales up to this, and down to its inverse, are what real corners have


def columns(poses: Poses) -> list[Column]:
    """Return the columns of a table of poses."""
    named = [Column("object")] if any(pose_key.object for pose_key in poses.estimates) else []
    length = _length(poses)
    quality = [Column("points", priority=5), Column("RMS", "px", priority=2)]
    place = [Column("x y z", length), Column("± std", length, priority=3)]
    turn = [Column("rotation vector", "deg", priority=1), Column("± std", "deg", priority=4)]
    return [Column("image", file=True), *named, *quality, *place, *turn, Column("seen from", priority=6), _STATUS]


def alternative_columns(poses: Poses) -> list[Column]:
    """Return the columns of a table of other poses."""
    place, turn = Column("x y z", _length(poses)), Column("rotation vector", "deg")
    return [Column("image", file=True), place, turn, Column("χ² above", priority=1), Column("probability")]


def row(poses: Poses, pose_key: PoseKey, record: PoseRecord) -> list[object]:
    """Return the cells of one pose."""
    named = [pose_key.object] if any(other.object for other in poses.estimates) else []
    scale = MILLI if poses.unit == "m" else 1.0
    place = values_and_stds(scale * record.transform.translation, scale * record.std[:3])
    turn = values_and_stds(np.degrees(record.transform.vector()), np.degrees(record.std[3:]))
    fit = points(record), f"{record.rms_px:.3g}"
    return [pose_key.image, *named, *fit, *place, *turn, standpoint(poses, record), record.status]


def alternative_rows(poses: Poses, pose_key: PoseKey, record: PoseRecord) -> list[list[object]]:
    """Return the cells of the other poses that an image allows."""
    scale = MILLI if poses.unit == "m" else 1.0
    return [
        [
            str(pose_key),
            _numbers(scale * other.transform.translation, ".3f"),
            _numbers(np.degrees(other.transform.vector()), ".3f"),
            other.chi_square_difference,
            f"{other.probability:.2g}",
        ]
        for other in record.alternatives
    ]


def points(record: PoseRecord) -> str:
    """Return how many points a pose follows from, such as 54, or 50 of 54."""
    return str(record.n_points) if record.n_points == record.n_inliers else f"{record.n_inliers} of {record.n_points}"


def standpoint(poses: Poses, record: PoseRecord) -> str:
    """Return where the camera stands, such as '0.712 m away, 38° oblique', 0° being straight in front of a plane."""
    away = f"{np.linalg.norm(record.transform.translation):.3g} {poses.unit} away"
    return away if record.tilt_rad is None else f"{away}, {math.degrees(record.tilt_rad):.0f}° oblique"


def noise(poses: Poses) -> str:
    """Return how large the noise of a pixel coordinate is and where that is known from.

    How far the residuals are from what the pixels came with is said only where that is more than chance and habit.
    """
    found = poses.noise
    size, dof = f"noise {found.sigma_px:.3g} px", f"{found.degrees_of_freedom} degrees of freedom"
    if found.degrees_of_freedom is None:
        return f"{size}, as given"
    if found.scale is None:
        return f"{size}, from the residuals, {dof}"
    if 1 / _NEAR <= found.scale <= _NEAR:
        return f"{size}, by the corner standard deviations, consistent with the residuals"
    return f"{size}: the residuals are {found.scale:.3g} x the corner standard deviations (a-posteriori scale, {dof})"


def caption(poses: Poses, pose_key: PoseKey, record: PoseRecord) -> str:
    """Return a line about a pose in plain letters, for a picture."""
    named = f"{pose_key.object}: " if pose_key.object else ""
    place = standpoint(poses, record).replace("°", " deg")
    return f"{named}{place}; RMS {record.rms_px:.2f} px, {points(record)} points; {record.status}".replace("±", "+-")


def _length(poses: Poses) -> str:
    """Return the unit that lengths are shown in."""
    return "mm" if poses.unit == "m" else poses.unit


def _numbers(values: Array, form: str) -> str:
    return " ".join(format(value, form) for value in values)
