"""The cell of every corner of a board: where its two edges lead, how they bend, how far the picture is theirs alone.

Half-way to the next corner an edge begins to be that corner's. Edges are straight on the board but not in the image of
a lens that distorts.
"""

from dataclasses import dataclass, replace

import numpy as np

from camcal.arrays import Array, readonly

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
        """Return the cells for a first look: with straight edges, and as little depth everywhere as anywhere."""
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
