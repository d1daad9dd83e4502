"""`camcal transform average`: the mean of several estimates of one transform."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from camcal.errors import InvalidInput
from camcal.estimate.pose_average import PoseAverage, average_poses
from camcal.formats.pose_text import form_of
from camcal.geometry.named import NamedTransform
from camcal.progress import SILENT, Progress
from camcal.report.transform import plain
from camcal.run.pose_sources import read_trajectories, read_transforms
from camcal.tasks.frames.options import AverageOptions, Output
from camcal.tasks.frames.transform_output import require_own, write

_FAR = 3.0  # standard deviations of χ² above its mean


@dataclass(frozen=True, eq=False)
class Averaged:
    """The mean as a transform, what it is the mean of, and how these lie about it; weighted: by their covariances."""

    transform: NamedTransform
    estimates: tuple[NamedTransform, ...]
    mean: PoseAverage
    weighted: bool


def average(options: AverageOptions, progress: Progress = SILENT) -> Averaged:
    """Return the mean of transforms that all have one name, or none.

    Raises InvalidInput for transforms of other frames, FileError, InsufficientData for fewer than two, NotConverged.
    """
    require_own(options.output, options.sources)
    estimates = _estimates(options)
    _require_one_name(estimates)
    covariances = [item.covariance for item in estimates if item.covariance is not None]
    weighted = not options.equal and bool(estimates) and len(covariances) == len(estimates)
    if covariances and not weighted and not options.equal:
        progress.warn(f"{len(estimates) - len(covariances)} of {len(estimates)} have no covariance: all count alike")
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
        raise InvalidInput("--form is of numbers; a trajectory file says its own by its suffix")
    return read_trajectories(options.sources)


def document(averaged: Averaged, output: Output) -> dict[str, Any]:
    """Return the mean and the estimates as plain data for --json."""
    mean = averaged.mean
    return {
        "transform": plain(averaged.transform, output.numbers),
        "weighted": averaged.weighted,
        "unique": mean.unique,
        "chi_square": mean.chi_square,
        "degrees_of_freedom": mean.freedom,
        "estimates": [
            {"name": item.name or None, "where": item.where, "weight": weight, "offset_m": offset, "angle_deg": angle}
            for item, weight, offset, angle in zip(
                averaged.estimates, mean.weights, mean.offsets, np.degrees(mean.angles), strict=True
            )
        ],
        "output": output.path,
    }


def _require_one_name(estimates: Sequence[NamedTransform]) -> None:
    for item in estimates:
        if item.name != estimates[0].name:
            raise InvalidInput(
                f"{item.called} and {estimates[0].called} are other transforms; a mean is of one", where=item.where
            )


def _warn(mean: PoseAverage, progress: Progress) -> None:
    if not mean.unique:
        progress.warn(f"rotations lie up to {np.degrees(mean.angles.max()):.0f}° from their mean: there may be another")
    if mean.chi_square is not None and mean.chi_square > mean.freedom + _FAR * np.sqrt(2 * mean.freedom):
        progress.warn(
            f"the estimates differ more than their covariances say (χ² = {mean.chi_square:.4g}, "
            f"{mean.freedom} degrees of freedom); with --equal the covariance follows from how they scatter"
        )
