"""Where every pixel of a view comes from: the lens on a coarse lattice, cubics between its nodes.

A lens is smooth: on a 12 MP image cubics over 16 pixels stay within 1e-4 px of it. Every cell is checked at its middle,
and where they do not hold, or the lens ends, the model itself is asked pixel by pixel.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle

LONGEST_SIDE = 32766  # pixels of a map are counted in 16 bits by OpenCV
STEP = 16  # pixels between nodes, and rows in a band: a band of two maps stays in the processor's cache
ACCURACY = 2e-4  # px, at the middle of a cell, where a cubic is farthest off


@dataclass(frozen=True, eq=False)
class Trace:
    """The way from pixels of a view to pixels of a camera.

    source_R_view: (3, 3) turns the view's rays, if given. circle: of the camera; there is no source outside of it.
    """

    source: Camera
    view: Camera
    source_R_view: Array | None = None
    circle: ImageCircle | None = None

    def positions(self, x: Array, y: Array) -> Array:
        """Return the source pixels (2, ...) of view pixels x, y, broadcast against each other; NaN where none is."""
        x, y = np.broadcast_arrays(x, y)
        rays = self.view.unproject(np.column_stack([x.ravel(), y.ravel()])).directions
        if self.source_R_view is not None:
            rays = rays @ self.source_R_view.T
        pixels = self.source.project(rays).pixels
        if self.circle is not None:
            pixels = np.where(self.circle.contains(pixels)[:, None], pixels, np.nan)
        return pixels.T.reshape(2, *x.shape)


def exact_bands(trace: Trace) -> Iterator[tuple[slice, Array]]:
    """Yield slices of rows of the view with the source pixels (2, rows, width) of theirs, from the model itself."""
    width, height = trace.view.image_size
    for start in range(0, height, STEP):
        rows = slice(start, min(start + STEP, height))
        yield rows, trace.positions(np.arange(width), np.arange(rows.start, rows.stop)[:, None])


def bands(trace: Trace) -> Iterator[tuple[slice, Array]]:
    """Yield the same as `exact_bands`, float32, good to a thousandth of a pixel and many times faster."""
    width, height = trace.view.image_size
    columns, rows = -(-width // STEP), -(-height // STEP)
    nodes = trace.positions((np.arange(columns + 3) - 1) * STEP, (np.arange(rows + 3) - 1)[:, None] * STEP)
    rough = _rough_cells(trace, nodes)
    shares = _cubic(np.arange(STEP) / STEP)
    across = (sliding_window_view(nodes, 4, axis=2) @ shares.T).reshape(2, rows + 3, -1)
    across = np.ascontiguousarray(across[:, :, :width], np.float32)
    downwards = shares.astype(np.float32)
    for row in range(rows):
        band = slice(row * STEP, min((row + 1) * STEP, height))
        result = downwards[: band.stop - band.start] @ across[:, row : row + 4]
        x = (np.flatnonzero(rough[row])[:, None] * STEP + np.arange(STEP)).ravel()
        x = x[x < width]
        if x.size:
            result[:, :, x] = trace.positions(x, np.arange(band.start, band.stop)[:, None])
        yield band, result


def _rough_cells(trace: Trace, nodes: Array) -> Array:
    """Return the mask (rows, columns) of the cells of nodes (2, rows + 3, columns + 3) that no cubic describes.

    A cell without a single known node, its neighbours' among them, lies beyond the lens as a whole and is not rough.
    """
    rows, columns = nodes.shape[1] - 3, nodes.shape[2] - 3
    middle = trace.positions((np.arange(columns) + 0.5) * STEP, (np.arange(rows)[:, None] + 0.5) * STEP)
    half = _cubic(np.array([0.5]))[0]
    guess = sliding_window_view(sliding_window_view(nodes, 4, axis=2) @ half, 4, axis=1) @ half
    known = sliding_window_view(np.isfinite(nodes[0]), (4, 4)).any(axis=(2, 3)) | np.isfinite(middle[0])
    return np.asarray(known & ~(np.abs(guess - middle).max(axis=0) < ACCURACY))


def _cubic(t: Array) -> Array:
    """Return the shares (n, 4) of the nodes at -1, 0, 1 and 2 in the value of their cubic at t (Lagrange)."""
    before, after, last = t + 1, t - 1, t - 2
    return np.stack(
        [-t * after * last / 6, before * after * last / 2, -before * t * last / 2, before * t * after / 6], 1
    )
