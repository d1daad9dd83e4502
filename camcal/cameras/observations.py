"""The observations of many views as one table: pixels with the camera, the body and the time of each view."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from camcal.arrays import Array
from camcal.cameras.reprojection import whitening_of


class DetectedPoints(Protocol):
    """What one image shows of one body: points ids (N,) at pixels (N, 2), with covariances (N, 2, 2) px² or None."""

    @property
    def ids(self) -> Array: ...
    @property
    def pixels(self) -> Array: ...
    @property
    def covariance(self) -> Array | None: ...
    @property
    def camera(self) -> str | None: ...
    @property
    def body(self) -> str: ...
    @property
    def time(self) -> float | None: ...


@dataclass(frozen=True, eq=False)
class Observations:
    """Pixels of points of bodies in V views, padded to P rows a view.

    ids: (V, P). pixels: (2, V, P). weights: (V, P), 0 for padding and for what is rejected, else at most 1.
    whitening: (2, 2, V, P) with Wᵀ W the inverse covariance of a pixel over a typical one's, or None: all alike.
    present: (V, P), the points that there are, whatever their weight; by default those of a weight above 0.
    covariance: (V, P, 2, 2) px², as the images give it, None: all alike. camera, body: (V,) places in the names cameras
    and bodies. time: (V,) s, NaN where unknown.
    """

    ids: Array
    pixels: Array
    weights: Array
    whitening: Array | None = None
    present: Array = field(default_factory=lambda: np.zeros(0, np.bool_))
    covariance: Array | None = None
    camera: Array = field(default_factory=lambda: np.zeros(0, np.intp))
    body: Array = field(default_factory=lambda: np.zeros(0, np.intp))
    time: Array = field(default_factory=lambda: np.zeros(0))
    cameras: tuple[str, ...] = ("",)
    bodies: tuple[str, ...] = ("",)

    def __post_init__(self) -> None:
        count = len(self.ids)
        columns = {
            "present": self.weights > 0,
            "camera": np.zeros(count, np.intp),
            "body": np.zeros(count, np.intp),
            "time": np.full(count, np.nan),
        }
        for name, default in columns.items():
            if not getattr(self, name).size:
                object.__setattr__(self, name, default)

    @classmethod
    def of(cls, views: Sequence[DetectedPoints | None], unknown: Array | None = None) -> "Observations":
        """Return the table of the points in `views`, a row of the table for each, all points counting the same.

        None is a view of nothing. unknown: (2, 2) px², the covariance of points whose view gives none where another one
        does; None: that of the typical one of the others.
        """
        counts = np.array([0 if view is None else len(view.pixels) for view in views])
        shape = len(views), max(int(counts.max(initial=0)), 1)
        present = np.arange(shape[1]) < counts[:, None]
        ids, pixels = np.zeros(shape, np.intp), np.zeros((2, *shape))
        known = [view.covariance for view in views if view is not None and view.covariance is not None]
        covariance = None
        if known:
            typical = np.median(np.concatenate(known), axis=0) if unknown is None else unknown
            covariance = np.tile(typical, (*shape, 1, 1))
        for row, view in enumerate(views):
            if view is None or not counts[row]:
                continue
            ids[row, : counts[row]] = view.ids
            pixels[:, row, : counts[row]] = view.pixels.T
            pixels[:, row, counts[row] :] = view.pixels[0, :, None]  # one that the lens knows
            if covariance is not None and view.covariance is not None:
                covariance[row, : counts[row]] = view.covariance
        cameras, camera = _numbered([(view and view.camera) or "" for view in views])
        bodies, body = _numbered([view.body if view else "" for view in views])
        times = [view.time if view else None for view in views]
        return cls(
            ids,
            pixels,
            present.astype(float),
            present=present,
            covariance=covariance,
            camera=camera,
            body=body,
            time=np.array([np.nan if time is None else time for time in times]),
            cameras=cameras,
            bodies=bodies,
        )

    def padded(self, columns: Sequence[Array | None], size: int) -> Array:
        """Return `size` values (N, D) of the points of every view, None of a view of nothing, as a table (D, V, P)."""
        result = np.zeros((size, *self.ids.shape))
        for row, column in enumerate(columns):
            if column is not None:
                result[:, row, : len(column)] = column.T
        return result

    def weighted(self, covariances: Array) -> "Observations":
        """Return the table with points that count by their covariances (V, P, 2, 2) px², relative to the typical one.

        Residuals stay in pixels, those of a typical point: one with the geometric mean of all variances.
        """
        typical = np.exp(np.log(np.linalg.det(covariances[self.weights > 0])).mean() / 2)
        return replace(self, whitening=whitening_of(covariances / typical))

    def alike(self) -> "Observations":
        """Return the table with all points that there are counting the same."""
        return replace(self, weights=self.present.astype(float), whitening=None, covariance=None)

    def take(self, views: Array) -> "Observations":
        """Return the table of some of the views."""
        return replace(
            self,
            ids=self.ids[views],
            pixels=self.pixels[:, views],
            weights=self.weights[views],
            whitening=None if self.whitening is None else self.whitening[:, :, views],
            present=self.present[views],
            covariance=None if self.covariance is None else self.covariance[views],
            camera=self.camera[views],
            body=self.body[views],
            time=self.time[views],
        )


def _numbered(names: Sequence[str]) -> tuple[tuple[str, ...], Array]:
    """Return the different names, in the order in which they come first, and the place of each name among them."""
    places = {name: place for place, name in enumerate(dict.fromkeys(names))}
    return tuple(places), np.array([places[name] for name in names], np.intp)
