"""Views that share arrays, and what keeps some of them from having a pose at all."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.estimate.poses.extent import Extents
from camcal.estimate.poses.records import Correspondences
from camcal.estimate.poses.sightings import Sightings
from camcal.geometry.pose import Pose

_COLLINEAR = 1e-6  # second spread over the first
_CORNERS = 3  # points of one camera that give a start
_KEYS = np.array([0.5772156649, 0.6931471806, 1.2020569032])  # no two points of an object are alike under these weights


@dataclass(frozen=True, eq=False)
class Group:
    """Views that share arrays: of each item what every camera sees, the sights, and which of all items they are.

    centres: (W, 3) the means of the items' points. The points of the sights are counted from there, since far from the
    origin of an object, as in maps, its rotation about that origin and its place are one and the same.
    """

    views: Sequence[Sequence[Correspondences | None]]
    sights: tuple[Sightings, ...]
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
        sights = [Sightings.of(camera, seen, frame) for camera, frame, seen in each]
        counts = np.maximum(sum(sight.present.sum(axis=1) for sight in sights), 1)
        sums = sum(np.where(sight.present, sight.points, 0.0).sum(axis=2) for sight in sights)
        centres = np.asarray(sums / counts).T
        return cls(views, tuple(sight.about(centres) for sight in sights), items, centres)

    def take(self, chosen: Array) -> "Group":
        """Return some of the items."""
        views = [self.views[index] for index in chosen]
        sights = tuple(sight.take(chosen) for sight in self.sights)
        return Group(views, sights, self.items[chosen], self.centres[chosen])

    def points(self) -> tuple[Array, Array]:
        """Return the points (3, W, N) of all cameras and the mask (W, N) of those present."""
        points = np.concatenate([sight.points for sight in self.sights], axis=2)
        return points, np.concatenate([sight.present for sight in self.sights], axis=1)

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
        different = _different(points, present)
        most = np.max([sight.present.sum(axis=1) for sight in self.sights], axis=0)
        found = {}
        for index in np.flatnonzero((different < needed) | (narrowness < _COLLINEAR) | (most < _CORNERS)).tolist():
            if different[index] < needed:
                outside = sum(self.counts()[index]) - int(present[index].sum())
                lost = f" ({outside} more outside the lens's domain)" if outside else ""
                found[index] = f"a pose needs {needed} different points or more, found {different[index]}{lost}"
            elif narrowness[index] < _COLLINEAR:
                line = f"all {different[index]} points lie on one line, about which the object may turn"
                found[index] = f"{line}; add a point beside it"
            elif not started:
                found[index] = f"no camera sees {_CORNERS} of the points or more, the best {most[index]}"
        return found


def _different(points: Array, present: Array) -> Array:
    """Return how many different points (W,) there are among points (3, W, N)."""
    keys = np.where(present, np.einsum("i,iwn->wn", _KEYS, points), np.inf)
    keys.sort(axis=1)
    there = np.isfinite(keys)
    return np.asarray(there[:, 0] + np.sum((keys[:, 1:] > keys[:, :-1]) & there[:, 1:], axis=1))
