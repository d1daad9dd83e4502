"""Scenes for stereo pairs: a back wall and a ramp, and in front of them slanted planes, discs, rods, boxes and balls.

Their textures have many scales, edges, weak areas, and some are periodic.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.geometry import rotation as so3
from camcal.simulate.stereo_surfaces import Ball, Facet, Paint, Surface

STEEPEST = np.radians(65)  # of a facet against the image; steeper ones are hardly more than a line to both cameras
FINEST = 2.5  # texels per pixel at the most, where a surface is farthest: the point spread leaves little of finer paint
TILES = (128, 2048)  # texels: the smallest and the largest painting before it repeats

_LIGHT = np.array([-0.4, -0.6, -0.69])
LIGHT = _LIGHT / np.linalg.norm(_LIGHT)
_TRIES = 20


@dataclass(frozen=True)
class ViewFrustum:
    """What the left camera sees: size (width, height), focal length and principal point in pixels, depths in metres.

    overhang: how many columns the other camera sees on the right beyond these, pixels.
    """

    size: tuple[int, int]
    focal: float
    centre: tuple[float, float]
    near: float
    far: float
    overhang: float

    def at(self, column: float, row: float, nearness: float) -> Array:
        """Return the point (3,), metres, seen at a pixel; nearness: of inverse depth, 0 the farthest, 1 the nearest."""
        depth = 1 / (1 / self.far + nearness * (1 / self.near - 1 / self.far))
        offset = np.array([column - self.centre[0], row - self.centre[1], self.focal])
        return np.asarray(offset * (depth / self.focal))

    def density(self, points: Array, axis: Array) -> Array:
        """Return how many pixels one metre along `axis` (3,) takes in the image at points (K, 3)."""
        x, y, z = points.T
        moved = np.stack([axis[0] - axis[2] * x / z, axis[1] - axis[2] * y / z])
        return np.asarray(self.focal / z * np.linalg.norm(moved, axis=0))


class Texture(NamedTuple):
    """A tile to be painted with, (T, T), and the colours (3,) of its darkest and its brightest texels."""

    tile: Array
    dark: Array
    bright: Array


class Place(NamedTuple):
    """Where an object stands (3,) and how far it goes to both sides, metres, and how it is turned (3, 3)."""

    centre: Array
    reach: float
    turn: Array


def make_world(frustum: ViewFrustum, objects: int, rng: np.random.Generator) -> tuple[Surface, ...]:
    """Return the surfaces of a world that fills the sight between its nearest and its farthest depth."""
    surfaces = _room(frustum, rng)
    for number in range(objects):
        surfaces += _fitting(_MAKERS[number % len(_MAKERS)], frustum, rng)
    return tuple(surfaces)


def _room(frustum: ViewFrustum, rng: np.random.Generator) -> list[Surface]:
    """Return a back wall, somewhat oblique, and a ramp before it that comes near at one border, mostly the lower."""
    wall, end = rng.uniform(0.04, 0.3), rng.uniform(0.45, 0.85)
    right, down = rng.uniform(-0.4, 0.4, 2) * wall
    wider = (
        1 + 2 * frustum.overhang / frustum.size[0]
    )  # the right camera sees more on the right; the wall goes on there
    foot = rng.uniform(0.3, 0.9) * wall
    rise, lean = end - foot, rng.uniform(-0.1, 0.1)
    ramp = ((lean, rise), (rise, lean), (-rise, lean))[rng.choice(3, p=(0.6, 0.2, 0.2))]
    return [_plane(frustum, (wall, right / wider, down), rng), _plane(frustum, (foot, *ramp), rng)]


def _plane(frustum: ViewFrustum, nearness: tuple[float, float, float], rng: np.random.Generator) -> Surface:
    """Return an unbounded plane by its nearness: in the middle, and its growth to the right and to the lower border."""
    middle, right, down = nearness
    width, height = frustum.size

    def seen(u: float, v: float) -> Array:
        return frustum.at((u + 1) / 2 * (width - 1), (v + 1) / 2 * (height - 1), middle + right * u + down * v)

    centre = seen(0, 0)
    along, towards = seen(0.1, 0) - centre, seen(0, 0.1) - centre
    along /= np.linalg.norm(along)
    across = towards - along * (towards @ along)
    axes = np.stack([along, across / np.linalg.norm(across)])
    steps = (-1.0, 0.0, 1.0)
    spots = np.array([seen(u, v) for u in steps for v in steps if middle + right * u + down * v >= 0])
    return Facet(centre, axes, (np.inf, np.inf), _paint(frustum, _coat(max(frustum.size), rng), spots, axes))


def _fitting(
    make: Callable[[ViewFrustum, np.random.Generator], list[Surface]], frustum: ViewFrustum, rng: np.random.Generator
) -> list[Surface]:
    """Return an object that lies between the nearest and the farthest depth; none if no try gives one."""
    for _ in range(_TRIES):
        surfaces = make(frustum, rng)
        depths = np.concatenate([surface.corners()[:, 2] for surface in surfaces])
        if frustum.near <= depths.min() and depths.max() <= frustum.far:
            return surfaces
    return []


def _place(frustum: ViewFrustum, rng: np.random.Generator, steepest: float = STEEPEST) -> Place:
    """Return a place anywhere in the sight for an object of any size, turned any way."""
    width, height = frustum.size
    centre = frustum.at(rng.uniform(0, width), rng.uniform(0, height), rng.uniform(0.1, 1))
    reach = 0.5 * width * np.exp(rng.uniform(np.log(0.06), np.log(0.4))) * centre[2] / frustum.focal
    tilt, azimuth, roll = steepest * np.sqrt(rng.random()), *rng.uniform(-np.pi, np.pi, 2)
    lean = np.array([np.cos(azimuth), np.sin(azimuth), 0]) * tilt
    return Place(centre, float(reach), so3.exp(lean) @ so3.exp(np.array([0, 0, roll])))


def _board(frustum: ViewFrustum, rng: np.random.Generator) -> list[Surface]:
    centre, reach, turn = _place(frustum, rng)
    return [_facet(frustum, centre, turn.T[:2], (reach, reach * rng.uniform(0.4, 1)), rng)]


def _disc(frustum: ViewFrustum, rng: np.random.Generator) -> list[Surface]:
    centre, reach, turn = _place(frustum, rng)
    return [_facet(frustum, centre, turn.T[:2], (reach, reach * rng.uniform(0.5, 1)), rng, elliptic=True)]


def _rod(frustum: ViewFrustum, rng: np.random.Generator) -> list[Surface]:
    """Return a strip 3 to 10 pixels wide, nearly upright."""
    centre = _place(frustum, rng).centre
    pixel = centre[2] / frustum.focal
    axes = so3.exp(np.array([rng.normal(0, 0.2), 0, rng.normal(0, 0.2)])).T[:2]
    reach = pixel * rng.uniform(1.5, 5), pixel * frustum.size[1] * rng.uniform(0.15, 0.4)
    return [_facet(frustum, centre, axes, reach, rng)]


def _box(frustum: ViewFrustum, rng: np.random.Generator) -> list[Surface]:
    """Return the six faces of a box under one coat, each in its own light."""
    centre, reach, turn = _place(frustum, rng)
    sides = reach * rng.uniform(0.4, 0.8, 3)
    coat = _coat(2 * sides.max() * frustum.focal / centre[2], rng)
    faces: list[Surface] = []
    for number in range(3):
        others = [(number + 1) % 3, (number + 2) % 3]
        for outward in (turn[:, number], -turn[:, number]):
            light = 0.75 + 0.25 * outward @ LIGHT
            lit = Texture(coat.tile, light * coat.dark, light * coat.bright)
            place, axes = centre + sides[number] * outward, turn.T[others]
            spots = place + np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)]) * sides[others] @ axes
            faces.append(Facet(place, axes, tuple(sides[others]), _paint(frustum, lit, spots, axes)))
    return faces


def _ball(frustum: ViewFrustum, rng: np.random.Generator) -> list[Surface]:
    centre, reach, _ = _place(frustum, rng)
    radius, axes = 0.7 * reach, np.eye(3)[:2]
    coat = _coat(2 * radius * frustum.focal / centre[2], rng)
    return [Ball(centre, radius, _paint(frustum, coat, centre[None], axes), LIGHT)]


_MAKERS = (_board, _box, _ball, _board, _rod, _disc)


def _facet(
    frustum: ViewFrustum,
    centre: Array,
    axes: Array,
    reach: tuple[float, float],
    rng: np.random.Generator,
    *,
    elliptic: bool = False,
) -> Facet:
    coat = _coat(2 * max(reach) * frustum.focal / centre[2], rng)
    spots = centre + np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)]) * reach @ axes
    return Facet(centre, axes, reach, _paint(frustum, coat, spots, axes), elliptic)


def _coat(extent: float, rng: np.random.Generator) -> Texture:
    """Return a coat for a surface that is `extent` pixels long."""
    smallest, largest = TILES
    tile = paint_tile(int(np.clip(2 ** np.ceil(np.log2(extent)), smallest, largest)), rng)
    tint = 1 - 0.35 * rng.random(3) ** 2
    return Texture(tile, rng.uniform(0.02, 0.15) * tint[::-1], rng.uniform(0.5, 1) * tint)


def _paint(frustum: ViewFrustum, coat: Texture, spots: Array, axes: Array) -> Paint:
    """Return the paint of a surface seen at spots (K, 3): a texel a pixel where it is far, larger where it is near."""
    densities = [frustum.density(spots, axis) for axis in axes]
    texels = [min(float(np.median(density)), FINEST * float(density.min())) for density in densities]
    return Paint(coat.tile, np.array(texels)[:, None] * axes, coat.dark, coat.bright)


TextureGenerator = Callable[[int, np.random.Generator], Array]

_WEAK_SHARE = 0.25  # of an area whose contrast is lowered


def paint_tile(size: int, rng: np.random.Generator) -> Array:
    """Return a periodic texture (size, size), 0 … 1, of a kind that is drawn: most often as photographs are."""
    kind = rng.choice(len(KINDS), p=[share for _, share in KINDS])
    texture = KINDS[kind][0](size, rng)
    return np.asarray(np.clip(0.5 + texture * _strength(size, rng), 0, 1))


def _strength(size: int, rng: np.random.Generator) -> Array:
    """Return the contrast (size, size) of a texture: full in most places, a tenth in some."""
    field = cloud(size, 2.2, rng)
    limit = np.quantile(field[::4, ::4], _WEAK_SHARE)
    return np.asarray(0.1 + 0.9 / (1 + np.exp(-(field - limit) / 0.15)))


def cloud(size: int, falloff: float, rng: np.random.Generator) -> Array:
    """Return periodic noise (size, size) of mean 0 and deviation 1, amplitudes falling with frequency^-falloff."""
    frequency = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None])
    frequency[0, 0] = np.inf
    spectrum = (
        np.fft.rfft2(rng.standard_normal((size, size), dtype=np.float32)) * np.maximum(frequency, 2 / size) ** -falloff
    )
    noise = np.fft.irfft2(spectrum, (size, size))
    return np.asarray(noise / noise.std())


def _grain(size: int, rng: np.random.Generator) -> Array:
    """Return noise (size, size) like that of stone or bark, from the finest scale to the coarsest."""
    return 0.17 * cloud(size, rng.uniform(0.7, 1.4), rng)


def _leaves(size: int, rng: np.random.Generator) -> Array:
    """Return discs (size, size) that cover each other: like photographs in their edges and in their scales.

    Source: Lee, Mumford, Huang, Occlusion models for natural images, IJCV 2001.
    """
    image = 0.25 * cloud(size, 1.5, rng)
    count = size * size // 150
    radii = 2.5 * np.minimum((1 - rng.random(count)) ** -0.55, size / 10)
    for radius, column, row, level in zip(
        np.sort(radii)[::-1], *rng.integers(0, size, (2, count)), rng.uniform(-0.42, 0.42, count), strict=True
    ):
        span = np.arange(-int(radius), int(radius) + 1)
        inside = span[:, None] ** 2 + span**2 <= radius**2
        window = np.ix_((row + span) % size, (column + span) % size)
        image[window] = np.where(inside, level, image[window])
    return np.asarray(image + 0.04 * cloud(size, 0.6, rng))


def _stripes(size: int, rng: np.random.Generator) -> Array:
    """Return stripes (size, size), upright or slanted, that repeat every 8 to 24 texels, with some grain."""
    across, down = _waves(size, rng), int(rng.integers(-2, 3))
    phase = 2 * np.pi * (across * np.arange(size) + down * np.arange(size)[:, None]) / size
    wave = np.tanh(rng.uniform(1, 4) * np.sin(phase))
    return np.asarray(0.22 * wave + 0.07 * cloud(size, 1.0, rng))


def _bricks(size: int, rng: np.random.Generator) -> Array:
    """Return a wall (size, size) of bricks that are alike, with joints and some grain."""
    across, down = _waves(size, rng), _waves(size, rng)
    row = np.arange(size) * down / size
    column = np.arange(size) * (across // 2) / size + 0.5 * (np.floor(row) % 2)[:, None]
    level = rng.uniform(-0.2, 0.2, (down, across // 2 + 1))[
        np.floor(row).astype(int)[:, None], np.floor(column).astype(int) % (across // 2)
    ]
    joint = (row % 1 < 0.15)[:, None] | (column % 1 < 0.1)
    return np.asarray(np.where(joint, 0.33, level - 0.1) + 0.06 * cloud(size, 0.9, rng))


def _waves(size: int, rng: np.random.Generator) -> int:
    """Return an even number of periods in a tile, each 8 to 24 texels long."""
    return 2 * round(size / rng.uniform(8, 24) / 2)


def _plaster(size: int, rng: np.random.Generator) -> Array:
    """Return a surface (size, size) that is almost even: a grain of few gray levels over slow changes."""
    return 0.015 * cloud(size, 0.5, rng) + 0.05 * cloud(size, 2.5, rng)


KINDS: tuple[tuple[TextureGenerator, float], ...] = (
    (_leaves, 0.4),
    (_grain, 0.25),
    (_stripes, 0.1),
    (_bricks, 0.13),
    (_plaster, 0.12),
)
