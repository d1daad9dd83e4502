"""Proposals of checker patterns in copies of an image, the cheapest first.

Finding asks for structure, not for precision, so large images are searched in reduced copies: the time goes with the
number of pixels. What is proposed is verified and located at full resolution by targets/checker/checker.py.

Two edges may cross at a saddle of the brightness that looks the same turned by half a turn. The determinant of the
second derivatives is negative there whatever its direction, contrast or blur. The second derivatives have their axes
along the middles of the dark and of the bright sectors, even where the edges are not at right angles: such a saddle
knows on which sides of it the dark squares lie.

A pattern is found among the saddles of an image: each is linked to the next along its four edges, then counted off. An
edge leaves a corner between a dark and a bright sector, and it is the same edge, with dark on the same side, until
it meets the next corner, whose dark and bright sectors are exchanged. So two corners are neighbours if dark and bright
lie beside the whole way between them as the sectors of both say. No size, no angle and no straight line is asked for.
"""

from collections import deque
from collections.abc import Callable, Iterator

import numpy as np

from camcal import opencv
from camcal.arrays import Array
from camcal.dataclass import dataclass

_REACH = 3  # nodes away that take part in a prediction
_UPRIGHT = np.array([np.cos(np.radians(20)), np.sin(np.radians(20))])


def predict(grid: Array) -> Array:
    """Return where its neighbours put every node (rows, columns, 2), pixels; NaN where they are too few.

    The median of the estimates along rows and columns, exact for quadratic spacing, so that perspective and strong
    distortion pass and a wrong neighbour or two is outvoted; where there are none, of linear ones.
    """
    quadratic, linear = _estimates(grid)
    best = _median(quadratic)
    return np.where(np.isnan(best), _median(linear), best)


def widen(grid: Array, width: int = 1) -> Array:
    """Return the grid with so many rows and columns more on each of its sides, NaN there."""
    rows, columns = grid.shape[:2]
    wide = np.full((rows + 2 * width, columns + 2 * width, 2), np.nan)  # in a tenth of the time of np.pad
    wide[width : width + rows, width : width + columns] = grid
    return wide


def outer(values: Array) -> tuple[Array, Array, Array, Array]:
    """Return what stands along the top, bottom, left and right of a padded grid's values (rows, columns, ...).

    The corners, of which nobody knows to which side they belong, are left out.
    """
    return values[0, 1:-1], values[-1, 1:-1], values[1:-1, 0], values[1:-1, -1]


def stray(grid: Array) -> Array:
    """Return how far every node (rows, columns) is from the nearest estimate of its neighbours, in steps.

    The nearest one, because on the rim of a fisheye image the estimates scatter. NaN where there is none.
    """
    away = np.linalg.norm(np.concatenate(_estimates(grid)) - grid, axis=-1)
    nearest = np.where(np.isnan(away), np.inf, away).min(axis=0)
    return np.where(np.isfinite(nearest), nearest / np.maximum(spacing(steps(grid)), 1e-9), np.nan)


def _estimates(grid: Array) -> tuple[Array, Array]:
    """Return estimates (K, rows, columns, 2) of every node from its neighbours: quadratic ones and linear ones."""
    near = _neighbours(grid)
    quadratic, linear = [], []
    for row, column in ((0, 1), (1, 0)):
        for sign in (-1, 1):
            one, two, three = (near(k * row, k * column) for k in (sign, 2 * sign, 3 * sign))
            quadratic.append(3 * one - 3 * two + three)
            linear.append(2 * one - two)
            linear.append(one + near(sign * column, sign * row) - near(sign, sign))
        before, after = near(-row, -column), near(row, column)
        quadratic.append((4 * (before + after) - near(-2 * row, -2 * column) - near(2 * row, 2 * column)) / 6)
        linear.append((before + after) / 2)
    return np.array(quadratic), np.array(linear)


def steps(grid: Array) -> Array:
    """Return the vectors to the next column and the next row at every node (rows, columns, 2, 2), pixels.

    The last axis is (along the row, down the column). A node without neighbours takes the steps of an affine map.
    """
    near = _neighbours(grid)
    pairs = np.empty((*grid.shape, 2))
    for place, along in enumerate(((0, 1), (1, 0))):
        ahead, behind = near(*along) - grid, grid - near(-along[0], -along[1])
        pairs[..., place] = np.where(np.isnan(ahead), behind, np.where(np.isnan(behind), ahead, (ahead + behind) / 2))
    if np.isnan(pairs).any():
        row, column = np.nonzero(~np.isnan(grid[..., 0]))
        design = np.column_stack([column, row, np.ones(len(row))])
        affine = np.linalg.lstsq(design, grid[row, column], rcond=None)[0]
        pairs = np.where(np.isnan(pairs), affine[:2].T, pairs)
    return pairs


