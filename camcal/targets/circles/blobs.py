"""Candidate ellipses in an image, and lattices of them.

An ellipse is the outline of a region darker or brighter than around it. It says how its disc is seen: where it becomes
a unit circle, its four neighbours lie at equal distances and at right angles, whatever the perspective. From such a
patch a lattice grows where its nodes predict the next ones, so that strong distortion passes. Nodes are (rows, columns)
of indices of ellipses, -1 where none, right-handed: columns turn clockwise to rows, as on a board seen from the front.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import KDTree

from camcal.arrays import Array
from camcal.targets.checker import grid as grids

_LEAST_POINTS = 8  # of an outline
_LEAST_AXIS = 1.2  # px, half the width of the flattest ellipse
_FLATTEST = 6.0  # long over short axis; a disc seen at 80°
_ROUND = 0.05  # spread of an outline about its ellipse, of the radius; 0.1 of a square
_ROUND_PX = 0.3  # that pixels add to it
_CONTRAST = 0.04  # of the image's range by which a disc must differ from its surroundings
_LEAST_CONTRAST = 3.0  # gray levels


@dataclass(frozen=True, eq=False)
class Ellipses:
    """Ellipses x = centre + axes · u, |u| = 1: centres (N, 2), axes (N, 2, 2) symmetric, pixels."""

    centres: Array
    axes: Array

    @property
    def areas(self) -> Array:
        """Return the areas (N,) over π."""
        return np.asarray(np.linalg.det(self.axes))

    def take(self, rows: Array) -> "Ellipses":
        """Return some of the ellipses."""
        return Ellipses(self.centres[rows], self.axes[rows])

    def enlarged(self, scale: float) -> "Ellipses":
        """Return the ellipses as they are in an image `scale` times as large; pixel (0, 0) is a pixel's centre."""
        return Ellipses((self.centres + 0.5) * scale - 0.5, self.axes * scale)


def find_ellipses(gray: Array, block: int, *, bright: bool) -> Ellipses:
    """Return the ellipses of a gray image (H, W) uint8 that are darker, or brighter, than the mean over a block.

    block: side in pixels, odd.
    """
    smooth = cv2.GaussianBlur(gray, (0, 0), 0.8)
    low, high = np.percentile(smooth[::4, ::4], (2, 98))
    offset = max(_LEAST_CONTRAST, _CONTRAST * (high - low))
    image = cv2.bitwise_not(smooth) if bright else smooth
    mask = cv2.adaptiveThreshold(image, 1, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY_INV, block, offset)
    outlines, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    longest = 2 * min(gray.shape)
    kept = [np.asarray(line).reshape(-1, 2) for line in outlines if _LEAST_POINTS <= len(line) < longest]
    return _round(kept) if kept else Ellipses(np.zeros((0, 2)), np.zeros((0, 2, 2)))


def _round(outlines: list[Array]) -> Ellipses:
    """Return the ellipses of the outlines (K, 2) that are some; those of holes run the other way."""
    lengths = np.array([len(line) for line in outlines])
    points = np.concatenate(outlines).astype(np.float64)
    first = np.cumsum(lengths) - lengths
    areas, centres, seconds = _moments(points, first, lengths)
    kept = (areas > _LEAST_AXIS**2) & (np.linalg.det(seconds) > 0)
    axes = square_roots(np.where(kept[:, None, None], seconds, np.eye(2)))
    short, long = np.linalg.eigvalsh(axes).T
    kept &= (short > _LEAST_AXIS) & (long < _FLATTEST * short)
    inverse = np.linalg.inv(np.where(kept[:, None, None], axes, np.eye(2)))
    owner = np.repeat(np.arange(len(lengths)), lengths)
    away = np.einsum("nij,nj->ni", inverse[owner], points - centres[owner])
    off = np.add.reduceat((np.hypot(*away.T) - 1) ** 2, first) / lengths
    kept &= np.sqrt(off) < _ROUND + _ROUND_PX / short
    return Ellipses(centres[kept], axes[kept] + 0.5 * np.eye(2))  # outlines go through the centres of pixels


def _moments(points: Array, first: Array, lengths: Array) -> tuple[Array, Array, Array]:
    """Return areas (N,) px², centroids (N, 2) and squared axes (N, 2, 2) px² of the polygons that begin at `first`.

    Positive areas run as the outlines of regions do, holes are negative. Source: Green's theorem, as in Steger 1996,
    On the calculation of arbitrary moments of polygons.
    """
    origin = points[first]
    here = points - np.repeat(origin, lengths, axis=0)
    after = np.roll(here, -1, axis=0)
    after[first + lengths - 1] = here[first]
    cross = here[:, 1] * after[:, 0] - here[:, 0] * after[:, 1]
    areas = np.add.reduceat(cross, first) / 2
    scale = np.where(areas == 0, np.inf, areas)[:, None]
    centroids = np.add.reduceat((here + after) * cross[:, None], first) / (6 * scale)
    both = here + after
    products = np.stack([_product(here, after, both, i, j) for i, j in ((0, 0), (0, 1), (1, 1))], axis=1)
    xx, xy, yy = (np.add.reduceat(products * cross[:, None], first) / (24 * scale)).T
    seconds = np.stack([xx, xy, xy, yy], axis=1).reshape(-1, 2, 2)
    seconds -= centroids[:, :, None] * centroids[:, None, :]
    return areas, centroids + origin, 4 * seconds


def _product(here: Array, after: Array, both: Array, i: int, j: int) -> Array:
    return np.asarray(here[:, i] * here[:, j] + after[:, i] * after[:, j] + both[:, i] * both[:, j])


def square_roots(matrices: Array) -> Array:
    """Return the square roots (N, 2, 2) of symmetric positive matrices (N, 2, 2)."""
    root = np.sqrt(np.linalg.det(matrices))[:, None, None]
    trace = np.trace(matrices, axis1=1, axis2=2)[:, None, None]
    return np.asarray((matrices + root * np.eye(2)) / np.sqrt(trace + 2 * root))  # Cayley and Hamilton


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
