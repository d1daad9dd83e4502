"""Refinement of detected corners of a board, with covariance.

They are measured along the edges that cross at the points of the board as printed, from how blurred its edges are.
Where the lens and the pose of the board are known, they are measured along the edges as the lens bends them, and those
that were missed are searched for where they must be.
"""

from collections.abc import Callable, Sequence
from itertools import product

import numpy as np

from camcal.arrays import Array, readonly
from camcal.dataclass import dataclass, replace
from camcal.errors import InvalidInput
from camcal.targets.board import APRILGRID, Board
from camcal.targets.board_map import map_of
from camcal.targets.board_types import TAG_BORDER, dotted_squares
from camcal.targets.corner_cells import CROWDED, LONGEST_PX, Beside, Cells
from camcal.targets.corner_refinement import RefinedCorners, refine
from camcal.targets.detection import MIN_CORNERS, BoardDetection, MaskedImage
from camcal.targets.pattern import DOT, family_named

LARGEST_NOISE = 0.4  # of the contrast; what is left over of a corner that is none is more
LARGEST_STD_PX = 0.5  # of a corner that is one
UNUSUAL = 1.5  # times the usual noise, which may be large where there is little light
_BLUR_PX = 1.0  # where no edge says otherwise
_NEAR_PX = 8.0  # along the edges at first: from corners some tenths of a pixel off one cannot tell how they bend
_BENT_PX = 0.03  # that an edge may be off by where it ends
_ROUNDS = 3  # where corners are so close that each is seen in its neighbours' pictures


def measure(samples: MaskedImage, board: Board, detection: BoardDetection) -> BoardDetection:
    """Return what was located of a board of crossing edges with its corners measured; those that are none are left out.

    detection: its corners are good to half a pixel or so.
    """
    if not detection.found:
        return detection
    ids, pixels, values, sites = detection.ids, detection.pixels, samples.values, samples.sites
    blur = blur_of(values, pixels)
    near = refine(values, pixels, _cells(board, ids, pixels, values, blur)[0].narrow(), blur, sites, _NEAR_PX)
    if not near.settled.any():
        return replace(detection.without_points("no clear corners"), refused=pixels)
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
    return _detection(detection, corners, near)


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


def _detection(start: BoardDetection, corners: RefinedCorners, near: RefinedCorners) -> BoardDetection:
    """Return the corners that are clear, measured closely where the whole of their cells does not fit."""
    good, fallback = clear(corners), clear(near)
    kept = good | fallback
    if kept.sum() < MIN_CORNERS:
        return replace(start.without_points(f"only {int(kept.sum())} clear corners"), refused=start.pixels)
    pixels = np.where(good[:, None], corners.pixels, near.pixels)
    covariance = np.where(good[:, None, None], corners.covariance, near.covariance)
    return replace(
        start,
        ids=start.ids[kept],
        pixels=pixels[kept],
        covariance=covariance[kept],
        refused=start.pixels[~kept],
        located=False,
    )


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


_HALF = 0.5  # of a step on either side of a corner, whose edges are seen as far as that


def board_edges(board: Board, first: int | None = None) -> tuple[float, Array, Array]:
    """Return the length of the steps in which edges count, in the board's unit, and reach and depth, see Cells.

    Both (C, 2, 2) are of the two edges at each of the board's C points, along x and along y of the board. first: 1 if
    the square before the first corner is dark, -1 if it is bright, None for as drawn.
    Raises InvalidInput for a board of circles.
    """
    if board.type == APRILGRID:
        return _tag_edges(board)
    if not board.has_saddle_corners:
        raise InvalidInput(f"a {board.words} has no checkerboard corners")
    if first is None:  # a ChArUco board that does not say is of the current kind
        first = -1 if board.legacy and (board.rows + 1) % 2 == 0 else 1
    row, column = np.indices((board.rows, board.columns))
    dark_before = np.where((row + column) % 2, -first, first) > 0
    same = np.eye(2, dtype=bool)  # before both edges, or after both: only bright squares have something printed in them
    depth = np.where(same == dark_before[..., None, None], 1.0, margin(board))
    for down, right in dotted_squares(board.columns, board.rows) if board.dots else ():
        for after_row, after_column in product((0, 1), repeat=2):
            depth[down - after_row, right - after_column, after_column, after_row] = 1 / 2 - DOT
    return board.spacing, np.ones((board.count, 2, 2)), depth.reshape(-1, 2, 2)


