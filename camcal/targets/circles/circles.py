"""A grid of circles in an image: ellipses on a lattice, fitted, numbered so that the same id is the same dot.

A plain grid looks the same after half a turn, a square one after a quarter, and so does an asymmetric one of an even
number of rows; the turn whose rows run most to the right is then taken. The pixels are those of the discs' centres,
not of the ellipses' (disc_centres.py).
"""

from collections.abc import Iterator

import numpy as np
from scipy.spatial import KDTree

from camcal import opencv
from camcal.arrays import Array
from camcal.targets.board import Board
from camcal.targets.board_map import map_of
from camcal.targets.circles.blobs import Ellipses, find_ellipses
from camcal.targets.circles.disc_centres import projected_centres
from camcal.targets.circles.disc_fit import DiscFits, fit_discs
from camcal.targets.circles.lattice import lattices
from camcal.targets.circles.numbering import as_drawn, nodes, numbered, size_of
from camcal.targets.circles.other_grids import OtherGrid
from camcal.targets.detection import MIN_CORNERS, Detection

MIN_PROPOSED = 0.5  # of the board's circles, for the others to be looked for
LEAST_OTHER = 9  # circles of a grid that is worth a word; fewer may be anything
MIN_SHARE = 0.75  # of them that must be measured
_REDUCED = 800  # px, the longer side of the copy that is searched first
_LARGEST = 3200  # px, of a copy that is searched at last
_BLOCKS = (8, 16, 4, 32)  # of the longer side, the blocks that circles are darker or brighter than
_AGREEMENT = 0.6  # of a dot's window; noise takes its part
_INK = 0.4  # relative difference of a dot's contrast from the board's
_NOISE = 4.0  # times the median over the board: more of it is something that lies on a dot
_NOISE_FLOOR = 2.0  # gray levels


def find_circles(gray: Array, board: Board) -> Detection:
    """Return the circles of a board in `gray`, (H, W) uint8, or the reason why there are none.

    Up to a quarter of the circles may be hidden, but on each side of the board most must be seen: they say where it
    ends. Pixels are the images of the discs' centres; covariances are those of the fitted ellipses.
    """
    largest: OtherGrid | None = None
    unclear, longest = None, 2 * max(size_of(board)) + 1
    for ellipses in _proposals(gray):
        for lattice in lattices(ellipses, longest):
            ordered = numbered(as_drawn(lattice, board), ellipses, board)
            if ordered is None or (ordered >= 0).sum() < max(MIN_CORNERS, MIN_PROPOSED * board.count):
                other = OtherGrid.of(lattice, ellipses, board, whole=max(lattice.shape) <= longest)
                largest = other if largest is None or other.count > largest.count else largest
                continue
            seen = _measured(gray, board, ordered, ellipses)
            if seen.found:
                return seen
            unclear = seen
    if unclear or largest is None or largest.count < LEAST_OTHER:
        return unclear or Detection.nothing(f"no {board.words} found")
    return largest.detection(gray, board)


def _proposals(gray: Array) -> Iterator[Ellipses]:
    """Yield ellipses that may be the dots of a board, what is found most quickly first, in pixels of `gray`."""
    longest = max(gray.shape)
    sizes = dict.fromkeys((min(longest, _REDUCED), min(longest, _LARGEST)))
    for size in sizes:
        scale = size / longest
        copy = gray if scale == 1 else opencv.resized(gray, scale)
        for share in _BLOCKS:
            for bright in (False, True):
                yield find_ellipses(copy, size // share | 1, bright=bright).enlarged(1 / scale)


def _measured(gray: Array, board: Board, lattice: Array, ellipses: Ellipses) -> Detection:
    """Return the dots of a board fitted to the image; those that the lattice lacks are looked for too."""
    height, width = gray.shape
    start = _completed(board, lattice, ellipses, (width, height))
    fits = fit_discs(gray, start)
    good = _good(fits)
    if good.sum() < MIN_SHARE * board.count:
        return Detection.nothing(f"only {int(good.sum())} of {board.count} circles are clear")
    points = board.points()[good, :2] / board.pitch
    radius = None if board.diameter is None else board.diameter / board.pitch / 2
    pixels = projected_centres(fits.ellipses.take(good), points, radius, (width, height))
    return Detection(ids=np.flatnonzero(good), pixels=pixels, covariance=fits.covariance[good])


def _completed(board: Board, lattice: Array, ellipses: Ellipses, size: tuple[int, int]) -> Ellipses:
    """Return the ellipses (count,) of all dots of a board in the order of their ids, of some as the others tell."""
    index = lattice[tuple(nodes(board).T)]
    known = index >= 0
    points = board.points()[:, :2] / board.pitch
    centres, axes = ellipses.centres[index], ellipses.axes[index]
    if not known.all():
        near = KDTree(points[known]).query(points[~known], k=4)[1]
        axes[~known] = axes[known][near].mean(axis=1)
        centres[~known] = map_of(points[known], centres[known], size).pixels(points[~known])
    return Ellipses(centres, axes)


def _good(fits: DiscFits) -> Array:
    """Return which fits (N,) are of dots of one board: of the same ink on the same paper, and nothing lies on them."""
    good = fits.agreement > _AGREEMENT
    if not good.any():
        return good
    ink = fits.contrast / np.maximum(np.abs(2 * fits.level + fits.contrast), 1.0)  # the same in light and in shade
    usual, noise = float(np.median(ink[good])), float(np.median(fits.noise[good]))
    good &= np.abs(ink / usual - 1) < _INK
    return np.asarray(good & (fits.noise < _NOISE * noise + _NOISE_FLOOR))
