"""`camcal transform convert` and `points`: poses in other forms, along other axes and over time;
points to another frame.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass, replace
from camcal.errors import InsufficientData, InvalidInput
from camcal.formats import cameras, correspondences, pointclouds, trajectories
from camcal.formats.correspondences import PointTable
from camcal.formats.pointclouds.record import MILLIMETRES, PointCloudFile, cloud_of
from camcal.formats.pose_text import form_of
from camcal.geometry.pose import (
    Axes,
    NamedTransform,
    Trajectory,
    carried,
    change,
    convention_named,
    frames_of,
    inverse_jacobian,
    point_jacobian,
    reexpress,
    reexpress_jacobian,
)
from camcal.messages import Message
from camcal.parsing import did_you_mean
from camcal.progress import SILENT, Progress
from camcal.report.rig import plain
from camcal.run.outputs import writes
from camcal.run.pose_sources import files_of, read_one, read_transforms, split_name
from camcal.stereo.depth import METRES, NORMAL, POSITION, VertexStream
from camcal.tasks.options import CAMERA_SUFFIXES
from camcal.tasks.transform import write
from camcal.tasks.transform_options import ConvertOptions, Output, PointsOptions

_UNNAMED = ("a", "b")
_KINDS = {"tum": "tum", "kitti": "kitti", "ros": "tf"}


@dataclass(frozen=True)
class AxesChange:
    """A frame whose axes point elsewhere from now on."""

    frame: str
    before: Axes
    after: Axes

    @classmethod
    def parse(cls, text: str) -> "AxesChange":
        """Return the change that a text such as camera=opencv:opengl says; raises InvalidInput for another text."""
        frame, equals, conventions = text.partition("=")
        before, colon, after = conventions.partition(":")
        if not (frame and equals and colon):
            raise InvalidInput(f"--axes {text!r}: write FRAME=FROM:TO, such as camera=opencv:opengl")
        return cls(frame, convention_named(before), convention_named(after))

    @property
    def matrix(self) -> Array:
        """The matrix (3, 3) that takes coordinates along the old axes to those along the new ones."""
        return change(self.before, self.after)


def _changes_of(axes: Sequence[str]) -> dict[str, AxesChange]:
    """Return changes of axes by frame; raises InvalidInput for a frame that is changed twice."""
    changes = [AxesChange.parse(text) for text in axes]
    by_frame = {item.frame: item for item in changes}
    if len(by_frame) < len(changes):
        raise InvalidInput("--axes: frame given twice")
    return by_frame


@dataclass(frozen=True)
class PrincipalPoint:
    """Where a camera's principal point is, px, if the centre of the top-left pixel is counted as its axes' users do."""

    camera: str
    convention: str
    cx: float
    cy: float


@dataclass(frozen=True, eq=False)
class Converted:
    """Transforms, the changes of axes, and principal points of cameras whose pixels are counted from elsewhere."""

    transforms: tuple[NamedTransform, ...]
    changes: tuple[AxesChange, ...]
    principal_points: tuple[PrincipalPoint, ...]


@writes
def convert(options: ConvertOptions, progress: Progress = SILENT) -> Converted:
    """Return transforms along other axes.

    Raises InvalidInput for a frame or convention that is not there and where one frame alone would become left-handed,
    InsufficientData where there is nothing to convert, FileError.
    """
    transforms = read_transforms(options.sources, form_of(options.form), allow_none=True)
    centres = _principal_points_of(options.sources, progress)
    if not transforms and not centres:
        raise InsufficientData("no transforms and no cameras", where=" ".join(options.sources))
    if options.inverse:
        transforms = tuple(item.inverse() for item in transforms)
    changes = _changes_of(options.axes)
    require_known(changes, {*centres, *(frame for item in transforms for frame in _frames_in(item))})
    converted = tuple(_along(item, changes) for item in transforms)
    points = tuple(_counted_from_corners(centres, changes))
    for point in points:
        text = (
            f"principal point in {point.convention}: cx {point.cx:.9g}, cy {point.cy:.9g} (pixel origin at the corner "
            "of the image)"
        )
        values = {"cx": point.cx, "cy": point.cy}
        progress.warn(Message("pixel_origin_differs", text, values, point.camera))
    write(options.output, converted)
    return Converted(converted, tuple(changes.values()), points)


def document(converted: Converted, output: Output) -> dict[str, Any]:
    """Return transforms and what was changed as plain data for --json."""
    return {
        "transforms": [plain(transform, output.numbers) for transform in converted.transforms],
        "axes": _plain_changes(converted.changes),
        "principal_points": [vars(point) for point in converted.principal_points],
        "trajectory": None,
        "output": output.path,
    }


def _plain_changes(changes: Sequence[AxesChange]) -> list[dict[str, Any]]:
    """Return changes of axes as plain data for --json."""
    return [
        {
            "frame": item.frame,
            "from": item.before.name,
            "to": item.after.name,
            "words": item.after.words,
            "left_handed": item.after.left_handed,
            "pixel_centre": item.after.pixel_centre,
        }
        for item in changes
    ]


def _frames_in(transform: NamedTransform) -> tuple[str, str]:
    """Return the frames of a transform, a and b where it has no names."""
    return (transform.target, transform.source) if transform.name else _UNNAMED


def require_known(changes: Mapping[str, AxesChange], frames: set[str]) -> None:
    """Raise InvalidInput for a change of a frame that is not there."""
    for frame in changes:
        if frame not in frames:
            known = sorted(frames)
            raise InvalidInput(f"--axes: no frame {frame!r}{did_you_mean(frame, known)}")


def _matrices_of(changes: Mapping[str, AxesChange], frames: tuple[str, str]) -> tuple[Array, Array]:
    """Return the matrices (3, 3) that change the axes of two frames."""
    a, b = (changes[frame].matrix if frame in changes else np.eye(3) for frame in frames)
    return a, b


def _along(transform: NamedTransform, changes: Mapping[str, AxesChange]) -> NamedTransform:
    change_a, change_b = _matrices_of(changes, _frames_in(transform))
    try:
        pose = reexpress(transform.pose, change_a, change_b)
    except InvalidInput as error:
        raise InvalidInput(f"{transform.called}: {error.message}", where=transform.where or None) from error
    return replace(transform, pose=pose, covariance=carried(reexpress_jacobian(change_a), transform.covariance))


def _principal_points_of(sources: Sequence[str], progress: Progress) -> dict[str, tuple[float, float]]:
    """Return cx and cy (px) of the cameras of camera files among the sources, which count from pixel centres."""
    found: dict[str, tuple[float, float]] = {}
    for path in dict.fromkeys(files_of(sources)):
        if path.suffix.lower() in CAMERA_SUFFIXES and cameras.is_camera_file(path):
            known = {name: entry.camera for name, entry in cameras.read(path, progress).cameras.items()}
            found |= {name: (camera.value("cx"), camera.value("cy")) for name, camera in known.items()}
    return found


def _counted_from_corners(
    centres: Mapping[str, tuple[float, float]], changes: Mapping[str, AxesChange]
) -> Iterator[PrincipalPoint]:
    """Yield principal points where the users of a camera's new axes count pixels from elsewhere than camcal does."""
    for name, (cx, cy) in centres.items():
        item = changes.get(name)
        if item is not None and item.after.pixel_centre:
            shift = item.after.pixel_centre
            yield PrincipalPoint(name, item.after.name, cx + shift, cy + shift)


