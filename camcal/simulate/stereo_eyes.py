"""What an eye sees of a world along its rays, and so the true disparity of every pixel.

A disparity belongs to the ray through the middle of a pixel; nothing is taken from the pictures.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array, readonly
from camcal.simulate.stereo_surfaces import NOTHING, Surface, first_hits

SAME = 1e-6  # by this share may depths differ that are those of one point

_STRIP = 1 << 18  # rays that are worked on at once: their temporaries stay near the processor's cache


@dataclass(frozen=True, eq=False)
class Eye:
    """A pinhole that looks along z: its place (3,), metres, size (width, height), focal length and centre in pixels.

    row_shift: by how many pixels its image lies too low; row_tilt: by how much more at the right border than at the
    left one, 0 in between.
    """

    place: Array
    size: tuple[int, int]
    focal: float
    centre: tuple[float, float]
    row_shift: float = 0.0
    row_tilt: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "place", readonly(self.place, (3,), "place"))

    def rays(self, columns: Array, rows: Array) -> tuple[Array, Array]:
        """Return x and y of the directions (x, y, 1) in which pixels look."""
        level = rows - self._lower(columns)
        return (columns - self.centre[0]) / self.focal, (level - self.centre[1]) / self.focal

    def pixels(self, points: Array) -> tuple[Array, Array]:
        """Return the columns and the rows at which points (N, 3), metres, are seen."""
        x, y, z = (points - self.place).T
        columns = self.focal * x / z + self.centre[0]
        return columns, self.focal * y / z + self.centre[1] + self._lower(columns)

    def contains(self, columns: Array, rows: Array) -> Array:
        """Return which places (N,) lie on a pixel of the image."""
        width, height = self.size
        return (columns >= -0.5) & (columns <= width - 0.5) & (rows >= -0.5) & (rows <= height - 0.5)

    def _lower(self, columns: Array) -> Array:
        return np.asarray(self.row_shift + self.row_tilt * (columns / (self.size[0] - 1) - 0.5))


def disparity(surfaces: Sequence[Surface], eye: Eye, other: Eye) -> tuple[Array, Array]:
    """Return the disparity (H, W), float32 pixels, at the pixels of an eye, and which of them (H, W) the other sees.

    The disparity is the column of the left eye less that of the right one; NaN where nothing is seen.
    """
    width, height = eye.size
    result = np.full((height, width), np.nan, np.float32)
    visible = np.zeros((height, width), bool)
    sign = 1 if eye.place[0] < other.place[0] else -1
    for first, last in strips(height, width):
        rows, columns = (grid.ravel() for grid in np.mgrid[first:last, 0:width].astype(float))
        surface, points = seen(surfaces, eye, columns, rows)
        with np.errstate(invalid="ignore"):
            matches, levels = other.pixels(points)
            result[first:last] = (sign * (columns - matches)).reshape(-1, width)
            found = (surface != NOTHING) & other.contains(matches, levels)
        found[found] = ~_hidden(surfaces, other, points[found])
        visible[first:last] = found.reshape(-1, width)
    return result, visible


def _hidden(surfaces: Sequence[Surface], eye: Eye, points: Array) -> Array:
    """Return which points (N, 3) another surface hides from an eye."""
    x, y, z = (points - eye.place).T
    return np.asarray(first_hits(surfaces, eye.place, x / z, y / z)[1] < z * (1 - SAME))


def seen(surfaces: Sequence[Surface], eye: Eye, columns: Array, rows: Array) -> tuple[Array, Array]:
    """Return which surface an eye sees at pixels (N,), and which point (N, 3) of it, NaN if none."""
    x, y = eye.rays(columns, rows)
    surface, depths = first_hits(surfaces, eye.place, x, y)
    depths[surface == NOTHING] = np.nan
    return surface, eye.place + depths[:, None] * np.stack([x, y, np.ones_like(x)], axis=1)


def strips(height: int, rays_of_a_row: int) -> Iterator[tuple[int, int]]:
    """Yield the first and the last but one row of parts of an image that are worked on at once."""
    rows = max(1, _STRIP // rays_of_a_row)
    for first in range(0, height, rows):
        yield first, min(height, first + rows)
