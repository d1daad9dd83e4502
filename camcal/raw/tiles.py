"""A Bayer mosaic as tiles of half-size planes for filters, and the colour image they leave.

Every plane of a tile is one contiguous row of numbers with room on both ends: the plane seen one pixel to the right, or
one row further down, is a slice of it. NumPy and OpenCV work on such slices several times faster than on shifted 2-D
views. What runs over the end of a row lands in the halo of the tile, which is cut off in the end. Filters compare
neighbours on a scale of 0 … 255; here is the way there from counts, and back.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import pairwise
from typing import Any, NamedTuple

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass, field
from camcal.raw.mosaic import sites

Each = Callable[[Callable[[Any], None], Iterable[Any]], None]

HERE = (0, 0)
_FARTHEST = 3  # rows that a shifted view may look up or down
_STEP = 32  # rows of a plane are multiples of it: no vector of numbers is cut, so that every tile rounds alike


def one_by_one(work: Callable[[Any], None], items: Iterable[Any]) -> None:
    """Do the work for each item in this thread; what a caller with more threads replaces."""
    for item in items:
        work(item)


class Plane:
    """One plane (rows, columns) of a tile, float32. plane[dy, dx] is what every pixel sees that far down and right.

    A shifted view is (1, rows * columns); where it crosses the end of a row it holds the next row's pixels.
    """

    def __init__(self, rows: int, columns: int) -> None:
        self._columns, self._count = columns, rows * columns
        self._margin = _FARTHEST * (columns + 1)
        self._flat = np.zeros((1, self._count + 2 * self._margin), np.float32)
        self._views: dict[tuple[int, int], Array] = {}
        self.image = self[HERE].reshape(rows, columns)

    def __getitem__(self, shift: tuple[int, int]) -> Array:
        view = self._views.get(shift)
        if view is None:
            start = self._margin + shift[0] * self._columns + shift[1]
            view = self._views[shift] = self._flat[:, start : start + self._count]
        return view

    def fill(self, values: Array) -> None:
        """Take values (rows, up to columns); beyond them stands zero, not what another tile left."""
        columns = values.shape[1]
        self.image[:, :columns] = values
        self.image[:, columns:] = 0


class Tile:
    """The planes that the filters work with on one tile, used again and again, the latest first: it is in the cache."""

    def __init__(self, rows: int, columns: int) -> None:
        """Make room for planes that hold a tile of at least rows x columns, both even."""
        self.rows, self.columns = rows, -(-columns // _STEP) * _STEP
        self._free: list[Plane] = []
        self._coarse: list[Array] = []

    def take(self) -> Plane:
        """Return a plane; its content is left from its last use."""
        return self._free.pop() if self._free else Plane(self.rows, self.columns)

    def give_back(self, *planes: Plane) -> None:
        self._free.extend(planes)

    def fits(self, rows: int, columns: int) -> bool:
        """Return whether planes of this size are no larger than they have to be."""
        return rows == self.rows and 0 <= self.columns - columns < _STEP

    def mean(self, plane: Plane, taps: Array, plus: float = 0.0) -> Array:
        """Return weighted means over windows at half the plane's size, plus a number; a tap covers 2 × 2 pixels."""
        shape = self.rows // 2, self.columns // 2
        result = self._coarse.pop() if self._coarse else np.zeros(shape, np.float32)
        cv2.resize(plane.image, shape[::-1], dst=result, interpolation=cv2.INTER_AREA)
        cv2.sepFilter2D(result, -1, taps, taps, result, delta=plus)
        return result

    def spread(self, means: Array, out: Plane) -> None:
        """Write means at the plane's own size, interpolated linearly, and take their memory back."""
        cv2.resize(means, (self.columns, self.rows), dst=out.image, interpolation=cv2.INTER_LINEAR)
        self._coarse.append(means)

    def forget(self, means: Array) -> None:
        """Take the memory of means back."""
        self._coarse.append(means)


def weighted(a: Array, alpha: float, b: Array, beta: float, out: Array, plus: float = 0.0) -> None:
    """Write alpha a + beta b + plus."""
    cv2.addWeighted(a, alpha, b, beta, plus, out)


def plus_scaled(a: Array, b: Array, beta: float, out: Array) -> None:
    """Write a + beta b."""
    cv2.scaleAdd(b, beta, a, out)


