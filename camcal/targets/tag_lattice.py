"""Tags of an AprilGrid in an image: outlines, the agreement of their bits, and all tags as one lattice.

A tag is a dark quadrilateral with a bright gap around it. At its corners it touches the small black squares of the
print, but only there, so that a threshold somewhat below the local mean keeps them apart. Bits are never decided one by
one: a blurred tag agrees with its code as a whole, and a board does with all its tags together.

Lines at the edges of all tags cross in 2 rows × 2 columns corners, which an array (2 rows, 2 columns, 2) of pixels
holds, NaN where a corner is missing; rows go upwards on the print, as Kalibr's do. Lengths are in sides of a tag.

Whether two quadrilaterals stand side by side as the tags of a grid do follows from their outlines alone. So a group has
a shape before a bit is read, and all bits of the group decide together where on the board it is and how it is turned.
"""

from collections.abc import Iterator
from functools import cache

import cv2
import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from camcal import opencv
from camcal.arrays import Array, readonly
from camcal.dataclass import dataclass
from camcal.targets.board import Board
from camcal.targets.board_types import TAG_BORDER
from camcal.targets.pattern import family_named

_SMALL, _MEDIUM, _LARGE, _TINY = 0.5e6, 1.5e6, 6e6, 0.12e6  # pixels of the copies
_ENLARGEMENTS = ((1.5e6, 1.6), (0.8e6, 2.5))  # of images with fewer pixels
_LEAST_SIDE_PX = 8.0
_STRAIGHT = 0.05  # of its length, how far an outline may be from a quadrilateral
_STUCK_OUT = 0.25  # of half a diagonal; the small square is 0.6 of it with Kalibr's usual gap
_OUTLINE_PX = 1.5  # how far its corners may be from the tag's
_MIDDLES = 0.15  # a cell is read by four samples so far from its middle, in cells
_BEYOND_DOUBT = 0.85  # of the correlation of a tag's bits, out of all codes and turns
_LEAST_CONTRAST = 2.0  # gray levels, standard deviation of a tag's bits


def quadrilaterals(gray: Array) -> Iterator[tuple[Array, float]]:
    """Yield what may be tags in `gray`, (H, W) uint8, each time from another copy or threshold, the quick ones first.

    They are at corners (Q, 4, 2) px, clockwise; the number says how far off (px) the corners of a tag may be. Structure
    takes few pixels, and blur is narrow in a small copy; large copies and enlarged ones show the small tags.
    """
    for scale, block, drop in _attempts(gray.size):
        copy = gray if scale == 1 else opencv.resized(gray, scale)
        to_image = np.array(gray.shape[::-1]) / np.array(copy.shape[::-1])
        corners = (_dark_quadrilaterals(copy, block, drop) + 0.5) * to_image - 0.5
        yield corners, _OUTLINE_PX * float(to_image.max())


def _attempts(size: int) -> Iterator[tuple[float, int, float]]:
    """Yield the scale of a copy, and the threshold's neighbourhood and drop below its mean, for so many pixels."""
    small, medium, large, tiny = (min(1.0, float(np.sqrt(p / size))) for p in (_SMALL, _MEDIUM, _LARGE, _TINY))
    yield from ((small, 3, 7.0), (small, 3, 3.0))
    if small < 1:
        yield from ((medium, 3, 7.0), (medium, 5, 5.0))
    else:
        yield (small, 5, 5.0)
    yield from ((scale, 5, 5.0) for limit, scale in _ENLARGEMENTS if size < limit)
    if medium < 1:
        yield (large, 3, 7.0)
    yield from ((tiny, 3, 3.0), (small, 9, 3.0))


def _dark_quadrilaterals(gray: Array, block: int, drop: float) -> Array:
    """Return the corners (Q, 4, 2) px of dark convex quadrilaterals, clockwise."""
    dark = cv2.adaptiveThreshold(gray, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY_INV, block, drop)
    outlines, _ = cv2.findContours(dark, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    longest = 2 * sum(gray.shape)
    quadrilaterals = []
    for outline in outlines:
        if not 4 * _LEAST_SIDE_PX <= len(outline) <= longest:
            continue
        corners = cv2.approxPolyDP(outline, _STRAIGHT * len(outline), closed=True)
        if len(corners) == 4 and cv2.isContourConvex(corners):
            quadrilaterals.append(corners.reshape(4, 2))
    corners = np.array(quadrilaterals, dtype=np.float64).reshape(-1, 4, 2)
    turned = _cross(corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0]) < 0  # y is down
    clockwise = np.where(turned[:, None, None], corners[:, ::-1], corners)
    sides = np.linalg.norm(clockwise - np.roll(clockwise, 1, axis=1), axis=2)
    return _mend(clockwise[sides.min(axis=1) >= _LEAST_SIDE_PX / 2])  # without slits


