"""Pictures of what was found of a board: its points in their order, how sure they are, or why there are none."""

from collections.abc import Sequence
from textwrap import wrap

import numpy as np

from camcal.arrays import Array
from camcal.report.canvas import Canvas, Colour
from camcal.report.colour_scale import turbo
from camcal.targets.board import Detection

MOST_WIDTH = 2400  # px; larger photographs are reduced by a whole factor
_POINT, _FIRST, _ELLIPSE, _REASON = (255, 255, 255), (80, 255, 80), (0, 235, 255), (70, 70, 255)
_TURBO = (0.12, 0.92)  # of the colours: the ends are too dark to be seen
_FACTORS = tuple(digit * 10**power for power in range(5) for digit in (1, 2, 5))
_ELLIPSE_SHARE = 0.3  # of the way to the next point, which a typical ellipse may reach
_LINE_SHARE = 1 / 40  # of the way to the next point, which a line may be thick
_JUMP = 2.5  # times the usual way to the next point is a step to another row, which is drawn thin
_ROUND = np.linspace(0, 2 * np.pi, 32, endpoint=False)
_RADIUS = 4.0  # of a ring, px, where lines are one pixel wide
_APART = 50.0  # px of the picture between points with their ids beside them, where letters have their usual size
_LONGEST, _WIDE = 44, 500  # letters of a line of a reason; px of width for letters of their usual size


def corner_overlay(gray: Array, view: Detection) -> Array:
    """Return a picture (H', W', 3) blue, green, red, uint8, of what was found in an image (H, W) uint8.

    A line through the points runs from id to id, blue at the first and red at the last; a green square is around the
    first one. Where it is known how sure points are, ellipses of one standard deviation take the place of rings,
    enlarged by the factor that is said below. An image without points has the reason written over it.
    """
    canvas = Canvas.of(gray, MOST_WIDTH)
    if not view.found:
        _write_reason(canvas, view.reason or "nothing found")
        return canvas.captioned([view.image])
    order = np.argsort(view.ids, kind="stable")
    ids, pixels = view.ids[order], view.pixels[order]
    spacing = _spacing(pixels)
    width = max(1, min(canvas.thickness, round(_LINE_SHARE * spacing * canvas.scale)))
    colours = _draw_order(canvas, pixels, spacing, width)
    lines = [view.image, f"{len(ids)} points; the line runs from id to id, blue to red; green: the first, id {ids[0]}"]
    if view.covariance is None:
        _draw_rings(canvas, pixels, colours, width)
    else:
        lines.append(_draw_ellipses(canvas, pixels, view.covariance[order], spacing, width))
    _draw_first(canvas, pixels[0], width)
    _write_ids(canvas, ids, pixels, spacing)
    return canvas.captioned(lines)


def _spacing(pixels: Array) -> float:
    """Return the median distance (px) of points to their nearest neighbour, 1 for a single point."""
    away = np.linalg.norm(pixels[:, None] - pixels, axis=2)
    np.fill_diagonal(away, np.inf)
    return float(np.median(away.min(axis=1))) if len(pixels) > 1 else 1.0


def _draw_order(canvas: Canvas, pixels: Array, spacing: float, width: int) -> list[Colour]:
    """Draw a line through points, its colour along a colour map; return the colour of each point."""
    colours = [(blue, green, red) for red, green, blue in turbo(np.linspace(*_TURBO, len(pixels))).tolist()]
    places = [canvas.place(pixel) for pixel in pixels]
    lengths = np.linalg.norm(np.diff(pixels, axis=0), axis=1)
    for start, end, length, colour in zip(places, places[1:], lengths, colours, strict=False):
        canvas.line(start, end, colour, width if length < _JUMP * spacing else 1)
    return colours


def _draw_rings(canvas: Canvas, pixels: Array, colours: Sequence[Colour], width: int) -> None:
    for pixel, colour in zip(pixels, colours, strict=True):
        place = canvas.place(pixel)
        if place is not None:
            canvas.circle(place, _RADIUS * width, colour, width)


def _draw_ellipses(canvas: Canvas, pixels: Array, covariance: Array, spacing: float, width: int) -> str:
    """Draw the ellipses of covariances (N, 2, 2) px²; return the line that says how large they are."""
    values, axes = np.linalg.eigh(covariance)
    roots = np.sqrt(np.maximum(values, 0.0))
    typical = float(np.median(roots[:, 1]))
    factor = max((factor for factor in _FACTORS if factor * typical <= _ELLIPSE_SHARE * spacing), default=1)
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


def _write_reason(canvas: Canvas, reason: str) -> None:
    """Write in large letters over the picture why there is no board."""
    height, width = canvas.pixels.shape[:2]
    size = width / _WIDE
    for row, line in enumerate(wrap(f"no board: {reason}", _LONGEST)):
        place = np.array([0.03 * width, 0.1 * height + 26 * size * row]) / canvas.scale
        canvas.write(line, canvas.place(place) or (0, 0), _REASON, size)
