"""The corners of a board measured where they have been found, as exactly as an image allows, with their covariance."""

import numpy as np

from camcal.arrays import Array
from camcal.targets.board import Board
from camcal.targets.board_edges import seen_cells, signs
from camcal.targets.board_map import map_of
from camcal.targets.cells import Cells
from camcal.targets.edge_blur import edge_blur
from camcal.targets.refine import RefinedCorners, refine
from camcal.targets.samples import Samples
from camcal.targets.sighting import MIN_CORNERS, Sighting

LARGEST_NOISE = 0.4  # of the contrast; what is left over of a corner that is none is more
_BLUR_PX = 1.0  # where no edge says otherwise
_NEAR_PX = 8.0  # along the edges at first: from corners some tenths of a pixel off one cannot tell how they bend
_ROUNDS = 3  # where corners are so close that each is seen in its neighbours' pictures


def measure(samples: Samples, board: Board, sighting: Sighting) -> Sighting:
    """Return what was seen of a board of crossing edges with its corners measured; those that are none are left out.

    sighting: its corners are good to half a pixel or so.
    """
    if not sighting.found:
        return sighting
    ids, pixels, values, sites = sighting.ids, sighting.pixels, samples.values, samples.sites
    blur = blur_of(values, pixels)
    corners = refine(values, pixels, _cells(board, ids, pixels, values).narrow(), blur, sites, _NEAR_PX)
    # What a board that leaves its pattern open, or that is printed inverted, has before its first corner
    first = 1 if np.nansum(corners.contrast * signs(board)[ids]) >= 0 else -1
    for _ in range(_ROUNDS):
        cells = _cells(board, ids, corners.pixels, values, first)
        corners = refine(values, corners.pixels, cells, blur, sites)
        if not cells.crowded(blur):
            break
    good = clear(corners)
    if good.sum() < MIN_CORNERS:
        return Sighting.nothing(f"only {int(good.sum())} clear corners")
    return Sighting(ids[good], corners.pixels[good], covariance=corners.covariance[good])


def _cells(board: Board, ids: Array, pixels: Array, values: Array, first: int = 1) -> Cells:
    """Return the cells of corners as a map that is fitted to all of them has them."""
    points = board.points()[ids]
    seen = map_of(points[:, :2], pixels, (values.shape[1], values.shape[0]))
    return seen_cells(board, ids, points, lambda points: seen.pixels(points[:, :2]), first)[1]


def clear(corners: RefinedCorners) -> Array:
    """Return which corners (N,) are borne out by the image."""
    return np.asarray(corners.settled & (corners.noise < LARGEST_NOISE * np.abs(corners.contrast)))


def blur_of(values: Array, pixels: Array) -> float:
    """Return the blur of the edges (px, the pixel's own square included) around points (N, 2)."""
    blur = edge_blur(values, pixels) if len(pixels) > 2 else np.nan
    return float(blur) if np.isfinite(blur) else _BLUR_PX
