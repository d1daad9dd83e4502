"""Planes for smooth areas with few matches: walls, tables, boards without texture.

Such an area is matched only along its border and where something is printed on it. Where what is matched of it lies on
one plane, the plane tells the rest. Else a large area is taken for the background, and for the farthest plane that goes
on from what lies beside it: what stands in front of it may hide a part of its border, but nothing lies behind it.
"""

from collections.abc import Iterator
from typing import NamedTuple

import cv2
import numpy as np
from scipy import ndimage

from camcal.arrays import Array
from camcal.opencv import remap
from camcal.stereo.disparity import Confidence
from camcal.stereo.matching.matchers import Fused
from camcal.stereo.matching.preparation import GrayPair

_LARGEST = 500_000  # pixels; larger images are examined in steps, and lengths below are in steps then
_BLUR = 1.5  # pixels
_EDGE, _EDGE_NOISES = 1.2, 0.3  # gray levels per pixel, and times the noise, from which there is an edge
_SMALLEST, _BORDER = 500, 6  # pixels of an area, and pixels around it that belong to it
_GAP, _GAP_SHARE, _GAP_MOST = 50, 0.03, 1.5  # pixels without a match inside; share inside; of the area, with its border
_FEWEST, _FEWEST_CELLS = 40, 3  # pixels with a match, and cells with some
_CELLS, _PER_CELL = 12, 8  # along each side of an area's box, all of one weight; pixels taken from each
_REFITS, _FINALISTS, _SAMPLES, _TRIED_ON = 3, 1000, 400, 200
_NEAR = 1.0  # pixels between a plane and what lies on it
_APART, _WIDE = 100, 200  # squared pixels between two points of a plane, and twice the area between three, at least
_STEEPEST, _ERROR = 1.0, 0.5  # pixels per pixel; pixels of error of a match
_TYPICAL, _FARTHEST = 0.6, 0.01  # slope of a surface over disparity per width of the image, and the least of the latter
_UPRIGHT = 3.0  # how much more of it from top to bottom counts as steep: walls stand
_AROUND, _AROUND_SHARE, _OUTSIDE = 2.0, 0.1, 0.5  # pixels and share of its range beside the support; what it costs
_MARGIN, _MARGIN_SHARE, _TAIL = 2.0, 0.25, 2  # pixels and share by which a plane goes on; percent that says nothing
_BACKDROP, _FLOOR_SHARE = 0.1, 0.03  # shares of the image: of a background, and of a floor
_GROUND = 0.04  # share of the image: of gaps at its lower edge that stay as they are
_MIN_GAP_SHARE = 0.5  # of a background that are gaps, at least: where more is matched, that tells
_SPREAD, _LOWER = 0.4, 0.1  # shares of an area's side, and of its height
_MISFIT, _MOST_MISFIT, _COMPARED = 0.5, 20.0, 30  # gray levels worse than the filling; clipped; pixels compared


class _Rule(NamedTuple):
    """When a plane holds: the least share of the support on it, and the most of it behind it.

    cost: of the share behind. steep: of the support, what steepness costs. trials: planes of each kind that are tried.
    """

    on: float
    behind: float
    cost: float
    steep: float
    trials: int


_SMALL = _Rule(on=0.85, behind=0.15, cost=1.0, steep=0.04, trials=400)
_LARGE = _Rule(on=0.75, behind=0.15, cost=1.0, steep=0.04, trials=400)
_BACKGROUND = _Rule(on=0.1, behind=0.1, cost=3.0, steep=0.04, trials=4000)
_FLOOR = _Rule(on=0.2, behind=0.1, cost=3.0, steep=0.0, trials=4000)


class _View(NamedTuple):
    """What is examined, every `step`-th pixel: arrays (h, w); disparities in steps, NaN where there is none.

    nearest: (h, w) the largest disparity that is accepted at each pixel of the right image.
    """

    left: Array
    right: Array
    disparity: Array
    filled: Array
    nearest: Array
    step: int


class _Support(NamedTuple):
    """Matched pixels of an area: places (N, 2) x, y; their disparities (N,)."""

    places: Array
    disparities: Array


