"""The samples of an image around the corners of a checker pattern."""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array

CORE_PX = 2.5  # the smallest radius: fewer pixels than parameters determine nothing
REACH_PX = 12.0  # a radius that holds edge enough; lens distortion bends longer edges
BAND_PX = 6.0  # samples so near to an edge are always taken


@dataclass(frozen=True)
class Window:
    """How far samples are taken and how densely.

    reach: radius as a share of the spacing where that is more than REACH_PX. share: largest radius, of a step.
    band: share of the radius, how far from an edge samples lie. across: samples on a diameter at most.
    blur: share of the radius that the edges are blurred by at the start of a fit.
    """

    reach: float
    share: float
    band: float
    across: float = np.inf
    blur: float = 0.0


FINE = Window(reach=1 / 8, share=0.4, band=0.25)  # an image's blur grows with its pixels; the next edge is far
QUICK = Window(reach=1 / 8, share=0.4, band=0.25, across=12)  # sharp edges sampled so are good to tenths of a pixel
WIDE = Window(reach=0.7, share=0.7, band=1.0, across=16, blur=0.3)  # blurred edges attract from up to 0.4 steps away


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples (N, K) of N windows: offsets from the start in pixels, gray values, and 0 for those beyond the window.

    reach: the largest radius, blur: that of the edges at the start, pixels.
    """

    x: Array
    y: Array
    values: Array
    weights: Array
    reach: float
    blur: float

    def take(self, rows: Array) -> "Samples":
        """Return the samples of some of the windows."""
        return Samples(self.x[rows], self.y[rows], self.values[rows], self.weights[rows], self.reach, self.blur)


def sample(
    gray: Array, pixels: Array, steps: Array, window: Window, clearance: float, sites: Array | None = None
) -> Samples:
    """Return the samples around pixels (N, 2) of `gray` (H, W).

    steps: (N, 2, 2) pixels, columns are the steps to the next corner along the row and down the column.
    clearance: how far from the nearer edge, in steps, samples may lie. sites: (H, W) mask of the pixels that count,
    such as those of one colour of a mosaic; None for all.
    """
    lengths = np.linalg.norm(steps, axis=1)
    limit = np.maximum(REACH_PX, window.reach * lengths.min(axis=1))
    reach = float(max(CORE_PX, np.minimum(window.share * lengths.max(axis=1), limit).max()))
    stride = max(1, round(2 * reach / window.across))
    side = np.arange(-int(reach / stride) - 1, int(reach / stride) + 2) * stride
    offsets = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    places = np.rint(pixels).astype(np.intp)[:, None] + offsets
    used = _in_window(places - pixels[:, None], steps, limit[:, None], window, clearance)
    used &= ((places >= 0) & (places < (gray.shape[1], gray.shape[0]))).all(axis=-1)
    if sites is not None:
        column, row = np.moveaxis(places, -1, 0)
        used &= sites[np.clip(row, 0, gray.shape[0] - 1), np.clip(column, 0, gray.shape[1] - 1)]
    first = np.argsort(~used, axis=1, kind="stable")[:, : max(1, int(used.sum(axis=1).max()))]
    places = np.take_along_axis(places, first[..., None], axis=1)
    x, y = np.moveaxis(places - pixels[:, None], -1, 0)
    column, row = np.moveaxis(places, -1, 0)
    values = gray[np.clip(row, 0, gray.shape[0] - 1), np.clip(column, 0, gray.shape[1] - 1)]
    weights = np.take_along_axis(used, first, axis=1)
    blur = max(1.0, window.blur * reach)
    return Samples(x, y, values.astype(np.float64), weights.astype(np.float64), reach, blur)


def _in_window(away: Array, steps: Array, limit: Array, window: Window, clearance: float) -> Array:
    """Return which samples (N, K), offsets (N, K, 2) in pixels, belong to the windows: a disc in the board's plane,
    of which what is far from both edges is left out.
    """
    in_steps = np.abs(away @ _inverse(steps).swapaxes(1, 2))
    radius = np.hypot(away[..., 0], away[..., 1])
    disc = (np.hypot(in_steps[..., 0], in_steps[..., 1]) < window.share) & (radius <= limit)
    edge_distance = (in_steps * _heights(steps)[:, None]).min(axis=-1)
    near = (edge_distance < np.maximum(BAND_PX, window.band * limit)) & (in_steps.min(axis=-1) < clearance)
    return np.asarray((disc & near) | (radius <= CORE_PX))


def _heights(steps: Array) -> Array:
    """Return the distance in pixels (N, 2) between neighbouring edges: of the columns, then of the rows."""
    return np.asarray(np.abs(np.linalg.det(steps))[:, None] / np.linalg.norm(steps, axis=1)[:, ::-1])


def _inverse(steps: Array) -> Array:
    """Return the inverses of (N, 2, 2), the unit matrix for parallel steps: a corner without angle fits nothing."""
    flat = np.abs(np.linalg.det(steps)) < 1e-3
    return np.asarray(np.linalg.inv(np.where(flat[:, None, None], np.eye(2), steps)))