def margin(board: Board) -> float:
    """Return how far from its edges a bright square shows nothing, in squares: 1 unless a ChArUco marker is in it."""
    return 1.0 if board.marker is None or not board.checker else (1 - board.marker / board.spacing) / 2


def signs(board: Board) -> Array:
    """Return 1 or -1 for every point (C,) of a board: where it is the same, the quadrants between the edges have the
    same colours. What stands before the first point may be either dark or bright.
    """
    if board.type == APRILGRID:
        return np.tile([1.0, -1.0], board.count // 2)
    row, column = np.divmod(np.arange(board.count), board.columns)
    return np.where((row + column) % 2, -1.0, 1.0)


def _tag_edges(board: Board) -> tuple[float, Array, Array]:
    side = float(board.marker or 0.0)
    gap = (board.spacing - side) / side
    after = np.tile(np.array([(1, 1), (0, 1), (0, 0), (1, 0)]), (board.columns * board.rows, 1))  # where the tag lies
    reach, in_tag = tag_reach(after, gap)
    cells = family_named(str(board.dictionary)).bits + 2 * TAG_BORDER
    return side, reach, np.where(in_tag, TAG_BORDER / cells, gap)


def tag_reach(after: Array, gap: float) -> tuple[Array, Array]:
    """Return the reach (N, 2, 2) of the edges at corners of tags, see Cells, and which quadrant (N, 2, 2) a tag is in.

    after: (N, 2) 1 where the tag lies behind the corner along an edge, 0 where before it. gap: between tags, in sides.
    """
    toward = np.arange(2) == after[..., None]
    return np.where(toward, 1.0, gap), toward[:, 0, :, None] & toward[:, 1, None]


def seen_cells(
    board: Board,
    ids: Array,
    points: Array,
    project: Callable[[Array], Array],
    blur_px: float,
    first: int | None = None,
) -> tuple[Array, Cells]:
    """Return the pixels (N, 2) of some of a board's points, ids (N,), and their cells as a camera sees them.

    points: (N, 3) where they are on the board as it is, in its unit. project: takes points (N, 3) of the board to
    pixels (N, 2), NaN where the camera does not see them. Pixels and cells are NaN there. blur_px: of the edges; the
    next ones are searched for only where it may bring them into the picture. first: see `board_edges`.
    """
    length, reach, depth = board_edges(board, first)

    def see(steps: Sequence[tuple[float, float]]) -> Array:
        """Return the pixels (S, N, 2) of what is S steps along x and y from the points."""
        shifts = length * np.column_stack([np.array(steps), np.zeros(len(steps))])
        places = points + shifts[:, None]
        return project(places.reshape(-1, 3)).reshape(len(steps), -1, 2)

    middle, *ends = see([(0, 0), (-_HALF, 0), (_HALF, 0), (0, -_HALF), (0, _HALF)])
    steps, bends = np.empty((len(points), 2, 2)), np.empty((len(points), 2))
    for edge in (0, 1):
        before, after = ends[2 * edge : 2 * edge + 2]
        step, second = after - before, (after - 2 * middle + before) / _HALF**2
        steps[:, :, edge] = step
        bends[:, edge] = (step[:, 0] * second[:, 1] - step[:, 1] * second[:, 0]) / np.linalg.norm(step, axis=1) ** 3
    cells = Cells(steps, bends, reach[ids], depth[ids])
    if board.checker and cells.narrowest() < CROWDED * blur_px:
        cells = replace(cells, beside=_seen_beside(board, ids, middle, see))
    return middle, cells


def _seen_beside(
    board: Board, ids: Array, middle: Array, see: Callable[[Sequence[tuple[float, float]]], Array]
) -> Beside:
    """Return the edges beside those of a checker pattern's corners at pixels `middle` (N, 2).

    see: takes S steps along x and y from the corners to pixels (S, N, 2).
    """
    row, column = np.divmod(ids, board.columns)
    ends = ((row, board.rows - 1), (column, board.columns - 1))
    lines, border = np.empty((len(ids), 2, 2, 3)), np.empty((len(ids), 2, 2), np.bool_)
    for edge, (place, last) in enumerate(ends):
        for index, sign in enumerate((-1, 1)):
            shifts = [(share, sign) if edge == 0 else (sign, share) for share in (0, -_HALF, _HALF)]
            there, before, after = see(shifts)
            lines[:, edge, index] = Beside.line(there - middle, after - before)
            border[:, edge, index] = place == (0 if sign < 0 else last)
    return Beside.sorted(lines, border)


_SURE = 3.0  # times the median of the noise and of the blur that a corner nobody had found may have
_FAINT = 0.3  # of the median contrast that it must have
_OFF = 0.15  # steps from where it must be, or
_OFF_PX = 1.0
_DRAWN = 0.5  # px that a corner which was found may move: further, it was another


@dataclass(frozen=True, eq=False)
class Expected:
    """What a calibration expects of an image: the pixels (C, 2) of all points of the board and their cells.

    inside: (C,) which of them are in the image, with room for a window. signs: (C,) see `signs`.
    """

    pixels: Array
    cells: Cells
    inside: Array
    signs: Array

    def __post_init__(self) -> None:
        count = len(self.cells)
        object.__setattr__(self, "pixels", readonly(self.pixels, (count, 2), "pixels"))
        object.__setattr__(self, "inside", readonly(self.inside, (count,), "inside", np.bool_))
        object.__setattr__(self, "signs", readonly(self.signs, (count,), "signs"))


def remeasure(samples: MaskedImage, view: BoardDetection, expected: Expected) -> BoardDetection:
    """Return a view of a board that has been calibrated with, its corners measured, or measured again, and those that
    were missed added; as it was where too few are seen there. Corners that the model does not bear out, along the edges
    that are expected, are left out.
    """
    ids, pixels = view.ids, view.pixels
    start = expected.pixels.copy()
    start[ids] = pixels
    measured = np.zeros(len(start), np.bool_)
    measured[ids] = True
    chosen = np.flatnonzero((measured | expected.inside) & np.isfinite(expected.cells.bends).all(axis=1))
    blur = blur_of(samples.values, pixels)
    corners = refine(samples.values, start[chosen], expected.cells.take(chosen), blur, samples.sites)
    good = clear(corners)
    contrast = np.where(good, corners.contrast * expected.signs[chosen], 0.0)
    good &= contrast * np.sign(contrast[measured[chosen]].sum()) > 0
    moved = np.linalg.norm(corners.pixels - start[chosen], axis=1)
    near = moved < np.maximum(_OFF * np.linalg.norm(expected.cells.steps[chosen], axis=1).min(axis=1), _OFF_PX)
    before = good & measured[chosen] & (near if view.located else moved < _DRAWN)
    if before.sum() < (MIN_CORNERS if view.located else 1):
        return view
    fresh = good & ~measured[chosen] & near
    fresh &= np.abs(contrast) > _FAINT * np.median(np.abs(contrast[before]))
    fresh &= corners.noise < _SURE * np.median(corners.noise[before])
    fresh &= (corners.blur < _SURE * np.median(corners.blur[before])).all(axis=1)
    kept = before | fresh
    return replace(
        view,
        ids=chosen[kept],
        pixels=corners.pixels[kept],
        covariance=corners.covariance[kept],
        refused=np.concatenate([view.refused, pixels[~np.isin(ids, chosen[kept])]]),
        located=False,
    )


_REACH = 0.45  # of the way to the nearest point: what lies around a point and no other
_RADII = (3, 16)  # px of a window: enough for an edge, few enough for a quick look
_MOST = 100  # points of a board that are examined
_NEIGHBOURS = 2.5  # nearest distances within which the second direction is sought
_DARK, _BRIGHT = 0.05, 0.95
_DIFFERENCE = 1 / 3  # px², variance of the box that a central difference averages over


def edge_blur(gray: Array, pixels: Array) -> float:
    """Return the standard deviation (px) of the blur of the edges around points, in the direction that is worse.

    gray: (H, W). pixels: (N, 2) points of a board, at least three of them not in a line. Motion blurs the edges across
    it and leaves those along it, so that both directions of a board are measured and the larger counts; the median over
    the points. NaN where no window lies in the image.
    An edge of contrast A has the slope p exp(-x² / 2s²), p = A / (√(2π) s). Its squares and fourth powers sum up to
    p² s √π and p⁴ s √(π/2) per unit length: √2 times their ratio is p², in which noise counts little.
    """
    chosen = pixels[:: -(-len(pixels) // _MOST)]
    directions, nearest = _directions(chosen, pixels)
    radius = int(np.clip(_REACH * np.median(nearest), *_RADII))
    windows, kept = _windows(gray, chosen, radius)
    if not kept.any():
        return float("nan")
    down, across = (np.gradient(windows, axis=axis)[:, 1:-1, 1:-1] for axis in (1, 2))
    slope = np.stack([across, down], axis=-1).reshape(len(windows), -1, 2)
    squares = (slope**2).sum(axis=2)
    normals = np.stack([-directions[kept, :, 1], directions[kept, :, 0]], axis=-1)
    of_first = np.abs(slope @ normals[:, 0, :, None]) >= np.abs(slope @ normals[:, 1, :, None])
    dark, bright = np.quantile(windows.reshape(len(windows), -1), [_DARK, _BRIGHT], axis=1)
    blurs = [_blur(squares * mask, bright - dark) for mask in (of_first[..., 0], ~of_first[..., 0])]
    return float(np.sqrt(max(np.median(np.maximum(*blurs)) ** 2 - _DIFFERENCE, 0.0)))


def _blur(squares: Array, contrast: Array) -> Array:
    """Return the blur (N,) of edges from the squared slopes (N, P) of their pixels and their contrasts (N,)."""
    steepest = np.sqrt(2) * (squares**2).sum(axis=1) / np.maximum(squares.sum(axis=1), 1e-9)
    return np.asarray(contrast / np.sqrt(2 * np.pi * np.maximum(steepest, 1e-9)))


def _directions(chosen: Array, pixels: Array) -> tuple[Array, Array]:
    """Return unit vectors (M, 2, 2) from points to the nearest one and to a near one across, and the distance (M,)."""
    away = pixels - chosen[:, None]
    length = np.linalg.norm(away, axis=2)
    length[length < 1e-9] = np.inf
    rows, closest = np.arange(len(chosen)), length.argmin(axis=1)
    nearest = length[rows, closest]
    first = away[rows, closest] / nearest[:, None]
    aside = np.abs(first[:, None, 0] * away[..., 1] - first[:, None, 1] * away[..., 0]) / length
    aside[length > _NEIGHBOURS * nearest[:, None]] = -1.0
    other = (aside / np.where(np.isfinite(length), length, 1.0)).argmax(axis=1)
    second = away[rows, other] / length[rows, other][:, None]
    return np.stack([first, second], axis=1), nearest


def _windows(gray: Array, points: Array, radius: int) -> tuple[Array, Array]:
    """Return the windows (K, S, S) around points that lie in the image, and which points (M,) these are."""
    middle = np.rint(points).astype(np.intp)
    size = np.array(gray.shape[::-1])
    kept = np.asarray(((middle >= radius) & (middle < size - radius)).all(axis=1))
    reach = np.arange(-radius, radius + 1)
    rows, columns = (middle[kept, axis, None] + reach for axis in (1, 0))
    return gray[rows[:, :, None], columns[:, None, :]].astype(np.float64), kept