@dataclass(frozen=True, eq=False)
class ConvertedTrajectory:
    """What was written: poses over time, and the changes of axes."""

    trajectory: Trajectory
    changes: tuple[AxesChange, ...]
    output: Path


@writes
def convert_trajectory(options: ConvertOptions, progress: Progress = SILENT) -> ConvertedTrajectory:
    """Return what was written to the output: the trajectory of the one source, in other axes or another form.

    Raises InvalidInput as `convert` does, and without an output, FileError.
    """
    output, form = options.output.path, options.output.form
    if len(options.sources) != 1 or output is None:
        raise InvalidInput("--trajectory needs one file and --output")
    if form is not None and form not in _KINDS:
        raise InvalidInput(f"--as {form}: a trajectory is written as {', '.join(_KINDS)}, or as its suffix says")
    if options.form is not None:
        raise InvalidInput("--form applies to numbers, not to trajectory files")
    name, body = split_name(options.sources[0])
    kind = trajectories.kind_of(output, None if form is None else _KINDS[form])
    trajectory = trajectories.read(Path(body), name or None)
    if options.inverse:
        trajectory = _inverse_trajectory(trajectory, progress)
    changes = _changes_of(options.axes)
    frames = frames_of(trajectory.frames)
    require_known(changes, set(frames))
    trajectory = _trajectory_along(trajectory, changes, frames)
    trajectories.write(output, trajectory, kind)
    return ConvertedTrajectory(trajectory, tuple(changes.values()), output)


