"""`camcal transform average` and `check`.

The mean of several estimates of one transform; how far poses, as they are written, are from being any.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from camcal.errors import GateFailed, InvalidInput
from camcal.estimate.pose_average import PoseAverage, average_poses
from camcal.formats.frames import LooseTransform
from camcal.formats.pose_text import LoosePose, form_of
from camcal.geometry import rotation as so3
from camcal.geometry.pose import NamedTransform, Pose, frames_of
from camcal.geometry.rotation import MAX_ORTHONORMALITY_ERROR, Orthogonality, examine
from camcal.messages import Message
from camcal.progress import SILENT, Progress
from camcal.report.rig import plain
from camcal.run.outputs import writes
from camcal.run.pose_sources import read_loose, read_trajectories, read_transforms
from camcal.tasks.frames.options import AverageOptions, CheckOptions, Output
from camcal.tasks.frames.transform import write

EXACT = 1e-6  # what a camera file asks of its rotations
OK = "ok"
INEXACT = "inexact"
REFLECTION = "reflection"
NONE = "no pose"

_FAR = 3.0  # standard deviations of χ² above its mean


@dataclass(frozen=True, eq=False)
class Averaged:
    """The mean as a transform, what it is the mean of, and how these lie about it; weighted: by their covariances."""

    transform: NamedTransform
    estimates: tuple[NamedTransform, ...]
    mean: PoseAverage
    weighted: bool


@writes
def average(options: AverageOptions, progress: Progress = SILENT) -> Averaged:
    """Return the mean of transforms that all have one name, or none.

    Raises InvalidInput for transforms of other frames, FileError, InsufficientData for fewer than two, NotConverged.
    """
    estimates = _estimates(options)
    for item in estimates:
        if item.name != estimates[0].name:
            text = f"{item.called} and {estimates[0].called} are different transforms: a mean is of one"
            raise InvalidInput(text, where=item.where)
    covariances = [item.covariance for item in estimates if item.covariance is not None]
    weighted = not options.equal and bool(estimates) and len(covariances) == len(estimates)
    if covariances and not weighted and not options.equal:
        text = (
            f"{len(estimates) - len(covariances)} of {len(estimates)} estimates have no covariance: equal weights used"
        )
        progress.warn(Message("equal_weights", text, {"without_covariance": len(estimates) - len(covariances)}))
    poses = [item.pose for item in estimates]
    mean = average_poses(poses, covariances if weighted else None, robust=options.robust)
    _warn(mean, progress)
    first = estimates[0]
    result = NamedTransform(first.target, first.source, mean.pose, mean.covariance)
    write(options.output, [result])
    return Averaged(result, estimates, mean, weighted)


def _estimates(options: AverageOptions) -> tuple[NamedTransform, ...]:
    if not options.trajectory:
        return read_transforms(options.sources, form_of(options.form))
    if options.form is not None:
        raise InvalidInput("--form applies to numbers, not to trajectory files")
    return read_trajectories(options.sources)


def average_document(averaged: Averaged, output: Output) -> dict[str, Any]:
    """Return the mean and the estimates as plain data for --json."""
    mean = averaged.mean
    return {
        "transform": plain(averaged.transform, output.numbers),
        "weighted": averaged.weighted,
        "unique": mean.unique,
        "chi_square": mean.chi_square,
        "degrees_of_freedom": mean.degrees_of_freedom,
        "estimates": [
            {"name": item.name or None, "where": item.where, "weight": weight, "offset_m": offset, "angle_deg": angle}
            for item, weight, offset, angle in zip(
                averaged.estimates, mean.weights, mean.offsets, np.degrees(mean.angles), strict=True
            )
        ],
        "output": output.path,
    }


def _warn(mean: PoseAverage, progress: Progress) -> None:
    if not mean.unique:
        largest = float(np.degrees(mean.angles.max()))
        text = f"rotations up to {largest:.0f}° from their mean: the mean may not be unique"
        progress.warn(Message("mean_not_unique", text, {"angle_deg": largest}))
    if mean.chi_square is not None and mean.chi_square > mean.degrees_of_freedom + _FAR * np.sqrt(
        2 * mean.degrees_of_freedom
    ):
        text = (
            f"estimates differ more than their covariances (χ² = {mean.chi_square:.4g}, "
            f"{mean.degrees_of_freedom} degrees of freedom): --equal estimates the covariance from their scatter"
        )
        values = {"chi_square": mean.chi_square, "degrees_of_freedom": mean.degrees_of_freedom}
        progress.warn(Message("inconsistent_estimates", text, values))


@dataclass(frozen=True, eq=False)
class CheckedPose:
    """A pose as it is written, what its nine numbers are, and the verdict: ok, inexact, reflection or no pose."""

    written: LooseTransform
    found: Orthogonality
    verdict: str

    @property
    def called(self) -> str:
        """Where the pose stands, and its name if it has one: all poses of a pose file have the same."""
        name = self.written.name
        return f"{self.written.where}: {name}" if name else self.written.where

    @property
    def row(self) -> list[object]:
        """The cells of a table: name, verdict, orthonormality error, determinant, angle in degrees, length."""
        angle = None if np.isnan(self.found.angle) else float(np.degrees(self.found.angle))
        return [self.called, self.verdict, self.found.error, self.found.determinant, angle, self.written.pose.norm]

    @property
    def failure(self) -> Message:
        """Why it is not a pose."""
        norm = self.written.pose.norm
        if norm is not None and abs(norm - 1) > EXACT:
            return Message("quaternion_norm", f"quaternion norm {norm:.9g}, not 1", {"norm": norm}, self.called)
        if text := self.found.fault(EXACT):
            return Message("not_a_rotation", text, {"determinant": self.found.determinant}, self.called)
        off = self.written.pose.strays
        return Message("last_row", f"last row differs from 0 0 0 1 by {off:.3g}", {"difference": off}, self.called)


@dataclass(frozen=True, eq=False)
class Checked:
    """What was found of every pose, and the nearest poses of those that have one, if that was asked for."""

    poses: tuple[CheckedPose, ...]
    fixed: tuple[NamedTransform, ...]


@writes
def check(options: CheckOptions, _: Progress = SILENT) -> Checked:
    """Return what was found of poses; raises InvalidInput, FileError for what is not even numbers."""
    poses = []
    for written in read_loose(options.sources, form_of(options.form)):
        found = examine(written.pose.matrix)
        poses.append(CheckedPose(written, found, _verdict(written.pose, found)))
    fixed = tuple(_fixed(pose.written) for pose in poses if pose.verdict in {OK, INEXACT}) if options.fix else ()
    if fixed:
        write(options.output, fixed)
    return Checked(tuple(poses), fixed)


def require_good(checked: Checked, *, fix: bool) -> None:
    """Raise GateFailed with the failures of all that are not poses; inexact ones pass if they were to be fixed."""
    passing = {OK, INEXACT} if fix else {OK}
    failures = [pose.failure for pose in checked.poses if pose.verdict not in passing]
    if failures:
        raise GateFailed.of(failures)


def check_document(checked: Checked, output: Output) -> dict[str, Any]:
    """Return what was found as plain data for --json."""
    return {
        "poses": [
            {
                "name": pose.written.name or None,
                "where": pose.written.where,
                "verdict": pose.verdict,
                "orthonormality_error": pose.found.error,
                "determinant": pose.found.determinant,
                "angle_to_nearest_deg": float(np.degrees(pose.found.angle)),
                "quaternion_length": pose.written.pose.norm,
            }
            for pose in checked.poses
        ],
        "fixed": [plain(transform, output.numbers) for transform in checked.fixed],
        "output": output.path,
    }


def _verdict(pose: LoosePose, found: Orthogonality) -> str:
    if found.is_reflection:
        return REFLECTION
    stretched = 0.0 if pose.norm is None else abs(pose.norm - 1)
    if not found.can_be_fixed or stretched > MAX_ORTHONORMALITY_ERROR or pose.strays > EXACT:
        return NONE
    return OK if found.is_rotation(EXACT) and stretched <= EXACT else INEXACT


def _fixed(written: LooseTransform) -> NamedTransform:
    frames = frames_of(written.name) if written.name else ("", "")
    pose = Pose(so3.nearest(written.pose.matrix), written.pose.translation)
    return NamedTransform(*frames, pose, written.covariance, written.where)
