"""Half-size planes of a Bayer mosaic, laid out for fast access to adjacent samples.

Every plane of a tile is one contiguous row of numbers with room on both ends: the plane seen one pixel to the right, or
one row further down, is a slice of it. NumPy and OpenCV work on such slices several times faster than on shifted 2-D
views. What runs over the end of a row lands in the halo of the tile, which is cut off in the end.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from camcal.arrays import Array

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

    def slope(self, of: Plane, on: Plane, taps: Array, learning: "Learning", times: float = 1.0) -> Plane:
        """Return the slope of the regression of a plane on another in windows, times a factor.

        What is regressed is a difference and has no mean of its own. The slope is found at half the plane's size and
        interpolated.
        """
        result, power = self.take(), self.take()
        np.multiply(of[HERE], on[HERE], out=result[HERE])
        np.multiply(on[HERE], on[HERE], out=power[HERE])
        slopes = self.mean(result, taps, learning.expected * learning.flat)
        powers = self.mean(power, taps, learning.flat)
        np.divide(slopes, powers, out=slopes)
        np.clip(slopes, -learning.steepest, learning.steepest, out=slopes)
        if learning.noise:
            np.divide(np.float32(-learning.noise), powers, out=powers)
            np.add(powers, np.float32(1), out=powers)
            np.maximum(powers, 0, out=powers)
            np.multiply(slopes, powers, out=slopes)
        if times != 1:
            slopes *= np.float32(times)
        self.forget(powers)
        self.give_back(power)
        self.spread(slopes, result)
        return result


@dataclass(frozen=True)
class Learning:
    """How the slope of one plane on another is learnt from a window.

    flat: mean square of the other plane below which the slope tends to `expected`. steepest: largest magnitude of the
    slope. noise: mean square of the other plane that is noise; the slope is multiplied by the share that is not
    (Wiener's gain).
    """

    flat: float
    steepest: float
    expected: float = 1.0
    noise: float = 0.0


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
