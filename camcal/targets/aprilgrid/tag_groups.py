"""Quadrilaterals that stand side by side as the tags of a grid do, and the place on the board that their bits tell.

Whether two of them are neighbours follows from their outlines alone. So a group has a shape before a bit is read, and
all bits of the group decide together where on the board it is and how it is turned.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from camcal.arrays import Array, readonly
from camcal.targets.aprilgrid.outlines import bit_agreement
from camcal.targets.aprilgrid.tag_lattice import TagLattice, inverse

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


@dataclass(frozen=True, eq=False)
class Placed:
    """A group's corners on the board: grid (2 rows, 2 columns, 2) px, NaN where none. score: see `placed`."""

    grid: Array
    score: float


def tag_groups(corners: Array, pitch: float) -> list[TagGroup]:
    """Return the groups among quadrilaterals at corners (Q, 4, 2) px, clockwise.

    pitch: distance of neighbouring tags, in sides of a tag.
    """
    corners = _outermost(corners)
    if not len(corners):
        return []
    steps, turns = _neighbours(corners, pitch)
    linked = csr_array(np.abs(steps).any(axis=2).astype(np.int8))
    count, label = connected_components(linked, directed=False)
    links = np.diff(linked.indptr)
    roots = [int(np.argmax(np.where(label == group, links, -1))) for group in range(count)]
    return [_walked(corners, linked, steps, turns, root) for root in roots]


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


def _neighbours(corners: Array, pitch: float) -> tuple[Array, Array]:
    """Return steps (Q, Q, 2) in cells from each tag to its neighbours, 0 to all others, and turns (Q, Q) of frames."""
    middles, sides = _frames(corners)
    back = inverse(sides)[:, None]
    away = (back @ (middles - middles[:, None])[..., None])[..., 0] / pitch
    steps = np.rint(away)
    frames = back @ sides
    angle = np.arctan2(frames[..., 1, 0] - frames[..., 0, 1], frames[..., 0, 0] + frames[..., 1, 1])
    turns = np.rint(angle / (np.pi / 2)).astype(np.intp) % 4
    near = (np.abs(away - steps).max(axis=2) * pitch < _OFF) & (np.abs(steps).max(axis=2) == 1)
    alike = np.abs(frames - _TURNS[turns]).max(axis=(2, 3)) < _SKEW
    linked = near & alike
    return np.where((linked & linked.T)[..., None], np.nan_to_num(steps), 0.0).astype(np.intp), turns


def _walked(corners: Array, linked: csr_array, steps: Array, turns: Array, root: int) -> TagGroup:
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


def placed(gray: Array, lattice: TagLattice, codes: Array, group: TagGroup) -> Placed:
    """Return where on the board a group is, by the agreement of all its bits with codes (tags, n, n).

    The score is the sum of correlations in standard deviations of what bits at random would give.
    """
    upright = [_placed_upright(gray, lattice, codes, group.turned(turns)) for turns in range(4)]
    return max(upright, key=lambda one: one.score)


def _placed_upright(gray: Array, lattice: TagLattice, codes: Array, group: TagGroup) -> Placed:
    """Return the best place of a group whose corners begin at the upper left of the upright print."""
    column, row = group.cells[:, 0], group.cells[:, 1].max() - group.cells[:, 1]  # rows go upwards on the board
    height, width = int(row.max()), int(column.max())
    agreement = bit_agreement(gray, group.corners, codes).reshape(-1, lattice.rows, lattice.columns)
    padded = np.pad(agreement, ((0, 0), (height, height), (width, width)))
    shape = (lattice.rows + height, lattice.columns + width)
    total = sum(values[y : y + shape[0], x : x + shape[1]] for values, x, y in zip(padded, column, row, strict=True))
    up, right = np.unravel_index(int(np.argmax(total)), shape)
    score = float(total[up, right]) * codes.shape[-1] / np.sqrt(len(group.cells))
    row, column = row + int(up) - height, column + int(right) - width
    inside = (row >= 0) & (row < lattice.rows) & (column >= 0) & (column < lattice.columns)
    tags = np.full((lattice.count, 4, 2), np.nan)
    tags[row[inside] * lattice.columns + column[inside]] = group.corners[inside, ::-1]
    return Placed(lattice.grid(tags), score)