def add_product(a: Array, b: Array, out: Array) -> None:
    """Add a b to what is there."""
    cv2.accumulateProduct(a, b, out)


def blended(a: Array, b: Array, weight_a: Array, weight_b: Array, out: Array) -> None:
    """Write the weighted mean of a and b; the weights must be large against 1e-5, which OpenCV adds to their sum."""
    cv2.blendLinear(a, b, weight_a, weight_b, out)


def difference(a: Array, b: Array, out: Array) -> None:
    """Write |a - b|."""
    cv2.absdiff(a, b, out)


def filtered(source: Plane, taps: Array, out: Plane, plus: float = 0.0) -> None:
    """Write the plane filtered with the same taps along rows and columns."""
    cv2.sepFilter2D(source.image, -1, taps, taps, out.image, delta=plus)


def interleave(parts: list[Array], factors: list[float], highest: float, out: Array) -> None:
    """Write six parts (rows, columns), each times its factor, as the three colours of two neighbouring pixels.

    out: (rows, 2 * columns, 3); integers are rounded and begin at 0. Nothing is above `highest`.
    """
    if out.dtype == np.float32:
        parts = [np.minimum(part * np.float32(f), np.float32(highest)) for part, f in zip(parts, factors, strict=True)]
    else:
        parts = [rounded(part, factor, out.dtype) for part, factor in zip(parts, factors, strict=True)]
        if highest < np.iinfo(out.dtype).max:
            parts = [np.minimum(part, out.dtype.type(highest)) for part in parts]
    cv2.merge(parts, out.reshape(*parts[0].shape, 6))


def rounded(values: Array, factor: float, dtype: np.dtype[Any]) -> Array:
    """Return values, times a factor, as uint8 or uint16; what these cannot hold becomes the nearest they can."""
    # The fastest of OpenCV's functions that convert, round and saturate.
    return cv2.addWeighted(values, factor, values, 0, 0, dtype=cv2.CV_8U if dtype == np.uint8 else cv2.CV_16U)


TILE = (256, 256)  # cells; the fewer, the more of the work is margin; the more, the less stays in the cache
PLACES = "RGGB"  # the four places of a cell, as tiles count cells
WHITE = 255.0  # of green on the scale of the filters

_BAND = 32  # rows of cells
_TOE = np.float32(0.002)  # share of the white level below which the root turns linear: noise falls below 0
_ROOT_SCALE = float(WHITE / (np.sqrt(1 + _TOE) - np.sqrt(_TOE)))
_SAMPLED_ROWS = 256
_STRONGEST_BALANCE = 16.0


@dataclass(frozen=True)
class Scale:
    """How counts of a colour ("R", "G" or "B") become the filters' numbers, and back: proportionally.

    white: counts at saturation. highest: the number that they become; by default counts stay as they are, which linear
    filters take. Gamma-encoded images have the scale that the other filters were made for.
    """

    white: float
    highest: float | None = None

    def apply(self, values: Array, colour: str) -> None:  # noqa: ARG002
        """Make numbers of counts, in place."""
        if self.highest is not None:
            values *= np.float32(self.highest / self.white)

    def undo(self, plane: Plane, scratch: Plane) -> None:
        """Leave numbers, in place, that are counts after a multiplication with `factor`."""

    def factor(self, colour: str) -> float:  # noqa: ARG002
        return 1.0 if self.highest is None else self.white / self.highest


@dataclass(frozen=True)
class Root(Scale):
    """Square roots of linear light, the detail of the three colours made equally strong by their gains.

    There photon noise has the same strength everywhere, and what demosaicing assumes, that colours vary together and
    differ smoothly, is much more nearly true than in linear light. Every sample comes back as it was.
    """

    gains: Mapping[str, float] = field(default_factory=dict)

    def apply(self, values: Array, colour: str) -> None:
        values *= np.float32(self.gains[colour] / self.white)
        scratch = np.abs(values)
        scratch += _TOE
        np.sqrt(scratch, out=scratch)
        scratch += np.sqrt(_TOE)
        values *= np.float32(_ROOT_SCALE)
        values /= scratch  # x / (√(|x| + c) + √c) is √(x + c) - √c, for negative x with the other sign

    def undo(self, plane: Plane, scratch: Plane) -> None:
        values = plane[HERE]
        np.abs(values, out=scratch[HERE])
        np.add(scratch[HERE], np.float32(2 * np.sqrt(_TOE) * _ROOT_SCALE), out=scratch[HERE])
        np.multiply(scratch[HERE], values, out=values)

    def factor(self, colour: str) -> float:
        return self.white / self.gains[colour] / _ROOT_SCALE**2


