"""A Bayer mosaic as tiles for filters that work on half-size planes, and the colour image they leave.

Filters compare neighbours on a scale of 0 … 255; here is the way there from counts, and back.
"""

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple, Protocol

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.raw.mosaic import sites
from camcal.raw.planes import HERE, Each, Plane, Tile, interleave

TILE = (256, 256)  # cells; the fewer, the more of the work is margin; the more, the less stays in the cache
PLACES = "RGGB"  # the four places of a cell, as tiles count cells
WHITE = 255.0  # of green on the scale of the filters

_BAND = 32  # rows of cells
_TOE = np.float32(0.002)  # share of the white level below which the root turns linear: noise falls below 0
_ROOT_SCALE = float(WHITE / (np.sqrt(1 + _TOE) - np.sqrt(_TOE)))
_SAMPLED_ROWS = 256
_STRONGEST_BALANCE = 16.0


class Scale(Protocol):
    """How counts of a colour ("R", "G" or "B") become the filters' numbers, and back.

    `undo` leaves numbers, in place, that are counts after a multiplication with `factor`.
    """

    @property
    def white(self) -> float: ...
    def apply(self, values: Array, colour: str) -> None: ...
    def undo(self, plane: Plane, scratch: Plane) -> None: ...
    def factor(self, colour: str) -> float: ...


@dataclass(frozen=True)
class Proportional:
    """Numbers proportional to the counts: gamma-encoded images have the scale that filters were made for."""

    white: float

    def apply(self, values: Array, colour: str) -> None:  # noqa: ARG002
        values *= np.float32(WHITE / self.white)

    def undo(self, plane: Plane, scratch: Plane) -> None:
        pass

    def factor(self, colour: str) -> float:  # noqa: ARG002
        return self.white / WHITE


@dataclass(frozen=True)
class Counts:
    """The counts themselves, for linear filters."""

    white: float

    def apply(self, values: Array, colour: str) -> None:
        pass

    def undo(self, plane: Plane, scratch: Plane) -> None:
        pass

    def factor(self, colour: str) -> float:  # noqa: ARG002
        return 1.0


@dataclass(frozen=True)
class Root:
    """Square roots of linear light, the detail of the three colours made equally strong.

    There photon noise has the same strength everywhere, and what demosaicing assumes, that colours vary together and
    differ smoothly, is much more nearly true than in linear light. Every sample comes back as it was.
    """

    white: float
    gains: dict[str, float]

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


def scale_of(values: Array, pattern: str, white: float, *, linear: bool) -> Scale:
    """Return the scale for a Bayer mosaic (H, W) of counts, linear in light or gamma-encoded."""
    return Root(white, _detail_balance(values, pattern)) if linear else Proportional(white)


def _detail_balance(values: Array, pattern: str) -> dict[str, float]:
    """Return gains that make the detail of red and blue as strong as that of green.

    Detail is the mean second difference along rows, of some hundred rows.
    """
    strength = {colour: float(np.mean([_detail(values[site]) for site in sites(pattern, colour)])) for colour in "RGB"}
    if min(strength.values()) <= 0:
        return dict.fromkeys("RGB", 1.0)
    gains = {colour: strength["G"] / strength[colour] for colour in "RGB"}
    return {colour: float(np.clip(gain, 1 / _STRONGEST_BALANCE, _STRONGEST_BALANCE)) for colour, gain in gains.items()}


def _detail(samples: Array) -> float:
    rows = samples[:: max(1, len(samples) // _SAMPLED_ROWS)].astype(np.float32)
    curves = np.abs(rows[:, :-2] - 2 * rows[:, 1:-1] + rows[:, 2:])
    return float(curves.mean()) if curves.size else 0.0


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
        self._source = self._mirrored(values)
        self._numbers = np.empty((4, len(self._source) // 2, self._source.shape[1] // 2), np.float32)
        self._colour = np.empty((2 * self.cells.rows, 2 * self.cells.columns, 3), values.dtype)
        self._spare: deque[Tile] = deque()

    def _mirrored(self, values: Array) -> Array:
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
    rows, columns = (_starts(length, limit) for length, limit in zip(whole[2:], most, strict=True))
    return [
        Box(top, left, bottom - top, right - left)
        for top, bottom in pairwise(rows)
        for left, right in pairwise(columns)
    ]


def _starts(length: int, most: int) -> list[int]:
    count = -(-length // most)
    return [2 * round(length / 2 * index / count) for index in range(count + 1)]
