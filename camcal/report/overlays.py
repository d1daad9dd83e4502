"""Pictures of poses: the object's axes, where its points are and where the pose puts them, over the image."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.geometry.pose import Pose
from camcal.report.canvas import Canvas, Colour

_AXES: tuple[tuple[str, Colour], ...] = (("x", (60, 60, 240)), ("y", (60, 200, 60)), ("z", (240, 120, 40)))
_POINT: Colour = (80, 220, 80)
_ARROW: Colour = (0, 220, 255)
_OUTLIER: Colour = (60, 60, 255)
_NAME: Colour = (255, 255, 255)
_AXIS = 0.35  # of the object's largest extent
_STEPS = 24  # of an axis, which a lens may bend
_ARROW_SHARE = 0.02  # of the picture's width, which an arrow of the root mean square may have
_FACTORS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
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
    canvas = Canvas.of(gray)
    enlarged = _enlargement(objects, gray.shape[1])
    for each in objects:
        _draw_axes(canvas, each)
        _draw_points(canvas, each, enlarged)
    lines = [each.words for each in objects[:_MOST_LINES]]
    if len(objects) > _MOST_LINES:
        lines.append(f"... and {len(objects) - _MOST_LINES} more")
    lines.append(f"axes: x red, y green, z blue; arrows: seen to projected, x {enlarged}; red crosses: outliers")
    return canvas.captioned(lines)


def _enlargement(objects: Sequence[Posed], width: int) -> int:
    """Return by how much residuals are enlarged: a round number that makes a typical one visible."""
    squares = np.concatenate([((each.projected() - each.pixels)[each.inliers] ** 2).sum(axis=1) for each in objects])
    rms = float(np.sqrt(np.nanmean(squares))) if np.isfinite(squares).any() else 0.0
    return max((factor for factor in _FACTORS if factor * rms <= _ARROW_SHARE * width), default=1)


def _draw_axes(canvas: Canvas, each: Posed) -> None:
    """Draw the axes of the object's frame, z last, which often points at the viewer."""
    for index, (name, colour) in enumerate(_AXES):
        places = [canvas.place(pixel) for pixel in each.axis(index)]
        for start, end in pairwise(places):
            canvas.line(start, end, colour, 2 * canvas.thickness)
        if places[-1] is not None:
            canvas.write(name, places[-1], colour)
    origin = canvas.place(each.axis(0)[0])
    if origin is not None and each.name:
        canvas.write(each.name, origin, _NAME)


def _draw_points(canvas: Canvas, each: Posed, enlarged: int) -> None:
    """Draw where points were seen and arrows to where they are projected."""
    ends = each.pixels + enlarged * (each.projected() - each.pixels)
    for pixel, end, inlier in zip(each.pixels, ends, each.inliers, strict=True):
        start = canvas.place(pixel)
        if start is None:
            continue
        if not inlier:
            canvas.cross(start, 6 * canvas.thickness, _OUTLIER, 2 * canvas.thickness)
            continue
        canvas.circle(start, 2.5 * canvas.thickness, _POINT, canvas.thickness)
        canvas.line(start, canvas.place(end), _ARROW, canvas.thickness)
