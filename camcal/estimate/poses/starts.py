"""First poses of many views by one camera."""

from itertools import combinations

import numpy as np

from camcal.arrays import Array
from camcal.estimate.poses import states as se3
from camcal.estimate.poses.extent import IN_PLANE, NEAR_PLANE, Extents
from camcal.estimate.poses.object_space import SpaceErrors
from camcal.estimate.poses.sightings import Sightings
from camcal.estimate.poses.three_points import poses_of_triplets
from camcal.geometry import rotation as so3

FEW = 5  # points for which every choice of three gives starts: noise may have the others lead astray
_LEAST = 4  # points below which only triplets give starts


def starts(sight: Sightings, extents: Extents) -> tuple[Array, Array]:
    """Return states (S, 3, 4), camera_T_object, and which view (S,) each belongs to; extents: of the views.

    A view of a plane has one, of a solid object several, of fewer than three points none.
    """
    counts = sight.present.sum(axis=1)
    enough = counts >= _LEAST
    flat, solid = enough & (extents.flatness < NEAR_PLANE), enough & (extents.flatness > IN_PLANE)
    parts = [(np.zeros((0, 3, 4)), np.zeros(0, np.intp))]
    # a call for no view at all would take as long as one for a few
    if flat.any():
        parts.append(_of_planes(sight, extents, np.flatnonzero(flat)))
    if solid.any():
        parts.append(_of_solids(sight, extents, np.flatnonzero(solid)))
    if (few := (counts >= 3) & (counts <= FEW)).any():
        parts.append(_of_triplets(sight, np.flatnonzero(few)))
    return np.concatenate([states for states, _ in parts]), np.concatenate([view for _, view in parts])


def _of_planes(sight: Sightings, extents: Extents, views: Array) -> tuple[Array, Array]:
    states = _space_errors(sight, extents, views).of_planes()
    return se3.compose(states, extents.plane_T_object[views]), views


def _of_solids(sight: Sightings, extents: Extents, views: Array) -> tuple[Array, Array]:
    states, which = _space_errors(sight, extents, views).minima()
    return se3.compose(states, extents.plane_T_object[views[which]]), views[which]


def _space_errors(sight: Sightings, extents: Extents, views: Array) -> SpaceErrors:
    points = extents.take(views).in_plane(sight.points[:, views])
    return SpaceErrors.of(sight.rays[:, views], points, sight.present[views])


def _of_triplets(sight: Sightings, views: Array) -> tuple[Array, Array]:
    """Return the poses that meet three points exactly, for every choice of three."""
    corners = [(view, *three) for view in views for three in combinations(np.flatnonzero(sight.present[view]), 3)]
    table = np.array(corners, dtype=np.intp).reshape(-1, 4)
    rays, points = (each[:, table[:, :1], table[:, 1:]].transpose(1, 2, 0) for each in (sight.rays, sight.points))
    states, triplet = poses_of_triplets(rays, points)
    return se3.stacked(so3.nearest(states[:, :, :3]), states[:, :, 3]), table[triplet, 0]
