"""Boxes (left, top, right, bottom) inside and around a region of the plane that is given by its outline."""

import numpy as np

from camcal.arrays import Array

_AROUND = np.array([(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1) if (x, y) != (0, 0)], dtype=float)
_PULL = 0.01  # of its distance from the axis that a box must gain in half its height to be moved there
_FINE, _COARSE = 1e-7, 1e-3  # of the box: where the search for its place ends, and for its aspect
_ASPECTS = np.geomspace(1 / 3, 3, 21)  # times that of the outline
_EVERY = 8  # samples of the outline from one to the next that tell aspects from each other


def largest_box(outline: Array, aspect: float | None) -> Array:
    """Return the largest box (4,) inside an outline (N, 2) around the origin.

    aspect: its width by its height; None lets it have any, and the largest area wins.
    """
    if aspect is not None:
        return _box(outline, aspect)[0]
    low, high = outline.min(axis=0), outline.max(axis=0)
    aspect = (high[0] - low[0]) / (high[1] - low[1])
    for choice in (_ASPECTS, _ASPECTS**0.1, _ASPECTS**0.01):
        areas = [_box(outline[::_EVERY], aspect * factor, _COARSE)[1] for factor in choice]
        aspect *= choice[int(np.argmax(areas))]
    return _box(outline, aspect)[0]


def enclosing_box(outline: Array, aspect: float | None) -> Array:
    """Return the smallest box (4,) around an outline (N, 2); aspect: its width by its height, None any."""
    low, high = outline.min(axis=0), outline.max(axis=0)
    middle, half = (low + high) / 2, (high - low) / 2
    if aspect is not None:
        height = max(half[1], half[0] / aspect)
        half = np.array([height * aspect, height])
    return np.concatenate([middle - half, middle + half])


def _box(outline: Array, aspect: float, fine: float = _FINE) -> tuple[Array, float]:
    """Return the largest box of one aspect, and its area.

    Seen with one axis scaled, a box is a ball of the largest-coordinate distance: its half height is the distance
    from its middle to the outline, and the middle is moved while that grows. Where it hardly does, as along the
    longer sides of a barrel, the middle stays near the axis.
    """
    stretch = np.array([aspect, 1.0])
    points = outline / stretch
    middle, worth = np.zeros(2), float(np.abs(points).max(axis=1).min())
    step, smallest = worth / 2, fine * worth
    while step > smallest:
        candidates = middle + step * _AROUND
        distances = np.abs(points - candidates[:, None]).max(axis=2).min(axis=1)
        worths = distances - _PULL * np.abs(candidates).sum(axis=1)
        best = int(np.argmax(worths))
        if worths[best] > worth:
            middle, worth = candidates[best], float(worths[best])
        else:
            step /= 2
    reach = float(np.abs(points - middle).max(axis=1).min())
    half = reach * stretch
    return np.concatenate([middle * stretch - half, middle * stretch + half]), 4 * reach * reach * aspect
