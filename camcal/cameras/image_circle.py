"""The image circle of a camera: the disc of its image that the lens lights, and what lies inside of it."""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array


@dataclass(frozen=True)
class ImageCircle:
    """The disc of a camera's image that its lens lights; beyond it, the image is black.

    image_size: (width, height) px. centre: (x, y) px, (0, 0) is the centre of the top-left pixel. radius: px.
    """

    image_size: tuple[int, int]
    centre: tuple[float, float]
    radius: float

    def contains(self, pixels: Array) -> Array:
        """Return the mask (...) of pixels (..., 2) inside the circle; those that are NaN are not."""
        apart = pixels - np.array(self.centre)
        return np.asarray(np.hypot(apart[..., 0], apart[..., 1]) <= self.radius)

    def clipped(self, start: Array, ends: Array) -> Array:
        """Return ends (N, 2) of lines from `start` (2,), px, those outside of the circle moved along their line to it.

        All stay where they are if the start itself is outside.
        """
        outside = ~self.contains(ends)
        if not self.contains(start) or not outside.any():
            return ends
        away, lines = start - np.array(self.centre), ends[outside] - start
        # |away + s line| = radius, a quadratic equation in s with one root from 0 to 1
        squares, slopes = (lines**2).sum(axis=1), lines @ away
        roots = np.sqrt(slopes**2 + squares * (self.radius**2 - away @ away))
        result = np.array(ends, dtype=float)
        result[outside] = start + ((roots - slopes) / squares)[:, None] * lines
        return result

    def resized(self, size: tuple[int, int]) -> "ImageCircle":
        """Return the circle in images resized to (width, height)."""
        across, down = (new / old for new, old in zip(size, self.image_size, strict=True))
        x, y = self.centre
        centre = ((x + 0.5) * across - 0.5, (y + 0.5) * down - 0.5)
        return ImageCircle(size, centre, self.radius * float(np.sqrt(across * down)))
