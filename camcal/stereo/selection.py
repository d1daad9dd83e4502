"""Selection of pixels for a cloud, and removal of isolated points.

A point stands alone by the disparities around its pixel, or by the points around it.
"""

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.raw.tiles import Each, difference, one_by_one
from camcal.stereo.depth import BackProjection, Frame, StereoImage, require_size, row_blocks, widened

ORGANISED = "organised"
RADIUS = "radius"
NONE = "none"
METHODS = (ORGANISED, RADIUS, NONE)

NEIGHBOURS = 6  # that a point must have, of 24 around a pixel, or in the sphere around a point
REACH = 2  # pixels to all sides
_APART = 1.0  # pixels of disparity
_HALF = tuple((dy, dx) for dy in range(REACH + 1) for dx in range(-REACH, REACH + 1) if dy > 0 or dx > 0)
_SHARE_OF_DEPTH = 0.01
_BLOCK = 1 << 17  # pixels worked on at a time: few enough for the cache, enough for threads
_MEDIAN_OF = 1 << 20
_METRES_OF_LEFT = Frame()


@dataclass(frozen=True, eq=False)
class Selection:
    """What a pixel with a match has to fulfil besides.

    depth: nearest and farthest z along the optical axis, metres. crop: lowest and highest of x, y and z, (3, 2), metres
    in the frame of the cloud. mask: (H, W) bool, True where points are wanted. max_sigma: largest standard deviation of
    the depth, as a share of it. min_confidence: see `Confidence`. stride: only every so many rows and columns.
    outliers: one of METHODS; with radius, metres, None for 1 % of the median depth.
    """

    depth: tuple[float, float] = (0.0, float("inf"))
    crop: Array | None = None
    mask: Array | None = None
    max_sigma: float | None = None
    min_confidence: int | None = None
    stride: int = 1
    outliers: str = ORGANISED
    radius: float | None = None

    def __post_init__(self) -> None:
        if not self.depth[0] < self.depth[1]:
            raise InvalidInput(f"the depth range {self.depth[0]:g} … {self.depth[1]:g} m is empty")
        if self.crop is not None and not np.all(self.crop[:, 0] < self.crop[:, 1]):
            raise InvalidInput("the crop is empty; write xmin,xmax,ymin,ymax,zmin,zmax in metres")
        if self.max_sigma is not None and not self.max_sigma > 0:
            raise InvalidInput(f"the largest standard deviation must be positive, found {self.max_sigma:g}")
        if self.stride < 1:
            raise InvalidInput(f"a stride of {self.stride}, need at least 1")
        if self.outliers not in METHODS:
            raise InvalidInput(f"outliers {self.outliers!r} is unknown; use one of {', '.join(METHODS)}")


@dataclass(frozen=True, eq=False)
class Selected:
    """kept: (H, W) bool, True for pixels that become points. matched: how many have a match. outliers: how many are
    left out because they stand alone, of those with a match or, by radius, of those that were left.
    """

    kept: Array
    matched: int
    outliers: int


def select(image: StereoImage, selection: Selection, frame: Frame, each: Each = one_by_one) -> Selected:
    """Return the pixels that become points in a frame; each: does work on blocks of rows, on threads if it has them.

    Raises InvalidInput if the mask has another size, or sigma or confidence is asked for and not known.
    """
    require_size(selection.mask, image.shape, "mask")
    if selection.min_confidence is not None and image.confidence is None:
        raise InvalidInput("unknown confidence of the pixels: no sidecar of the map names it")
    in_metres = Frame(frame.frame_T_left)  # whatever the unit of the cloud is
    places = BackProjection(image.geometry, image.shape, in_metres) if selection.crop is not None else None
    kept = np.empty(image.shape, bool)
    matched, alone = np.zeros((2, image.shape[0]), np.int64)

    def choose(rows: slice) -> None:
        chosen = image.matched(rows)
        matched[rows.start] = np.count_nonzero(chosen)
        if selection.outliers == ORGANISED:
            wide, within = widened(rows, REACH, image.shape[0])
            chosen &= has_similar_neighbours(image.shifted(wide), within)
            alone[rows.start] = matched[rows.start] - np.count_nonzero(chosen)
        _apply_limits(image, selection, rows, chosen)
        if places is not None and selection.crop is not None:
            depth = image.depth(rows)
            for axis, (lowest, highest) in enumerate(selection.crop):
                coordinate = places.coordinate(axis, rows, depth)
                chosen &= (coordinate >= lowest) & (coordinate <= highest)
        kept[rows] = chosen

    each(choose, row_blocks(image.shape, _BLOCK))
    if selection.stride > 1:
        grid = np.zeros(image.shape, bool)
        grid[:: selection.stride, :: selection.stride] = True
        kept &= grid
    if selection.outliers == RADIUS:
        alone[0] = _remove_lonely(image, selection.radius, kept)
    return Selected(kept, int(matched.sum()), int(alone.sum()))


