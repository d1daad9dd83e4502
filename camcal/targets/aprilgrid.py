"""Detection of an AprilGrid: a few tags are identified, all corners predicted, verified and refined.

Tags of such a board meet small black squares at their corners, so that every corner is a crossing of two edges, as on a
chessboard, but with less room: the next edges are a gap away on one side, and on the other the tag's bits begin within
the width of its border. One tag that is read says where all corners are; what is seen there decides.

A corner has a tag's border on one side, a small square on the other, and gaps between them: along each edge a corner
has the side of the tag before it or behind it, and the gap's width on the other side. Nothing but edges is seen as deep
as the border of a tag, behind which its bits begin, and as deep as the gap elsewhere.
"""

from collections.abc import Iterator
from itertools import islice

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass, replace
from camcal.targets.board import Board
from camcal.targets.board_types import TAG_BORDER
from camcal.targets.checker.checker import CONTRAST, NodeMeasurements, measure_saddles
from camcal.targets.corner_cells import Beside, Cells
from camcal.targets.corner_measurement import blur_of, clear, tag_reach
from camcal.targets.corner_refinement import refine
from camcal.targets.detection import MIN_CORNERS, BoardDetection, MaskedImage
from camcal.targets.tag_lattice import (
    TagGroup,
    TagLattice,
    bit_agreement,
    codes_of,
    most_legible,
    predict,
    quadrilaterals,
    read_tags,
    tag_groups,
)

WINDOW = 0.6  # of a tag's side, what nodes take for the distance of the next corner
CLEARANCE = 0.3  # of that, how far from an edge they go: not as far as the bits
NEAR = 0.15  # of that, how far off corners may be for a narrow look
MOVED = 0.2  # sides of a tag from where a corner was put to where it is seen at most
STRAY = 0.12  # sides of a tag from where its neighbours put a corner that rule it out
LEAST_SIDE_PX = 6.0  # of a tag; corners of smaller ones are not distinguished
GROUPS = 3  # of tags in a copy of the image that are tried; more are accidents
CERTAIN = 5.0  # standard deviations of the bits' agreement by chance: tags that are read
RIGHT = 0.6  # correlation of a tag's bits with the right ones that one tag in thousands has by chance
OTHER = 0.1  # less of it shows that it is another tag, or none
ENOUGH = 2  # tags with the right bits, and none with others, that end the search
NOISE_LIMIT = 4.0  # times the median of what the model leaves over, or
ROUGH = 0.02  # of the contrast more: something covers a part of the corner
COPIES = 3  # of an image in which other tags are searched for, to say what is in sight
SHOWN = 6  # ids in a message
PASSES = 2  # of the final fit, where the blur makes corners see their neighbours


@dataclass(frozen=True, eq=False)
class _TagCorners:
    """Corners (2 rows, 2 columns, 2) of the board, NaN where none; contrast: their median, gray levels.

    right, wrong: how many tags have the bits they should have, and other ones.
    """

    grid: Array
    contrast: float
    right: int = 0
    wrong: int = 0

    @classmethod
    def nothing(cls, lattice: TagLattice) -> "_TagCorners":
        """Return the record of no corner."""
        return cls(np.full_like(lattice.nodes, np.nan), 0.0)

    @property
    def found(self) -> Array:
        """Which corners were found, (2 rows, 2 columns)."""
        return ~np.isnan(self.grid[..., 0])