def trajectory_document(converted: ConvertedTrajectory) -> dict[str, Any]:
    """Return what was written as plain data for --json, under the keys of `document`."""
    trajectory = converted.trajectory
    return {
        "transforms": [],
        "axes": _plain_changes(converted.changes),
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


def _inverse_trajectory(trajectory: Trajectory, progress: Progress) -> Trajectory:
    """Return the poses in the other direction; velocities are of the moving frame in the fixed one and are left out."""
    if trajectory.velocities is not None:
        progress.warn(Message("velocities_not_written", "velocities are not written for inverted poses"))
    poses = [trajectory.pose(index) for index in range(len(trajectory))]
    inverses = [pose.inverse() for pose in poses]
    covariances = trajectory.covariances
    if covariances is not None:
        jacobians = np.array([inverse_jacobian(pose) for pose in poses]).reshape(-1, 6, 6)
        covariances = jacobians @ covariances @ np.swapaxes(jacobians, 1, 2)
    a, b = frames_of(trajectory.frames)
    inverted = Trajectory.of(f"{b}_T_{a}", trajectory.stamps, inverses)
    return replace(inverted, covariances=covariances, segments=trajectory.segments)


def _trajectory_along(trajectory: Trajectory, changes: dict[str, AxesChange], frames: tuple[str, str]) -> Trajectory:
    change_a, change_b = _matrices_of(changes, frames)
    poses = [reexpress(trajectory.pose(index), change_a, change_b) for index in range(len(trajectory))]
    jacobian = reexpress_jacobian(change_a)
    covariances, velocities = trajectory.covariances, trajectory.velocities
    return replace(
        Trajectory.of(trajectory.frames, trajectory.stamps, poses),
        covariances=None if covariances is None else jacobian @ covariances @ jacobian.T,
        velocities=None if velocities is None else velocities @ jacobian.T,
        segments=trajectory.segments,
    )


_CSV = ".csv"
_PER_METRE = {METRES: 1.0, MILLIMETRES: 1000.0}


@dataclass(frozen=True, eq=False)
class MovedPoints:
    """What was written: how many points, what was turned with them, and the transform that was applied."""

    transform: NamedTransform
    count: int
    normals: bool
    covariances: bool
    output: Path


@writes
def transform_points(options: PointsOptions, progress: Progress = SILENT) -> MovedPoints:
    """Return what was written to options.output: the points, and all else that the file has, in the other frame.

    Raises InvalidInput for what is no points or several transforms, FileError.
    """
    transform = read_one(options.transform, form_of(options.form))
    if options.inverse:
        transform = transform.inverse()
    work = _table if options.is_table else _cloud
    return work(options, transform, progress)


def points_document(moved: MovedPoints) -> dict[str, Any]:
    """Return what was written as plain data for --json."""
    return {
        "transform": plain(moved.transform, None),
        "points": moved.count,
        "normals": moved.normals,
        "covariances": moved.covariances,
        "output": moved.output,
    }


def _table(options: PointsOptions, transform: NamedTransform, _: Progress) -> MovedPoints:
    found = correspondences.read_point_table(options.points)
    moved = _move(found, transform, _PER_METRE[options.unit])
    correspondences.write_point_table(options.output, moved)
    return MovedPoints(
        transform, len(moved.points), moved.normals is not None, moved.covariances is not None, options.output
    )


def _move(found: PointTable, transform: NamedTransform, per_metre: float) -> PointTable:
    """Return points in the other frame; the transform's own uncertainty is in every covariance, alike for all."""
    rotation = transform.pose.rotation
    turned = found.points @ rotation.T
    normals = None if found.normals is None else found.normals @ rotation.T
    covariances = None if found.covariances is None else rotation @ found.covariances @ rotation.T
    if transform.covariance is not None:
        jacobian = point_jacobian(turned / per_metre) * per_metre
        shared = jacobian @ transform.covariance @ np.swapaxes(jacobian, 1, 2)
        covariances = shared if covariances is None else covariances + shared
    points = turned + per_metre * transform.pose.translation
    return replace(found, points=points, normals=normals, covariances=covariances)


def _cloud(options: PointsOptions, transform: NamedTransform, progress: Progress) -> MovedPoints:
    found = pointclouds.read(options.points)
    if found.unit not in _PER_METRE:
        raise InvalidInput(f"its unit is {found.unit!r}; it must be m or mm", where=str(options.points))
    if transform.covariance is not None:
        text = "covariance of the transform not written: clouds hold none, a CSV does"
        progress.warn(Message("covariance_not_written", text, where=str(options.points)))
    moved = _move_cloud(found, transform)
    stream = VertexStream(
        count=len(moved.vertices),
        type=moved.vertices.dtype,
        blocks=(moved.vertices,),
        unit=moved.unit,
        frame=moved.frame,
        notes=dict(moved.notes),
        grid=found.grid,
    )
    pointclouds.write(options.output, stream)
    return MovedPoints(transform, stream.count, NORMAL[0] in (stream.type.names or ()), False, options.output)


def _move_cloud(found: PointCloudFile, transform: NamedTransform) -> PointCloudFile:
    """Return a cloud in the other frame, its coordinates from an origin of their own where they are large."""
    rotation, vertices = transform.pose.rotation, found.vertices
    origin = np.array([float(number) for number in found.notes.get("origin", "0 0 0").split()])
    points = (_stack(vertices, POSITION) + origin) @ rotation.T
    points += _PER_METRE[found.unit] * transform.pose.translation
    columns = {name: vertices[name] for name in vertices.dtype.names or ()}
    columns |= dict(zip(POSITION, points.T, strict=True))
    if NORMAL[0] in columns:
        columns |= dict(zip(NORMAL, (_stack(vertices, NORMAL) @ rotation.T).astype(np.float32).T, strict=True))
    notes = {key: words for key, words in found.notes.items() if key != "origin"}
    return cloud_of(columns, unit=found.unit, frame=transform.target, notes=notes)


def _stack(vertices: Array, names: tuple[str, ...]) -> Array:
    return np.stack([vertices[name].astype(np.float64) for name in names], axis=-1)
