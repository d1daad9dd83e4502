"""Pictures of poses: the object's axes, where its points are and where the pose puts them, over the image."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.geometry.pose import Pose

Colour = tuple[int, int, int]

_AXES: tuple[tuple[str, Colour], ...] = (("x", (60, 60, 240)), ("y", (60, 200, 60)), ("z", (240, 120, 40)))
_POINT: Colour = (80, 220, 80)
_ARROW: Colour = (0, 220, 255)
_OUTLIER: Colour = (60, 60, 255)
_NAME: Colour = (255, 255, 255)
_EDGE: Colour = (20, 20, 20)
_AROUND = tuple((right, down) for right in (-1, 0, 1) for down in (-1, 0, 1) if right or down)
_INK, _PAPER = (30, 30, 30), 245
_LEAST_WIDTH = 900  # px; smaller images are enlarged by a whole factor, so that arrows and letters can be seen
_AXIS = 0.35  # of the object's largest extent
_STEPS = 24  # of an axis, which a lens may bend
_ARROW_SHARE = 0.02  # of the picture's width, which an arrow of the root mean square may have
_FACTORS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
_FAR = 20.0  # image widths; what is drawn farther out is not in the picture
_FINE = 4  # bits of a fraction of a pixel that OpenCV draws with
_MOST_LINES = 8


@dataclass(frozen=True, eq=False)
class Posed:
    """An object in an image: points (N, 3), pixels (N, 2), the pose and which points it follows from (N,).

    words: a line about it. name: what is written beside its origin.
    """

    camera: Camera
    camera_T_object: Pose
    points: Array
    pixels: Array
    inliers: Array
    words: str
    name: str = ""

    def projected(self) -> Array:
        """Return where the pose puts the points, pixels (N, 2), NaN outside the lens's domain."""
        return self.camera.project(self.camera_T_object.apply(self.points)).pixels

    def axis(self, index: int) -> Array:
        """Return one axis of the object's frame as a line of pixels (S, 2), NaN outside the lens's domain."""
        length = _AXIS * float(np.ptp(self.points, axis=0).max())
        line = np.outer(np.linspace(0, length, _STEPS), np.eye(3)[index])
        return self.camera.project(self.camera_T_object.apply(line)).pixels


