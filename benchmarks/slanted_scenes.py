"""Rectified pairs of slanted, partly textureless planes with their exact disparity, ray by ray.

A scene is a wall, a floor, often a side wall, boards that stand at any angle and boxes; each plane has a texture of
its own, fixed to the plane: fine, coarse, streaks, stripes that repeat, next to none, or none but light that falls off.
Every pixel is the mean of 3 x 3 rays through it, for each camera by itself; then come blur and noise. It shares nothing
with `camcal simulate`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from stereo_pairs import Pair, up

RAYS = 3  # of a pixel, along each axis
LATTICE = 256  # values of a texture along each side, after which it repeats
KINDS = {"fine": 0.3, "coarse": 0.2, "streaks": 0.12, "stripes": 0.08, "faint": 0.15, "plain": 0.15}  # how often
FAINT, PLAIN = 2.0, 0.0  # gray levels of contrast


@dataclass(frozen=True)
class Texture:
    """Gray levels of a point of a plane: lattice (256, 256), metres per value along both axes, levels, colour (3,)."""

    lattice: np.ndarray
    step: tuple[float, float]
    contrast: float
    colour: np.ndarray
    falloff: float


@dataclass(frozen=True)
class Plane:
    """A part of a plane: corner (3,), unit axes (2, 3), metres; extent (2, 2) of both, or None if it has no end."""

    corner: np.ndarray
    axes: np.ndarray
    extent: np.ndarray | None
    round: bool
    texture: Texture


def slanted_scenes(seeds: Sequence[int]) -> Iterator[Pair]:
    """Yield the pair of every seed."""
    for seed in seeds:
        yield slanted_scene(seed)


def slanted_scene(seed: int, size: tuple[int, int] | None = None) -> Pair:
    """Return the pair of a seed; size: (width, height), pixels, None for one of its own."""
    rng = np.random.default_rng([7141, seed])
    width, height = size or [(480, 360), (640, 480), (720, 480)][rng.integers(3)]
    focal = width * rng.uniform(0.75, 1.2)
    planes = room(rng, width / focal)
    nearest = rng.uniform(0.09, 0.16) * width  # px, of what is 1.5 m away
    baseline = 1.5 * nearest / focal
    images, depths = zip(*(view(planes, focal, (width, height), x) for x in (0.0, baseline)), strict=True)
    truth, other = (focal * baseline / depth for depth in depths)
    blur, noise, gain = rng.uniform(0.3, 0.6), rng.uniform(0.5, 2.0), rng.uniform(0.97, 1.03)
    left, right = (developed(image, blur, noise, level, rng) for image, level in zip(images, (1.0, gain), strict=True))
    return Pair(f"slanted {seed}", left, right, truth.astype(np.float32), seen(truth, other), up(truth.max() + 8))


def room(rng: np.random.Generator, field: float) -> list[Plane]:
    """Return the planes of a scene; x to the right, y down, z forward, from the left camera."""
    distance = rng.uniform(4, 6)
    yaw = rng.uniform(-0.7, 0.7)
    planes = [
        plane(rng, (0, 0, distance), facing(yaw, rng.uniform(-0.15, 0.15))),
        plane(rng, (0, rng.uniform(0.7, 1.3), 0), np.array([[1.0, 0, 0], [0, 0, 1]])),
    ]
    if rng.random() < 0.5:
        side = rng.choice([-1, 1])
        axes = np.array([[0, 0, 1.0], [0, 1, 0]])
        planes.append(plane(rng, (side * rng.uniform(1.3, 2.2), 0, 0), axes))
    for _ in range(rng.integers(3, 8)):
        z = rng.uniform(1.6, 3.8)
        centre = (rng.uniform(-0.45, 0.45) * field * z, rng.uniform(-0.5, 0.5) * 0.7 * field * z, z)
        axes = facing(rng.uniform(-1.1, 1.1), rng.uniform(-0.9, 0.9), rng.uniform(-0.5, 0.5))
        half = rng.uniform(0.12, 0.5, 2) * z / 2.5
        planes.append(plane(rng, centre, axes, np.column_stack([-half, half]), oval=rng.random() < 0.25))
    for _ in range(rng.integers(0, 3)):
        planes.extend(box(rng, field))
    return planes


def box(rng: np.random.Generator, field: float) -> list[Plane]:
    """Return the six faces of a box."""
    z = rng.uniform(1.8, 3.2)
    centre = np.array([rng.uniform(-0.4, 0.4) * field * z, rng.uniform(0, 0.35) * field * z, z])
    turned = facing(rng.uniform(-0.8, 0.8), rng.uniform(-0.3, 0.3))
    frame = np.vstack([turned, np.cross(*turned)])
    half = rng.uniform(0.1, 0.35, 3)
    faces = []
    for axis in range(3):
        others = [index for index in range(3) if index != axis]
        extent = np.column_stack([-half[others], half[others]])
        faces.extend(plane(rng, centre + side * half[axis] * frame[axis], frame[others], extent) for side in (-1, 1))
    return faces


def facing(yaw: float, pitch: float, roll: float = 0.0) -> np.ndarray:
    """Return the axes (2, 3) of a plane that faces the camera but for three angles, radians."""
    a, b, c = (np.array([np.cos(angle), np.sin(angle)]) for angle in (yaw, pitch, roll))
    about_y = np.array([[a[0], 0, a[1]], [0, 1, 0], [-a[1], 0, a[0]]])
    about_x = np.array([[1, 0, 0], [0, b[0], -b[1]], [0, b[1], b[0]]])
    about_z = np.array([[c[0], -c[1], 0], [c[1], c[0], 0], [0, 0, 1]])
    return (about_y @ about_x @ about_z)[:, :2].T


def plane(
    rng: np.random.Generator,
    corner: Sequence[float],
    axes: np.ndarray,
    extent: np.ndarray | None = None,
    *,
    oval: bool = False,
) -> Plane:
    return Plane(np.asarray(corner, float), np.asarray(axes, float), extent, oval, texture(rng))


def texture(rng: np.random.Generator) -> Texture:
    kind = rng.choice(list(KINDS), p=list(KINDS.values()))
    noise = rng.normal(size=(LATTICE, LATTICE))
    step, contrast = rng.uniform(0.004, 0.012), rng.uniform(12, 35)
    steps = step, step
    if kind == "coarse":
        noise = sum(smooth(rng.normal(size=noise.shape), sigma) for sigma in (1, 4, 12))
    elif kind == "streaks":
        noise, steps = smooth(noise, 1), (step, 20 * step)
    elif kind == "stripes":
        cycles = int(rng.integers(12, 40))
        across = np.arange(LATTICE) * 2 * np.pi * cycles / LATTICE
        noise = np.sin(across)[None, :] + 0.1 * noise
    elif kind in ("faint", "plain"):
        noise, contrast = smooth(noise, 1), FAINT if kind == "faint" else PLAIN
    noise = (noise - noise.mean()) / noise.std()
    colour = rng.uniform(50, 200) * rng.uniform(0.75, 1.25, 3)
    return Texture(noise.astype(np.float32), steps, contrast, colour, rng.uniform(-0.08, 0.08))


def smooth(values: np.ndarray, sigma: float) -> np.ndarray:
    """Return values blurred with what lies beyond an edge taken from the opposite one, of standard deviation 1."""
    frequency = np.fft.fftfreq(LATTICE)
    kernel = np.exp(-2 * (np.pi * sigma) ** 2 * (frequency[:, None] ** 2 + frequency**2))
    blurred = np.real(np.fft.ifft2(np.fft.fft2(values) * kernel))
    return blurred / blurred.std()


def view(planes: Sequence[Plane], focal: float, size: tuple[int, int], x: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the image (H, W, 3) of a camera at x metres and the depth (H, W) along its axis at the pixels' centres."""
    width, height = size
    places = ((np.arange(n * RAYS) + 0.5) / RAYS - 0.5 - (n - 1) / 2 for n in (width, height))
    across, down = np.meshgrid(*places)
    rays = np.stack([across / focal, down / focal, np.ones_like(across)], axis=-1)
    depth = np.full(across.shape, np.inf)
    colours = np.zeros((*across.shape, 3), np.float32)
    for part in planes:
        normal = np.cross(*part.axes)
        with np.errstate(divide="ignore", invalid="ignore"):
            away = normal @ (part.corner - [x, 0, 0]) / (rays @ normal)
        hit = (away > 0.3) & (away < depth)
        points = away[hit, None] * rays[hit] + np.array([x, 0, 0]) - part.corner
        on = points @ part.axes.T
        if part.extent is not None:
            half = part.extent[:, 1]
            inside = np.hypot(*(on / half).T) <= 1 if part.round else (np.abs(on) <= half).all(axis=1)
            hit[hit] = inside
            on = on[inside]
        depth[hit] = away[hit]
        colours[hit] = painted(part.texture, on)
    image = cv2.resize(colours, size, interpolation=cv2.INTER_AREA)
    return image, depth[RAYS // 2 :: RAYS, RAYS // 2 :: RAYS]


def painted(texture: Texture, on: np.ndarray) -> np.ndarray:
    """Return the colours (N, 3) of points (N, 2) of a plane, metres."""
    u, v = (on / texture.step).T
    whole = np.floor(u).astype(int), np.floor(v).astype(int)
    part = u - whole[0], v - whole[1]
    column, row = (each % LATTICE for each in whole)
    right, below = (column + 1) % LATTICE, (row + 1) % LATTICE
    grid = texture.lattice
    top = grid[row, column] * (1 - part[0]) + grid[row, right] * part[0]
    bottom = grid[below, column] * (1 - part[0]) + grid[below, right] * part[0]
    value = top * (1 - part[1]) + bottom * part[1]
    light = 1 + texture.falloff * np.tanh(on.sum(axis=1))
    return light[:, None] * texture.colour + texture.contrast * value[:, None]


def developed(image: np.ndarray, blur: float, noise: float, gain: float, rng: np.random.Generator) -> np.ndarray:
    blurred = cv2.GaussianBlur(image, (0, 0), blur)
    return np.clip(np.rint(gain * blurred + rng.normal(0, noise, image.shape)), 0, 255).astype(np.uint8)


def seen(truth: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return which pixels (H, W) of the left image the right one shows, by the disparity of both."""
    width = truth.shape[1]
    there = np.rint(np.arange(width) - truth).astype(int)
    inside = (there >= 0) & (there < width)
    back = np.take_along_axis(other, np.clip(there, 0, width - 1), axis=1)
    return inside & (np.abs(back - truth) <= 1 + 0.02 * truth)
