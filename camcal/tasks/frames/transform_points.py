"""`camcal transform points`: a file of points to another frame, with normals and covariances."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.formats import correspondences, pointclouds
from camcal.formats.correspondences import PointTable
from camcal.formats.pointclouds.record import MILLIMETRES, PointCloudFile, cloud_of
from camcal.formats.pose_text import form_of
from camcal.geometry.pose import NamedTransform, point_jacobian
from camcal.messages import Message
from camcal.progress import SILENT, Progress
from camcal.report.rig import plain
from camcal.run.outputs import writes
from camcal.run.pose_sources import read_one
from camcal.stereo.points.frames import METRES, NORMAL, POSITION, VertexStream
from camcal.tasks.frames.options import PointsOptions

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


def document(moved: MovedPoints) -> dict[str, Any]:
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
