"""Views of one camera in images of several sizes: how the sizes are related, and the same views in one size.

Pixel (0, 0) is the centre of the top-left pixel, so that x in an image of half the size is (x + 0.5) * 2 - 0.5 in the
whole one. An image turned by 90 degrees has lost which way it was turned; see tasks/calibration/mixed_sizes.py.
"""

from dataclasses import dataclass, replace

import numpy as np

from camcal.arrays import Array
from camcal.targets.detection import Detection

Size = tuple[int, int]

TURNED, HALF, DOUBLE, NEAR = "turned", "half", "double", "near"
CLOCKWISE, COUNTER_CLOCKWISE = 1, 3  # quarter turns, from the image to the others'
NEAR_PX = 2  # a side, by which sizes differ that a driver or a converter has cropped


def size_relation(size: Size, usual: Size) -> str | None:
    """Return how a size (width, height) is related to another one, None if it is the same or has nothing to do with it.

    TURNED: by 90 degrees; HALF, DOUBLE: exactly; NEAR: by NEAR_PX pixels a side at most.
    """
    if size == usual:
        return None
    off = max(abs(one - other) for one, other in zip(size, usual, strict=True))
    if off <= NEAR_PX:
        return NEAR
    if size == usual[::-1]:
        return TURNED
    if (2 * size[0], 2 * size[1]) == usual:
        return HALF
    return DOUBLE if size == (2 * usual[0], 2 * usual[1]) else None


def size_words(size: Size, usual: Size) -> str:
    """Return how a size that is related to another one differs from it, in words; raises KeyError for others."""
    off = " x ".join(str(abs(one - other)) for one, other in zip(size, usual, strict=True))
    return {
        TURNED: "turned by 90 degrees",
        HALF: "half as large",
        DOUBLE: "twice as large",
        NEAR: f"{off} px off",
    }[size_relation(size, usual) or ""]


@dataclass(frozen=True, eq=False)
class PixelMap:
    """How pixels x of one image become those of another of a size (width, height): linear · x + offset."""

    linear: Array
    offset: Array
    size: Size

    def apply(self, view: Detection) -> Detection:
        """Return a view with its points as an image of the other size would show them."""
        covariance = None if view.covariance is None else self.linear @ view.covariance @ self.linear.T
        pixels = view.pixels @ self.linear.T + self.offset
        colours = {colour: self.apply(own) for colour, own in view.colours.items()}
        return replace(view, size=self.size, pixels=pixels, covariance=covariance, colours=colours)


def pixel_map(size: Size, usual: Size, quarter: int = 0) -> PixelMap:
    """Return how pixels of an image of a related size become those of the usual one.

    quarter: CLOCKWISE or COUNTER_CLOCKWISE, for an image that is TURNED. Raises ValueError for unrelated sizes.
    """
    relation = size_relation(size, usual)
    width, height = size
    if relation == TURNED and quarter == CLOCKWISE:
        return PixelMap(np.array([(0.0, -1.0), (1.0, 0.0)]), np.array([height - 1.0, 0.0]), usual)
    if relation == TURNED and quarter == COUNTER_CLOCKWISE:
        return PixelMap(np.array([(0.0, 1.0), (-1.0, 0.0)]), np.array([0.0, width - 1.0]), usual)
    factors = {None: 1.0 if size == usual else None, NEAR: 1.0, HALF: 2.0, DOUBLE: 0.5}
    factor = factors.get(relation)
    if factor is None:
        raise ValueError(f"pixels of {size} do not become those of {usual} with {quarter} quarter turns")
    return PixelMap(factor * np.eye(2), np.full(2, 0.5 * factor - 0.5), usual)
