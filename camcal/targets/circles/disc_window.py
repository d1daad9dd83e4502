"""The samples of an image around the rims of ellipses."""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.targets.circles.blobs import Ellipses


@dataclass(frozen=True, eq=False)
class RimSamples:
    """Samples (N, K) around N ellipses: offsets from the starts (pixels), gray values, 1 for those that count or 0.

    reach: (N, 1) pixels, the largest offset of each. whole: (N,) share of each window that is within the image.
    others: (N, K) how much of a sample other ellipses cover.
    """

    x: Array
    y: Array
    values: Array
    used: Array
    reach: Array
    whole: Array
    others: Array

    def take(self, rows: Array) -> "RimSamples":
        """Return the samples of some of the windows."""
        return RimSamples(
            self.x[rows],
            self.y[rows],
            values=self.values[rows],
            used=self.used[rows],
            reach=self.reach[rows],
            whole=self.whole[rows],
            others=self.others[rows],
        )


def sample(gray: Array, start: Ellipses, band: float, room: Array, most: float = np.inf) -> RimSamples:
    """Return the samples not farther than `band` (px) from the rims, `most` an ellipse or a few more.

    room: (N,) the multiple of an ellipse's axes that samples may reach outwards, short of the next ellipse.
    """
    height, width = gray.shape
    half = np.linalg.norm(start.axes, axis=2).max() + band  # rows' lengths are half the sides of the bounding box
    side = np.arange(-int(half) - 1, int(half) + 2)
    offsets = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    whole = np.rint(start.centres).astype(np.intp)
    shift = whole - start.centres
    owner, place = np.nonzero(_near_rim(offsets + shift[:, None], start.axes, band, room))
    count = np.bincount(owner, minlength=len(whole))
    every = np.maximum(1, (count / most).astype(np.intp))[owner]
    kept = (np.arange(len(owner)) - (np.cumsum(count) - count)[owner]) % every == 0
    owner, offset = owner[kept], offsets[place[kept]]
    column, row = (whole[owner] + offset).T
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    wanted = np.bincount(owner, minlength=len(whole))
    owner, offset, column, row = owner[inside], offset[inside], column[inside], row[inside]
    count = np.bincount(owner, minlength=len(whole))
    slot = np.arange(len(owner)) - (np.cumsum(count) - count)[owner]
    x, y, values, used = np.zeros((4, len(whole), max(1, int(count.max()))), np.float32)
    x[owner, slot], y[owner, slot] = (offset + shift[owner]).T
    values[owner, slot], used[owner, slot] = gray[row, column], 1
    reach = np.maximum(np.abs(x), np.abs(y)).max(axis=1, keepdims=True) + 1
    return RimSamples(
        x, y, values=values, used=used, reach=reach, whole=count / np.maximum(wanted, 1), others=np.zeros_like(x)
    )


def _near_rim(away: Array, axes: Array, band: float, room: Array) -> Array:
    """Return which offsets (N, K, 2) lie within the band, to first order, and within the room."""
    x, y = np.moveaxis(away.astype(np.float32), -1, 0)
    inverse = np.linalg.inv(axes).astype(np.float32)
    a, b, c = (inverse[:, i, j, None] for i, j in ((0, 0), (0, 1), (1, 1)))
    across, down = a * x + b * y, b * x + c * y
    square = across * across + down * down
    slope = np.sqrt((a * across + b * down) ** 2 + (b * across + c * down) ** 2)
    near = np.abs(square - np.sqrt(square)) < band * slope
    return np.asarray(
        (near | (square < 0.25) & (np.linalg.det(axes)[:, None] < band**2)) & (square < room[:, None] ** 2)
    )