def _mend(corners: Array) -> Array:
    """Return quadrilaterals (Q, 4, 2) whose one corner that sticks out, if any, is put where it makes a parallelogram.

    Where noise joins a tag with the small square at its corner the outline runs around both.
    """
    away = corners - corners.mean(axis=1, keepdims=True)
    size = np.linalg.norm(away, axis=2)
    excess = (away[:, 0] - away[:, 1] + away[:, 2] - away[:, 3])[:, None] * np.array([1, -1, 1, -1])[:, None]
    outward = (excess * away).sum(axis=2) / np.maximum(size, 1e-9)
    place = np.arange(len(corners)), outward.argmax(axis=1)
    long = outward[place] > np.maximum(_STUCK_OUT * size.mean(axis=1), 0.9 * np.linalg.norm(excess[:, 0], axis=1))
    mended = corners.copy()
    mended[place] -= np.where(long[:, None], excess[place], 0.0)
    return mended


@cache
def codes_of(dictionary: str) -> Array:
    """Return the bits (ids, n, n) of a family's tags, upright as printed: 1 is white."""
    family = family_named(dictionary)
    return readonly(family.printed(range(family.count))[:, 1:-1, 1:-1], (None, None, None), "bits")


def bit_agreement(gray: Array, corners: Array, codes: Array) -> Array:
    """Return the correlation (M, K) of what is seen of tags with codes (K, n, n), 0 where nothing is seen.

    corners: (M, 4, 2) px, clockwise from the upper left as the codes are turned. Of what is no tag at all the
    correlations scatter by 1/n about 0.
    """
    seen = _cells(gray, corners, codes.shape[-1]).reshape(len(corners), codes[0].size)
    seen = seen - seen.mean(axis=1, keepdims=True)
    spread = seen.std(axis=1, keepdims=True)
    seen = np.where(spread > _LEAST_CONTRAST, seen / np.where(spread > 0, spread, 1.0), 0.0)
    expected = codes.reshape(len(codes), -1).astype(np.float64)
    expected -= expected.mean(axis=1, keepdims=True)
    expected /= expected.std(axis=1, keepdims=True)
    return np.asarray(np.nan_to_num(seen) @ expected.T / expected.shape[1])


def read_tags(gray: Array, corners: Array, codes: Array) -> tuple[Array, Array]:
    """Return the ids, ascending, of codes (K, n, n) that quadrilaterals show beyond doubt, and the corners of these.

    corners: (Q, 4, 2) px; those that are returned (P, 4, 2), in no order of the ids.
    """
    agreement = np.stack([bit_agreement(gray, np.roll(corners, turns, axis=1), codes) for turns in range(4)])
    _, shown, ids = np.nonzero(np.asarray(agreement > _BEYOND_DOUBT))
    return np.unique(ids), corners[np.unique(shown)]


def _cells(gray: Array, corners: Array, side: int) -> Array:
    """Return the gray values (M, side, side) of the cells within the borders of tags, NaN out of the image."""
    cells = side + 2 * TAG_BORDER
    steps = (TAG_BORDER + 0.5 + np.arange(side)) / cells
    x, y = (values[..., None] for values in np.meshgrid(steps, steps))
    shift = np.array([-1, 1]) * _MIDDLES / cells
    shift_x, shift_y = (values.ravel() for values in np.meshgrid(shift, shift))
    places = np.stack([x + shift_x, y + shift_y], axis=-1).reshape(-1, 2)
    seen = _within(corners, places)
    inside = np.all((seen >= 0) & (seen <= np.array(gray.shape[::-1]) - 1), axis=-1)
    x, y = np.moveaxis(np.where(inside[..., None], seen, 0.0), -1, 0)
    values = np.where(inside, opencv.sampled(gray, x, y), np.nan)
    return np.asarray(values.reshape(-1, side, side, 4).mean(axis=-1))


