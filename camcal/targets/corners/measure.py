"""The corners of a board measured where they have been found, as exactly as an image allows, with their covariance."""

import numpy as np

from camcal.arrays import Array
from camcal.targets.board import Board
from camcal.targets.board_map import map_of
from camcal.targets.corners.board_edges import seen_cells, signs
from camcal.targets.corners.cell_window import LONGEST_PX
from camcal.targets.corners.cells import Cells
from camcal.targets.corners.refine import RefinedCorners, refine
from camcal.targets.detection import MIN_CORNERS, Detection
from camcal.targets.edge_blur import edge_blur
from camcal.targets.samples import Samples

LARGEST_NOISE = 0.4  # of the contrast; what is left over of a corner that is none is more
LARGEST_STD_PX = 0.5  # of a corner that is one
UNUSUAL = 1.5  # times the usual noise, which may be large where there is little light
_BLUR_PX = 1.0  # where no edge says otherwise
_NEAR_PX = 8.0  # along the edges at first: from corners some tenths of a pixel off one cannot tell how they bend
_BENT_PX = 0.03  # that an edge may be off by where it ends
_ROUNDS = 3  # where corners are so close that each is seen in its neighbours' pictures


def measure(samples: Samples, board: Board, detection: Detection) -> Detection:
    """Return what was seen of a board of crossing edges with its corners measured; those that are none are left out.

    detection: its corners are good to half a pixel or so.
    """
    if not detection.found:
        return detection
    ids, pixels, values, sites = detection.ids, detection.pixels, samples.values, samples.sites
    blur = blur_of(values, pixels)
    near = refine(values, pixels, _cells(board, ids, pixels, values, blur)[0].narrow(), blur, sites, _NEAR_PX)
    if not near.settled.any():
        return Detection.nothing("no clear corners")
    # What a board that leaves its pattern open, or that is printed inverted, has before its first corner
    first = 1 if np.nansum(near.contrast * signs(board)[ids]) >= 0 else -1
    corners = near
    for _ in range(_ROUNDS):
        cells, reach = _cells(
            board, ids, pixels=corners.pixels, values=values, blur_px=blur, first=first, covariance=corners.covariance
        )
        if not np.isfinite(cells.bends).all():
            break  # no map holds these corners
        corners = refine(values, corners.pixels, cells, blur, sites, reach)
        if not (cells.crowded(blur) and corners.settled.any()):
            break
    return _detection(ids, corners, near)


def _cells(
    board: Board,
    ids: Array,
    pixels: Array,
    values: Array,
    blur_px: float,
    first: int = 1,
    covariance: Array | None = None,
) -> tuple[Cells, float]:
    """Return the cells of corners as a map that is fitted to all of them has them, and how far (px) its edges hold.

    covariance: (N, 2, 2) px² of the corners, None where they are good to some tenths of a pixel only. What the map
    leaves beyond it, r over a step h, is r (l / h)² at l.
    """
    points = board.points()[ids]
    seen = map_of(points[:, :2], pixels, (values.shape[1], values.shape[0]), rough=covariance is None)
    middle, cells = seen_cells(board, ids, points, lambda points: seen.pixels(points[:, :2]), blur_px, first)
    if covariance is None:
        return cells, LONGEST_PX
    left = ((middle - pixels) ** 2).sum(axis=1) - np.trace(covariance, axis1=1, axis2=2)
    left = np.sqrt(max(float(np.median(left[np.isfinite(left)])), 0.0)) if np.isfinite(left).any() else 0.0
    step = float(np.median(np.linalg.norm(cells.steps, axis=1)))
    return cells, float(np.clip(step * np.sqrt(_BENT_PX / max(left, 1e-9)), _NEAR_PX, LONGEST_PX))


def _detection(ids: Array, corners: RefinedCorners, near: RefinedCorners) -> Detection:
    """Return the corners that are clear, by a near look at them where the whole of their cells does not fit."""
    good, fallback = clear(corners), clear(near)
    kept = good | fallback
    if kept.sum() < MIN_CORNERS:
        return Detection.nothing(f"only {int(kept.sum())} clear corners")
    pixels = np.where(good[:, None], corners.pixels, near.pixels)
    covariance = np.where(good[:, None, None], corners.covariance, near.covariance)
    return Detection(ids=ids[kept], pixels=pixels[kept], covariance=covariance[kept])


def clear(corners: RefinedCorners) -> Array:
    """Return which corners (N,) are borne out by the image: most are, and say what noise there is."""
    usual = np.nanmedian(corners.noise) if corners.settled.any() else 0.0
    limit = np.maximum(LARGEST_NOISE * np.abs(corners.contrast), UNUSUAL * usual)
    sure = np.trace(corners.covariance, axis1=1, axis2=2) < 2 * LARGEST_STD_PX**2
    return np.asarray(corners.settled & (corners.noise < limit) & sure)


def blur_of(values: Array, pixels: Array) -> float:
    """Return the blur of the edges (px, the pixel's own square included) around points (N, 2)."""
    blur = edge_blur(values, pixels) if len(pixels) > 2 else np.nan
    return float(blur) if np.isfinite(blur) else _BLUR_PX