def find_aprilgrid(gray: Array, board: Board, samples: MaskedImage | None = None) -> BoardDetection:
    """Return the corners of an AprilGrid in `gray`, (H, W) uint8, with covariance, or the reason why there are none.

    samples: those of the same image that say where its corners are, None for gray itself. A corner is left
    out where no two edges cross: it is hidden, or the board is cut along its outer tags.
    Raises InvalidInput if the family of the tags is unknown.
    """
    lattice = TagLattice.of(board)
    codes = codes_of(str(board.dictionary))[board.first_marker :][: lattice.count]
    best = _TagCorners.nothing(lattice)
    for seen in _candidates(gray, lattice, codes):
        best = max(best, seen, key=lambda one: one.right)
        if seen.right >= ENOUGH and not seen.wrong:
            break
    if not best.right:
        return _explain_absence(gray, board, lattice)
    if best.wrong > best.right:
        layout = f"{board.columns} x {board.rows}"
        reason = f"tag positions do not match a board of {layout} tags: check its size"
        return BoardDetection.nothing(reason, refused=best.grid)
    return _measure(samples or MaskedImage(gray), lattice, best, codes.shape[-1] + 2 * TAG_BORDER)


def _candidates(gray: Array, lattice: TagLattice, codes: Array) -> Iterator[_TagCorners]:
    """Yield what is seen of the board from each group of tags whose bits are certain."""
    for corners, off_px in quadrilaterals(gray):
        groups = most_legible(gray, codes, tag_groups(corners, 1 + lattice.gap))
        for group in groups[:GROUPS]:
            turned = [_place_upright(gray, lattice, codes, group.turned(turns)) for turns in range(4)]
            start, score = max(turned, key=lambda placed: placed[1])
            if score >= CERTAIN:
                yield _verify(gray, lattice, codes, _follow(gray, lattice, start, off_px))


def _place_upright(gray: Array, lattice: TagLattice, codes: Array, group: TagGroup) -> tuple[Array, float]:
    """Return the corners of a group that begin at the upper left of the upright print, on the board, and a score.

    By the agreement of all its bits with codes (tags, n, n). The corners are a grid (2 rows, 2 columns, 2) px, NaN
    where none. The score is the sum of correlations in standard deviations of what bits at random would give.
    """
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
    return lattice.grid(tags), score


def _follow(gray: Array, lattice: TagLattice, start: Array, off_px: float) -> _TagCorners:
    """Return the corners that are seen near those of some tags, and from them on as far as the board goes.

    off_px: how far those of the tags may be off.
    """
    nodes = _measure_nodes(gray, lattice, start, predict(lattice, start)[1], np.full(start.shape[:2], off_px))
    crossing = nodes.crossing(MOVED) & (nodes.contrast > 0)
    if not crossing.any():
        return _TagCorners.nothing(lattice)
    seen = _TagCorners(np.where(crossing[..., None], nodes.grid, np.nan), float(np.median(nodes.contrast[crossing])))
    for _ in range(sum(seen.grid.shape[:2])):
        grown = _grow(gray, lattice, seen)
        if (grown.found == seen.found).all():
            break
        seen = grown
    return seen


def _grow(gray: Array, lattice: TagLattice, seen: _TagCorners) -> _TagCorners:
    """Return the corners without those that stray, with missing ones that are seen where their neighbours put them."""
    places, steps, spread = predict(lattice, seen.grid)
    side = _side(steps)
    off = np.linalg.norm(places - seen.grid, axis=-1) / side
    grid = np.where((off > STRAY + 2 * spread)[..., None], np.nan, seen.grid)
    missing = np.where(seen.found[..., None], np.nan, places)
    nodes = _measure_nodes(gray, lattice, missing, steps, spread * side)
    new = nodes.crossing(MOVED) & (nodes.contrast > CONTRAST * seen.contrast)
    return _TagCorners(np.where(new[..., None], nodes.grid, grid), seen.contrast)


def _measure_nodes(gray: Array, lattice: TagLattice, places: Array, steps: Array, off_px: Array) -> NodeMeasurements:
    """Return what is seen near the places (2 rows, 2 columns, 2) px that are not NaN and lie in the image.

    steps: see `predict`. off_px: (2 rows, 2 columns) how far the corners may be from them. The contrast is positive
    where dark and bright are as on the board.
    """
    side = _side(steps)
    where = ((places > -0.5) & (places < np.array(gray.shape[::-1]) - 0.5)).all(axis=-1) & (side > LEAST_SIDE_PX)
    result = NodeMeasurements(places.copy(), *np.full((3, *side.shape), np.nan))
    if where.any():
        far = bool((off_px[where] > NEAR * WINDOW * side[where]).any())
        pixels, contrast, agreement = measure_saddles(gray, places[where], WINDOW * steps[where], CLEARANCE, far=far)
        result.grid[where], result.agreement[where] = pixels, agreement
        result.contrast[where] = contrast * lattice.signs[where]
        result.moved[where] = np.linalg.norm(pixels - places[where], axis=1) / side[where]
    return result


