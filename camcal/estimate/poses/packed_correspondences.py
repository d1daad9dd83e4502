"""Correspondences of many views of one camera, packed in arrays whose last axes are views and points.

Views are grouped by the arrays they share; what keeps a view from having a pose at all is found here, too.
"""

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.cameras.observations import (
    Observations,
    by_pose,
    linearised,
    residuals,
    rotated_points,
    whitened,
    whitening_of,
)
from camcal.dataclass import dataclass, replace
from camcal.estimate.poses import states as se3
from camcal.estimate.poses.records import Correspondences
from camcal.estimate.poses.states import Extents
from camcal.geometry.pose import Pose

ROOM = 1.3  # views share arrays that are filled up to at most this many times the points of the smallest
_COLLINEAR = 1e-6  # second spread over the first
_ALIKE = np.eye(2)  # px², the covariance of pixels without one
_CORNERS = 3  # points of one camera that give a start
_KEYS = np.array([0.5772156649, 0.6931471806, 1.2020569032])  # no two points of an object are alike under these weights


@dataclass(frozen=True, eq=False)
class PackedCorrespondences:
    """The points of W views by one camera, filled up to N each.

    frame: camera_T_frame, where the frame is that of the poses searched for (the camera's own, or a rig's).
    points: (3, W, N) in the objects' frames. pixels: (2, W, N). rays: (3, W, N) unit, in the camera's frame.
    whitening: (2, 2, W, N) with Wᵀ W the inverse covariance of a pixel, or None.
    present: (W, N), the points that are there and whose pixels have a ray.
    """

    camera: Camera
    frame: Pose
    points: Array
    pixels: Array
    rays: Array
    whitening: Array | None
    present: Array

    @classmethod
    def of(cls, camera: Camera, views: Sequence[Correspondences | None], frame: Pose) -> "PackedCorrespondences":
        """Return what the camera sees in views; None is a view in which it sees nothing."""
        table = Observations.of(views, unknown=_ALIKE)
        rays = camera.unproject(table.pixels.reshape(2, -1).T)
        directions = np.nan_to_num(np.ascontiguousarray(rays.directions.T)).reshape(3, *table.ids.shape)
        return cls(
            camera,
            frame,
            points=table.padded([None if view is None else view.points for view in views], 3),
            pixels=table.pixels,
            rays=directions,
            whitening=None if table.covariance is None else whitening_of(table.covariance),
            present=rays.valid.reshape(table.ids.shape) & table.present,
        )

    def take(self, chosen: Array) -> "PackedCorrespondences":
        """Return some of the views."""
        whitening = None if self.whitening is None else self.whitening[:, :, chosen]
        return replace(
            self,
            points=self.points[:, chosen],
            pixels=self.pixels[:, chosen],
            rays=self.rays[:, chosen],
            whitening=whitening,
            present=self.present[chosen],
        )

    def about(self, centres: Array) -> "PackedCorrespondences":
        """Return the views with their points counted from centres (W, 3)."""
        return replace(self, points=self.points - centres.T[:, :, None])

    def only(self, points: Array) -> "PackedCorrespondences":
        """Return some of the points of every view."""
        whitening = None if self.whitening is None else self.whitening[..., points]
        return replace(
            self,
            points=self.points[..., points],
            pixels=self.pixels[..., points],
            rays=self.rays[..., points],
            whitening=whitening,
            present=self.present[:, points],
        )

    def variances(self) -> Array:
        """Return the mean variances (W, N), px², of the coordinates of the pixels; 1 where none are known."""
        if self.whitening is None:
            return np.ones(self.present.shape)
        # (Wᵀ W)⁻¹ of two by two: half its trace is ‖W‖² / (2 det² W)
        size = np.einsum("ijwn,ijwn->wn", self.whitening, self.whitening)
        determinant = self.whitening[0, 0] * self.whitening[1, 1] - self.whitening[0, 1] * self.whitening[1, 0]
        return np.asarray(size / (2 * determinant**2))

    def residuals(self, states: Array, view: Array) -> Array:
        """Return projected minus observed pixels (2, S, N) of views (S,) at states (S, 3, 4), frame_T_object.

        Not whitened; NaN outside the lens's domain.
        """
        in_camera = self._in_camera(rotated_points(states[:, :, :3], _of(self.points, view)), states[:, :, 3])
        return residuals(self.camera.model, self.camera.parameters, in_camera, _of(self.pixels, view))

    def squared(self, states: Array, view: Array) -> Array:
        """Return the squared lengths (S, N) of the whitened residuals, infinite outside the lens's domain and where
        there is no point.
        """
        left = whitened(self._whitening_of(view), self.residuals(states, view))
        squared = np.einsum("isn,isn->sn", left, left)
        return np.where(self.present[view], np.nan_to_num(squared, nan=np.inf), np.inf)

    def sight_factors(self, scale: Array | float) -> Array:
        """Return A (3, N, 13) of the first view: times the 12 numbers of a state [R t] and a one, A gives J y · scale
        and d · y of points y in the camera, with their rays d and the derivatives J of whitened pixels at d.
        """
        seen = linearised(self.camera.model, self.camera.parameters, self.rays, self.pixels)
        slopes = scale * whitened(self.whitening, seen.by_point)
        rows = np.concatenate([slopes, self.rays[None]])[:, :, 0]
        in_frame = np.einsum("ipn,pq->inq", rows, self.frame.rotation)
        points = np.concatenate([self.points[:, 0], np.ones((1, self.points.shape[2]))])
        factors = np.empty((3, points.shape[1], 13))
        factors[:, :, :12] = np.einsum("inq,jn->inqj", in_frame, points).reshape(3, -1, 12)
        factors[:, :, 12] = np.einsum("ipn,p->in", rows, self.frame.translation)
        return factors

    def rows(self, states: Array, view: Array, mask: Array, *, lens: bool = False) -> tuple[Array, Array | None, Array]:
        """Return the whitened residuals behind their derivatives by the pose's step as (2, 7, S, N), zero outside the
        mask (S, N); the derivatives by the lens's parameters as (2, K, S, N) where they are wanted; and the mask (S,)
        of states at which all points of the mask are in the lens's domain.
        """
        rotated = rotated_points(states[:, :, :3], _of(self.points, view))
        in_camera = self._in_camera(rotated, states[:, :, 3])
        seen = linearised(self.camera.model, self.camera.parameters, in_camera, _of(self.pixels, view))
        by_point = np.einsum("ipsn,pq->iqsn", seen.by_point, self.frame.rotation) if self._turns else seen.by_point
        rows = np.empty((2, 7, *rotated.shape[1:]))
        by_pose(by_point, rotated, out=rows[:, :6])
        rows[:, 6] = seen.residuals
        whitening = self._whitening_of(view)
        rows, by_lens = whitened(whitening, rows), whitened(whitening, seen.by_lens) if lens else None
        if not mask.all():
            np.copyto(rows, 0.0, where=~mask)
        return rows, by_lens, np.all(seen.valid | ~mask, axis=1)

    def _whitening_of(self, view: Array) -> Array | None:
        return None if self.whitening is None else self.whitening[:, :, view]

    @cached_property
    def inverse_frame(self) -> Array:
        """frame_T_camera as a state (3, 4)."""
        return se3.inverse(self.frame.matrix()[:3])

    @property
    def eye(self) -> Array:
        """The camera's place (3,) in the frame."""
        return self.inverse_frame[:, 3]

    def in_frame(self, states: Array) -> Array:
        """Return frame_T_object (S, 3, 4) of states camera_T_object."""
        return se3.compose(self.inverse_frame, states) if self._turns or self.frame.translation.any() else states

    @cached_property
    def _turns(self) -> bool:
        """Whether the frame's axes differ from the camera's."""
        return bool(np.any(self.frame.rotation != np.eye(3)))

    def _in_camera(self, rotated: Array, translations: Array) -> Array:
        """Return points (3, S, N) in the camera, of those turned into the frame but not moved yet."""
        moved = rotated + translations.T[:, :, None]
        if self._turns or self.frame.translation.any():
            moved = np.einsum("pq,qsn->psn", self.frame.rotation, moved) + self.frame.translation[:, None, None]
        return np.asarray(moved)


