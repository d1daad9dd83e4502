"""`camcal transform convert --trajectory`: poses over time along other axes, in another file."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from camcal.errors import InvalidInput
from camcal.formats import trajectories
from camcal.geometry.axes import reexpress, reexpress_jacobian
from camcal.geometry.named import frames_of
from camcal.geometry.pose import Trajectory, inverse_jacobian
from camcal.progress import SILENT, Progress
from camcal.run.outputs import refuse_overwriting
from camcal.run.pose_sources import split_name
from camcal.tasks.frames.options import ConvertOptions
from camcal.tasks.frames.transform_convert import (
    AxesChange,
    changes_of,
    matrices_of,
    plain_changes,
    require_known,
)

_KINDS = {"tum": "tum", "kitti": "kitti", "ros": "tf"}


@dataclass(frozen=True, eq=False)
class ConvertedTrajectory:
    """What was written: poses over time, and the changes of axes."""

    trajectory: Trajectory
    changes: tuple[AxesChange, ...]
    output: Path


def convert_trajectory(options: ConvertOptions, progress: Progress = SILENT) -> ConvertedTrajectory:
    """Return what was written to the output: the trajectory of the one source, in other axes or another form.

    Raises InvalidInput as `convert` does, and without an output, FileError.
    """
    output, form = options.output.path, options.output.form
    if len(options.sources) != 1 or output is None:
        raise InvalidInput("--trajectory takes one file, and --output for where it goes")
    if form is not None and form not in _KINDS:
        raise InvalidInput(f"--as {form}: a trajectory is written as {', '.join(_KINDS)}, or as its suffix says")
    if options.form is not None:
        raise InvalidInput("--form is of numbers; a trajectory file says its own by its suffix")
    name, body = split_name(options.sources[0])
    refuse_overwriting([output], [Path(body)])
    kind = trajectories.kind_of(output, None if form is None else _KINDS[form])
    trajectory = trajectories.read(Path(body), name or None)
    if options.inverse:
        trajectory = _inverse(trajectory, progress)
    changes = changes_of(options.axes)
    frames = frames_of(trajectory.frames)
    require_known(changes, set(frames))
    trajectory = _along(trajectory, changes, frames)
    trajectories.write(output, trajectory, kind)
    return ConvertedTrajectory(trajectory, tuple(changes.values()), output)


def document(converted: ConvertedTrajectory) -> dict[str, Any]:
    """Return what was written as plain data for --json, under the keys of `transform_convert.document`."""
    trajectory = converted.trajectory
    return {
        "transforms": [],
        "axes": plain_changes(converted.changes),
        "principal_points": [],
        "trajectory": {
            "frames": trajectory.frames,
            "poses": len(trajectory),
            "start_s": float(trajectory.stamps[0]) if len(trajectory) else None,
            "end_s": float(trajectory.stamps[-1]) if len(trajectory) else None,
            "covariances": trajectory.covariances is not None,
        },
        "output": converted.output,
    }


def _inverse(trajectory: Trajectory, progress: Progress) -> Trajectory:
    """Return the poses in the other direction; velocities are of the moving frame in the fixed one and are left out."""
    if trajectory.velocities is not None:
        progress.warn("velocities are left out of inverted poses")
    poses = [trajectory.pose(index) for index in range(len(trajectory))]
    inverses = [pose.inverse() for pose in poses]
    covariances = trajectory.covariances
    if covariances is not None:
        jacobians = np.array([inverse_jacobian(pose) for pose in poses]).reshape(-1, 6, 6)
        covariances = jacobians @ covariances @ np.swapaxes(jacobians, 1, 2)
    a, b = frames_of(trajectory.frames)
    inverted = Trajectory.of(f"{b}_T_{a}", trajectory.stamps, inverses)
    return replace(inverted, covariances=covariances, segments=trajectory.segments)


def _along(trajectory: Trajectory, changes: dict[str, AxesChange], frames: tuple[str, str]) -> Trajectory:
    change_a, change_b = matrices_of(changes, frames)
    poses = [reexpress(trajectory.pose(index), change_a, change_b) for index in range(len(trajectory))]
    jacobian = reexpress_jacobian(change_a)
    covariances, velocities = trajectory.covariances, trajectory.velocities
    return replace(
        Trajectory.of(trajectory.frames, trajectory.stamps, poses),
        covariances=None if covariances is None else jacobian @ covariances @ jacobian.T,
        velocities=None if velocities is None else velocities @ jacobian.T,
        segments=trajectory.segments,
    )
