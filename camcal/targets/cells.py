"""The cell of every corner of a board: where its two edges lead, how they bend, how far the picture is theirs alone.

Half-way to the next corner an edge begins to be that corner's. Edges are straight on the board but not in the image of
a lens that distorts; how they bend there is read off the corners themselves.
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array, readonly
from camcal.targets import grid as grids


@dataclass(frozen=True, eq=False)
class Cells:
    """The cells of N corners.

    steps: (N, 2, 2) px, columns are the vectors to the next corner along the first edge and along the second.
    bends: (N, 2) 1/px, the curvature of both edges, positive where an edge bends towards its left normal (-y, x).
    reach: (N, 2, 2) steps from the corner to the end of each edge: [edge, before and after the corner].
    depth: (N, 2, 2) steps from an edge to what else is printed in each quadrant: [before and after along the first
    edge, before and after along the second].
    """

    steps: Array
    bends: Array
    reach: Array
    depth: Array

    def __post_init__(self) -> None:
        count = len(self.steps)
        for name, shape in (("steps", (2, 2)), ("bends", (2,)), ("reach", (2, 2)), ("depth", (2, 2))):
            object.__setattr__(self, name, readonly(getattr(self, name), (count, *shape), name))

    def __len__(self) -> int:
        return len(self.steps)

    @classmethod
    def plain(cls, steps: Array, bends: Array | None = None) -> "Cells":
        """Return cells with nothing in them but two edges that end at the next corners."""
        whole = np.ones((len(steps), 2, 2))
        return cls(steps, np.zeros((len(steps), 2)) if bends is None else bends, whole, whole)

    @classmethod
    def of_grid(cls, grid: Array) -> "Cells":
        """Return the plain cells of the corners that a grid (rows, columns, 2) px has, NaN where none, row by row."""
        known = ~np.isnan(grid[..., 0])
        bends = np.stack([grids.curvature(grid, axis)[known] for axis in (0, 1)], axis=1)
        return cls.plain(grids.steps(grid)[known], bends)
