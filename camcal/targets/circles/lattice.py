"""A lattice of ellipses: neighbours that stand to each other as the discs of a printed square lattice do.

An ellipse says how its disc is seen: where it becomes a unit circle, its four neighbours lie at equal distances and at
right angles, whatever the perspective. From such a patch the lattice grows where its nodes predict the next ones, so
that strong distortion passes. Nodes are (rows, columns) of indices of ellipses, -1 where none, right-handed: columns
turn clockwise to rows, as on a board seen from the front.
"""

from collections.abc import Iterator

import numpy as np
from scipy.spatial import KDTree

from camcal.arrays import Array
from camcal.targets.checker import grid as grids
from camcal.targets.circles.blobs import Ellipses

_NEAREST = 12  # ellipses around one that may be its neighbours
_SIMILAR = 2.0  # ratio of the areas of neighbours at most
_CLOSEST, _FARTHEST = 2.05, 8.0  # radii from a disc to the next
_SEED = 0.25  # of a spacing that the neighbours of a seed may be off
_SEEDS = 8  # patches that are grown at most
_STRAY = 0.3  # of a spacing that a node may be off where its neighbours predict it
_NONE = -1


def lattices(ellipses: Ellipses, longest: int) -> Iterator[Array]:
    """Yield lattices, indices (rows, columns) of ellipses or -1, grown from the best patches in turn.

    longest: the side at which a lattice grows no more. No ellipse is in two of them.
    """
    if len(ellipses.centres) < 4:
        return
    used = np.zeros(len(ellipses.centres), dtype=bool)
    for patch, spacing in _patches(ellipses):
        if not used[patch[patch != _NONE]].any():
            lattice = _grown(ellipses, patch, spacing, longest)
            used[lattice[lattice != _NONE]] = True
            yield lattice


def places(ellipses: Ellipses, lattice: Array) -> Array:
    """Return the centres (rows, columns, 2) of a lattice's ellipses, NaN where none."""
    return np.where((lattice == _NONE)[..., None], np.nan, ellipses.centres[lattice])


def neighbours(points: Array, most: int) -> Array:
    """Return the indices (N, M) of the others nearest to points (N, 2), `most` of each or as many as there are."""
    nearest = np.asarray(KDTree(points).query(points, k=min(most + 1, len(points)))[1])
    return nearest[:, 1:]


def _patches(ellipses: Ellipses) -> Iterator[tuple[Array, float]]:
    """Yield ellipses (3, 3) with their four neighbours, or three of them, and their spacing in radii; best first."""
    count = len(ellipses.centres)
    near = neighbours(ellipses.centres, _NEAREST)
    away = np.einsum("nij,nkj->nki", np.linalg.inv(ellipses.axes), ellipses.centres[near] - ellipses.centres[:, None])
    distance = np.linalg.norm(away, axis=2)
    ratio = ellipses.areas[near] / ellipses.areas[:, None]
    fits = (distance > _CLOSEST) & (distance < _FARTHEST) & (ratio < _SIMILAR) & (ratio > 1 / _SIMILAR)
    distance[~fits] = np.inf
    nearest = distance.argmin(axis=1)
    spacing = distance.min(axis=1)
    first = away[np.arange(count), nearest]
    aside = np.stack([-first[:, 1], first[:, 0]], axis=1)  # clockwise: y points down
    wanted = np.stack([first, aside, -first, -aside], axis=1)
    off = np.linalg.norm(away[:, None] - wanted[:, :, None], axis=3)
    off[np.broadcast_to(~fits[:, None], off.shape)] = np.inf
    best = off.argmin(axis=2)
    missed = off.min(axis=2) / np.where(np.isfinite(spacing), spacing, 1.0)[:, None]
    found = missed < _SEED
    found[~np.isfinite(spacing)] = False
    cost = np.where(found, missed, 1.0).sum(axis=1)
    kept = found[:, :2].all(axis=1)
    for row in np.argsort(cost, kind="stable")[: 8 * _SEEDS]:
        if kept[row]:
            yield _patch(row, np.where(found[row], near[row, best[row]], _NONE)), float(spacing[row])


def _patch(middle: int, around: Array) -> Array:
    patch = np.full((3, 3), _NONE)
    patch[1, 1] = middle
    patch[1, 2], patch[2, 1], patch[1, 0], patch[0, 1] = around
    return patch


def _grown(ellipses: Ellipses, lattice: Array, spacing: float, longest: int) -> Array:
    """Return a lattice grown from a patch until nothing fits any more or a side is too long."""
    tree = KDTree(ellipses.centres)
    inverse = np.linalg.inv(ellipses.axes)
    while max(lattice.shape) <= longest:
        wide = np.pad(lattice, 1, constant_values=_NONE)
        free = np.argwhere(wide == _NONE)
        grid = places(ellipses, wide)
        predicted = grids.predict(grid)[tuple(free.T)]
        known = ~np.isnan(predicted[:, 0])
        free, predicted = free[known], predicted[known]
        index = np.asarray(tree.query(predicted)[1])
        off = np.linalg.norm(np.einsum("nij,nj->ni", inverse[index], ellipses.centres[index] - predicted), axis=1)
        fits = (off < _STRAY * spacing) & _like(ellipses, wide, free, index) & ~np.isin(index, wide)
        order = np.argsort(off, kind="stable")
        order = order[fits[order]]
        order = order[np.unique(index[order], return_index=True)[1]]  # of several nodes for one ellipse, the nearest
        if not len(order):
            return lattice
        wide[tuple(free[order].T)] = index[order]
        lattice = _cropped(wide)
    return lattice


def _like(ellipses: Ellipses, wide: Array, nodes: Array, index: Array) -> Array:
    """Return which ellipses `index` (N,) are as large as the lattice's beside nodes (N, 2)."""
    areas = np.log(np.where(wide == _NONE, np.nan, ellipses.areas[wide]))
    near = np.pad(areas, 1, constant_values=np.nan)
    row, column = nodes.T
    around = np.stack([near[row + i, column + j] for i in range(3) for j in range(3)])
    present = ~np.isnan(around)
    mean = np.where(present, around, 0).sum(axis=0) / np.maximum(present.sum(axis=0), 1)
    return np.asarray(present.any(axis=0) & (np.abs(np.log(ellipses.areas[index]) - mean) < np.log(_SIMILAR)))


def _cropped(lattice: Array) -> Array:
    """Return the lattice without empty rows and columns around it."""
    rows, columns = (np.flatnonzero((lattice != _NONE).any(axis=axis)) for axis in (1, 0))
    return lattice[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