def spacing(steps_at_nodes: Array) -> Array:
    """Return the shorter of the two steps (..., 2, 2) at every node, pixels."""
    return np.asarray(np.linalg.norm(steps_at_nodes, axis=-2).min(axis=-1))


def area(grid: Array) -> float:
    """Return the area that the nodes of a grid stand for, pixels: their number times that of the usual cell."""
    found = ~np.isnan(grid[..., 0])
    cells = np.abs(np.linalg.det(steps(grid)[found])) if found.any() else np.zeros(1)
    return float(np.median(cells)) * int(found.sum())


def uprightness(grid: Array) -> float:
    """Return how nearly the rows of a grid run to the right: the cosine of the angle to 20° below the image's x axis.

    Boards are held upright or on their side, so that the rows of two views of one stand seldom run just opposite ways
    on this scale, as they would against the x axis: a board on its side leans a little to the left or to the right.
    """
    along = np.nansum(grid[:, 1:] - grid[:, :-1], axis=(0, 1))
    return float(along @ _UPRIGHT / max(np.hypot(*along), 1e-9))


def _neighbours(grid: Array) -> Callable[[int, int], Array]:
    """Return what gives the grid moved by so many rows and columns, NaN from outside."""
    rows, columns = grid.shape[:2]
    wide = widen(grid, _REACH)

    def shift(row: int, column: int) -> Array:
        row, column = row + _REACH, column + _REACH
        return np.asarray(wide[row : row + rows, column : column + columns])

    return shift