def _side(steps: Array) -> Array:
    """Return the shorter side (...) of tags with sides (..., 2, 2), px."""
    return np.asarray(np.linalg.norm(steps, axis=-2).min(axis=-1))


def _verify(gray: Array, lattice: TagLattice, codes: Array, seen: _TagCorners) -> _TagCorners:
    """Return the corners without those of tags whose bits are others, and the numbers of right and of wrong tags.

    The bits of a tag are read where its four corners are, or where their neighbours put them.
    """
    if not seen.found.any():
        return seen
    grid = np.where(seen.found[..., None], seen.grid, predict(lattice, seen.grid)[0])
    clockwise = lattice.tags(grid)[:, ::-1]  # from the upper left
    agreement = np.diagonal(bit_agreement(gray, clockwise, codes))
    other = (agreement < OTHER) & (agreement != 0)
    hidden = lattice.grid(np.repeat(other, 4).reshape(-1, 4))
    grid = np.where(hidden[..., None], np.nan, seen.grid)
    return _TagCorners(grid, seen.contrast, int((agreement > RIGHT).sum()), int(other.sum()))


def _measure(samples: MaskedImage, lattice: TagLattice, seen: _TagCorners, side: int) -> BoardDetection:
    """Return the corners as exactly as the image allows, with their covariance, in the order of their ids.

    side: cells across a tag, its border included.
    """
    found, grid = seen.found, seen.grid.copy()
    blur = blur_of(samples.values, grid[found])
    for _ in range(PASSES):
        cells = tag_cells(lattice, grid, side)
        crowded = cells.crowded(blur)
        if not crowded:  # without the edges beside them: as deep as cells go in an image that is sharp enough
            depth = np.minimum(cells.depth, cells.reach.min(axis=(1, 2))[:, None, None])
            cells = replace(cells, depth=depth, beside=None)
        corners = refine(samples.values, grid[found], cells, blur, samples.sites)
        grid[found] = corners.pixels
        if not crowded:
            break
    good = clear(corners) & (
        corners.noise < NOISE_LIMIT * np.nanmedian(corners.noise) + ROUGH * np.abs(corners.contrast)
    )
    if good.sum() < MIN_CORNERS:
        return BoardDetection.nothing(f"only {int(good.sum())} usable tag corners", refused=seen.grid)
    ids = lattice.ids[found][good]
    order = np.argsort(ids)
    return BoardDetection(
        ids=ids[order],
        pixels=corners.pixels[good][order],
        covariance=corners.covariance[good][order],
        refused=seen.grid[found][~good],
    )


def _explain_absence(gray: Array, board: Board, lattice: TagLattice) -> BoardDetection:
    """Return why the tags of a board are not found: there are none, others, or only their mirror images."""
    codes = codes_of(str(board.dictionary))
    expected = np.arange(len(codes))[board.first_marker :][: lattice.count]
    for clockwise, _ in islice(quadrilaterals(gray), COPIES):
        for corners, what in ((clockwise, "tags"), (clockwise[:, ::-1], "mirror images of tags")):
            ids, places = read_tags(gray, corners, codes)
            if len(ids):
                seen = f"{what} {', '.join(map(str, ids[:SHOWN]))} visible"
                other = f"{seen}; this board has {expected[0]} to {expected[-1]}"
                reason = f"{seen}, not as on this board" if np.isin(ids, expected).any() else other
                return BoardDetection.nothing(reason, refused=places)
    return BoardDetection.nothing(f"no tag of {board.dictionary} with a black border of {TAG_BORDER} cells found")


