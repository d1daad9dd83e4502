"""Pictures over images: poses with their axes and points, or the points found of a board in their order."""

from collections.abc import Sequence
from itertools import pairwise
from textwrap import wrap

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.dataclass import dataclass
from camcal.geometry.pose import Pose
from camcal.report.colour_scale import turbo
from camcal.targets.detection import BoardDetection

Colour = tuple[int, int, int]  # blue, green, red
Place = tuple[int, int]  # in the picture, as OpenCV takes it: multiples of 2⁻⁴ px

INK, PAPER = (30, 30, 30), 245
LEAST_WIDTH = 900  # px; smaller images are enlarged by a whole factor, so that marks and letters can be seen
_EDGE: Colour = (20, 20, 20)
_AROUND = tuple((right, down) for right in (-1, 0, 1) for down in (-1, 0, 1) if right or down)
_FAR = 20.0  # picture widths; what is drawn farther out is not in the picture
_FINE = 4  # bits of a fraction of a pixel that OpenCV draws with
_LETTERS = cv2.FONT_HERSHEY_SIMPLEX
_SIZE = 0.55  # of letters, with lines of one pixel

# poses
_AXES: tuple[tuple[str, Colour], ...] = (("x", (60, 60, 240)), ("y", (60, 200, 60)), ("z", (240, 120, 40)))
_SEEN: Colour = (80, 220, 80)
_ARROW: Colour = (0, 220, 255)
_OUTLIER: Colour = (60, 60, 255)
_NAME: Colour = (255, 255, 255)
_AXIS = 0.35  # of the object's largest extent
_STEPS = 24  # of an axis, which a lens may bend
_ARROW_SHARE = 0.02  # of the picture's width, which an arrow of the root mean square may have
_ARROW_FACTORS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
_MOST_LINES = 8

# points of boards
MOST_WIDTH = 2400  # px; larger photographs are reduced by a whole factor
_POINT, _FIRST, _ELLIPSE, _REASON = (255, 255, 255), (80, 255, 80), (0, 235, 255), (70, 70, 255)
_TURBO = (0.12, 0.92)  # of the colours: the ends are too dark to be seen
_ELLIPSE_FACTORS = tuple(digit * 10**power for power in range(5) for digit in (1, 2, 5))
_ELLIPSE_SHARE = 0.3  # of the way to the next point, which a typical ellipse may reach
_LINE_SHARE = 1 / 40  # of the way to the next point, which a line may be thick
_JUMP = 2.5  # times the usual way to the next point is a step to another row, which is drawn thin
_ROUND = np.linspace(0, 2 * np.pi, 32, endpoint=False)
_RADIUS = 4.0  # of a ring, px, where lines are one pixel wide
_APART = 50.0  # px of the picture between points with their ids beside them, where letters have their usual size
_LONGEST, _WIDE = 44, 500  # letters of a line of a reason; px of width for letters of their usual size


