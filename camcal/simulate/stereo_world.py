"""Worlds for two eyes: a back wall and a ramp, and before them slanted planes, discs, rods, boxes and balls."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.geometry import rotation as so3
from camcal.simulate.stereo_surfaces import Ball, Facet, Paint, Surface
from camcal.simulate.stereo_textures import paint_tile

STEEPEST = np.radians(65)  # of a facet against the image; steeper ones are hardly more than a line to both eyes
FINEST = 2.5  # texels per pixel at the most, where a surface is farthest: the point spread leaves little of finer paint
TILES = (128, 2048)  # texels: the smallest and the largest painting before it repeats

_LIGHT = np.array([-0.4, -0.6, -0.69])
LIGHT = _LIGHT / np.linalg.norm(_LIGHT)
_TRIES = 20


@dataclass(frozen=True)
class Sight:
    """What the left eye sees: size (width, height), focal length and principal point in pixels, depths in metres.

    overhang: how many columns the other eye sees on the right beyond these, pixels.
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


class Coat(NamedTuple):
    """A tile to be painted with, (T, T), and the colours (3,) of its darkest and its brightest texels."""

    tile: Array
    dark: Array
    bright: Array


class Place(NamedTuple):
    """Where an object stands (3,) and how far it goes to both sides, metres, and how it is turned (3, 3)."""

    centre: Array
    reach: float
    turn: Array


def make_world(sight: Sight, objects: int, rng: np.random.Generator) -> tuple[Surface, ...]:
    """Return the surfaces of a world that fills the sight between its nearest and its farthest depth."""
    surfaces = _room(sight, rng)
    for number in range(objects):
        surfaces += _fitting(_MAKERS[number % len(_MAKERS)], sight, rng)
    return tuple(surfaces)


def _room(sight: Sight, rng: np.random.Generator) -> list[Surface]:
    """Return a back wall, somewhat oblique, and a ramp before it that comes near at one border, mostly the lower."""
    wall, end = rng.uniform(0.04, 0.3), rng.uniform(0.45, 0.85)
    right, down = rng.uniform(-0.4, 0.4, 2) * wall
    wider = 1 + 2 * sight.overhang / sight.size[0]  # the right eye sees more on the right; the wall goes on there
    foot = rng.uniform(0.3, 0.9) * wall
    rise, lean = end - foot, rng.uniform(-0.1, 0.1)
    ramp = ((lean, rise), (rise, lean), (-rise, lean))[rng.choice(3, p=(0.6, 0.2, 0.2))]
    return [_plane(sight, (wall, right / wider, down), rng), _plane(sight, (foot, *ramp), rng)]


def _plane(sight: Sight, nearness: tuple[float, float, float], rng: np.random.Generator) -> Surface:
    """Return an unbounded plane by its nearness: in the middle, and its growth to the right and to the lower border."""
    middle, right, down = nearness
    width, height = sight.size

    def seen(u: float, v: float) -> Array:
        return sight.at((u + 1) / 2 * (width - 1), (v + 1) / 2 * (height - 1), middle + right * u + down * v)

    centre = seen(0, 0)
    along, towards = seen(0.1, 0) - centre, seen(0, 0.1) - centre
    along /= np.linalg.norm(along)
    across = towards - along * (towards @ along)
    axes = np.stack([along, across / np.linalg.norm(across)])
    steps = (-1.0, 0.0, 1.0)
    spots = np.array([seen(u, v) for u in steps for v in steps if middle + right * u + down * v >= 0])
    return Facet(centre, axes, (np.inf, np.inf), _paint(sight, _coat(max(sight.size), rng), spots, axes))


def _fitting(
    make: Callable[[Sight, np.random.Generator], list[Surface]], sight: Sight, rng: np.random.Generator
) -> list[Surface]:
    """Return an object that lies between the nearest and the farthest depth; none if no try gives one."""
    for _ in range(_TRIES):
        surfaces = make(sight, rng)
        depths = np.concatenate([surface.corners()[:, 2] for surface in surfaces])
        if sight.near <= depths.min() and depths.max() <= sight.far:
            return surfaces
    return []


