"""What the rectified images of a pair show: their windows in the plane of the projection, focal length and size.

Places in the plane: along and across the baseline, at focal length 1.
"""

from typing import NamedTuple

import numpy as np

from camcal.arrays import Array, BoolArray
from camcal.cameras.validity import pixel_angles
from camcal.dataclass import dataclass, replace
from camcal.errors import InsufficientData
from camcal.images.options import LONGEST_SIDE
from camcal.stereo.options import RectifiedViewOptions
from camcal.stereo.rectify.field import CELLS, CommonField, Directions, Interval, Viewer, extent
from camcal.stereo.rectify.record import CYLINDRICAL, LATLON, PINHOLE

FARTHEST = {PINHOLE: np.radians(70), CYLINDRICAL: np.radians(80), LATLON: np.radians(82)}  # off either plane
_LARGEST = 2.0  # times the pixels of the larger camera
_TOGETHER = 1.15  # times the wider image, that one window for both may take
_NEAR = 2.5  # cells, from which an end found on the grid is the exact one of the outline
_SHARES = 400  # cells that tell the resolution of a camera
_NEARNESS = (0.0, 0.01, 0.1, 1 / 3)  # baseline by distance of the points that tell what is kept
_NEARER = (0.47, 0.57, 2 / 3, 0.77, 0.87)  # times that of the nearest points: around where toed-in axes meet, at 2/3
_CHECKED = 160  # places a side that tell where both images are valid


class Place(NamedTuple):
    """Places in the plane, along and across the baseline."""

    along: Array
    across: Array


def to_plane(projection: str, where: Directions) -> Place:
    """Return where directions stand in the plane of a projection."""
    if projection == PINHOLE:
        return Place(np.tan(where.off) / np.cos(where.about), np.tan(where.about))
    return Place(np.tan(where.off) if projection == CYLINDRICAL else where.off, where.about)


def from_plane(projection: str, place: Place) -> Directions:
    """Return the directions that stand at places in the plane of a projection."""
    if projection == PINHOLE:
        about = np.arctan(place.across)
        return Directions(np.arctan(place.along * np.cos(about)), about)
    return Directions(np.arctan(place.along) if projection == CYLINDRICAL else place.along, place.across)


def density(projection: str, where: Directions) -> Array:
    """Return pixels per radian (root of those per solid angle) at focal length 1."""
    if projection == PINHOLE:
        return np.asarray((np.cos(where.off) * np.cos(where.about)) ** -1.5)
    return np.asarray(np.cos(where.off) ** (-1.5 if projection == CYLINDRICAL else -0.5))


