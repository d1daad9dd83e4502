"""Pairs of flat things one before the other, with their exact disparities and what both images show."""

import numpy as np
from scipy.ndimage import gaussian_filter


def layered_pair(size=(160, 110), disparities=(4, 9, 16), *, seed=1):
    """Return a pair (H, W) uint8, its disparity (H, W), whole pixels, and which pixels (H, W) both images show.

    The first disparity is that of the background; the others are of rectangles, each before those named earlier.
    """
    width, height = size
    rng = np.random.default_rng(seed)
    margin = max(abs(disparity) for disparity in disparities)
    canvas = height, width + 2 * margin
    left, right = np.zeros((2, *canvas), np.uint8)
    points_left, points_right = np.zeros((2, *canvas), int)  # every point of every thing has a number
    truth = np.zeros(canvas)
    for number, disparity in enumerate(disparities):
        paint, points = _paint(canvas, rng), (number * np.prod(canvas) + np.arange(np.prod(canvas))).reshape(canvas)
        inside = _rectangle(canvas, number, len(disparities))
        left[inside], points_left[inside], truth[inside] = paint[inside], points[inside], disparity
        moved = np.roll(inside, -disparity, axis=1)
        right[moved] = np.roll(paint, -disparity, axis=1)[moved]
        points_right[moved] = np.roll(points, -disparity, axis=1)[moved]
    shown = np.s_[:, margin : margin + width]
    return left[shown], right[shown], truth[shown], np.isin(points_left[shown], points_right[shown])


def _paint(shape, rng):
    noise = [gaussian_filter(rng.normal(size=shape), sigma) for sigma in (0.8, 3, 12)]
    values = rng.uniform(90, 160) + 22 * sum(each / each.std() for each in noise)
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def _rectangle(shape, number, count):
    """Return where a thing is (H, W) bool: the first everywhere, the others from the upper left to the lower right."""
    inside = np.zeros(shape, bool)
    start = 0.1 + 0.6 * (number - 1) / count
    stretch = tuple(slice(round(length * start), round(length * (start + 0.3))) for length in shape)
    inside[stretch if number else ...] = True
    return inside