_AROUND = 20  # corners that say how lines bend at one of them
_SPARE = 2  # corners to a term of the polynomial


def tag_cells(lattice: TagLattice, grid: Array, side: int) -> Cells:
    """Return the cells of the corners that a grid (2 rows, 2 columns, 2) px has, NaN where none, row by row.

    side: cells across a tag, its border included.
    """
    places, steps, _ = predict(lattice, grid, own=True)
    present = ~np.isnan(grid[..., 0])
    row, column = np.nonzero(present)
    after = 1 - np.stack([column, row], axis=1) % 2  # 1 where the tag lies behind the corner along an edge
    reach, in_tag = tag_reach(after, lattice.gap)
    beside = _beside(lattice, np.where(present[..., None], grid, places), steps)
    depth = np.where(in_tag, TAG_BORDER / side, 1.0)
    return Cells(steps[present], _bends(lattice, grid), reach, depth, beside.take(np.flatnonzero(present)))


def _bends(lattice: TagLattice, grid: Array) -> Array:
    """Return the curvatures (N, 2) 1/px of the lines through a grid's corners, see Cells.bends.

    What bends lines is smooth and corners are not exact: a polynomial in x and y says where those around a corner are.
    """
    present = ~np.isnan(grid[..., 0])
    nodes, pixels = lattice.nodes[present], grid[present]
    degree = next((degree for degree in (3, 2) if _SPARE * (degree + 1) * (degree + 2) / 2 <= len(nodes)), None)
    if degree is None:
        return np.zeros_like(pixels)
    powers = np.array([(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)])
    away = nodes - nodes[:, None]
    nearest = np.argsort((away**2).sum(axis=2), axis=1, kind="stable")[:, :_AROUND]
    away = np.take_along_axis(away, nearest[..., None], axis=1)
    terms = (away[:, :, None] ** powers).prod(axis=-1)
    fitted = np.linalg.pinv(terms) @ pixels[nearest]
    bends = []
    for one, two in (((1, 0), (2, 0)), ((0, 1), (0, 2))):
        slope, bend = (fitted[:, (powers == power).all(axis=1).argmax()] for power in (one, two))
        across = slope[:, 0] * bend[:, 1] - slope[:, 1] * bend[:, 0]
        bends.append(2 * across / np.maximum(np.hypot(*slope.T), 1e-9) ** 3)
    return np.stack(bends, axis=1)


def _beside(lattice: TagLattice, places: Array, steps: Array) -> Beside:
    """Return the edges next to those of all corners at places (2 rows, 2 columns, 2) px, NaN where unknown."""
    rows, columns = places.shape[:2]
    wide = np.pad(places, ((1, 1), (1, 1), (0, 0)), constant_values=np.nan)
    tangents = np.pad(steps, ((1, 1), (1, 1), (0, 0), (0, 0)), constant_values=np.nan)
    lines, border = np.empty((rows, columns, 2, 2, 3)), np.zeros((rows, columns, 2, 2), np.bool_)
    row, column = np.indices((rows, columns))
    for edge, line, count in ((0, row, rows), (1, column, columns)):
        for index, sign in enumerate((-1, 1)):
            down, right = (1 + sign, 1) if edge == 0 else (1, 1 + sign)
            part = np.s_[down : down + rows, right : right + columns]
            width = np.where(line % 2 == (sign + 1) // 2, lattice.gap, 1.0)[..., None]
            unknown = np.isnan(wide[part][..., :1])
            toward = np.where(unknown, sign * width * steps[..., 1 - edge], wide[part] - places)
            lines[:, :, edge, index] = Beside.line(
                toward, np.where(unknown[..., None], steps, tangents[part])[..., edge]
            )
            border[:, :, edge, index] = line == (0 if sign < 0 else count - 1)
    return Beside.sorted(lines.reshape(-1, 2, 2, 3), border.reshape(-1, 2, 2))
