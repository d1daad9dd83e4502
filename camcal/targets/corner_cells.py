"""The cell of every corner of a board, and the pixels used for its refinement.

A cell is where a corner's two edges lead, how they bend, how far the picture is theirs alone: half-way to the next
corner an edge begins to be that corner's. Edges are straight on the board but not in the image of a lens that distorts.
The pixels are those by the two edges, each counted with the nearer one.
"""

import numpy as np

from camcal.arrays import Array, readonly
from camcal.dataclass import dataclass, replace

CROWDED = 6.5  # standard deviations of the blur to the next edge, below which it is part of the picture


@dataclass(frozen=True, eq=False)
class Cells:
    """The cells of N corners.

    steps: (N, 2, 2) px, columns are the vectors to the next corner along the first edge and along the second.
    bends: (N, 2) 1/px, the curvature of both edges, positive where an edge bends towards its left normal (-y, x).
    reach: (N, 2, 2) steps from the corner to the end of each edge: [edge, before and after the corner].
    depth: (N, 2, 2) steps from an edge to what else is printed in each quadrant: [before and after along the first
    edge, before and after along the second].
    beside: the next edges of a checker pattern, None where there is none.
    """

    steps: Array
    bends: Array
    reach: Array
    depth: Array
    beside: "Beside | None" = None

    def __post_init__(self) -> None:
        count = len(self.steps)
        for name, shape in (("steps", (2, 2)), ("bends", (2,)), ("reach", (2, 2)), ("depth", (2, 2))):
            object.__setattr__(self, name, readonly(getattr(self, name), (count, *shape), name))

    def __len__(self) -> int:
        return len(self.steps)

    def narrowest(self) -> float:
        """Return the smallest distance (px) of an edge from the next corner beside it, inf of no cells."""
        lengths = np.linalg.norm(self.steps, axis=1)
        (x_first, x_second), (y_first, y_second) = self.steps.transpose(1, 2, 0)
        areas = np.abs(x_first * y_second - x_second * y_first)  # written out, as linalg.det warns of NaN
        heights = areas[:, None] / np.maximum(lengths, 1e-9)
        return float(np.nanmin(heights, initial=np.inf))

    def crowded(self, blur_px: float) -> bool:
        """Return whether a blur (px, the pixel's own included) brings the next edges into the picture of a corner."""
        if self.beside is None or not len(self):
            return False
        return bool(np.abs(self.beside.lines[..., 2]).min() < CROWDED * blur_px)

    def take(self, rows: Array) -> "Cells":
        """Return the cells of some of the corners."""
        beside = None if self.beside is None else self.beside.take(rows)
        return Cells(self.steps[rows], self.bends[rows], self.reach[rows], self.depth[rows], beside)

    def narrow(self) -> "Cells":
        """Return the cells for a first measurement: with straight edges, and as little depth everywhere as anywhere."""
        return replace(self, bends=np.zeros_like(self.bends), depth=np.full_like(self.depth, self.depth.min(initial=1)))


@dataclass(frozen=True, eq=False)
class Beside:
    """The edges next to those of N corners, on either side: lines a x + b y + c, in px, x and y from the corner.

    lines: (N, 2, 2, 3), [edge, on its right and on its left], a, b along the edge's own left normal. border: (N, 2, 2)
    whether such an edge is the border of the pattern, where dark squares end and bright ones do not.
    """

    lines: Array
    border: Array

    def __post_init__(self) -> None:
        count = len(self.lines)
        object.__setattr__(self, "lines", readonly(self.lines, (count, 2, 2, 3), "lines"))
        object.__setattr__(self, "border", readonly(self.border, (count, 2, 2), "border", np.bool_))

    def take(self, rows: Array) -> "Beside":
        """Return the edges beside some of the corners."""
        return Beside(self.lines[rows], self.border[rows])

    @classmethod
    def sorted(cls, lines: Array, border: Array) -> "Beside":
        """Return the edges beside N corners, given in any order of right and left."""
        right_first = np.argsort(-lines[..., 2], axis=-1)
        lines = np.take_along_axis(lines, right_first[..., None], axis=-2)
        return cls(lines, np.take_along_axis(border, right_first, axis=-1))

    @staticmethod
    def line(place: Array, tangent: Array) -> Array:
        """Return a, b, c (..., 3) of the line through a place (..., 2) along a tangent (..., 2)."""
        normal = np.stack([-tangent[..., 1], tangent[..., 0]], axis=-1)
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
        return np.concatenate([normal, -(normal * place).sum(axis=-1, keepdims=True)], axis=-1)