def _median(values: Array) -> Array:
    """Return the median over the first axis without NaN, NaN where there is nothing else."""
    ordered = np.sort(values, axis=0)  # NaN last
    count = (~np.isnan(values)).sum(axis=0)
    low, high = (np.take_along_axis(ordered, k[None], axis=0)[0] for k in (np.maximum(count - 1, 0) // 2, count // 2))
    return np.where(count > 0, (low + np.where(count % 2 == 0, high, low)) / 2, np.nan)


SIGMA = 1.2  # px of the Gaussian that derivatives are taken of
APART = 5  # px, the window that one saddle has for itself
LEAST_CONTRAST = 0.7  # gray levels
MOST_SADDLES = 900  # saddles that are examined, those of most contrast
RING_PX = 3.0
RING = 16  # places on it
SYMMETRY = 0.75  # share of the ring's variance that is the same on opposite sides, 1 at a crossing of straight edges
_TO_CONTRAST = np.pi / 2  # the mixed derivative of erf(x / √2 s) · erf(y / √2 s) is 2 / (π s²)
_OWN_VARIANCE = 0.8  # px², of the derivative filters and of a pixel


@dataclass(frozen=True, eq=False)
class Saddles:
    """N saddles: pixels (N, 2), the direction (N,) of the middle of a dark sector in radians, contrast (N,).

    smooth: (H, W) float32, the image they were found in, blurred by SIGMA.
    """

    pixels: Array
    dark: Array
    contrast: Array
    smooth: Array

    def take(self, rows: Array) -> "Saddles":
        """Return some of the saddles."""
        return Saddles(self.pixels[rows], self.dark[rows], self.contrast[rows], self.smooth)


def find_saddles(gray: Array, sigma: float = SIGMA) -> Saddles:
    """Return the saddles of an image (H, W) uint8 that may be corners of a checker pattern."""
    smooth, xx, xy, yy = opencv.second_derivatives(gray, sigma)
    strength = xy * xy - xx * yy
    floor = (LEAST_CONTRAST / (_TO_CONTRAST * (sigma**2 + _OWN_VARIANCE))) ** 2
    row, column = _peaks(strength, floor)
    xx, xy, yy = (derivative[row, column].astype(np.float64) for derivative in (xx, xy, yy))
    gx = (smooth[row, column + 1] - smooth[row, column - 1]) / 2
    gy = (smooth[row + 1, column] - smooth[row - 1, column]) / 2
    depth = xy * xy - xx * yy
    shift = np.stack([yy * gx - xy * gy, xx * gy - xy * gx], axis=1) / depth[:, None]
    pixels = np.stack([column, row], axis=1) + shift
    saddles = Saddles(
        pixels,
        np.arctan2(2 * xy, xx - yy) / 2 + np.pi / 2,  # the image bends downwards from a saddle into the dark
        np.sqrt(depth) * (_TO_CONTRAST * (sigma**2 + _OWN_VARIANCE)),
        smooth,
    )
    return saddles.take((np.abs(shift).max(axis=1, initial=0.0) < 1) & (_symmetry(saddles) > SYMMETRY))


def _peaks(strength: Array, floor: float) -> tuple[Array, Array]:
    """Return rows and columns of the strongest places of their surroundings, the strongest of all if they are many."""
    peak = (strength == opencv.largest_around(strength, APART)) & (strength > floor)
    margin = int(RING_PX) + 1
    peak[:margin], peak[-margin:], peak[:, :margin], peak[:, -margin:] = False, False, False, False
    places = np.flatnonzero(peak)
    if len(places) > MOST_SADDLES:
        places = places[np.argpartition(-strength.ravel()[places], MOST_SADDLES)[:MOST_SADDLES]]
    return np.divmod(places, strength.shape[1])


def _symmetry(saddles: Saddles) -> Array:
    """Return the share (N,) of the brightness on a ring that is the same on opposite sides."""
    angle = np.arange(RING) * (2 * np.pi / RING)
    x, y = saddles.pixels[:, :1], saddles.pixels[:, 1:]
    values = opencv.sampled(saddles.smooth, x + RING_PX * np.cos(angle), y + RING_PX * np.sin(angle))
    values = values - values.mean(axis=1, keepdims=True)
    odd = (values[:, : RING // 2] - values[:, RING // 2 :]) / 2
    return np.asarray(1 - 2 * (odd**2).sum(axis=1) / np.maximum((values**2).sum(axis=1), 1e-9))


SMALL = 0.35e6  # pixels of the first copy, about
MOST = 6e6  # of the largest
ENLARGED = 0.5e6  # images with fewer pixels are also searched enlarged
TRIED = 3  # patterns of a copy


def proposals(gray: Array) -> Iterator[list[Array]]:
    """Yield what every copy shows of checker patterns, the largest first.

    Each is a grid of corners (rows, columns, 2) in pixels of `gray`, (H, W) uint8, NaN where one was not seen. Most
    boards show in the first copy; those out of focus or in much noise in one of half its width, small ones in larger
    ones.
    """
    for scale in _scales(gray.size):
        copy = gray if scale == 1 else opencv.resized(gray, scale)
        to_image = np.array(gray.shape[::-1]) / np.array(copy.shape[::-1])  # the outer edges of both coincide
        yield [(grid + 0.5) * to_image - 0.5 for grid in patterns(find_saddles(copy))[:TRIED]]


def _scales(size: int) -> Iterator[float]:
    """Yield the scales of the copies to search of an image of so many pixels."""
    first = max(1, round(float(np.sqrt(size / SMALL))))
    yield from (1 / first, 1 / (2 * first))
    scale = 1 / first
    while scale < 1 and 4 * scale**2 * size < MOST:
        scale = min(1.0, 2 * scale)
        yield scale
    if size < ENLARGED:
        yield 2.0


NEAREST = 40  # saddles that may be the next one; what is printed in a square lies nearer, so do foreshortened rows
WAY = np.array([0.15, 0.3, 0.45, 0.6, 0.75, 0.9])  # where an edge is examined, shares of it
BESIDE_PX, BESIDE = 1.3, 0.05  # how far from it, pixels and share of its length: edges bend
EDGE = 0.3  # smallest difference across an edge, of what the contrast of its corners makes expected
QUARTER = np.pi / 2
OFF_PERPENDICULAR = np.radians(35)  # of the dark sectors of neighbours
SKEW = 0.5  # of its shorter sides, by which the fourth corner of a cell is off a parallelogram at most
LEAST = 6  # corners of a pattern, two squares side by side; fewer may be anything


def patterns(saddles: Saddles) -> list[Array]:
    """Return the checker patterns among the saddles, the largest in the image first.

    Each is a grid (rows, columns, 2) of pixels, NaN where no corner was seen, its rows turn clockwise to its columns.
    """
    if len(saddles.pixels) < LEAST:
        return []
    links = _around_squares(saddles, _links(saddles))
    corner_grids, taken = [], np.zeros(len(links), dtype=bool)
    for seed in np.argsort(-(links >= 0).sum(axis=1), kind="stable"):
        if taken[seed] or (links[seed] < 0).all():
            continue
        places = _count_off(links, int(seed), taken)
        taken[list(places)] = True
        if len(places) >= LEAST:
            row, column = (np.array(list(places.values())) - np.min(list(places.values()), axis=0)).T
            grid = np.full((row.max() + 1, column.max() + 1, 2), np.nan)
            grid[row, column] = saddles.pixels[list(places)]
            corner_grids.append(grid)
    return sorted(corner_grids, key=area, reverse=True)


def _links(saddles: Saddles) -> Array:
    """Return the next corner (N, 4) along the edge in each quadrant from the dark sector on, clockwise, -1 if none."""
    count = len(saddles.pixels)
    distance, other = (column[:, 1:] for column in opencv.nearest_points(saddles.pixels, min(NEAREST + 1, count)))
    way = saddles.pixels[other] - saddles.pixels[:, None]
    angle = np.arctan2(way[..., 1], way[..., 0])
    quadrant = _quadrant(angle - saddles.dark[:, None])
    opposed = saddles.dark[other] - saddles.dark[:, None]
    seen = np.abs(np.cos(opposed)) < np.sin(OFF_PERPENDICULAR)
    one, rank = np.nonzero(seen)
    seen[one, rank] = _edge(saddles, one, other[one, rank], 1 - 2 * (quadrant[one, rank] % 2))
    links = np.full((count, 4), -1)
    for side in range(4):
        fits = seen & (quadrant == side)
        first = np.where(fits, distance, np.inf).argmin(axis=1)
        links[:, side] = np.where(fits.any(axis=1), other[np.arange(count), first], -1)
    return _mutual(saddles, links)


def _quadrant(angle: Array) -> Array:
    return np.asarray(np.floor(angle / QUARTER).astype(np.intp) % 4)


def _edge(saddles: Saddles, one: Array, two: Array, sign: Array) -> Array:
    """Return whether an edge (E,) runs from saddle to saddle; sign (E,): 1 if bright lies clockwise of it, else -1."""
    (x, y), (across, down) = saddles.pixels[one].T, (saddles.pixels[two] - saddles.pixels[one]).T
    aside = BESIDE + BESIDE_PX / np.maximum(np.hypot(across, down), 1e-9)
    x, y = (start[:, None] + way[:, None] * WAY for start, way in ((x, across), (y, down)))
    off_x, off_y = (-down * aside)[:, None], (across * aside)[:, None]
    clockwise = opencv.sampled(saddles.smooth, x + off_x, y + off_y)
    difference = sign[:, None] * (clockwise - opencv.sampled(saddles.smooth, x - off_x, y - off_y))
    expected = np.minimum(saddles.contrast[one], saddles.contrast[two])
    return np.asarray((difference.min(axis=1) > 0) & (np.median(difference, axis=1) > EDGE * 2 * expected))


def _mutual(saddles: Saddles, links: Array) -> Array:
    """Return the links (N, 4) that lead back to where they come from."""
    one, side = np.nonzero(links >= 0)
    two = links[one, side]
    back = saddles.pixels[one] - saddles.pixels[two]
    from_there = _quadrant(np.arctan2(back[:, 1], back[:, 0]) - saddles.dark[two])
    result = links.copy()
    result[one, side] = np.where(links[two, from_there] == one, two, -1)
    return result


def _around_squares(saddles: Saddles, links: Array) -> Array:
    """Return the links (N, 4) that go along a square: four of them, always turning the same way, lead back.

    What is printed in a square, or lies behind the board, may be linked to it by chance, but not all around a square.
    """
    one, side = np.nonzero(links >= 0)
    two = links[one, side]
    back = (links[two] == one[:, None]).argmax(axis=1)
    ahead = np.full(links.size + 1, links.size)  # from a link to the next one, turning right; the last is the dead end
    ahead[4 * one + side] = np.where(links[two, (back + 3) % 4] >= 0, 4 * two + (back + 3) % 4, links.size)
    start = np.arange(links.size)
    second, third = ahead[start], ahead[ahead[start]]
    closed = (ahead[ahead[third]] == start) & _is_cell(saddles.pixels, start, second, third, ahead[third])
    kept = closed[4 * one + side] | closed[4 * two + back]
    result = np.full_like(links, -1)
    result[one[kept], side[kept]] = two[kept]
    return result


def _is_cell(pixels: Array, *path: Array) -> Array:
    """Return whether four links (L,) each, one after the other, go around something like a parallelogram."""
    corners = [pixels[np.minimum(link // 4, len(pixels) - 1)] for link in path]
    sides = [np.linalg.norm(corners[k] - corners[k - 1], axis=1) for k in range(4)]
    skew = np.linalg.norm(corners[0] - corners[1] + corners[2] - corners[3], axis=1)
    return np.asarray(skew < SKEW * np.minimum(sides[0] + sides[2], sides[1] + sides[3]) / 2)


def _count_off(links: Array, seed: int, taken: Array) -> dict[int, tuple[int, int]]:
    """Return the places (row, column) of the corners that links lead to and that are not taken (N,).

    The seed's first edge leads along its row.
    """
    moves = ((0, 1), (1, 0), (0, -1), (-1, 0))
    table = links.tolist()
    places, turns, used = {seed: (0, 0)}, {seed: 0}, {(0, 0): seed}
    queue = deque([seed])
    while queue:
        one = queue.popleft()
        (row, column), turn = places[one], turns[one]
        for side, two in enumerate(table[one]):
            if two < 0 or two in places or taken[two]:
                continue
            direction = (side + turn) % 4
            place = row + moves[direction][0], column + moves[direction][1]
            if place in used:
                continue
            places[two], used[place] = place, two
            turns[two] = (direction + 2 - table[two].index(one)) % 4
            queue.append(two)
    return places
