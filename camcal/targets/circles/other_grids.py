"""What a grid of ellipses is that is not the board looked for: another board of circles, or a part of one."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree

from camcal.arrays import Array
from camcal.targets.board import ASYMMETRIC_CIRCLES, CIRCLES, Board
from camcal.targets.board_map import map_of
from camcal.targets.checker.proposals import proposals
from camcal.targets.circles.blobs import Ellipses
from camcal.targets.circles.lattice import places
from camcal.targets.circles.numbering import as_drawn, board_of
from camcal.targets.detection import MIN_CORNERS, Detection

_FILLED = 0.9  # of a board's circles, that are seen of one that is proposed
_CHECKERED = 0.75  # corners for every dark square of a checker pattern, at least
_GOES_ON = 2  # of the next circles along a side, that are seen where a grid is a part of a larger one
_OUTSIDE = 0.5  # of the next circles along a side, that lie outside the image where the board does


@dataclass(frozen=True, eq=False)
class OtherGrid:
    """A lattice of ellipses that is not the board looked for.

    drawn: indices (rows, columns), -1 where none, as `like` is drawn. like: the type of board of which most is seen.
    count: ellipses. whole: whether the lattice ends by itself.
    """

    drawn: Array
    ellipses: Ellipses
    like: Board
    count: int
    whole: bool

    @classmethod
    def of(cls, lattice: Array, ellipses: Ellipses, board: Board, *, whole: bool) -> "OtherGrid":
        """Return a lattice as the board is drawn, or as the other type of board is if it holds more of it then."""
        other = CIRCLES if board.type == ASYMMETRIC_CIRCLES else ASYMMETRIC_CIRCLES
        found = []
        for like in (board, replace(board, type=other, square=None, diameter=None)):
            drawn = as_drawn(lattice, like)
            found.append(cls(drawn, ellipses, like, int((drawn >= 0).sum()), whole))
        return max(found, key=lambda grid: grid.count)

    def detection(self, gray: Array, board: Board) -> Detection:
        """Return why the grid in an image (H, W) uint8 is not the board, and which board it is."""
        other, wanted = board_of(self.drawn, self.like), f"{board.columns} x {board.rows}"
        if self.like.type == ASYMMETRIC_CIRCLES and _checkered(gray, self.count):
            return Detection.nothing(f"a checker pattern in sight, no {board.words}")
        size = gray.shape[1], gray.shape[0]
        beyond = self._next(size)
        if self._leaves(beyond, size):
            return Detection.nothing(f"board partly outside the image ({self.count} circles in sight, not {wanted})")
        if other is None or self.count < _FILLED * other.count or not self.whole or self._goes_on(beyond):
            return Detection.nothing(f"a part of a grid in sight ({self.count} circles), not {wanted}")
        kind = "an asymmetric grid" if other.type == ASYMMETRIC_CIRCLES else "a grid"
        seen = f"{other.columns} x {other.rows}"
        return Detection.nothing(f"{kind} of {seen} circles in sight, not {wanted}", other)

    def _next(self, size: tuple[int, int]) -> tuple[Array, ...]:
        """Return where the next circles beyond each side would be (K, 2) px, nothing where that is unknown."""
        rows, columns = self.drawn.shape
        row, column = np.nonzero(self.drawn >= 0)
        points = np.column_stack([column, row]).astype(np.float64)
        if len(points) < MIN_CORNERS or np.ptp(points, axis=0).min() < 1:
            return ()
        seen = map_of(points, places(self.ellipses, self.drawn)[row, column], size, rough=True)
        across, down = np.arange(float(columns)), np.arange(float(rows))
        beside = [np.column_stack([across, np.full(columns, at)]) for at in (-1.0, rows)]
        beside += [np.column_stack([np.full(rows, at), down]) for at in (-1.0, columns)]
        return tuple(seen.pixels(nodes) for nodes in beside)

    def _leaves(self, beyond: tuple[Array, ...], size: tuple[int, int]) -> bool:
        """Return whether the next circles beyond a side would lie outside the image."""
        outside = [((side < 0) | (side > np.array(size) - 1)).any(axis=1) for side in beyond]
        return any(side.mean() > _OUTSIDE for side in outside)

    def _goes_on(self, beyond: tuple[Array, ...]) -> bool:
        """Return whether there are ellipses where the next circles beyond a side would be."""
        row, column = np.nonzero(self.drawn >= 0)
        radius = np.sqrt(np.median(self.ellipses.areas[self.drawn[row, column]]))
        tree = KDTree(self.ellipses.centres)
        return any((tree.query(side)[0] < radius).sum() >= _GOES_ON for side in beyond)


def _checkered(gray: Array, count: int) -> bool:
    """Return whether there is a checker pattern: a small one's dark squares are an asymmetric grid of `count` dots."""
    found = (~np.isnan(pattern[..., 0]) for copy in proposals(gray) for pattern in copy)
    return any(corners.sum() >= _CHECKERED * count for corners in found)