class _Area(NamedTuple):
    """A smooth area: its box, and in it which pixels are inside and which are the area with its border."""

    box: tuple[slice, slice]
    inside: Array
    whole: Array

    def pixels(self, chosen: Array) -> Array:
        """Return x and y (N, 2) in the image of chosen pixels of the box."""
        y, x = np.nonzero(chosen)
        return np.column_stack([x + self.box[1].start, y + self.box[0].start])


class _Plane(NamedTuple):
    """Disparity a x + b y + c, at least and at most; all in steps. floor: whether it is one."""

    coefficients: Array
    least: float
    most: float
    floor: bool = False

    def at(self, x: Array, y: Array) -> Array:
        across, down, offset = self.coefficients
        return np.asarray(np.clip(across * x + down * y + offset, self.least, self.most))


def on_planes(found: Fused, dense: Array, pair: GrayPair) -> Array:
    """Return a dense map (H, W), pixels, with planes in the gaps of areas that they explain; matches stay as they are.

    found: what is matched. dense: (H, W) the same with its gaps filled.
    """
    gap = np.isnan(found.disparity)
    if gap.all() or not gap.any():
        return dense
    view = _seen_in_steps(found, dense, pair)
    rng = np.random.default_rng(0)
    before = _misfit(view, view.filled)
    disparity = dense.copy()
    for area in _areas(view.left, pair.noise):
        plane = _plane_of(area, view, rng)
        if plane is not None:
            _put(plane, area, _taken(plane, area, view, before), gap, disparity, view.step)
    return disparity


def _seen_in_steps(found: Fused, dense: Array, pair: GrayPair) -> _View:
    step = int(np.ceil(np.sqrt(pair.left.size / _LARGEST)))
    every = slice(None, None, step)
    disparity, filled = (values[every, every] / step for values in (found.disparity, dense))
    size = disparity.shape[::-1]
    left, right = (
        image if step == 1 else np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
        for image in (pair.left, pair.right)
    )
    believed = np.where(found.confidence[every, every] > Confidence.SINGLE, disparity, np.nan)
    return _View(left, right, disparity, filled.astype(np.float32), _nearest(believed), step)


def _nearest(disparity: Array) -> Array:
    """Return the largest of the disparities (h, w) at each pixel of the right image (h, w), NaN where there is none."""
    rows, columns = np.nonzero(np.isfinite(disparity))
    values = disparity[rows, columns]
    there = np.rint(columns - values).astype(int)
    inside = (there >= 0) & (there < disparity.shape[1])
    nearest = np.full(disparity.shape, -np.inf, np.float32)
    np.maximum.at(nearest, (rows[inside], there[inside]), values[inside])
    nearest[np.isneginf(nearest)] = np.nan
    return nearest


