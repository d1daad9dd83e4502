"""The corners of a grid of tags as one lattice: where its neighbours put a corner, and which corners agree.

Lines at the edges of all tags cross in 2 rows × 2 columns corners, which an array (2 rows, 2 columns, 2) of pixels
holds, NaN where a corner is missing; rows go upwards on the print, as Kalibr's do. Lengths are in sides of a tag.
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.targets.board import Board

_CORNERS = np.array([[0, 1], [3, 2]])  # Kalibr's number of a tag's corner, [upper, right]
_NEIGHBOURS = 12  # the nearest corners, which say where one lies
_REACH = 4.0  # as far as neighbours are looked for
_EXACT = 0.01  # standard deviation of a corner, and
_BENT = 0.02  # of what a homography leaves of a lens's distortion, at distance 1; it goes with the distance squared
_PERSPECTIVE = 0.2  # standard deviation of the change of scale over a tag
_VAGUE = 0.15  # a corner whose place is known no better is not looked for


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
        return cls(board.columns, board.rows, board.pitch / float(board.marker or 1.0) - 1)

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


@dataclass(frozen=True, eq=False)
class Predicted:
    """Where neighbours put corners: places (..., 2) px, NaN where they cannot tell; spread (...), in sides of a tag.

    steps: (..., 2, 2) px, columns are the side of a tag along a row and up a column as they are seen there.
    """

    places: Array
    steps: Array
    spread: Array


def predict(lattice: TagLattice, grid: Array, *, own: bool = False) -> Predicted:
    """Return where its neighbours put every corner of a grid; own: and the corner itself, which is left out otherwise.

    The nearest corners are fitted by a homography, each as exact as a lens that distorts leaves it at its distance.
    """
    nodes, known = lattice.nodes.reshape(-1, 2), ~np.isnan(grid[..., 0]).ravel()
    away = nodes[known] - nodes[:, None]
    distance = np.linalg.norm(away, axis=2)
    if not own:
        distance[distance == 0] = np.inf
    nearest = np.argsort(distance, axis=1, kind="stable")[:, :_NEIGHBOURS]
    away, distance = (np.take_along_axis(v, i, axis=1) for v, i in ((away, nearest[..., None]), (distance, nearest)))
    seen = grid.reshape(-1, 2)[known][nearest]
    weights = np.where(distance < _REACH, 1 / (_EXACT**2 + (_BENT * distance**2) ** 2), 0.0)
    middle = seen.mean(axis=1, keepdims=True)
    size = _radius(seen) / _radius(away)  # px of a tag's side, more or less
    entries, spread = _homographies(away, (seen - middle) / size, weights)
    steps = entries[:, :4].reshape(-1, 2, 2) - entries[:, 4:6, None] * entries[:, None, 6:]
    known_enough = spread < _VAGUE
    places = np.where(known_enough[:, None], entries[:, 4:6] * size[:, 0] + middle[:, 0], np.nan)
    shape = grid.shape[:2]
    return Predicted(places.reshape(*shape, 2), (steps * size).reshape(*shape, 2, 2), spread.reshape(shape))


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


def inverse(frames: Array) -> Array:
    """Return the inverses of (..., 2, 2), NaN of parallel columns."""
    a, b, c, d = (frames[..., i, j] for i in (0, 1) for j in (0, 1))
    area = a * d - b * c
    area = np.where(np.abs(area) < 1e-9, np.nan, area)
    return np.stack([np.stack([d, -b], axis=-1), np.stack([-c, a], axis=-1)], axis=-2) / area[..., None, None]
