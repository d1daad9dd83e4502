"""Detection of a grid of circles: ellipses on a lattice, refined and numbered.

A plain grid looks the same after half a turn, a square one after a quarter, and so does an asymmetric one of an even
number of rows; the turn whose rows run most to the right is then taken. A grid that is not the board searched for is
told as another board or a part of one.

A grid of ellipses has centres (rows, columns, 2) and axes (rows, columns, 2, 2), NaN where there is none. An asymmetric
board's grid has a column for every half of its spacing, so that every other node is none of its circles.

Perspective moves the centre of the ellipse away from the projected centre of the disc. Where the board is seen as
x → p + J x / (1 + l · x) around a disc of radius r the offset is -r² J l / (1 - r² l · l): the centre of the dual conic
H diag(r², r², -1) Hᵀ (Heikkilä 2000, Geometric camera calibration using circular control points). Lens distortion moves
it too. Both follow from how the grid as a whole is seen: every disc's rim is taken into the image, an
ellipse is fitted to it as one was to the image, and its distance from the image of the centre is taken off.
"""

from collections.abc import Iterator

import numpy as np
from scipy.spatial import KDTree

from camcal import opencv
from camcal.arrays import Array
from camcal.dataclass import dataclass, replace
from camcal.targets.board import ASYMMETRIC_CIRCLES, CIRCLES, LARGEST, Board
from camcal.targets.board_map import BoardMap, map_of
from camcal.targets.board_types import grid_points, staggered
from camcal.targets.checker.proposals import proposals
from camcal.targets.detection import MIN_CORNERS, BoardDetection
from camcal.targets.disc_fit import DiscFits, fit_discs
from camcal.targets.ellipses import Ellipses, find_ellipses, lattices, places, rim, square_roots

MIN_PROPOSED = 0.5  # of the board's circles, for the others to be searched for
LEAST_OTHER = 9  # circles of a grid that is worth a word; fewer may be anything
MIN_SHARE = 0.75  # of them that must be measured
_REDUCED = 800  # px, the longer side of the copy that is searched first
_LARGEST = 3200  # px, of a copy that is searched at last
_BLOCKS = (8, 16, 4, 32)  # of the longer side, the blocks that circles are darker or brighter than
_AGREEMENT = 0.6  # of a dot's window; noise takes its part
_INK = 0.4  # relative difference of a dot's contrast from the board's
_NOISE = 4.0  # times the median over the board: more of it is something that lies on a dot
_NOISE_FLOOR = 2.0  # gray levels


def find_circles(gray: Array, board: Board) -> BoardDetection:
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
            seen = _measure(gray, board, ordered, ellipses)
            if seen.found:
                return seen
            unclear = seen
    if unclear or largest is None or largest.count < LEAST_OTHER:
        return unclear or BoardDetection.nothing(f"no {board.words} found")
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


def _measure(gray: Array, board: Board, lattice: Array, ellipses: Ellipses) -> BoardDetection:
    """Return the dots of a board fitted to the image; those that the lattice lacks are searched for too."""
    height, width = gray.shape
    start = _complete(board, lattice, ellipses, (width, height))
    fits = fit_discs(gray, start)
    good = _good(fits)
    if good.sum() < MIN_SHARE * board.count:
        reason = f"only {int(good.sum())} of {board.count} usable circles"
        return BoardDetection.nothing(reason, refused=fits.ellipses.take(good).centres)
    points = board.points()[good, :2] / board.spacing
    radius = None if board.diameter is None else board.diameter / board.spacing / 2
    pixels = projected_centres(fits.ellipses.take(good), points, radius, (width, height))
    return BoardDetection(ids=np.flatnonzero(good), pixels=pixels, covariance=fits.covariance[good])


def _complete(board: Board, lattice: Array, ellipses: Ellipses, size: tuple[int, int]) -> Ellipses:
    """Return the ellipses (count,) of all dots of a board in the order of their ids, of some as the others tell."""
    index = lattice[tuple(nodes(board).T)]
    present = index >= 0
    points = board.points()[:, :2] / board.spacing
    centres, axes = ellipses.centres[index], ellipses.axes[index]
    if not present.all():
        near = KDTree(points[present]).query(points[~present], k=4)[1]
        axes[~present] = axes[present][near].mean(axis=1)
        centres[~present] = map_of(points[present], centres[present], size).pixels(points[~present])
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