def detail_balance(values: Array, pattern: str) -> dict[str, float]:
    """Return gains that make the detail of red and blue of a Bayer mosaic (H, W) as strong as that of green.

    Detail is the mean second difference along rows, of some hundred rows.
    """
    strength = {}
    for colour in "RGB":
        details = []
        for site in sites(pattern, colour):
            samples = values[site]
            rows = samples[:: max(1, len(samples) // _SAMPLED_ROWS)].astype(np.float32)
            curves = np.abs(rows[:, :-2] - 2 * rows[:, 1:-1] + rows[:, 2:])
            details.append(float(curves.mean()) if curves.size else 0.0)
        strength[colour] = float(np.mean(details))
    if min(strength.values()) <= 0:
        return dict.fromkeys("RGB", 1.0)
    gains = {colour: strength["G"] / strength[colour] for colour in "RGB"}
    return {colour: float(np.clip(gain, 1 / _STRONGEST_BALANCE, _STRONGEST_BALANCE)) for colour, gain in gains.items()}


class Box(NamedTuple):
    """Cells of a tile: the first row and column, and the number of both."""

    row: int
    column: int
    rows: int
    columns: int

    @property
    def slices(self) -> tuple[slice, slice]:
        return slice(self.row, self.row + self.rows), slice(self.column, self.column + self.columns)

    def widened(self, cells: int) -> "Box":
        """Return the box with more cells on every side, counted from a frame that begins as many cells earlier."""
        return self._replace(rows=self.rows + 2 * cells, columns=self.columns + 2 * cells)

    def moved(self, cells: int) -> "Box":
        """Return the box in a frame that begins some cells earlier."""
        return self._replace(row=self.row + cells, column=self.column + cells)


class Bayer(NamedTuple):
    """The samples of a tile: red, green to the right of red, green below red, blue."""

    red: Plane
    right: Plane
    below: Plane
    blue: Plane


class Missing(NamedTuple):
    """What the cells of a tile lack: each colour at the other three places."""

    green_at_red: Plane
    green_at_blue: Plane
    red_right: Plane
    red_below: Plane
    red_at_blue: Plane
    blue_right: Plane
    blue_below: Plane
    blue_at_red: Plane


class TiledMosaic:
    """A mosaic (H, W) as the filters' numbers, mirrored at its edges, and the colour image (H, W, 3) to be filled.

    cells: the frame of whole cells, beginning with red, that holds the image. margin: cells around it, even.
    """

    def __init__(self, values: Array, pattern: str, margin: int, scale: Scale) -> None:
        place = pattern.index("R")
        self._offset = place // 2, place % 2  # rows and columns that bring red to the first place
        self._shape = values.shape
        rows, columns = ((length + first + 1) // 2 for length, first in zip(values.shape, self._offset, strict=True))
        self.cells = Box(0, 0, rows + rows % 2, columns + columns % 2)
        self._margin, self._scale = margin, scale
        self._source = self._mirror(values)
        self._numbers = np.empty((4, len(self._source) // 2, self._source.shape[1] // 2), np.float32)
        self._colour = np.empty((2 * self.cells.rows, 2 * self.cells.columns, 3), values.dtype)
        self._spare: deque[Tile] = deque()

    def _mirror(self, values: Array) -> Array:
        """Return the mosaic, continued about its border pixels: that keeps the colours in their places."""
        (down, right), (height, width) = self._offset, values.shape
        margin = 2 * self._margin
        below = 2 * self.cells.rows - height - down
        beyond = 2 * self.cells.columns - width - right
        edges = margin + down, margin + below, margin + right, margin + beyond
        return cv2.copyMakeBorder(values, *edges, borderType=cv2.BORDER_REFLECT_101)

    def fill(self, each: Each) -> None:
        """Turn all counts into the filters' numbers."""
        height = self._numbers.shape[1]
        each(self._fill, (slice(start, min(start + _BAND, height)) for start in range(0, height, _BAND)))

    @property
    def green(self) -> tuple[Array, Array]:
        """Green right of red and below red (rows, columns), as the filters' numbers, of the cells within the border."""
        rows, columns = self.cells.rows, self.cells.columns
        inside = Box(1, 1, max(rows - 2, 0), max(columns - 2, 0)).moved(self._margin).slices
        return self._numbers[1][inside], self._numbers[2][inside]

    def _fill(self, rows: slice) -> None:
        # In two steps, because NumPy is slow at changing type and picking every second number at once.
        source = self._source[2 * rows.start : 2 * rows.stop].astype(np.float32, copy=False)
        for place, colour in enumerate(PLACES):
            values = self._numbers[place, rows]
            np.copyto(values, source[place // 2 :: 2, place % 2 :: 2])
            self._scale.apply(values, colour)

    @contextmanager
    def tile(self, box: Box) -> Iterator[Tile]:
        """Lend the planes for a box of cells; they are used again when they are given back."""
        try:
            tile = self._spare.pop()
        except IndexError:
            tile = Tile(box.rows, box.columns)
        if not tile.fits(box.rows, box.columns):
            tile = Tile(box.rows, box.columns)
        yield tile
        self._spare.append(tile)

    def samples(self, tile: Tile, box: Box) -> Bayer:
        """Return the samples of a box of cells, counted in the frame with its margin."""
        bayer = Bayer(*(tile.take() for _ in range(4)))
        for numbers, plane in zip(self._numbers, bayer, strict=True):
            plane.fill(numbers[box.slices])
        return bayer

    def write(self, tile: Tile, box: Box, inset: int, bayer: Bayer, missing: Missing) -> None:
        """Write the colours of a box of cells; it lies `inset` cells inside the planes, which are used up."""
        colours = {
            "B": (missing.blue_at_red, missing.blue_right, missing.blue_below, bayer.blue),
            "G": (missing.green_at_red, bayer.right, bayer.below, missing.green_at_blue),
            "R": (bayer.red, missing.red_right, missing.red_below, missing.red_at_blue),
        }
        work = tile.take()
        for planes in colours.values():
            for plane in planes:
                self._scale.undo(plane, work)
        tile.give_back(work)
        factors = [self._scale.factor(colour) for colour in colours]
        rows, columns = box._replace(row=inset, column=inset).slices
        out = self._colour[2 * box.row : 2 * (box.row + box.rows), 2 * box.column : 2 * (box.column + box.columns)]
        for row in (0, 1):
            places = 2 * row, 2 * row + 1
            parts = [planes[place].image[rows, columns] for place in places for planes in colours.values()]
            interleave(parts, 2 * factors, self._scale.white, out[row::2])

    def in_one_pass(self, find: Callable[[Tile, Bayer], Missing], each: Each, most: tuple[int, int]) -> Array:
        """Return the colours (H, W, 3) by a filter that sees no further than the margin; most: see `boxes`."""
        self.fill(each)

        def filter_box(box: Box) -> None:
            around = box.widened(self._margin)
            with self.tile(around) as tile:
                bayer = self.samples(tile, around)
                missing = find(tile, bayer)
                self.write(tile, box, self._margin, bayer, missing)
                tile.give_back(*bayer, *missing)

        each(filter_box, boxes(self.cells, most))
        return self.result()

    def result(self) -> Array:
        """Return the colours of the mosaic proper."""
        (down, right), (height, width) = self._offset, self._shape
        return self._colour[down : down + height, right : right + width]


def boxes(whole: Box, most: tuple[int, int]) -> list[Box]:
    """Return the tiles of a frame, nearly of the same size each, of at most these rows and columns; all are even."""
    counts = [-(-length // limit) for length, limit in zip(whole[2:], most, strict=True)]
    rows, columns = (
        [2 * round(length / 2 * index / count) for index in range(count + 1)]
        for length, count in zip(whole[2:], counts, strict=True)
    )
    return [
        Box(top, left, bottom - top, right - left)
        for top, bottom in pairwise(rows)
        for left, right in pairwise(columns)
    ]
