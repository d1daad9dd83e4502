"""Where in the image the corners were, and whether the residuals still depend on it."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from camcal.arrays import Array
from camcal.calibrate.intrinsics import Calibration
from camcal.cameras.image_circle import ImageCircle

_CELLS = (10, 8)
_RINGS = 8


@dataclass(frozen=True)
class Coverage:
    """cells: share of a 10 × 8 grid of the image with a corner in it. reach: largest distance of a corner from the
    principal point over that of the farthest image corner. Both of what the image circle shows, where there is one.
    """

    cells: float
    reach: float


@dataclass(frozen=True)
class Trend:
    """Mean radial residual (px, outwards positive) in the ring where it is largest, and the chance of such a pattern
    if the lens model were right.
    """

    largest_px: float
    ring: tuple[float, float]
    chance: float


def coverage(calibration: Calibration, circle: ImageCircle | None = None) -> Coverage:
    """Return how much of the image, or of its image circle, the kept corners cover."""
    width, height = calibration.camera.image_size
    pixels = calibration.pixels
    cell = np.array([width, height]) / _CELLS
    places = np.clip((pixels + 0.5) // cell, 0, np.array(_CELLS) - 1).astype(int)
    middles = (np.stack(np.meshgrid(*map(np.arange, _CELLS), indexing="ij"), axis=-1) + 0.5) * cell - 0.5
    shown = np.ones(_CELLS, bool) if circle is None else circle.contains(middles)
    shown[places[:, 0], places[:, 1]] = True
    cells = len(np.unique(places, axis=0)) / np.count_nonzero(shown)
    corners = np.array([[x, y] for x in (-0.5, width - 0.5) for y in (-0.5, height - 0.5)])
    centre = _centre(calibration)
    corners = corners if circle is None else circle.clipped(centre, corners)
    farthest = np.linalg.norm(corners - centre, axis=1).max()
    return Coverage(cells, float(np.linalg.norm(pixels - centre, axis=1).max() / farthest))


def radial_trend(calibration: Calibration) -> Trend:
    """Return whether residuals point inwards or outwards by distance from the centre, as a wrong lens model's do."""
    offset = calibration.pixels - _centre(calibration)
    radius = np.linalg.norm(offset, axis=1)
    radial = np.einsum("ni,ni->n", calibration.residuals, offset) / np.maximum(radius, 1e-9)
    edges = np.quantile(radius, np.linspace(0, 1, _RINGS + 1))
    ring = np.clip(np.searchsorted(edges, radius, side="right") - 1, 0, _RINGS - 1)
    counts = np.maximum(np.bincount(ring, minlength=_RINGS), 1)
    means = np.bincount(ring, radial, _RINGS) / counts
    # corners of one view share its errors, so a ring holds fewer independent values than corners
    per_view = max(len(radius) / max(len(calibration.used), 1) / _RINGS, 1.0)
    statistic = float(np.sum(means**2 * counts / per_view)) / calibration.sigma_px**2
    worst = int(np.argmax(np.abs(means)))
    return Trend(float(means[worst]), (float(edges[worst]), float(edges[worst + 1])), float(chi2.sf(statistic, _RINGS)))


def _centre(calibration: Calibration) -> Array:
    return np.array([calibration.camera.value("cx"), calibration.camera.value("cy")])