def _of(values: Array, view: Array) -> Array:
    """Return the values (D, S, N) of views (S,); those of an only view (D, 1, N) serve all."""
    return values if values.shape[1] == 1 else values[:, view]


def alike(counts: Array) -> list[Array]:
    """Return the indices of views, in groups of similar counts (W,) of points."""
    order = np.argsort(counts, kind="stable")
    groups: list[list[int]] = []
    for index in order:
        if not groups or counts[index] > ROOM * counts[groups[-1][0]]:
            groups.append([])
        groups[-1].append(int(index))
    return [np.sort(group) for group in groups]


@dataclass(frozen=True, eq=False)
class Group:
    """Views that share arrays: of each item what every camera sees, the sights, and which of all items they are.

    centres: (W, 3) the means of the items' points. The points of the sights are counted from there, since far from the
    origin of an object, as in maps, its rotation about that origin and its place are one and the same.
    """

    views: Sequence[Sequence[Correspondences | None]]
    packed_views: tuple[PackedCorrespondences, ...]
    items: Array
    centres: Array

    @classmethod
    def of(
        cls,
        cameras: Sequence[Camera],
        frames: Sequence[Pose],
        views: Sequence[Sequence[Correspondences | None]],
        items: Array,
    ) -> "Group":
        """Return the group of views, of each item one for every camera; frames: camera_T_frame of the cameras."""
        each = zip(cameras, frames, zip(*views, strict=True), strict=True)
        packed_views = [PackedCorrespondences.of(camera, seen, frame) for camera, frame, seen in each]
        counts = np.maximum(sum(packed.present.sum(axis=1) for packed in packed_views), 1)
        sums = sum(np.where(packed.present, packed.points, 0.0).sum(axis=2) for packed in packed_views)
        centres = np.asarray(sums / counts).T
        return cls(views, tuple(packed.about(centres) for packed in packed_views), items, centres)

    def take(self, chosen: Array) -> "Group":
        """Return some of the items."""
        views = [self.views[index] for index in chosen]
        packed_views = tuple(packed.take(chosen) for packed in self.packed_views)
        return Group(views, packed_views, self.items[chosen], self.centres[chosen])

    def points(self) -> tuple[Array, Array]:
        """Return the points (3, W, N) of all cameras and the mask (W, N) of those present."""
        points = np.concatenate([packed.points for packed in self.packed_views], axis=2)
        return points, np.concatenate([packed.present for packed in self.packed_views], axis=1)

    @cached_property
    def extents(self) -> Extents:
        """How the points of the items spread."""
        return Extents.of(*self.points())

    def counts(self) -> list[list[int]]:
        """Return the number of points of every item and camera, those without a ray included."""
        return [[0 if view is None else len(view.points) for view in item] for item in self.views]

    def name(self, index: int) -> str:
        """Return the image, or the first of the images, of an item."""
        return next((view.image for view in self.views[index] if view is not None), "")

    def obstacles(self, needed: int, *, started: bool) -> dict[int, str]:
        """Return by index why items cannot have a pose, for which `needed` points are; started: starts are known."""
        points, present = self.points()
        narrowness = self.extents.narrowness
        keys = np.where(present, np.einsum("i,iwn->wn", _KEYS, points), np.inf)
        keys.sort(axis=1)
        there = np.isfinite(keys)
        different = there[:, 0] + np.sum((keys[:, 1:] > keys[:, :-1]) & there[:, 1:], axis=1)  # how many points
        most = np.max([packed.present.sum(axis=1) for packed in self.packed_views], axis=0)
        found = {}
        for index in np.flatnonzero((different < needed) | (narrowness < _COLLINEAR) | (most < _CORNERS)).tolist():
            if different[index] < needed:
                outside = sum(self.counts()[index]) - int(present[index].sum())
                lost = f" ({outside} more outside the lens's domain)" if outside else ""
                found[index] = f"a pose needs {needed} different points or more, found {different[index]}{lost}"
            elif narrowness[index] < _COLLINEAR:
                line = f"all {different[index]} points are collinear: the rotation about their line is not determined"
                found[index] = f"{line}; add a point off the line"
            elif not started:
                found[index] = f"no camera sees {_CORNERS} of the points or more, the best {most[index]}"
        return found
