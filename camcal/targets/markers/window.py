"""The pixels of an image that say where a marker is."""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.targets.markers import map as marker_map
from camcal.targets.markers.drawing import MarkerDrawing

_MARGIN = 0.6  # cells around a marker that count; the white there is a cell wide or wider
_BAND_PX = 3.5  # what is farther from an edge says nothing


@dataclass(frozen=True, eq=False)
class Window:
    """Pixels (K, 2) from a marker's middle, their gray values (K,), quadratics 1 x y x² xy y² (K, 6) for the light on
    them, and the bends (K, 2, 6) that a lens may add there.
    """

    pixels: Array
    values: Array
    light: Array
    bends: Array


def look(gray: Array, middle: Array, entries: Array, drawing: MarkerDrawing, most: int) -> Window:
    """Return the pixels of a marker and its margin, of a large one about `most` by its edges.

    gray: (H, W). middle: (2,) px, whole. entries: (8,) of the homography from the drawing to pixels from there.
    """
    corners = marker_map.straight(entries, marker_map.CORNERS).pixels
    side = marker_map.longest_side(corners)
    pixels = _all_over(entries, drawing) if side**2 < most else _by_edges(entries, drawing, side, most)
    size = np.array(gray.shape[::-1])
    pixels = pixels[((pixels + middle >= 0) & (pixels + middle < size)).all(axis=1)]
    column, row = (pixels + middle).astype(np.intp).T
    x, y = pixels.T / side
    places = marker_map.places_of(entries, pixels)
    bends = marker_map.bends(entries, places, (size - 1) / 2 - middle, float(np.linalg.norm(size)) / 2)
    light = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    return Window(pixels, gray[row, column].astype(np.float64), light, bends)


def _all_over(entries: Array, drawing: MarkerDrawing) -> Array:
    """Return the pixels (K, 2) of a marker and its margin."""
    reach = 1 + 2 * _MARGIN / len(drawing.ink)
    outline = marker_map.straight(entries, reach * marker_map.CORNERS).pixels
    low, high = np.floor(outline.min(axis=0)), np.ceil(outline.max(axis=0))
    x, y = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    return np.asarray(pixels[(np.abs(marker_map.places_of(entries, pixels)) < reach).all(axis=1)])


def _by_edges(entries: Array, drawing: MarkerDrawing, side: float, most: int) -> Array:
    """Return pixels (K, 2) near the edges of cells, as many by each of them; the same ones every time."""
    starts, ends = drawing.edges
    which = np.arange(most) % len(starts)
    chance = np.random.default_rng(0).random((most, 2))
    along = (ends - starts)[which]
    across = along[:, ::-1] / np.linalg.norm(along, axis=1, keepdims=True)
    band = min(2 * _BAND_PX / side, 2 * _MARGIN / len(drawing.ink))
    places = starts[which] + along * chance[:, [0]] + across * (2 * chance[:, [1]] - 1) * band
    return np.unique(np.rint(marker_map.straight(entries, places).pixels), axis=0)