_SIDE = 0.5  # of an outer row's nodes that must be seen for it to belong to the board


def as_drawn(lattice: Array, board: Board) -> Array:
    """Return a lattice of indices, -1 where none, with the board's rows and columns parallel to its own.

    The lattice of nearest neighbours of an asymmetric board stands at 45° to it.
    """
    if board.type != ASYMMETRIC_CIRCLES:
        return _trim(lattice, 1)
    row, column = np.nonzero(lattice >= 0)
    x, y = column - row, column + row
    turned = np.full((np.ptp(y) + 1, np.ptp(x) + 1), -1)
    turned[y - y.min(), x - x.min()] = lattice[row, column]
    return _trim(turned, 2)


def _trim(lattice: Array, every: int) -> Array:
    """Return the lattice without outer rows and columns of which too little was found."""
    while lattice.size:
        present = lattice >= 0
        sides = (present[0], present[-1], present[:, 0], present[:, -1])
        top, bottom, left, right = (int(every * side.mean() < _SIDE) for side in sides)
        if not (top or bottom or left or right):
            break
        rows, columns = lattice.shape
        lattice = lattice[top : rows - bottom, left : columns - right]
    return lattice


def size_of(board: Board) -> tuple[int, int]:
    """Return rows and columns of the board's grid of ellipses."""
    return board.rows, board.columns * (2 if board.type == ASYMMETRIC_CIRCLES else 1)


def numbered(lattice: Array, ellipses: Ellipses, board: Board) -> Array | None:
    """Return the lattice turned so that node (0, 0) is point 0, None if it is not the board's.

    Of the turns that look the same, the one whose rows run most to the right.
    """
    turns = [np.rot90(lattice, turn) for turn in range(4)]
    fitting = [turn for turn in turns if turn.shape == size_of(board) and _fits_board(turn, board)]

    def rightness(turn: Array) -> float:
        """Return the cosine of the angle from the image's x axis to the rows of a lattice."""
        row, column = np.nonzero(turn >= 0)
        design = np.column_stack([column, row, np.ones(len(row))])
        along = np.linalg.lstsq(design, ellipses.centres[turn[row, column]], rcond=None)[0][0]
        return float(along[0] / np.hypot(*along))

    return max(fitting, key=rightness, default=None)


def board_of(lattice: Array, like: Board) -> Board | None:
    """Return the board whose rows and columns a lattice of indices, turned as one like it is drawn, has; None if none.

    Lengths are those of `like`.
    """
    for turn in range(4):
        turned = np.rot90(lattice, turn)
        rows, columns = turned.shape
        if like.type == ASYMMETRIC_CIRCLES:
            columns, half = divmod(columns, 2)
            if half:
                continue
        if min(rows, columns) < 2 or max(rows, columns) > LARGEST:
            return None
        board = like.of_size(columns, rows)
        if turned.shape == size_of(board) and _fits_board(turned, board):
            return board
    return None


def nodes(board: Board) -> Array:
    """Return row and column (count, 2) of every point of the board in its grid of ellipses, in the order of ids."""
    layout = staggered if board.type == ASYMMETRIC_CIRCLES else grid_points
    return layout(board.columns, board.rows)[:, ::-1].astype(np.intp)


def _fits_board(lattice: Array, board: Board) -> bool:
    """Return whether the nodes with an ellipse are those of the board."""
    wanted = np.zeros(lattice.shape, dtype=bool)
    wanted[tuple(nodes(board).T)] = True
    return not ((lattice >= 0) & ~wanted).any()


_FILLED = 0.9  # of a board's circles, that are seen of one that is proposed
_CHECKERED = 0.75  # corners for every dark square of a checker pattern, at least
_GOES_ON = 2  # of the next circles along a side, that are seen where a grid is a part of a larger one
_OUTSIDE = 0.5  # of the next circles along a side, that lie outside the image where the board does