_OWN = 0.5  # of a step: from here on an edge belongs to the next corner
_SHARED = 0.75  # of the way to a next edge that is part of the model
LONGEST_PX = 40.0  # along an edge; a longer one is known well enough
_BAND = 3.2  # standard deviations of the blur beside an edge
_LEAST_BAND_PX = 2.2
_CLEAR = 2.5  # standard deviations of the blur that whatever else is printed must be away
_LATTICE = (4, 14)  # pixels a side, spread over a cell, or
_LATTICE_PX = 3.0  # one in so many
_LEAST_PX = 1.0  # of an edge, and beside it


@dataclass(frozen=True, eq=False)
class CellWindow:
    """Pixels (N, K) of N cells: columns and rows from `middle` (N, 2), gray values, 1 where they count, else 0.

    scale: (N, 1) 1/px, of a cell's reach.
    """

    middle: Array
    x: Array
    y: Array
    values: Array
    used: Array
    scale: Array

    def take(self, rows: Array) -> "CellWindow":
        """Return the pixels of some of the cells."""
        return CellWindow(*(part[rows] for part in vars(self).values()))

    def offsets(self, pixels: Array) -> tuple[Array, Array]:
        """Return how far the pixels lie from corners (N, 2): x and y (N, K)."""
        x, y = (self.middle - pixels).astype(np.float32).T[..., None]
        return self.x + x, self.y + y


def sample_cells(
    gray: Array,
    pixels: Array,
    cells: Cells,
    blur_px: float,
    sites: Array | None = None,
    longest_px: float = LONGEST_PX,
) -> CellWindow:
    """Return the pixels of `gray` (H, W) by the edges of corners at about pixels (N, 2).

    blur_px: of the edges, the pixel's own square included. sites: (H, W) mask of the pixels that count, None for all.
    longest_px: how far along an edge at most.
    """
    middle = np.rint(pixels)
    frames = _Frames.of(pixels - middle, cells, blur_px, longest_px)
    strips = [frames.strip(0), frames.strip(1), frames.lattice()]
    x, y = (np.concatenate([strip[axis] for strip in strips], axis=1) for axis in (0, 1))
    used = frames.own(x, y, np.repeat([0, 1, 2], [strip[0].shape[1] for strip in strips]))
    column, row = (part.astype(np.intp) + middle[:, [axis]].astype(np.intp) for axis, part in enumerate((x, y)))
    used &= (column >= 0) & (column < gray.shape[1]) & (row >= 0) & (row < gray.shape[0])
    order = np.argsort(~used, axis=1, kind="stable")[:, : max(1, int(used.sum(axis=1).max(initial=1)))]
    x, y, column, row, used = (np.take_along_axis(part, order, axis=1) for part in (x, y, column, row, used))
    column, row = np.where(used, column, 0), np.where(used, row, 0)
    if sites is not None:
        used &= sites[row, column]
    values = gray[row, column].astype(np.float32)
    scale = (1 / frames.limits.max(axis=(1, 2))).astype(np.float32)[:, None]
    return CellWindow(middle, x.astype(np.float32), y.astype(np.float32), values, used.astype(np.float32), scale)