def _within(corners: Array, places: Array) -> Array:
    """Return the pixels (M, P, 2) of places (P, 2) of a unit square whose corners are seen at (M, 4, 2).

    Source: Heckbert, Fundamentals of Texture Mapping and Image Warping, 1989, section 2.2.3.
    """
    first, second, third, fourth = np.moveaxis(corners, 1, 0)
    one, two, skew = second - third, fourth - third, first - second + third - fourth
    area = _cross(one, two)
    area = np.where(np.abs(area) < 1e-9, np.nan, area)
    g, h = (_cross(skew, two) / area)[:, None], (_cross(one, skew) / area)[:, None]
    along, down = second - first + g * second, fourth - first + h * fourth
    x, y = places[:, 0], places[:, 1]
    depth = 1 + g * x + h * y
    flat = along[:, None] * x[:, None] + down[:, None] * y[:, None] + first[:, None]
    return np.asarray(flat / np.where(depth > 0, depth, np.nan)[..., None])


def _cross(one: Array, two: Array) -> Array:
    return np.asarray(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0])


_CORNERS = np.array([[0, 1], [3, 2]])  # Kalibr's number of a tag's corner, [upper, right]
_NEIGHBOURS = 12  # the nearest corners, which say where one lies
_REACH = 4.0  # as far as neighbours are searched for
_EXACT = 0.01  # standard deviation of a corner, and
_BENT = 0.02  # of what a homography leaves of a lens's distortion, at distance 1; it goes with the distance squared
_PERSPECTIVE = 0.2  # standard deviation of the change of scale over a tag
_MAX_POSITION_STD = 0.15  # a corner whose place is known no better is not searched for


