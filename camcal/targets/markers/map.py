"""Where a marker's drawing is in an image: a homography, and what a lens adds that bends straight lines.

    (x, y) = H(u, v) + Σ kᵢ Bᵢ(u, v)        u, v from -1 to 1 across the marker, x, y in pixels

H is h11 … h32 with h33 = 1. B₁ and B₂ are radial distortion of third and fifth order about the middle of the image,
less what moves the marker's corners, which H does as well. B₃ … B₆ are 1 - u² and 1 - v² along x and along y, times the
marker's side, for what is not quite radial. All of them vanish at the corners.
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.geometry.homography import through

BENDS = 6
CORNERS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])  # clockwise from the top-left


@dataclass(frozen=True, eq=False)
class Straight:
    """What a homography makes of K places: pixels (K, 2), derivatives (K, 2, 2) by u, v and (K, 2, 8) by h11 … h32."""

    pixels: Array
    by_place: Array
    by_entries: Array

    @property
    def gradients(self) -> Array:
        """The derivatives (K, 2, 2) of u and v by x and y, 1/px."""
        (a, b), (c, d) = self.by_place.transpose(1, 2, 0)
        adjugate = np.stack([d, -b, -c, a], axis=1).reshape(-1, 2, 2)
        return np.asarray(adjugate / (a * d - b * c)[:, None, None])


def homography(corners: Array) -> Array:
    """Return the entries (8,) of the homography that takes CORNERS to corners (4, 2) px."""
    rows = []
    for (u, v), (x, y) in zip(CORNERS, corners, strict=True):
        rows += [[u, v, 1, 0, 0, 0, -x * u, -x * v], [0, 0, 0, u, v, 1, -y * u, -y * v]]
    return np.asarray(np.linalg.solve(np.array(rows), corners.ravel()))


def straight(entries: Array, places: Array) -> Straight:
    """Return where a homography (8,) puts places (K, 2), as u, v."""
    h, (u, v) = entries, places.T
    one, zero = np.ones_like(u), np.zeros_like(u)
    w = h[6] * u + h[7] * v + 1
    pixels = np.stack([h[0] * u + h[1] * v + h[2], h[3] * u + h[4] * v + h[5]], axis=1) / w[:, None]
    by_place = (h[[0, 1, 3, 4]].reshape(2, 2) - pixels[:, :, None] * h[6:8]) / w[:, None, None]
    x, y = pixels.T
    by_x = np.stack([u, v, one, zero, zero, zero, -x * u, -x * v], axis=1)
    by_y = np.stack([zero, zero, zero, u, v, one, -y * u, -y * v], axis=1)
    return Straight(pixels, by_place, np.stack([by_x, by_y], axis=1) / w[:, None, None])


def places_of(entries: Array, pixels: Array) -> Array:
    """Return the places (K, 2), as u, v, that a homography (8,) puts at pixels (K, 2)."""
    inverse = np.linalg.inv(np.append(entries, 1.0).reshape(3, 3))
    return through(inverse, pixels)


def bends(entries: Array, places: Array, middle: Array, radius: float) -> Array:
    """Return B₁ … B₆ at places (K, 2) near a homography (8,) as (K, 2, 6) px.

    middle: (2,) px, of the image. radius: px, where radial distortion is as large as the distance from there.
    """
    anywhere, corners = straight(entries, places), straight(entries, CORNERS)
    moved = _distortion(corners.pixels - middle, radius).reshape(8, 2)
    followed = anywhere.by_entries @ np.linalg.solve(corners.by_entries.reshape(8, 8), moved)
    radial = _distortion(anywhere.pixels - middle, radius) - followed
    free = np.einsum("kp,xy->kxpy", longest_side(corners.pixels) * (1 - places**2), np.eye(2))
    return np.concatenate([radial, free.reshape(len(places), 2, 4)], axis=2)


def longest_side(corners: Array) -> float:
    """Return the length of the longest side between corners (4, 2)."""
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).max())


def _distortion(away: Array, radius: float) -> Array:
    """Return radial displacements (K, 2, 2) of third and fifth order, px, of pixels `away` (K, 2) from the middle."""
    square = ((away / radius) ** 2).sum(axis=1)[:, None]
    return np.stack([away * square, away * square**2], axis=2)