def _place(sight: Sight, rng: np.random.Generator, steepest: float = STEEPEST) -> Place:
    """Return a place anywhere in the sight for an object of any size, turned any way."""
    width, height = sight.size
    centre = sight.at(rng.uniform(0, width), rng.uniform(0, height), rng.uniform(0.1, 1))
    reach = 0.5 * width * np.exp(rng.uniform(np.log(0.06), np.log(0.4))) * centre[2] / sight.focal
    tilt, azimuth, roll = steepest * np.sqrt(rng.random()), *rng.uniform(-np.pi, np.pi, 2)
    lean = np.array([np.cos(azimuth), np.sin(azimuth), 0]) * tilt
    return Place(centre, float(reach), so3.exp(lean) @ so3.exp(np.array([0, 0, roll])))


def _board(sight: Sight, rng: np.random.Generator) -> list[Surface]:
    centre, reach, turn = _place(sight, rng)
    return [_facet(sight, centre, turn.T[:2], (reach, reach * rng.uniform(0.4, 1)), rng)]


def _disc(sight: Sight, rng: np.random.Generator) -> list[Surface]:
    centre, reach, turn = _place(sight, rng)
    return [_facet(sight, centre, turn.T[:2], (reach, reach * rng.uniform(0.5, 1)), rng, elliptic=True)]


def _rod(sight: Sight, rng: np.random.Generator) -> list[Surface]:
    """Return a strip 3 to 10 pixels wide, nearly upright."""
    centre = _place(sight, rng).centre
    pixel = centre[2] / sight.focal
    axes = so3.exp(np.array([rng.normal(0, 0.2), 0, rng.normal(0, 0.2)])).T[:2]
    reach = pixel * rng.uniform(1.5, 5), pixel * sight.size[1] * rng.uniform(0.15, 0.4)
    return [_facet(sight, centre, axes, reach, rng)]


def _box(sight: Sight, rng: np.random.Generator) -> list[Surface]:
    """Return the six faces of a box under one coat, each in its own light."""
    centre, reach, turn = _place(sight, rng)
    sides = reach * rng.uniform(0.4, 0.8, 3)
    coat = _coat(2 * sides.max() * sight.focal / centre[2], rng)
    faces: list[Surface] = []
    for number in range(3):
        others = [(number + 1) % 3, (number + 2) % 3]
        for outward in (turn[:, number], -turn[:, number]):
            light = 0.75 + 0.25 * outward @ LIGHT
            lit = Coat(coat.tile, light * coat.dark, light * coat.bright)
            place, axes = centre + sides[number] * outward, turn.T[others]
            spots = place + np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)]) * sides[others] @ axes
            faces.append(Facet(place, axes, tuple(sides[others]), _paint(sight, lit, spots, axes)))
    return faces


def _ball(sight: Sight, rng: np.random.Generator) -> list[Surface]:
    centre, reach, _ = _place(sight, rng)
    radius, axes = 0.7 * reach, np.eye(3)[:2]
    coat = _coat(2 * radius * sight.focal / centre[2], rng)
    return [Ball(centre, radius, _paint(sight, coat, centre[None], axes), LIGHT)]


_MAKERS = (_board, _box, _ball, _board, _rod, _disc)


def _facet(
    sight: Sight,
    centre: Array,
    axes: Array,
    reach: tuple[float, float],
    rng: np.random.Generator,
    *,
    elliptic: bool = False,
) -> Facet:
    coat = _coat(2 * max(reach) * sight.focal / centre[2], rng)
    spots = centre + np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)]) * reach @ axes
    return Facet(centre, axes, reach, _paint(sight, coat, spots, axes), elliptic)


def _coat(extent: float, rng: np.random.Generator) -> Coat:
    """Return a coat for a surface that is `extent` pixels long."""
    smallest, largest = TILES
    tile = paint_tile(int(np.clip(2 ** np.ceil(np.log2(extent)), smallest, largest)), rng)
    tint = 1 - 0.35 * rng.random(3) ** 2
    return Coat(tile, rng.uniform(0.02, 0.15) * tint[::-1], rng.uniform(0.5, 1) * tint)


def _paint(sight: Sight, coat: Coat, spots: Array, axes: Array) -> Paint:
    """Return the paint of a surface seen at spots (K, 3): a texel a pixel where it is far, larger where it is near."""
    densities = [sight.density(spots, axis) for axis in axes]
    texels = [min(float(np.median(density)), FINEST * float(density.min())) for density in densities]
    return Paint(coat.tile, np.array(texels)[:, None] * axes, coat.dark, coat.bright)
