"""Patterns of residuals: what a lens model leaves that does not describe the lens.

They follow the radius, or different views share them at the same place of the image.
"""

from typing import NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.intrinsics import Calibration
from camcal.calibrate.shared_residuals import CellSums, cell_numbers
from camcal.solve.losses import chi_square_beyond

_CHANCE = 1e-6  # of residuals that follow the radius by so much, if the lens model were right
_RINGS = 8
# Chance of residuals that different views share, if the lens model were right: ten views that all agree have it.
_SHARED_CHANCE = 1e-3
_SHARED = 1 / 3  # of the standard deviation of the map: a pattern below it, RMS, is among what that states
_VIEWS = 3  # of a cell, with fewer there is nothing that they share
_FARTHEST = 10.0  # standard deviations: a rejected corner counts with no more


class Pattern(NamedTuple):
    """largest_px: of the mean residuals. words: which way they point there, and where. bias: (M, 2) px, of the pixels
    that were asked for.
    """

    largest_px: float
    words: str
    bias: Array


def find_patterns(calibration: Calibration, pixels: Array, stated_px: float) -> tuple[Pattern, ...]:
    """Return the patterns of residuals that are not by chance, what says least about the place first.

    pixels: (M, 2) at which the bias of the lens is wanted. stated_px: RMS standard deviation of projections where
    corners were seen.
    """
    found = radial_pattern(calibration, pixels), shared_pattern(calibration, pixels, stated_px)
    return tuple(pattern for pattern in found if pattern is not None)


def radial_pattern(calibration: Calibration, pixels: Array) -> Pattern | None:
    """Return how residuals point inwards or outwards by distance from the centre, as a wrong lens model's do, None
    where it may be by chance; beyond the outermost ring the bias is as large as there.
    """
    centre = np.array([calibration.camera.value("cx"), calibration.camera.value("cy")])
    offset = calibration.pixels - centre
    radius = np.linalg.norm(offset, axis=1)
    radial = np.einsum("ni,ni->n", calibration.residuals, offset) / np.maximum(radius, 1e-9)
    edges = np.quantile(radius, np.linspace(0, 1, _RINGS + 1))
    ring = np.clip(np.searchsorted(edges, radius, side="right") - 1, 0, _RINGS - 1)
    counts = np.maximum(np.bincount(ring, minlength=_RINGS), 1)
    means = np.bincount(ring, radial, _RINGS) / counts
    # corners of one view share its errors, so a ring holds fewer independent values than corners
    per_view = max(len(radius) / max(len(calibration.used), 1) / _RINGS, 1.0)
    statistic = float(np.sum(means**2 * counts / per_view)) / calibration.sigma_px**2
    if chi_square_beyond(statistic, _RINGS) >= _CHANCE:
        return None
    worst = int(np.argmax(np.abs(means)))
    way, size = "outwards" if means[worst] > 0 else "inwards", float(abs(means[worst]))
    words = f"residuals point {way} by {size:.2f} px at {edges[worst]:.0f} to {edges[worst + 1]:.0f} px from the centre"
    outwards = pixels - centre
    distance = np.linalg.norm(outwards, axis=1)
    along = np.interp(distance, (edges[:-1] + edges[1:]) / 2, means) / np.maximum(distance, 1e-9)
    return Pattern(size, words, along[:, None] * outwards)


def shared_pattern(calibration: Calibration, pixels: Array, stated_px: float) -> Pattern | None:
    """Return what the residuals of different views share in the cells of a grid over the image, None where it may be by
    chance or is among what the standard deviation of the map states.
    """
    places, residuals, views = _with_rejected(calibration)
    size = calibration.camera.image_size
    found = CellSums.of(places, residuals, views, size)
    if found.chance >= _SHARED_CHANCE:
        return None
    sums, counts, cells = found.sums, found.counts, cell_numbers(places, size)
    total = counts.sum(axis=0)
    pairs = total**2 - (counts**2).sum(axis=0)
    whole = sums.sum(axis=0)
    squares = np.sum(whole**2, axis=1) - np.sum(sums**2, axis=(0, 2))
    squares = np.where(((counts > 0).sum(axis=0) >= _VIEWS) & (pairs > 0), squares / np.maximum(pairs, 1), 0.0)
    sizes = np.sqrt(np.maximum(squares, 0.0))
    if np.average(squares, weights=total) <= (_SHARED * stated_px) ** 2:
        return None
    means = sizes[:, None] * whole / np.maximum(np.linalg.norm(whole, axis=1), 1e-9)[:, None]
    worst = int(np.argmax(sizes))
    u, v = places[cells == worst].mean(axis=0)
    words = f"residuals of different views point the same way, by {sizes[worst]:.2f} px near ({u:.0f}, {v:.0f})"
    return Pattern(float(sizes[worst]), words, means[cell_numbers(pixels, size)])


def _with_rejected(calibration: Calibration) -> tuple[Array, Array, Array]:
    """Return the pixels (N, 2), residuals (N, 2) px and places of the views (N,) of the corners of views that are
    used: where a lens is described worst, its corners are rejected.
    """
    places = {view.image: place for place, view in enumerate(calibration.views) if view.used}
    lost = [own for own in calibration.rejected if own.image in places and np.isfinite(own.residual).all()]
    most = _FARTHEST * calibration.sigma_px
    near = [own.residual * min(1.0, most / max(own.distance, 1e-9)) for own in lost]
    return (
        np.concatenate([calibration.pixels, np.reshape([own.pixel for own in lost], (-1, 2))]),
        np.concatenate([calibration.residuals, np.reshape(near, (-1, 2))]),
        np.concatenate([calibration.corner_views, np.array([places[own.image] for own in lost], np.intp)]),
    )
