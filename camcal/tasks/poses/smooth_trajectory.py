"""Poses over time, smoothed by `camcal smooth`, and compared with a reference."""

from dataclasses import asdict
from typing import Any

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.estimate.smoothing.poses import PosesOptions, SmoothedPoses, poses_at, smooth_poses
from camcal.estimate.trajectory_error import TrajectoryError, trajectory_error
from camcal.formats import trajectories
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Trajectory
from camcal.progress import Progress
from camcal.report.over_time import Panel, over_time
from camcal.tasks.poses.smooth_options import SmoothOptions
from camcal.tasks.poses.smoothing import Outlier, Smoothing, wanted_stamps

_PARTS = ("translation", "rotation")
_AXES = ("tx, m", "ty, m", "tz, m", "rx, rad", "ry, rad", "rz, rad")


def smooth_trajectory(options: SmoothOptions, progress: Progress) -> Smoothing:
    """Return what came of smoothing poses, everything asked for written."""
    if options.output is not None:
        trajectories.kind_of(options.output, options.kind)
    measured = trajectories.read(options.source, options.frames)
    grid = wanted_stamps(options, measured.stamps)
    reference = None
    if options.reference is not None:
        reference, repeated = trajectories.read_reference(options.reference)
        if repeated:
            progress.warn(f"{options.reference}: left out because their time is repeated: {repeated} of the poses")
    how = PosesOptions(
        options.motion,
        _pair("--q", options.q),
        _pair("--sigma", options.sigma),
        options.method,
        options.robust != "none",
    )
    smoothed = smooth_poses(measured, how)
    shown = smoothed.trajectory if grid is None else poses_at(measured, smoothed, how, grid)
    errors = [
        None if reference is None else trajectory_error(each, reference, options.comparison)
        for each in (measured, shown)
    ]
    if options.output is not None:
        trajectories.write(options.output, shown, options.kind)
    if options.plot is not None:
        files.write_bytes(options.plot, over_time(_panels(measured, smoothed, shown), options.plot.suffix))
    return _smoothing(options, measured, smoothed, shown, (errors[0], errors[1]))


def evaluation(found: Smoothing) -> dict[str, Any] | None:
    """Return errors against a reference before and after smoothing as plain data, None without one."""
    if found.before is None or found.after is None:
        return None
    comparison = found.options.comparison
    return {
        "alignment": comparison.alignment,
        "delta": comparison.delta,
        "delta_unit": comparison.unit,
        "measured": _figures(found.before),
        "smoothed": _figures(found.after),
    }


def _figures(error: TrajectoryError) -> dict[str, Any]:
    parts = {
        "ate_m": error.translation,
        "ate_rad": error.rotation,
        "rpe_m": error.relative_translation,
        "rpe_rad": error.relative_rotation,
    }
    plain = {name: None if figures is None else asdict(figures) for name, figures in parts.items()}
    return {"poses": error.poses, "scale": error.alignment.scale, "pairs": error.pairs, **plain}


def broken_at_half_turns(vectors: Array) -> Array:
    """Return rotation vectors (K, 3) to draw a line through: NaN where they jump to the other way round."""
    jumps = np.linalg.norm(np.diff(vectors, axis=0), axis=1) > np.pi
    return np.where(np.append(False, jumps)[:, None], np.nan, vectors)


def _smoothing(
    options: SmoothOptions,
    measured: Trajectory,
    smoothed: SmoothedPoses,
    shown: Trajectory,
    errors: tuple[TrajectoryError | None, TrajectoryError | None],
) -> Smoothing:
    found = smoothed.trajectory
    shift = np.linalg.norm(measured.translations - found.translations, axis=1)
    turn = so3.angle_between(found.rotations, measured.rotations)
    outliers = [Outlier(int(row), float(measured.stamps[row]), None) for row in np.flatnonzero(smoothed.outliers)]
    return Smoothing(
        options,
        "poses",
        len(measured),
        0,
        shown.stamps,
        dict(zip(_PARTS, smoothed.q, strict=True)),
        {} if smoothed.sigma is None else dict(zip(_PARTS, smoothed.sigma, strict=True)),
        dict(zip(_PARTS, (_rms(shift), _rms(turn)), strict=True)),
        smoothed.log_likelihood,
        smoothed.consistency,
        {"pose": smoothed.nis},
        tuple(outliers),
        *errors,
        tuple(path for path in (options.output, options.plot) if path is not None),
    )


def _panels(measured: Trajectory, smoothed: SmoothedPoses, shown: Trajectory) -> list[Panel]:
    """Return translations, and rotations as vectors from the first one; without what covariances cannot say."""
    first = smoothed.trajectory.rotations[0].T
    lines, points = (_six(poses, first) for poses in (shown, measured))
    lines[:, 3:] = broken_at_half_turns(lines[:, 3:])
    covariances = shown.covariances if shown.covariances is not None else np.zeros((len(shown), 6, 6))
    std = np.sqrt(np.einsum("kii->ki", covariances))
    return [
        Panel(name, (shown.stamps, lines[:, k], std[:, k]), (measured.stamps, points[:, k]), smoothed.outliers)
        for k, name in enumerate(_AXES)
    ]


def _six(poses: Trajectory, first: Array) -> Array:
    return np.hstack([poses.translations, so3.log(poses.rotations @ first)])


def _pair(option: str, numbers: tuple[float, ...] | None) -> tuple[float, float] | None:
    if numbers is None:
        return None
    if len(numbers) != 2:
        raise InvalidInput(f"{option} has {len(numbers)} numbers; poses have two: of translation and of rotation")
    return numbers[0], numbers[1]


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
