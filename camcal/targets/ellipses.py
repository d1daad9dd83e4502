"""Candidate ellipses in an image, lattices of them, and the picture of a blurred disc near the rim of one.

An ellipse is the outline of a region darker or brighter than around it. It says how its disc is seen: where it becomes
a unit circle, its four neighbours lie at equal distances and at right angles, whatever the perspective. From such a
patch a lattice grows where its nodes predict the next ones, so that strong distortion passes. Nodes are (rows, columns)
of indices of ellipses, -1 where none, right-handed: columns turn clockwise to rows, as on a board seen from the front.
"""

from collections.abc import Iterator

import cv2
import numpy as np
from scipy.spatial import KDTree
from scipy.special import ndtr

from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.targets.checker import proposals as grids

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
    ends = here, after, here + after
    products = np.stack([sum(end[:, i] * end[:, j] for end in ends) for i, j in ((0, 0), (0, 1), (1, 1))], axis=1)
    xx, xy, yy = (np.add.reduceat(products * cross[:, None], first) / (24 * scale)).T
    seconds = np.stack([xx, xy, xy, yy], axis=1).reshape(-1, 2, 2)
    seconds -= centroids[:, :, None] * centroids[:, None, :]
    return areas, centroids + origin, 4 * seconds


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
            lattice = _grow(ellipses, patch, spacing, longest)
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
    close = missed < _SEED
    close[~np.isfinite(spacing)] = False
    cost = np.where(close, missed, 1.0).sum(axis=1)
    kept = close[:, :2].all(axis=1)
    for row in np.argsort(cost, kind="stable")[: 8 * _SEEDS]:
        if kept[row]:
            patch = np.full((3, 3), _NONE)
            patch[1, 1] = row
            patch[1, 2], patch[2, 1], patch[1, 0], patch[0, 1] = np.where(close[row], near[row, best[row]], _NONE)
            yield patch, float(spacing[row])


def _grow(ellipses: Ellipses, lattice: Array, spacing: float, longest: int) -> Array:
    """Return a lattice grown from a patch until nothing fits any more or a side is too long."""
    tree = KDTree(ellipses.centres)
    inverse = np.linalg.inv(ellipses.axes)
    while max(lattice.shape) <= longest:
        wide = np.pad(lattice, 1, constant_values=_NONE)
        free = np.argwhere(wide == _NONE)
        grid = places(ellipses, wide)
        predicted = grids.predict(grid)[tuple(free.T)]
        predictable = ~np.isnan(predicted[:, 0])
        free, predicted = free[predictable], predicted[predictable]
        index = np.asarray(tree.query(predicted)[1])
        off = np.linalg.norm(np.einsum("nij,nj->ni", inverse[index], ellipses.centres[index] - predicted), axis=1)
        fits = (off < _STRAY * spacing) & _like(ellipses, wide, free, index) & ~np.isin(index, wide)
        order = np.argsort(off, kind="stable")
        order = order[fits[order]]
        order = order[np.unique(index[order], return_index=True)[1]]  # of several nodes for one ellipse, the nearest
        if not len(order):
            return lattice
        wide[tuple(free[order].T)] = index[order]
        rows, columns = (np.flatnonzero((wide != _NONE).any(axis=axis)) for axis in (1, 0))
        lattice = wide[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
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


_DENSITY = np.float32(1 / np.sqrt(2 * np.pi))
_TINY = np.float32(1e-6)  # so that the centre itself has a direction
_STEPS = 3  # good to 1e-5 of the long axis where the short one is half as long, to 5e-5 at a seventh
_NEAR, _FAR = np.float32(2 / 3), np.float32(1 / 3)  # weights of ε = 0 and of ε² = 3
_FIRST, _THIRD = np.float32(3 / 2), np.float32(9 / 8)  # the terms of b for ε² = 3


@dataclass(frozen=True, eq=False)
class Rim:
    """Where samples (N, K) lie to the rims of N ellipses, pixels.

    distance: positive outside. curvature: 1 / px, of the rim nearby. outward: (N, 2, K) unit normals. unit: (N, 2, K)
    the points of the unit circle that the axes take to the rim nearby.
    """

    distance: Array
    curvature: Array
    outward: Array
    unit: Array


def rim(x: Array, y: Array, axes: Array) -> Rim:
    """Return where samples lie, x, y (N, K) from the ellipses' centres; axes (N, 2, 2) symmetric."""
    lengths, frames = (part.astype(x.dtype) for part in np.linalg.eigh(axes))
    long, short = lengths[:, [1]], lengths[:, [0]]
    (long_x, long_y), (short_x, short_y) = (frames[:, :, k].T[..., None] for k in (1, 0))
    along, across = x * long_x + y * long_y, x * short_x + y * short_y
    cosine, sine = _nearest(np.abs(along), np.abs(across), long, short)
    cosine, sine = np.copysign(cosine, along), np.copysign(sine, across)
    steepness = _length(cosine / long, sine / short)
    normal_along, normal_across = cosine / (long * steepness), sine / (short * steepness)
    distance = (along - long * cosine) * normal_along + (across - short * sine) * normal_across
    return Rim(
        distance,
        1 / ((long * short) ** 2 * (steepness * steepness * steepness)),
        np.stack([normal_along * long_x + normal_across * short_x, normal_along * long_y + normal_across * short_y], 1),
        np.stack([cosine * long_x + sine * short_x, cosine * long_y + sine * short_y], axis=1),
    )


def _nearest(along: Array, across: Array, long: Array, short: Array) -> tuple[Array, Array]:
    """Return cosine and sine (N, K) of the points of ellipses nearest to samples in their first quadrant.

    By steps on the circle that osculates the ellipse at the last point, from the middle of its quadrant.
    """
    cosine = sine = np.full_like(along, np.sqrt(0.5))
    middle_along, middle_across = (long**2 - short**2) / long, (short**2 - long**2) / short
    for _ in range(_STEPS):
        cube_along, cube_across = middle_along * (cosine * cosine * cosine), middle_across * (sine * sine * sine)
        radius = _length(long * cosine - cube_along, short * sine - cube_across)
        off_along, off_across = along - cube_along, across - cube_across
        scale = radius / (_length(off_along, off_across) + _TINY)
        cosine = np.maximum(off_along * scale + cube_along, 0) / long + _TINY
        sine = np.maximum(off_across * scale + cube_across, 0) / short
        length = _length(cosine, sine)
        cosine, sine = cosine / length, sine / length
    return cosine, sine


def _length(x: Array, y: Array) -> Array:
    return np.asarray(np.sqrt(x * x + y * y))


def picture(distance: Array, curvature: Array, blur: Array) -> tuple[Array, Array, Array]:
    """Return the picture (N, K), 1 inside and 0 outside, and its derivatives by distance and blur, per pixel.

    distance: (N, K) px from rims of curvature (N, K) 1 / px. blur: (N, 1) px.
    """
    scaled, bend = distance / blur, curvature * blur
    square = bend * bend
    beyond = scaled + bend * (_FIRST + _THIRD * square)
    density, density_beyond = (
        _DENSITY * weight * np.exp(-0.5 * z * z) for weight, z in ((_NEAR, scaled), (_FAR, beyond))
    )
    both = density + density_beyond
    return (
        _NEAR * ndtr(-scaled) + _FAR * ndtr(-beyond),
        -both / blur,
        (scaled * both - density_beyond * bend * (_FIRST + 3 * _THIRD * square)) / blur,
    )