def overlay(gray: Array, objects: Sequence[Posed]) -> Array:
    """Return a picture (H', W', 3) blue, green, red, uint8, of objects over an image (H, W) uint8, words below it.

    Green circles are where points were seen, arrows from there to where the pose puts them, enlarged by the factor that
    is said below; red crosses are points that the pose does not follow from.
    """
    factor = -(-_LEAST_WIDTH // gray.shape[1])
    large = cv2.resize(gray, None, fx=factor, fy=factor, interpolation=cv2.INTER_NEAREST)
    canvas = _Canvas(cv2.cvtColor((0.55 * large + 70).astype(np.uint8), cv2.COLOR_GRAY2BGR), factor)
    enlarged = _enlargement(objects, gray.shape[1])
    for each in objects:
        canvas.draw_axes(each)
        canvas.draw_points(each, enlarged)
    lines = [each.words for each in objects[:_MOST_LINES]]
    if len(objects) > _MOST_LINES:
        lines.append(f"... and {len(objects) - _MOST_LINES} more")
    lines.append(f"axes: x red, y green, z blue; arrows: seen to projected, x {enlarged}; red crosses: outliers")
    return np.concatenate([canvas.pixels, _caption(lines, canvas.pixels.shape[1])])


def _enlargement(objects: Sequence[Posed], width: int) -> int:
    """Return by how much residuals are enlarged: a round number that makes a typical one visible."""
    squares = np.concatenate([((each.projected() - each.pixels)[each.inliers] ** 2).sum(axis=1) for each in objects])
    rms = float(np.sqrt(np.nanmean(squares))) if np.isfinite(squares).any() else 0.0
    return max((factor for factor in _FACTORS if factor * rms <= _ARROW_SHARE * width), default=1)


@dataclass(frozen=True, eq=False)
class _Canvas:
    """A picture (H, W, 3) of an image that was enlarged by a whole factor."""

    pixels: Array
    factor: int

    @property
    def thickness(self) -> int:
        return max(1, round(float(self.pixels.shape[1]) / _LEAST_WIDTH))

    def draw_axes(self, each: Posed) -> None:
        """Draw the axes of the object's frame, z last, which often points at the viewer."""
        for index, (name, colour) in enumerate(_AXES):
            line = each.axis(index)
            for start, end in self._segments(line):
                cv2.line(self.pixels, start, end, colour, 2 * self.thickness, cv2.LINE_AA, _FINE)
            tip = self._place(line[-1])
            if tip is not None:
                self._write(name, tip, colour)
        origin = self._place(each.axis(0)[0])
        if origin is not None and each.name:
            self._write(each.name, origin, _NAME)

    def _write(self, text: str, place: tuple[int, int], colour: Colour) -> None:
        """Write beside a place, on a dark edge that sets it off from whatever is there."""
        corner = (place[0] >> _FINE) + 6, (place[1] >> _FINE) - 4
        # The edge is the same thin text moved about: bold letters of OpenCV 5 are wider and would stand beside it.
        for right, down, ink in (*((*move, _EDGE) for move in _AROUND), (0, 0, colour)):
            at = corner[0] + right, corner[1] + down
            cv2.putText(self.pixels, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.55, ink, 1, cv2.LINE_AA)

    def draw_points(self, each: Posed, enlarged: int) -> None:
        """Draw where points were seen and arrows to where they are projected."""
        radius = round(2.5 * self.thickness * (1 << _FINE))
        ends = each.pixels + enlarged * (each.projected() - each.pixels)
        for pixel, end, inlier in zip(each.pixels, ends, each.inliers, strict=True):
            start = self._place(pixel)
            if start is None:
                continue
            if not inlier:
                self._cross(start)
                continue
            cv2.circle(self.pixels, start, radius, _POINT, self.thickness, cv2.LINE_AA, _FINE)
            tip = self._place(end)
            if tip is not None:
                cv2.line(self.pixels, start, tip, _ARROW, self.thickness, cv2.LINE_AA, _FINE)

    def _cross(self, place: tuple[int, int]) -> None:
        reach = 6 * self.thickness << _FINE
        (x, y), width = place, 2 * self.thickness
        for sign in (-1, 1):
            ends = (x - reach, y - sign * reach), (x + reach, y + sign * reach)
            cv2.line(self.pixels, *ends, _OUTLIER, width, cv2.LINE_AA, _FINE)

    def _segments(self, line: Array) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
        places = [self._place(pixel) for pixel in line]
        for start, end in pairwise(places):
            if start is not None and end is not None:
                yield start, end

    def _place(self, pixel: Array) -> tuple[int, int] | None:
        """Return a pixel of the image in the picture, as OpenCV takes it; None if it is not there or far outside."""
        if not np.isfinite(pixel).all() or np.abs(pixel).max() * self.factor > _FAR * self.pixels.shape[1]:
            return None
        x, y = ((pixel + 0.5) * self.factor - 0.5) * (1 << _FINE)
        return round(x), round(y)


def _caption(lines: Sequence[str], width: int) -> Array:
    """Return a strip (H, width, 3) with lines of text; OpenCV's letters are ASCII."""
    size = width / 900 * 0.5
    step = round(40 * size)
    strip = np.full((step * len(lines) + step // 2, width, 3), _PAPER, np.uint8)
    for row, line in enumerate(lines, start=1):
        text = line.encode("ascii", "replace").decode()
        needed = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, 1)[0][0]
        fitting = size * min(1.0, (width - step) / needed)
        cv2.putText(strip, text, (step // 2, row * step), cv2.FONT_HERSHEY_SIMPLEX, fitting, _INK, 1, cv2.LINE_AA)
    return strip