@dataclass(frozen=True)
class TagLattice:
    """The lattice of a board of columns × rows tags with gaps between them, in sides of a tag."""

    columns: int
    rows: int
    gap: float

    @property
    def count(self) -> int:
        """The number of tags."""
        return self.columns * self.rows

    @classmethod
    def of(cls, board: Board) -> "TagLattice":
        """Return the lattice of an AprilGrid."""
        return cls(board.columns, board.rows, board.spacing / float(board.marker or 1.0) - 1)

    @property
    def nodes(self) -> Array:
        """The corners (2 rows, 2 columns, 2) as x, y on the board."""
        x, y = (self._lines(count) for count in (self.columns, self.rows))
        return np.stack(np.meshgrid(x, y), axis=-1)

    def _lines(self, count: int) -> Array:
        line = np.arange(2 * count)
        return np.asarray(line // 2 * (1 + self.gap) + line % 2)

    @property
    def ids(self) -> Array:
        """The ids (2 rows, 2 columns) of the corners: 4 · tag + corner."""
        row, column = np.indices((2 * self.rows, 2 * self.columns))
        return np.asarray(4 * (row // 2 * self.columns + column // 2) + _CORNERS[row % 2, column % 2])

    @property
    def signs(self) -> Array:
        """1 (2 rows, 2 columns) where the quarter before both steps is dark as the one after both is, else -1."""
        return np.asarray(1 - 2 * (np.indices((2 * self.rows, 2 * self.columns)).sum(axis=0) % 2))

    def tags(self, grid: Array) -> Array:
        """Return the tags (rows · columns, 4, ...) of a grid (2 rows, 2 columns, ...) in Kalibr's order."""
        flat = np.empty((4 * self.count, *grid.shape[2:]), grid.dtype)
        flat[self.ids] = grid
        return flat.reshape(-1, 4, *grid.shape[2:])

    def grid(self, tags: Array) -> Array:
        """Return tags (rows · columns, 4, ...) as a grid (2 rows, 2 columns, ...)."""
        return np.asarray(tags.reshape(-1, *tags.shape[2:])[self.ids])


def predict(lattice: TagLattice, grid: Array, *, own: bool = False) -> tuple[Array, Array, Array]:
    """Return where its neighbours put every corner of a grid; own: and the corner itself, which is left out otherwise.

    Places (2 rows, 2 columns, 2) px, NaN where they cannot tell; steps (2 rows, 2 columns, 2, 2) px, whose columns are
    the side of a tag along a row and up a column as they are seen there; and the spread of the places, in such sides.
    The nearest corners are fitted by a homography, each as exact as a lens that distorts leaves it at its distance.
    """
    nodes, present = lattice.nodes.reshape(-1, 2), ~np.isnan(grid[..., 0]).ravel()
    away = nodes[present] - nodes[:, None]
    distance = np.linalg.norm(away, axis=2)
    if not own:
        distance[distance == 0] = np.inf
    nearest = np.argsort(distance, axis=1, kind="stable")[:, :_NEIGHBOURS]
    away, distance = (np.take_along_axis(v, i, axis=1) for v, i in ((away, nearest[..., None]), (distance, nearest)))
    seen = grid.reshape(-1, 2)[present][nearest]
    weights = np.where(distance < _REACH, 1 / (_EXACT**2 + (_BENT * distance**2) ** 2), 0.0)
    middle = seen.mean(axis=1, keepdims=True)
    size = _radius(seen) / _radius(away)  # px of a tag's side, more or less
    entries, spread = _homographies(away, (seen - middle) / size, weights)
    steps = entries[:, :4].reshape(-1, 2, 2) - entries[:, 4:6, None] * entries[:, None, 6:]
    known_enough = spread < _MAX_POSITION_STD
    places = np.where(known_enough[:, None], entries[:, 4:6] * size[:, 0] + middle[:, 0], np.nan)
    shape = grid.shape[:2]
    return places.reshape(*shape, 2), (steps * size).reshape(*shape, 2, 2), spread.reshape(shape)


def _homographies(places: Array, seen: Array, weights: Array) -> tuple[Array, Array]:
    """Return the homographies (T, 8) from places (T, K, 2) to what is seen, and the spread (T,) of the origin's image.

    Entries are in the order of A (2 × 2), b, c of (A p + b) / (1 + c · p). That c is small is expected, with which few
    places give an affine map; the spread is in the unit of the places.
    """
    zero, one = np.zeros_like(places), np.ones_like(weights)
    first = np.concatenate([places, zero, one[..., None], zero[..., :1], -seen[..., :1] * places], axis=2)
    second = np.concatenate([zero, places, zero[..., :1], one[..., None], -seen[..., 1:] * places], axis=2)
    design = np.concatenate([first, second], axis=1)
    weighted = design * np.tile(weights, 2)[..., None]
    expected = np.diag([1e-6] * 6 + [1 / _PERSPECTIVE**2] * 2)
    covariance = np.linalg.inv(design.swapaxes(1, 2) @ weighted + expected)
    values = np.concatenate([seen[..., 0], seen[..., 1]], axis=1)
    entries = (covariance @ (weighted.swapaxes(1, 2) @ values[..., None]))[..., 0]
    return entries, np.sqrt(covariance[:, 4:6, 4:6].trace(axis1=1, axis2=2) / 2)


def _radius(places: Array) -> Array:
    """Return the root mean square distance (T, 1, 1) of places (T, K, 2) from their mean, never 0."""
    return np.asarray(np.sqrt(places.var(axis=1, keepdims=True).sum(axis=2, keepdims=True)) + 1e-9)


_OFF = 0.3  # sides of a tag, how far the middle of a neighbour may be from where one tag puts it
_SKEW = 0.5  # largest entry of the difference between the frames of neighbours
_SAME = 0.2  # sides of a tag; outlines with middles so near are of one tag
# By quarters, clockwise in the image
_TURNS = np.array([[[1, 0], [0, 1]], [[0, -1], [1, 0]], [[-1, 0], [0, -1]], [[0, 1], [-1, 0]]])


@dataclass(frozen=True, eq=False)
class TagGroup:
    """Tags at cells (M, 2), column and row down, at corners (M, 4, 2) px, clockwise from the same one in each."""

    cells: Array
    corners: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "cells", readonly(self.cells, (None, 2), "cells", np.intp))
        object.__setattr__(self, "corners", readonly(self.corners, (len(self.cells), 4, 2), "corners"))

    def turned(self, turns: int) -> "TagGroup":
        """Return the group with corners that begin so many corners earlier, and cells to match."""
        column, row = self.cells.T
        across, down = ((column, row), (-row, column), (-column, -row), (row, -column))[turns % 4]
        cells = np.column_stack([across - across.min(), down - down.min()])
        return TagGroup(cells, np.roll(self.corners, turns, axis=1))


def tag_groups(corners: Array, spacing: float) -> list[TagGroup]:
    """Return the groups among quadrilaterals at corners (Q, 4, 2) px, clockwise.

    spacing: distance of neighbouring tags, in sides of a tag.
    """
    corners = _outermost(corners)
    if not len(corners):
        return []
    steps, turns = _neighbours(corners, spacing)
    linked = csr_array(np.abs(steps).any(axis=2).astype(np.int8))
    count, label = connected_components(linked, directed=False)
    links = np.diff(linked.indptr)
    roots = [int(np.argmax(np.where(label == group, links, -1))) for group in range(count)]
    return [_walk(corners, linked, steps, turns, root) for root in roots]


def most_legible(gray: Array, codes: Array, groups: list[TagGroup]) -> list[TagGroup]:
    """Return the groups, those first whose tags agree best with any of the codes (tags, n, n), each by itself."""
    if not groups:
        return []
    corners = np.concatenate([group.corners for group in groups])
    turns = (bit_agreement(gray, np.roll(corners, turn, axis=1), codes).max(axis=1) for turn in range(4))
    best = np.max(list(turns), axis=0)
    ends = np.cumsum([len(group.cells) for group in groups])
    legible = [part.sum() / np.sqrt(len(part)) for part in np.split(best, ends[:-1])]
    return [groups[k] for k in np.argsort(-np.array(legible), kind="stable")]


def _frames(corners: Array) -> tuple[Array, Array]:
    """Return the middles (Q, 2) of quadrilaterals and their sides (Q, 2, 2), columns right and down."""
    first, second, third, fourth = np.moveaxis(corners, 1, 0)
    sides = np.stack([second + third - first - fourth, third + fourth - first - second], axis=-1) / 2
    return corners.mean(axis=1), sides


def _outermost(corners: Array) -> Array:
    """Return quadrilaterals without those that are outlines of the same tag as a larger one."""
    middles, sides = _frames(corners)
    area = np.linalg.det(sides)
    order = np.argsort(-area, kind="stable")
    corners, middles, side = corners[order], middles[order], np.sqrt(np.maximum(area[order], 0))
    apart = np.linalg.norm(middles[:, None] - middles, axis=2)
    copies = np.triu((apart < _SAME * side) & (side > _SAME * side[:, None]), 1)  # each with those that are smaller
    near_size = side > side[:, None] / 2
    return np.asarray(corners[~(copies & near_size).any(axis=0)])


def _neighbours(corners: Array, spacing: float) -> tuple[Array, Array]:
    """Return steps (Q, Q, 2) in cells from each tag to its neighbours, 0 to all others, and turns (Q, Q) of frames."""
    middles, sides = _frames(corners)
    (a, b), (c, d) = np.moveaxis(sides, 0, -1)
    area = a * d - b * c
    area = np.where(np.abs(area) < 1e-9, np.nan, area)  # of parallel sides
    back = (np.moveaxis(np.array([[d, -b], [-c, a]]), -1, 0) / area[:, None, None])[:, None]
    away = (back @ (middles - middles[:, None])[..., None])[..., 0] / spacing
    steps = np.rint(away)
    frames = back @ sides
    angle = np.arctan2(frames[..., 1, 0] - frames[..., 0, 1], frames[..., 0, 0] + frames[..., 1, 1])
    turns = np.rint(angle / (np.pi / 2)).astype(np.intp) % 4
    near = (np.abs(away - steps).max(axis=2) * spacing < _OFF) & (np.abs(steps).max(axis=2) == 1)
    alike = np.abs(frames - _TURNS[turns]).max(axis=(2, 3)) < _SKEW
    linked = near & alike
    return np.where((linked & linked.T)[..., None], np.nan_to_num(steps), 0.0).astype(np.intp), turns


def _walk(corners: Array, linked: csr_array, steps: Array, turns: Array, root: int) -> TagGroup:
    """Return the group around a tag, each cell taken by the tag that is reached first."""
    if not steps[root].any():
        return TagGroup(np.zeros((1, 2), np.intp), corners[[root]])
    order, before = breadth_first_order(linked, root, directed=False)
    cells, turn = {root: np.zeros(2, np.intp)}, {root: 0}
    taken = {(0, 0): root}
    for tag in order[1:]:
        last = int(before[tag])
        cells[tag] = cells[last] + _TURNS[turn[last]] @ steps[last, tag]
        turn[tag] = (turn[last] + int(turns[last, tag])) % 4
        taken.setdefault((int(cells[tag][0]), int(cells[tag][1])), int(tag))
    aligned = [np.roll(corners[tag], turn[tag], axis=0) for tag in taken.values()]
    return TagGroup(np.array(list(taken)), np.array(aligned))