def _apply_limits(image: StereoImage, selection: Selection, rows: slice, chosen: Array) -> None:
    """Leave out of the chosen pixels (N, W) of some rows what depth, mask, confidence and sigma speak against."""
    nearest, farthest = selection.depth
    if nearest > 0 or farthest < np.inf:
        depth = image.depth(rows)
        chosen &= (depth >= np.float32(nearest)) & (depth <= np.float32(farthest))
    if selection.mask is not None:
        chosen &= selection.mask[rows]
    if selection.min_confidence is not None and image.confidence is not None:
        chosen &= image.confidence[rows] >= selection.min_confidence
    if selection.max_sigma is not None:
        chosen &= image.relative_sigma(rows) <= np.float32(selection.max_sigma)


def _remove_lonely(image: StereoImage, radius: float | None, kept: Array) -> int:
    """Leave isolated points out of the pixels kept (H, W) and return how many that were."""
    places = BackProjection(image.geometry, image.shape, _METRES_OF_LEFT)
    blocks = row_blocks(image.shape, _BLOCK)
    points = np.concatenate([places.points(rows, image.depth(rows))[kept[rows]] for rows in blocks])
    accompanied = has_neighbours(points, radius)
    kept[kept] = accompanied
    return len(points) - int(accompanied.sum())


def depth_figures(image: StereoImage, kept: Array) -> tuple[float, float, float] | None:
    """Return the smallest, median and largest depth of the pixels kept, (H, W) bool, metres; None if there are none.

    Of many pixels the median is that of every n-th, since finding it of all takes longer than writing them.
    """
    step = 1 + np.count_nonzero(kept) // _MEDIAN_OF
    lowest, highest, some = np.inf, 0.0, []
    for rows in row_blocks(image.shape, _BLOCK):
        depth = image.depth_of_matches(rows)[kept[rows]]
        lowest, highest = float(depth.min(initial=lowest)), float(depth.max(initial=highest))
        some.append(depth[::step])
    return (lowest, float(np.median(np.concatenate(some))), highest) if highest else None


def has_similar_neighbours(disparity: Array, within: slice) -> Array:
    """Return whether at least 6 of the 5 × 5 pixels around each have a disparity within 1 px of its own, (N, W).

    disparity: (M, W) pixels, NaN where there is no match. within: the N of the M rows that are asked about; up to
    `REACH` on either side are examined.
    """
    columns = disparity.shape[1] + 2 * REACH
    padded = np.full((len(disparity), columns), np.nan, np.float32)
    padded[:, REACH:-REACH] = disparity
    # As one row of pixels: a neighbour is then the same row further on, and is so to both of the two.
    flat = padded.reshape(1, -1)
    count = np.zeros(flat.size, np.uint8)
    apart, near = np.empty_like(flat), np.empty(flat.size, bool)
    for shift in (dy * columns + dx for dy, dx in _HALF):
        end = flat.size - shift
        if end <= 0:
            break
        difference(flat[:, shift:], flat[:, :end], apart[:, :end])
        np.less_equal(apart[0, :end], _APART, out=near[:end])
        count[:end] += near[:end].view(np.uint8)
        count[shift:] += near[:end].view(np.uint8)
    return np.asarray(count.reshape(padded.shape)[within, REACH:-REACH] >= NEIGHBOURS)


def has_neighbours(points: Array, radius: float | None = None) -> Array:
    """Return whether each of points (N, 3) has at least 6 others within a radius, by default 1 % of the median z."""
    from scipy.spatial import cKDTree  # a quarter of a second that other clouds need not wait for

    if radius is None:
        radius = _SHARE_OF_DEPTH * float(np.median(points[:, 2])) if len(points) else 1.0
    if not radius > 0:
        raise InvalidInput(f"the radius around a point must be positive, found {radius:g} m")
    if not len(points):
        return np.zeros(0, bool)
    # The nearest of all is the point itself.
    distance, _ = cKDTree(points).query(points, k=[NEIGHBOURS + 1], distance_upper_bound=radius)
    return np.asarray(np.isfinite(np.ravel(distance)))