@dataclass(frozen=True, eq=False)
class OtherGrid:
    """A lattice of ellipses that is not the board searched for.

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
        candidates = []
        for like in (board, replace(board, type=other, square=None, diameter=None)):
            drawn = as_drawn(lattice, like)
            candidates.append(cls(drawn, ellipses, like, int((drawn >= 0).sum()), whole))
        return max(candidates, key=lambda grid: grid.count)

    def detection(self, gray: Array, board: Board) -> BoardDetection:
        """Return why the grid in an image (H, W) uint8 is not the board, and which board it is."""
        other, wanted = board_of(self.drawn, self.like), f"{board.columns} x {board.rows}"
        if self.like.type == ASYMMETRIC_CIRCLES:
            # the dark squares of a small checker pattern are an asymmetric grid of as many dots
            patterns = (~np.isnan(pattern[..., 0]) for copy in proposals(gray) for pattern in copy)
            if any(corners.sum() >= _CHECKERED * self.count for corners in patterns):
                return BoardDetection.nothing(f"a checker pattern visible, no {board.words}")
        size = gray.shape[1], gray.shape[0]
        beyond, circles = self._next(size), self.ellipses.centres[self.drawn[self.drawn >= 0]]
        if self._leaves(beyond, size):
            reason = f"board partly outside the image ({self.count} circles visible, not {wanted})"
            return BoardDetection.nothing(reason, refused=circles)
        if other is None or self.count < _FILLED * other.count or not self.whole or self._goes_on(beyond):
            reason = f"part of a grid visible ({self.count} circles), not {wanted}"
            return BoardDetection.nothing(reason, refused=circles)
        kind = "an asymmetric grid" if other.type == ASYMMETRIC_CIRCLES else "a grid"
        seen = f"{other.columns} x {other.rows}"
        return BoardDetection.nothing(f"{kind} of {seen} circles visible, not {wanted}", other, circles)

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
        return tuple(seen.pixels(side) for side in beside)

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


_RIM_POINTS = 24
_ROUNDS = 4  # the map is fitted to centres that are off at first; each round leaves a quarter or less
_TYPICAL_RADIUS = 0.3  # pitches


def projected_centres(ellipses: Ellipses, points: Array, radius: float | None, size: tuple[int, int]) -> Array:
    """Return the pixels (N, 2) of the discs' centres, from their ellipses in the image.

    points: (N, 2) of the centres on the board. radius: in the same unit, None to find it from the ellipses' areas.
    size: (width, height) of the image.
    """
    centres = ellipses.centres
    for _ in range(_ROUNDS):
        seen = map_of(points, centres, size)
        reach = radius
        if reach is None:  # the median over the discs' areas, from those of a trial radius
            trial = _TYPICAL_RADIUS * float(np.linalg.norm(points[1:] - points[:-1], axis=1).min())
            reach = trial * float(np.sqrt(np.median(ellipses.areas / _rims(seen, points, trial).areas)))
        centres = ellipses.centres - (_rims(seen, points, reach).centres - seen.pixels(points))
    return centres


def _rims(seen: BoardMap, points: Array, radius: float) -> Ellipses:
    """Return the ellipses that fit the images of the discs' rims best, every piece of a rim counting by its length."""
    angles = 2 * np.pi * np.arange(_RIM_POINTS) / _RIM_POINTS
    unit = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    traced = seen.pixels(points[:, None] + radius * unit)
    lengths = np.linalg.norm(np.roll(traced, -1, axis=1) - np.roll(traced, 1, axis=1), axis=2)
    centres = traced.mean(axis=1)
    first = 2 / _RIM_POINTS * traced.swapaxes(1, 2) @ unit  # the first harmonic, an affine map of the circle
    axes = square_roots(first @ first.swapaxes(1, 2))
    x, y = np.moveaxis(traced - centres[:, None], -1, 0)
    near = rim(x, y, axes)
    (normal_x, normal_y), (across, down) = near.outward.swapaxes(0, 1), near.unit.swapaxes(0, 1)
    design = [normal_x, normal_y, normal_x * across, normal_x * down + normal_y * across, normal_y * down]
    jacobian = np.stack(design, axis=1)
    weighted = jacobian * lengths[:, None]
    normal = weighted @ jacobian.swapaxes(1, 2)
    step = np.linalg.solve(normal, weighted @ near.distance[..., None])[..., 0]
    return Ellipses(centres + step[:, :2], axes + step[:, [2, 3, 3, 4]].reshape(-1, 2, 2))
