"""Surfaces of stereo scenes: planar facets and balls, their intersections with rays, and their textures."""

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from camcal.arrays import Array, readonly
from camcal.dataclass import dataclass

NOTHING = -1


@dataclass(frozen=True, eq=False)
class Paint:
    """A periodic painting of brightness 0 … 1 laid over a surface, and the colours that stand for 0 and for 1.

    tile: (T, T) float32, coefficients of a cubic B-spline, so that the painting is smooth between its texels too.
    texels: (2, 3) texels per metre along its columns and its rows. dark, bright: (3,) BGR, 0 … 1.
    """

    tile: Array
    texels: Array
    dark: Array
    bright: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "tile", readonly(self.tile, (None, None), "tile", np.float32))
        object.__setattr__(self, "texels", readonly(self.texels, (2, 3), "texels"))
        object.__setattr__(self, "dark", readonly(self.dark, (3,), "dark"))
        object.__setattr__(self, "bright", readonly(self.bright, (3,), "bright"))

    def brightness(self, offsets: Array) -> Array:
        """Return the brightness (N,) at points given by their offsets (N, 3) from the painting's origin, metres."""
        columns, rows = self.texels @ offsets.T
        values = ndimage.map_coordinates(self.tile, (rows, columns), order=3, mode="grid-wrap", prefilter=False)
        return np.asarray(values)


@dataclass(frozen=True, eq=False)
class Facet:
    """A flat rectangle or ellipse around a centre (3,), metres, painted on both sides.

    axes: (2, 3) orthogonal unit vectors in it. reach: how far it goes to both sides along each, metres, may be inf.
    """

    centre: Array
    axes: Array
    reach: tuple[float, float]
    paint: Paint
    elliptic: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", readonly(self.centre, (3,), "centre"))
        object.__setattr__(self, "axes", readonly(self.axes, (2, 3), "axes"))

    def corners(self) -> Array:
        """Return the corners (4, 3) of the rectangle around it, metres; not finite if it is unbounded."""
        sides = np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)]) * self.reach
        with np.errstate(invalid="ignore"):  # inf · 0
            return np.asarray(self.centre + sides @ self.axes)

    def depths(self, origin: Array, x: Array, y: Array) -> Array:
        """Return the depth (N,), metres, at which rays from `origin` (3,) along (x, y, 1) meet it; inf if none."""
        normal, off = np.cross(self.axes[0], self.axes[1]), self.centre - origin
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = normal @ off / (normal[0] * x + normal[1] * y + normal[2])
            hit = depth > 0
            if np.isfinite(self.reach).all():
                along, across = (
                    (depth * (axis[0] * x + axis[1] * y + axis[2]) - axis @ off) / reach
                    for axis, reach in zip(self.axes, self.reach, strict=True)
                )
                outline = along**2 + across**2 if self.elliptic else np.maximum(np.abs(along), np.abs(across))
                hit &= outline <= 1
        return np.where(hit, depth, np.inf)

    def shading(self, points: Array) -> Array:
        """Return the light (N,) on points (N, 3): even, as the paint says it all."""
        return np.ones(len(points))


@dataclass(frozen=True, eq=False)
class Ball:
    """A ball around a centre (3,), metres, painted from the front: as dense at its rim as in its middle.

    light: (3,) unit vector towards the light.
    """

    centre: Array
    radius: float
    paint: Paint
    light: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", readonly(self.centre, (3,), "centre"))
        object.__setattr__(self, "light", readonly(self.light, (3,), "light"))

    def corners(self) -> Array:
        """Return the corners (8, 3) of the cube around it, metres."""
        sides = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        return np.asarray(self.centre + self.radius * sides)

    def depths(self, origin: Array, x: Array, y: Array) -> Array:
        """Return the depth (N,), metres, at which rays from `origin` (3,) along (x, y, 1) meet it; inf if none."""
        to_centre = self.centre - origin
        squared = x**2 + y**2 + 1
        half = to_centre[0] * x + to_centre[1] * y + to_centre[2]
        discriminant = half**2 - squared * (to_centre @ to_centre - self.radius**2)
        hit = discriminant >= 0
        depth = (half - np.sqrt(np.where(hit, discriminant, 0))) / squared
        return np.where(hit & (depth > 0), depth, np.inf)

    def shading(self, points: Array) -> Array:
        """Return the light (N,) on points (N, 3) of it: less where it turns away from the light."""
        return np.asarray(0.65 + 0.35 * (points - self.centre) @ self.light / self.radius)


Surface = Facet | Ball


def first_hits(surfaces: Sequence[Surface], origin: Array, x: Array, y: Array) -> tuple[Array, Array]:
    """Return which surface rays from `origin` (3,) along (x, y, 1) meet first (N,), and at what depth (N,), metres.

    A ray that meets none has NOTHING and inf.
    """
    first = np.full(len(x), NOTHING, dtype=np.int16)
    depths = np.full(len(x), np.inf)
    for number, surface in enumerate(surfaces):
        rays = _towards(surface, origin, x, y)
        if not rays.size:
            continue
        found = surface.depths(origin, x[rays], y[rays])
        nearer = found < depths[rays]
        depths[rays[nearer]] = found[nearer]
        first[rays[nearer]] = number
    return first, depths


def _towards(surface: Surface, origin: Array, x: Array, y: Array) -> Array:
    """Return the numbers of the rays that go through the box around a surface: the others cannot meet it."""
    corners = surface.corners() - origin
    if not np.isfinite(corners).all() or corners[:, 2].min() <= 0:
        return np.arange(len(x))
    (left, top), (right, bottom) = (limit(corners[:, :2] / corners[:, 2:], axis=0) for limit in (np.min, np.max))
    if top > y.max() or bottom < y.min():  # most rays come in strips of a few rows
        return np.empty(0, np.intp)
    return np.flatnonzero((x >= left) & (x <= right) & (y >= top) & (y <= bottom))


def colours(surfaces: Sequence[Surface], first: Array, points: Array) -> Array:
    """Return the colours (N, 3), BGR, 0 … 1, of points (N, 3) on the surfaces `first` (N,) says they are on."""
    result = np.zeros((len(points), 3))
    for number, surface in enumerate(surfaces):
        own = np.flatnonzero(first == number)
        if own.size:
            paint, places = surface.paint, points[own]
            share = paint.brightness(places - surface.centre)[:, None]
            result[own] = (paint.dark + (paint.bright - paint.dark) * share) * surface.shading(places)[:, None]
    return result