def _areas(gray: Array, noise: float) -> Iterator[_Area]:
    """Yield the smooth areas of an image (h, w) uint8: within edges, and each with a border across them."""
    blurred = cv2.GaussianBlur(gray.astype(np.float32), (0, 0), _BLUR)
    slopes = (cv2.Sobel(blurred, cv2.CV_32F, *axes, ksize=3, scale=1 / 8) for axes in ((1, 0), (0, 1)))
    smooth = np.hypot(*slopes) < _EDGE + _EDGE_NOISES * noise
    inner = cv2.erode(smooth.astype(np.uint8), np.ones((3, 3), np.uint8))
    _, labels, facts, _ = cv2.connectedComponentsWithStats(inner, connectivity=4)
    large = facts[:, cv2.CC_STAT_AREA] >= _SMALLEST
    large[0] = False
    inside = (np.cumsum(large) * large)[labels]
    if not large.any():
        return
    away, places = cv2.distanceTransformWithLabels(
        (inside == 0).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    numbers = np.zeros(places.max() + 1, int)
    numbers[places[inside > 0]] = inside[inside > 0]
    whole = np.where(away <= _BORDER, numbers[places], 0)
    for number, (rows, columns) in enumerate(ndimage.find_objects(whole), 1):
        box = rows, columns
        yield _Area(box, inside[box] == number, whole[box] == number)


def _plane_of(area: _Area, view: _View, rng: np.random.Generator) -> _Plane | None:
    """Return the plane of an area, None if nothing of it is to be filled or nothing tells."""
    gap = np.isnan(view.disparity[area.box])
    inner, all_of_it = np.count_nonzero(gap & area.inside), np.count_nonzero(gap & area.whole)
    size = np.count_nonzero(area.inside)
    if inner < max(_GAP, _GAP_SHARE * size) or all_of_it > _GAP_MOST * size:
        return None
    gaps = rng.permutation(area.pixels(gap & area.whole))[:_SAMPLES]
    support = _support(area, area.whole & ~gap, view, rng)
    large = size >= _BACKDROP * view.left.size
    plane = None if support is None else _fitted(support, gaps, view, _LARGE if large else _SMALL, rng)
    low = _reaches_down(area, view) and size >= _FLOOR_SHARE * view.left.size
    if plane is not None or not (large or low) or inner < _MIN_GAP_SHARE * size:
        return None if plane is None else plane[0]
    support = _support(area, area.whole & ~area.inside & ~gap, view, rng)
    if support is None:
        return None
    support = _moved_in(support, area)
    plane = _fitted(support, gaps, view, _FLOOR, rng) if low else None
    if plane is not None and _is_floor(area, *plane):
        return plane[0]._replace(most=np.inf, floor=True)
    plane = _fitted(support, gaps, view, _BACKGROUND, rng) if large else None
    return None if plane is None or _is_open(area, plane[1], view) else plane[0]


def _support(area: _Area, chosen: Array, view: _View, rng: np.random.Generator) -> _Support | None:
    """Return chosen pixels of an area, at most so many from each cell of a grid over it, None if they are too few."""
    pixels = rng.permutation(area.pixels(chosen))
    if len(pixels) < _FEWEST:
        return None
    height, width = chosen.shape
    x, y = (pixels - [area.box[1].start, area.box[0].start]).T
    cells = (y * _CELLS // height) * _CELLS + x * _CELLS // width
    order = np.argsort(cells, kind="stable")
    pixels, cells = pixels[order], cells[order]
    counts = np.bincount(cells)
    kept = np.arange(len(cells)) - (np.cumsum(counts) - counts)[cells] < _PER_CELL
    pixels, cells = pixels[kept], cells[kept]
    if np.count_nonzero(counts) < _FEWEST_CELLS:
        return None
    return _Support(pixels.astype(float), view.disparity[pixels[:, 1], pixels[:, 0]].astype(float))


def _moved_in(support: _Support, area: _Area) -> _Support:
    """Return support from beside an area at the nearest places inside: of what is beside it, only its edge is known."""
    corner = [area.box[1].start, area.box[0].start]
    x, y = (support.places.astype(int) - corner).T
    outside = (~area.inside).astype(np.uint8)
    _, nearest = cv2.distanceTransformWithLabels(outside, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    edge = np.zeros((nearest.max() + 1, 2))
    edge[nearest[area.inside]] = area.pixels(area.inside)
    return support._replace(places=edge[nearest[y, x]])


def _fitted(
    support: _Support, gaps: Array, view: _View, rule: _Rule, rng: np.random.Generator
) -> tuple[_Plane, Array] | None:
    """Return the plane that most of the support lies on and the least behind, and what lies on it (M, 2); or None."""
    planes = _candidates(support, rule.trials, rng)
    planes = planes[np.argsort(-_score(planes, _some(support, rng), rule, gaps, view))[:_FINALISTS]]
    hidden = _in_front(planes, gaps, view) + _OUTSIDE * _beyond(planes, gaps, support.disparities)
    best = planes[[np.argmax(_score(planes, support, rule, gaps, view) - hidden)]]
    plane = _refitted(best[0], support, _typical_slopes(best, gaps, view)[0])
    places, disparities = _homogeneous(support.places), support.disparities
    off = places @ plane - disparities
    on = np.abs(off) < _NEAR
    if on.mean() < rule.on or (off > _NEAR).mean() > rule.behind:
        return None
    low, high = np.percentile(disparities[on], (_TAIL, 100 - _TAIL))
    margin = _MARGIN + _MARGIN_SHARE * (high - low)
    return _Plane(plane, low - margin, high + margin), support.places[on]


def _some(support: _Support, rng: np.random.Generator) -> _Support:
    """Return as much of a support as many planes are tried on."""
    chosen = rng.permutation(len(support.places))[:_TRIED_ON]
    return _Support(support.places[chosen], support.disparities[chosen])


def _score(planes: Array, support: _Support, rule: _Rule, gaps: Array, view: _View) -> Array:
    """Return how well planes (K, 3) explain a support (K,): what lies on them, and that they are not steep."""
    off = planes @ _homogeneous(support.places).T - support.disparities
    score: Array = (np.abs(off) < _NEAR).mean(axis=1) - rule.cost * (off > _NEAR).mean(axis=1)
    steep = np.hypot(planes[:, 0], _UPRIGHT * planes[:, 1]) / _typical_slopes(planes, gaps, view)
    return np.asarray(score - rule.steep * np.log1p(steep**2))


def _typical_slopes(planes: Array, gaps: Array, view: _View) -> Array:
    """Return slopes (K,), pixels per pixel, that surfaces have at the disparities of planes (K, 3) amid the gaps.

    Of surfaces of one tilt, the slope grows with the disparity, and falls with the focal length.
    """
    disparity = planes @ np.array([*gaps.mean(axis=0), 1.0])
    return np.asarray(_TYPICAL * np.maximum(disparity / view.left.shape[1], _FARTHEST))


def _candidates(support: _Support, trials: int, rng: np.random.Generator) -> Array:
    """Return planes (K, 3) through one, two and three points; what a point or two leave open has no slope."""
    places, disparities = support.places, support.disparities
    one, first, second, *three = rng.integers(len(places), size=(6, trials))
    level = np.column_stack([np.zeros((trials, 2)), disparities[one]])
    along = places[second] - places[first]
    squared = (along**2).sum(axis=1)
    slopes = ((disparities[second] - disparities[first]) / np.maximum(squared, 1))[:, None] * along
    tilted = np.column_stack([slopes, disparities[first] - (slopes * places[first]).sum(axis=1)])[squared > _APART]
    corners = np.stack(three, axis=1)
    triples = _homogeneous(places[corners])
    wide = np.abs(np.linalg.det(triples)) > _WIDE
    full = np.linalg.solve(triples[wide], disparities[corners[wide]][..., None])[..., 0]
    planes: Array = np.concatenate([level, tilted, full])
    return planes[(np.abs(planes[:, :2]) < _STEEPEST).all(axis=1)]


def _in_front(planes: Array, gaps: Array, view: _View) -> Array:
    """Return the share of the gaps (M, 2) where planes (K, 3) would hide what the right image shows (K,)."""
    disparity = planes @ _homogeneous(gaps).T
    there = np.rint(gaps[:, 0] - disparity).astype(int)
    inside = (there >= 0) & (there < view.left.shape[1])
    shown = view.nearest[gaps[:, 1], np.where(inside, there, 0)]
    return np.asarray((inside & (shown < disparity - _NEAR)).mean(axis=1))


def _beyond(planes: Array, gaps: Array, disparities: Array) -> Array:
    """Return the share of the gaps (M, 2) where planes (K, 3) leave the range of the support (K,)."""
    low, high = np.percentile(disparities, (_TAIL, 100 - _TAIL))
    margin = _AROUND + _AROUND_SHARE * (high - low)
    values = planes @ _homogeneous(gaps).T
    return np.asarray(((values < low - margin) | (values > high + margin)).mean(axis=1))


def _refitted(plane: Array, support: _Support, typical: float) -> Array:
    """Return a plane (3,) fitted to what lies on it; slopes that the support leaves open are small beside typical."""
    middle = support.places.mean(axis=0)
    places = _homogeneous(support.places - middle)
    plane = np.array([*plane[:2], plane[2] + plane[:2] @ middle])
    prior = np.diag([(_ERROR / typical) ** 2] * 2 + [0.0])
    for _ in range(_REFITS):
        on = np.abs(places @ plane - support.disparities) < _NEAR
        if not on.any():
            break
        weighted = places[on] / _PER_CELL  # neighbours tell the same
        plane = np.linalg.solve(weighted.T @ places[on] + prior, weighted.T @ support.disparities[on])
    return np.array([*plane[:2], plane[2] - plane[:2] @ middle])


def _reaches_down(area: _Area, view: _View) -> bool:
    return bool(area.box[0].stop >= len(view.left) - 3)


def _is_floor(area: _Area, plane: _Plane, on: Array) -> bool:
    """Return whether a plane with a part of an area's border on it (M, 2) is a floor: its horizon is in the image.

    Chance makes no plane that steep of so much.
    """
    x = area.pixels(area.inside)[:, 0].mean()
    across, down, offset = plane.coefficients
    return bool(across * x + offset < 0 < down and _spread(area, on)[0] > _SPREAD)


def _is_open(area: _Area, on: Array, view: _View) -> bool:
    """Return whether too little of an area's border (M, 2) lies on its plane, or only the far edge of the ground.

    How steeply a floor comes nearer below its edge, the edge does not tell.
    """
    rows = np.nonzero(area.inside)[0] + area.box[0].start
    above = np.median(on[:, 1]) < rows.mean() - _LOWER * np.ptp(rows)
    return bool(max(_spread(area, on)) < _SPREAD or (above and _reaches_down(area, view)))


def _spread(area: _Area, on: Array) -> tuple[float, float]:
    """Return which shares of an area's width and height places (M, 2) span."""
    height, width = area.inside.shape
    return float(np.ptp(on[:, 0]) / width), float(np.ptp(on[:, 1]) / height)


def _taken(plane: _Plane, area: _Area, view: _View, before: Array) -> Array:
    """Return which pixels of an area's box take its plane.

    before: (h, w) by how much the images differ with the filling as it was.
    """
    rows = view.left[area.box[0]].shape[0]
    y, x = np.indices(area.whole.shape)
    surface = plane.at(x + area.box[1].start, y + area.box[0].start)
    there = np.rint(x + area.box[1].start - surface).astype(int)
    inside = (there >= 0) & (there < view.left.shape[1])
    shown = view.nearest[area.box[0]][np.arange(rows)[:, None], np.where(inside, there, 0)]
    gap = area.whole & np.isnan(view.disparity[area.box])
    taken = gap & ~(inside & (shown < surface - _NEAR))
    mixed = view.filled[area.box[0]].copy()
    mixed[:, area.box[1]][taken] = surface[taken]
    strip = view._replace(left=view.left[area.box[0]], right=view.right[area.box[0]])
    worse = _misfit(strip, mixed)[:, area.box[1]] - before[area.box]
    compared = taken & inside & ~(shown > surface + _NEAR)
    count, patches = cv2.connectedComponents(taken.astype(np.uint8), connectivity=8)
    pixels = np.bincount(patches[compared], minlength=count)
    mean = np.bincount(patches[compared], weights=worse[compared], minlength=count) / np.maximum(pixels, 1)
    refused = (mean > _MISFIT) & (pixels > _COMPARED)
    if (
        area.box[0].stop == len(view.left) and not plane.floor
    ):  # how steeply ground comes nearer, nothing beside it tells
        refused[patches[-1]] |= np.bincount(patches.ravel())[patches[-1]] > _GROUND * view.left.size
    return np.asarray(taken & ~refused[patches])


def _misfit(view: _View, disparity: Array) -> Array:
    """Return by how much the images differ (h, w), gray levels, where disparities lay them on each other."""
    place: Array = np.indices(disparity.shape, np.float32)
    drawn = remap(view.right, place[1] - disparity, place[0])
    return np.minimum(cv2.absdiff(view.left, drawn).astype(np.float32), _MOST_MISFIT)


def _put(plane: _Plane, area: _Area, taken: Array, gap: Array, disparity: Array, step: int) -> None:
    """Write the plane of an area into the gaps of what is filled, at full size."""
    rows, columns = area.box
    box = slice(step * rows.start, step * rows.stop), slice(step * columns.start, step * columns.stop)
    wide = cv2.resize(taken.view(np.uint8), None, fx=step, fy=step, interpolation=cv2.INTER_NEAREST)
    height, width = gap[box].shape
    here = gap[box] & (wide[:height, :width] > 0)
    y, x = np.nonzero(here)
    disparity[box][here] = step * plane.at(x / step + columns.start, y / step + rows.start)


def _homogeneous(places: Array) -> Array:
    """Return places (…, 2) with a 1 behind them (…, 3)."""
    return np.concatenate([places, np.ones((*places.shape[:-1], 1))], axis=-1)