@dataclass(frozen=True, eq=False)
class Canvas:
    """A picture (H, W, 3) of an image, `scale` of its pixels for one of the image."""

    pixels: Array
    scale: float

    @classmethod
    def of(cls, gray: Array, most_width: int | None = None) -> "Canvas":
        """Return a picture of an image (H, W) uint8, dimmed so that marks stand out.

        Images narrower than LEAST_WIDTH are enlarged, those wider than `most_width` reduced, by whole factors.
        """
        width = gray.shape[1]
        if most_width is not None and width > most_width:
            factor = -(-width // most_width)
            size = (max(1, width // factor), max(1, gray.shape[0] // factor))
            gray = gray[: size[1] * factor, : size[0] * factor]
            scale, shown = 1 / factor, cv2.resize(gray, size, interpolation=cv2.INTER_AREA)
        else:
            scale = float(-(-LEAST_WIDTH // width))
            shown = cv2.resize(gray, None, fx=scale, fy=scale, interpolation=cv2.INTER_NEAREST)
        return cls(cv2.cvtColor((0.55 * shown + 70).astype(np.uint8), cv2.COLOR_GRAY2BGR), scale)

    @property
    def thickness(self) -> int:
        """How thick a line is, px."""
        return max(1, round(float(self.pixels.shape[1]) / LEAST_WIDTH))

    def place(self, pixel: Array) -> Place | None:
        """Return where a pixel of the image is in the picture; None if it is nowhere or far outside."""
        if not np.isfinite(pixel).all() or np.abs(pixel).max() * self.scale > _FAR * self.pixels.shape[1]:
            return None
        x, y = ((pixel + 0.5) * self.scale - 0.5) * (1 << _FINE)
        return round(x), round(y)

    def line(self, start: Place | None, end: Place | None, colour: Colour, width: int) -> None:
        """Draw a line between two places of which both are there."""
        if start is not None and end is not None:
            cv2.line(self.pixels, start, end, colour, width, cv2.LINE_AA, _FINE)

    def polygon(self, places: Sequence[Place | None], colour: Colour, width: int) -> None:
        """Draw a closed line through places, if all are there."""
        if all(place is not None for place in places):
            cv2.polylines(self.pixels, [np.array(places, np.int32)], True, colour, width, cv2.LINE_AA, _FINE)

    def circle(self, place: Place, radius: float, colour: Colour, width: int) -> None:
        """Draw a circle of a radius in pixels of the picture."""
        cv2.circle(self.pixels, place, round(radius * (1 << _FINE)), colour, width, cv2.LINE_AA, _FINE)

    def cross(self, place: Place, reach: int, colour: Colour, width: int) -> None:
        """Draw a lying cross that reaches so many pixels of the picture."""
        (x, y), reach = place, reach << _FINE
        for sign in (-1, 1):
            self.line((x - reach, y - sign * reach), (x + reach, y + sign * reach), colour, width)

    def write(self, text: str, place: Place, colour: Colour, size: float = 1.0) -> None:
        """Write beside a place, on a dark edge that sets it off from whatever is there."""
        corner = (place[0] >> _FINE) + round(6 * size), (place[1] >> _FINE) - round(4 * size)
        width = max(1, round(size))
        # The edge is the same thin text moved about: bold letters of OpenCV 5 are wider and would stand beside it.
        for right, down, ink in (*((*move, _EDGE) for move in _AROUND), (0, 0, colour)):
            at = corner[0] + right * width, corner[1] + down * width
            cv2.putText(self.pixels, _ascii(text), at, _LETTERS, _SIZE * size, ink, width, cv2.LINE_AA)

    def captioned(self, lines: Sequence[str]) -> Array:
        """Return the picture (H', W, 3) with lines of words below it."""
        return np.concatenate([self.pixels, _caption(lines, self.pixels.shape[1])])


def _caption(lines: Sequence[str], width: int) -> Array:
    """Return a strip (H, width, 3) with lines of text."""
    size = width / LEAST_WIDTH * 0.5
    step, thickness = round(40 * size), max(1, round(size))
    strip = np.full((step * len(lines) + step // 2, width, 3), PAPER, np.uint8)
    for row, line in enumerate(lines, start=1):
        text = _ascii(line)
        needed = cv2.getTextSize(text, _LETTERS, size, thickness)[0][0]
        fitting = size * min(1.0, (width - step) / needed)
        cv2.putText(strip, text, (step // 2, row * step), _LETTERS, fitting, INK, thickness, cv2.LINE_AA)
    return strip


def _ascii(text: str) -> str:
    """Return a text in OpenCV's letters."""
    return text.encode("ascii", "replace").decode()


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
    return max((factor for factor in _ARROW_FACTORS if factor * rms <= _ARROW_SHARE * width), default=1)


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
        canvas.circle(start, 2.5 * canvas.thickness, _SEEN, canvas.thickness)
        canvas.line(start, canvas.place(end), _ARROW, canvas.thickness)


def corner_overlay(gray: Array, view: BoardDetection) -> Array:
    """Return a picture (H', W', 3) blue, green, red, uint8, of what was found in an image (H, W) uint8.

    A line through the points runs from id to id, blue at the first and red at the last; a green square is around the
    first one. Where it is known how sure points are, ellipses of one standard deviation take the place of rings,
    enlarged by the factor that is said below. Red rings are around points that were found and are not used. An image
    without points has the reason written over it.
    """
    canvas = Canvas.of(gray, MOST_WIDTH)
    if not view.found:
        return _draw_refusal(canvas, view)
    order = np.argsort(view.ids, kind="stable")
    ids, pixels = view.ids[order], view.pixels[order]
    # the median distance to the nearest neighbour
    away = np.linalg.norm(pixels[:, None] - pixels, axis=2)
    np.fill_diagonal(away, np.inf)
    spacing = float(np.median(away.min(axis=1))) if len(pixels) > 1 else 1.0
    width = max(1, min(canvas.thickness, round(_LINE_SHARE * spacing * canvas.scale)))
    colours = _draw_order(canvas, pixels, spacing, width)
    lines = [view.image, f"{len(ids)} points; the line runs from id to id, blue to red; green: the first, id {ids[0]}"]
    if view.covariance is None:
        for pixel, colour in zip(pixels, colours, strict=True):
            place = canvas.place(pixel)
            if place is not None:
                canvas.circle(place, _RADIUS * width, colour, width)
    else:
        lines.append(_draw_ellipses(canvas, pixels, view.covariance[order], spacing, width))
    lines += _draw_refused(canvas, view.refused)
    _draw_first(canvas, pixels[0], width)
    _write_ids(canvas, ids, pixels, spacing)
    return canvas.captioned(lines)


def _draw_order(canvas: Canvas, pixels: Array, spacing: float, width: int) -> list[Colour]:
    """Draw a line through points, its colour along a colour map; return the colour of each point."""
    colours = [(blue, green, red) for red, green, blue in turbo(np.linspace(*_TURBO, len(pixels))).tolist()]
    places = [canvas.place(pixel) for pixel in pixels]
    lengths = np.linalg.norm(np.diff(pixels, axis=0), axis=1)
    for start, end, length, colour in zip(places, places[1:], lengths, colours, strict=False):
        canvas.line(start, end, colour, width if length < _JUMP * spacing else 1)
    return colours


def _draw_ellipses(canvas: Canvas, pixels: Array, covariance: Array, spacing: float, width: int) -> str:
    """Draw the ellipses of covariances (N, 2, 2) px²; return the line that says how large they are."""
    values, axes = np.linalg.eigh(covariance)
    roots = np.sqrt(np.maximum(values, 0.0))
    typical = float(np.median(roots[:, 1]))
    factor = max((factor for factor in _ELLIPSE_FACTORS if factor * typical <= _ELLIPSE_SHARE * spacing), default=1)
    circle = np.stack([np.cos(_ROUND), np.sin(_ROUND)])
    for pixel, root, axis in zip(pixels, roots, axes, strict=True):
        outline = pixel[:, None] + factor * (axis * root) @ circle
        canvas.polygon([canvas.place(point) for point in outline.T], _ELLIPSE, width)
    return f"yellow ellipses: one standard deviation x {factor}; its median along the longer axis is {typical:.2g} px"


def _draw_first(canvas: Canvas, pixel: Array, width: int) -> None:
    """Draw a square around a point."""
    reach = 2.2 * _RADIUS * width / canvas.scale
    square = pixel + reach * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    canvas.polygon([canvas.place(corner) for corner in square], _FIRST, 2 * width)


def _write_ids(canvas: Canvas, ids: Array, pixels: Array, spacing: float) -> None:
    """Write ids beside their points: of all where there is room, else of the first and the last."""
    size = min(float(canvas.thickness), max(1.0, spacing * canvas.scale / _APART))
    shown = range(len(ids)) if spacing * canvas.scale >= _APART else sorted({0, len(ids) - 1})
    for index in shown:
        place = canvas.place(pixels[index])
        if place is not None:
            canvas.write(str(ids[index]), place, _FIRST if index == 0 else _POINT, size)


def _draw_refusal(canvas: Canvas, view: BoardDetection) -> Array:
    """Return the picture of an image without points to use: rings around those that were refused, and the reason."""
    lines = [view.image, *_draw_refused(canvas, view.refused)]
    reason = view.reason or "nothing found"
    height, width = canvas.pixels.shape[:2]
    size = width / _WIDE
    for row, line in enumerate(wrap(f"no board: {reason}", _LONGEST)):
        place = np.array([0.03 * width, 0.1 * height + 26 * size * row]) / canvas.scale
        canvas.write(line, canvas.place(place) or (0, 0), _REASON, size)
    return canvas.captioned(lines)


def _draw_refused(canvas: Canvas, pixels: Array) -> list[str]:
    """Draw rings around points that were found and are not used; return the line that counts them, none without any."""
    for pixel in pixels:
        place = canvas.place(pixel)
        if place is not None:
            canvas.circle(place, _RADIUS * canvas.thickness, _REASON, canvas.thickness)
    return [f"red: {len(pixels)} points that were found and are not used"] if len(pixels) else []
