"""How blurred the edges of a board are in an image, whatever kind of board it is."""

import numpy as np

from camcal.arrays import Array

_REACH = 0.45  # of the way to the nearest point: what lies around a point and no other
_RADII = (3, 16)  # px of a window: enough for an edge, few enough for a quick look
_MOST = 100  # points of a board that are looked at
_NEIGHBOURS = 2.5  # nearest distances within which the second direction is sought
_DARK, _BRIGHT = 0.05, 0.95
_DIFFERENCE = 1 / 3  # px², variance of the box that a central difference averages over


def edge_blur(gray: Array, pixels: Array) -> float:
    """Return the standard deviation (px) of the blur of the edges around points, in the direction that is worse.

    gray: (H, W). pixels: (N, 2) points of a board, at least three of them not in a line. Motion blurs the edges across
    it and leaves those along it, so that both directions of a board are measured and the larger counts; the median over
    the points. NaN where no window lies in the image.
    An edge of contrast A has the slope p exp(-x² / 2s²), p = A / (√(2π) s). Its squares and fourth powers sum up to
    p² s √π and p⁴ s √(π/2) per unit length: √2 times their ratio is p², in which noise counts little.
    """
    chosen = pixels[:: -(-len(pixels) // _MOST)]
    directions, nearest = _directions(chosen, pixels)
    radius = int(np.clip(_REACH * np.median(nearest), *_RADII))
    windows, kept = _windows(gray, chosen, radius)
    if not kept.any():
        return float("nan")
    down, across = (np.gradient(windows, axis=axis)[:, 1:-1, 1:-1] for axis in (1, 2))
    slope = np.stack([across, down], axis=-1).reshape(len(windows), -1, 2)
    squares = (slope**2).sum(axis=2)
    normals = np.stack([-directions[kept, :, 1], directions[kept, :, 0]], axis=-1)
    of_first = np.abs(slope @ normals[:, 0, :, None]) >= np.abs(slope @ normals[:, 1, :, None])
    dark, bright = np.quantile(windows.reshape(len(windows), -1), [_DARK, _BRIGHT], axis=1)
    blurs = [_blur(squares * mask, bright - dark) for mask in (of_first[..., 0], ~of_first[..., 0])]
    return float(np.sqrt(max(np.median(np.maximum(*blurs)) ** 2 - _DIFFERENCE, 0.0)))


def _blur(squares: Array, contrast: Array) -> Array:
    """Return the blur (N,) of edges from the squared slopes (N, P) of their pixels and their contrasts (N,)."""
    steepest = np.sqrt(2) * (squares**2).sum(axis=1) / np.maximum(squares.sum(axis=1), 1e-9)
    return np.asarray(contrast / np.sqrt(2 * np.pi * np.maximum(steepest, 1e-9)))


def _directions(chosen: Array, pixels: Array) -> tuple[Array, Array]:
    """Return unit vectors (M, 2, 2) from points to the nearest one and to a near one across, and the distance (M,)."""
    away = pixels - chosen[:, None]
    length = np.linalg.norm(away, axis=2)
    length[length < 1e-9] = np.inf
    rows, closest = np.arange(len(chosen)), length.argmin(axis=1)
    nearest = length[rows, closest]
    first = away[rows, closest] / nearest[:, None]
    aside = np.abs(first[:, None, 0] * away[..., 1] - first[:, None, 1] * away[..., 0]) / length
    aside[length > _NEIGHBOURS * nearest[:, None]] = -1.0
    other = (aside / np.where(np.isfinite(length), length, 1.0)).argmax(axis=1)
    second = away[rows, other] / length[rows, other][:, None]
    return np.stack([first, second], axis=1), nearest


def _windows(gray: Array, points: Array, radius: int) -> tuple[Array, Array]:
    """Return the windows (K, S, S) around points that lie in the image, and which points (M,) these are."""
    middle = np.rint(points).astype(np.intp)
    size = np.array(gray.shape[::-1])
    kept = np.asarray(((middle >= radius) & (middle < size - radius)).all(axis=1))
    reach = np.arange(-radius, radius + 1)
    rows, columns = (middle[kept, axis, None] + reach for axis in (1, 0))
    return gray[rows[:, :, None], columns[:, None, :]].astype(np.float64), kept