@dataclass(frozen=True, eq=False)
class _Frames:
    """The frames of N cells at corners (N, 2): tangents (N, 2, 2) of both edges, one a row, and curvatures (N, 2).

    limits: (N, 2, 2) px, how far along each edge before and after the corner. band: (N, 2) px beside each edge.
    depth: (N, 2, 2) px, how far from the nearer edge in each quadrant. handed: (N,) the sign of the steps' turn.
    """

    corners: Array
    tangents: Array
    bends: Array
    limits: Array
    band: Array
    depth: Array
    handed: Array

    @classmethod
    def of(cls, corners: Array, cells: Cells, blur_px: float, longest_px: float) -> "_Frames":
        lengths = np.linalg.norm(cells.steps, axis=1)
        turn = np.linalg.det(cells.steps)
        sine = np.maximum(np.abs(turn) / np.maximum(lengths.prod(axis=1), 1e-9), 0.05)
        height = lengths * sine[:, None]  # of the cell, across the other edge
        clear = _CLEAR * blur_px
        # The next edges of a checker pattern are part of the model, other print is not.
        share, ends = (1.0, clear / sine[:, None, None]) if cells.beside is None else (_SHARED, 0.0)
        free = share * cells.reach * lengths[:, :, None] - ends
        prints = clear * ((cells.depth < 1) | (cells.beside is None))
        limits = np.clip(np.minimum(_OWN * lengths[:, :, None], free), _LEAST_PX, longest_px)
        depth = cells.depth * height.min(axis=1)[:, None, None] - prints
        band = np.minimum(max(_BAND * blur_px, _LEAST_BAND_PX), _OWN * height[:, ::-1])
        # a cell whose corners fell on one place has no frame of its own: any will do, nothing is measured in it
        tangents = np.where((lengths > 0)[:, None], cells.steps / np.maximum(lengths, 1e-9)[:, None], np.eye(2))
        tangents = tangents.swapaxes(1, 2)
        return cls(
            corners,
            tangents,
            bends=cells.bends,
            limits=limits,
            band=band,
            depth=np.maximum(depth, _LEAST_PX),
            handed=np.sign(turn),
        )

    def strip(self, edge: int) -> tuple[Array, Array]:
        """Return whole offsets x, y (N, K) that cover the band beside an edge."""
        tangent = self.tangents[:, edge]
        steep = np.abs(tangent[:, 1]) > np.abs(tangent[:, 0])
        major, minor = np.where(steep[:, None], tangent[:, ::-1], tangent).T
        corner_major, corner_minor = np.where(steep[:, None], self.corners[:, ::-1], self.corners).T
        furthest = int(np.ceil((self.limits[:, edge].max(axis=1) * np.abs(major)).max(initial=0)))
        beside = int(np.ceil((self.band[:, edge] / np.abs(major)).max(initial=0)))
        run = np.arange(-furthest - 1, furthest + 2)
        along = (run - corner_major[:, None]) / major[:, None]
        across_minor = np.where(steep, -tangent[:, 1], tangent[:, 0])  # of the left normal
        bend = self.bends[:, [edge]] / 2 * along**2 / across_minor[:, None]
        line = np.rint(corner_minor[:, None] + along * minor[:, None] + bend)
        across = line[..., None] + np.arange(-beside, beside + 1)
        count = len(tangent)
        run = np.broadcast_to(run[:, None], across.shape)
        x, y = np.where(steep[:, None, None], across, run), np.where(steep[:, None, None], run, across)
        return x.reshape(count, -1), y.reshape(count, -1)

    def lattice(self) -> tuple[Array, Array]:
        """Return whole offsets x, y (N, K) spread over the cells: pixels far from edges determine the illumination."""
        side = int(np.clip(2 * self.limits.max() / _LATTICE_PX, *_LATTICE))
        share = (np.arange(side) + 0.5) / side
        low, high = -self.limits[:, :, 0], self.limits[:, :, 1]
        along_1, along_2 = (low[:, [edge]] + (high - low)[:, [edge]] * share for edge in (0, 1))
        steps_1, steps_2 = (self.tangents[:, edge, :, None, None] for edge in (0, 1))
        places = steps_1 * along_1[:, None, :, None] + steps_2 * along_2[:, None, None, :]
        places = np.rint(places + self.corners[:, :, None, None]).reshape(len(low), 2, -1)
        return places[:, 0], places[:, 1]

    def own(self, x: Array, y: Array, strip: Array) -> Array:
        """Return which offsets (N, K) count; strip: (K,) 0 or 1 of an edge's strip, 2 of the lattice."""
        x, y = x - self.corners[:, [0]], y - self.corners[:, [1]]
        along, away = [], []
        for edge in (0, 1):
            cos, sin = self.tangents[:, edge].T[..., None]
            along.append(cos * x + sin * y)
            away.append(cos * y - sin * x - self.bends[:, [edge]] / 2 * along[edge] ** 2)
        inside = self._within(along[0], 0) & self._within(along[1], 1)
        near_1, near_2 = np.abs(away[0]), np.abs(away[1])
        far_1, far_2 = near_1 > self.band[:, [0]], near_2 > self.band[:, [1]]
        by_edge = (near_1 <= near_2) & ~far_1, (near_2 < near_1) & ~far_2
        mine = np.select([strip == 0, strip == 1], by_edge, far_1 & far_2)
        handed = self.handed[:, None]
        after_2 = (away[1] * handed < 0).astype(np.intp)  # beyond the second edge, further along the first
        after_1 = (away[0] * handed > 0).astype(np.intp)
        depth = self.depth[np.arange(len(x))[:, None], after_2, after_1]
        return np.asarray(mine & inside & (np.minimum(near_1, near_2) <= depth))

    def _within(self, along: Array, edge: int) -> Array:
        return np.asarray((along >= -self.limits[:, edge, [0]]) & (along <= self.limits[:, edge, [1]]))