@dataclass(frozen=True, eq=False)
class Window:
    """The windows of both images in the plane, left first, of one size, and what they leave out of the common field."""

    projection: str
    along: int
    columns: tuple[Interval, Interval]
    rows: Interval
    focal: float = 1.0
    size: tuple[int, int] = (1, 1)
    kept: float = 1.0
    reason: str = ""

    @property
    def centres(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The centres (cx, cy) of both images, px."""
        length, breadth = (self.size[axis] for axis in (self.along, 1 - self.along))
        across = (breadth - 1) / 2 - self.focal * self.rows.middle
        found = [((length - 1) / 2 - self.focal * each.middle, across) for each in self.columns]
        first, second = (each[::-1] if self.along else each for each in found)
        return first, second


class Region(NamedTuple):
    """The angles that are to be shown: φ of both images, λ of each."""

    about: Interval
    off: tuple[Interval, Interval]

    def within(self, farthest: float, projection: str) -> "Region":
        """Return the part that a projection is used for."""
        limit = Interval(-farthest, farthest)
        about = self.about.within(limit) if projection == PINHOLE else self.about
        return Region(about, (self.off[0].within(limit), self.off[1].within(limit)))

    def masks(self, field: CommonField) -> tuple[BoolArray, BoolArray]:
        """Return the masks (R, C) of useful cells inside."""
        first, second = (
            each.mask & self.about.holds(each.about)[:, None] & off.holds(each.off)
            for each, off in zip((field.left, field.right), self.off, strict=True)
        )
        return first, second


def window_of(
    viewers: tuple[Viewer, Viewer],
    field: CommonField,
    region: Region,
    projection: str,
    options: RectifiedViewOptions,
) -> Window:
    """Return the windows for a projection: around what is useful in the region, or as the options say."""
    shown = region.within(FARTHEST[projection], projection)
    if options.fov_deg is None:
        rows = _rows(viewers, field, shown, projection)
        columns = [_columns(viewers[side], field, shown, projection, side) for side in (0, 1)]
    else:
        edges = [Directions(np.array(off), np.zeros(2)) for off in shown.off]
        columns = [Interval(*to_plane(projection, edge).along) for edge in edges]
        rows = Interval(*to_plane(projection, Directions(np.zeros(2), np.array(shown.about))).across)
    left, right = _of_one_width(*columns, together=options.zero_disparity)
    window = Window(projection, viewers[0].along, (left, right), rows)
    if options.alpha < 1:
        window = _crop(window, viewers, options.alpha)
    window = _size(window, _native_focal(viewers, field, shown, projection), viewers, options)
    return _judge(window, viewers, field, options)


def _rows(viewers: tuple[Viewer, Viewer], field: CommonField, shown: Region, projection: str) -> Interval:
    """Return the rows in the plane, their ends exact where the outline of a camera makes them."""
    outlines = [viewer.outline().about for viewer in viewers]
    ends = Interval(max(each.min() for each in outlines), min(each.max() for each in outlines))
    exact = _snap(shown.about, ends, _NEAR * float(field.left.about[1] - field.left.about[0]))
    return Interval(*to_plane(projection, Directions(np.zeros(2), np.array(exact))).across)


def _columns(viewer: Viewer, field: CommonField, shown: Region, projection: str, side: int) -> Interval:
    """Return the columns in the plane of one image around what is useful, exact where an outline ends it."""
    useful = (field.left, field.right)[side]
    mask = shown.masks(field)[side]
    places, weights = to_plane(projection, useful.cells()).along[mask], useful.weights[mask]
    counts, edges = np.histogram(places, CELLS, weights=weights)
    found = extent(counts, (edges[1:] + edges[:-1]) / 2)
    outline = viewer.outline()
    inside = shown.about.holds(outline.about) & shown.off[side].holds(outline.off)
    if not inside.any():
        return found
    around = to_plane(projection, Directions(outline.off[inside], outline.about[inside])).along
    return _snap(found, Interval(around.min(), around.max()), _NEAR * (edges[1] - edges[0]))


def _snap(found: Interval, exact: Interval, near: float) -> Interval:
    low, high = (there if abs(here - there) < near else here for here, there in zip(found, exact, strict=True))
    return Interval(float(low), float(high))


def _of_one_width(left: Interval, right: Interval, *, together: bool) -> tuple[Interval, Interval]:
    """Return intervals of the same width around two: one for both, where that costs little or is asked for."""
    both = Interval(min(left.low, right.low), max(left.high, right.high))
    width = max(left.width, right.width)
    if together or both.width <= _TOGETHER * width:
        return both, both
    first, second = (Interval(each.middle - width / 2, each.middle + width / 2) for each in (left, right))
    return first, second


def _native_focal(viewers: tuple[Viewer, Viewer], field: CommonField, shown: Region, projection: str) -> float:
    """Return the focal length (px) at which the finer one of the two cameras keeps its resolution."""
    found = []
    for viewer, useful, mask in zip(viewers, (field.left, field.right), shown.masks(field), strict=True):
        cells = useful.cells()
        chosen = np.flatnonzero(mask)[:: max(1, int(mask.sum()) // _SHARES)]
        where = Directions(cells.off.ravel()[chosen], cells.about.ravel()[chosen])
        angles = pixel_angles(viewer.camera, viewer.pixels(where))
        found.append(float(np.nanmedian(1 / (angles * density(projection, where)))))
    return max(found)


def _size(window: Window, native: float, viewers: tuple[Viewer, Viewer], options: RectifiedViewOptions) -> Window:
    """Return the window with its focal length and size."""
    length, breadth = window.columns[0].width, window.rows.width
    if options.size is not None:
        sides = options.size[window.along], options.size[1 - window.along]
        focal = min((sides[0] - 1) / length, (sides[1] - 1) / breadth)
        return replace(window, focal=focal, size=options.size)
    pixels = _LARGEST * max(viewer.camera.image_size[0] * viewer.camera.image_size[1] for viewer in viewers)
    focal = min(native, float(np.sqrt(pixels / (length * breadth))), (LONGEST_SIDE - 1) / max(length, breadth))
    scale = options.scale or 1.0
    sides = max(2, round(scale * (focal * length + 1))), max(2, round(scale * (focal * breadth + 1)))
    focal *= scale
    return replace(window, focal=focal, size=sides[::-1] if window.along else sides)


def _crop(window: Window, viewers: tuple[Viewer, Viewer], alpha: float) -> Window:
    """Return the window between the largest one valid in both images (alpha 0) and the given one (1)."""
    shares = (np.arange(_CHECKED) + 0.5) / _CHECKED
    across = window.rows.low + shares * window.rows.width
    valid = np.ones((_CHECKED, _CHECKED), bool)
    for viewer, columns in zip(viewers, window.columns, strict=True):
        along = columns.low + shares * columns.width
        grid = Place(*(axis.ravel() for axis in np.meshgrid(along, across)))
        valid &= np.isfinite(viewer.pixels(from_plane(window.projection, grid))[:, 0]).reshape(valid.shape)
    box = _largest_rectangle(valid)
    if box is None:
        raise InsufficientData("no part of the rectified images is valid in both: use --alpha 1")
    rows, columns = (Interval((1 - alpha) * low / _CHECKED, alpha + (1 - alpha) * high / _CHECKED) for low, high in box)

    def part(whole: Interval, share: Interval) -> Interval:
        return Interval(whole.low + share.low * whole.width, whole.low + share.high * whole.width)

    left, right = (part(each, columns) for each in window.columns)
    return replace(window, columns=(left, right), rows=part(window.rows, rows))


def _largest_rectangle(valid: BoolArray) -> tuple[tuple[int, int], tuple[int, int]] | None:
    """Return the rows and columns, from and to, of the largest rectangle of True, a cell smaller on every side."""
    best, found = 0, None
    heights = np.zeros(valid.shape[1], int)
    for bottom, row in enumerate(valid):
        heights = np.where(row, heights + 1, 0)
        for height in np.unique(heights[heights > 2]):
            tall = np.flatnonzero(np.diff(np.concatenate([[0], heights >= height, [0]])))
            widths = tall[1::2] - tall[::2]
            widest = int(np.argmax(widths))
            if widths[widest] > 2 and height * widths[widest] > best:
                best, start = int(height * widths[widest]), int(tall[2 * widest])
                top = bottom - int(height) + 1
                found = (top + 1, bottom), (start + 1, start + int(widths[widest]) - 1)
    return found


def _judge(window: Window, viewers: tuple[Viewer, Viewer], field: CommonField, options: RectifiedViewOptions) -> Window:
    """Return the window with the share of the common field that it keeps, and why it is not all of it.

    Points along rays of all of an image are counted at several distances, if both cameras see them, whether the window
    was made for them or not. The image that keeps less counts.
    """
    found = []
    for side, sign in ((0, -1), (1, 1)):
        here, weights = viewers[side].spread()
        in_here, far_here = _held(window, side, here), _is_far(window.projection, here)
        common = kept = far = 0.0
        for parallax in (*(share / np.cos(here.off) for share in _NEARNESS), *(field.near * np.array(_NEARER))):
            there = Directions(np.arctan(np.tan(here.off) + sign * parallax), here.about)
            seen = np.isfinite(viewers[1 - side].pixels(there)[:, 0])
            common += float(weights[seen].sum())
            kept += float(weights[seen & in_here & _held(window, 1 - side, there)].sum())
            far += float(weights[seen & (far_here | _is_far(window.projection, there))].sum())
        found.append((kept / common, far / common) if common else (0.0, 0.0))
    share, far = min(found)
    return replace(window, kept=share, reason=_reason(window.projection, 1 - share, far, options))


def _held(window: Window, side: int, where: Directions) -> BoolArray:
    """Return the mask (N,) of directions (N,) that lie in the left (0) or right (1) image."""
    held = ~_is_far(window.projection, where)
    with np.errstate(all="ignore"):
        place = to_plane(window.projection, where)
        for values, axis in zip(place, (window.along, 1 - window.along), strict=True):
            pixels = window.focal * values + window.centres[side][axis]
            held &= (pixels >= -0.5) & (pixels <= window.size[axis] - 0.5)
    return held


def _is_far(projection: str, where: Directions) -> BoolArray:
    """Return the mask (N,) of directions (N,) farther from the middle than a projection is used."""
    far = np.abs(where.off) > FARTHEST[projection]
    return np.asarray(far | (np.abs(where.about) > FARTHEST[projection]) if projection == PINHOLE else far)


def _reason(projection: str, lost: float, far: float, options: RectifiedViewOptions) -> str:
    limit = np.degrees(FARTHEST[projection])
    if far > lost / 2:
        return f"a {projection} image holds up to {limit:.0f}° off the plane across the baseline"
    if options.fov_deg is not None:
        return "--fov {:g}x{:g} holds no more".format(*options.fov_deg)
    if options.alpha < 1:
        return f"--alpha {options.alpha:g} crops the images"
    return "parts that only a few rows or columns would hold are left out"
