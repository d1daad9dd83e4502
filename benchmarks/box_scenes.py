"""Slanted plates before a wall, with textures of one scale a scene: the pairs and their exact disparities.

A plate is a turned rectangle of the left image, its disparity affine in its pixels as a plane's is. Both images are
drawn from the same functions, three by three rays to a pixel; the nearest plate is seen. Textures are noise of 0.7 to
6 px, alone or with stripes of a few pixels, between 4 and 35 counts of contrast.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from stereo_pairs import Pair

SIZE = (480, 360)
SCALES = {"fine": (0.7, 1.2), "medium": (1.5, 3.0), "coarse": (3.5, 6.0)}  # px, standard deviation of the blur
RAYS = 3
FIELD = 400  # px a side of a texture, at which it is repeated as its mirror image


@dataclass(frozen=True)
class Plate:
    """Disparity slopes (2,), offset px; centre, half sides and angle in the left image; texture (H, W) gray levels."""

    slopes: np.ndarray
    offset: float
    centre: np.ndarray
    half: np.ndarray
    angle: float
    texture: np.ndarray

    def seen(self, x: np.ndarray, y: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the columns in the left image of what is at pixels of an image, and its disparities, NaN off it."""
        base = self.slopes[1] * y + self.offset
        column = x if side == 0 else (x + base) / (1 - self.slopes[0])
        turn = np.exp(-1j * self.angle) * ((column - self.centre[0]) + 1j * (y - self.centre[1]))
        inside = (np.abs(turn.real) <= self.half[0]) & (np.abs(turn.imag) <= self.half[1])
        return column, np.where(inside, self.slopes[0] * column + base, np.nan)


def box_scenes(seeds: Sequence[int]) -> Iterator[Pair]:
    """Yield the pairs of every seed, one of each scale of texture."""
    for seed in seeds:
        for number, (name, scales) in enumerate(SCALES.items()):
            yield box_scene(f"{name} {seed}", np.random.default_rng([3011, seed, number]), scales)


def box_scene(name: str, rng: np.random.Generator, scales: tuple[float, float]) -> Pair:
    far = rng.uniform(4, 12)
    plates = [plate(rng, far, 3.0 * np.array(SIZE), scales, slope=0.015)]
    plates += [plate(rng, rng.uniform(far + 4, 60), rng.uniform(25, 90, 2), scales, slope=0.12) for _ in range(6)]
    views, tops, truths = zip(*(view(plates, side) for side in (0, 1)), strict=True)
    gain = rng.uniform(0.97, 1.03)
    left, right = (np.clip(np.rint(image + rng.normal(0, 0.8, image.shape)), 0, 255).astype(np.uint8)
                   for image in (views[0], views[1] * gain))  # fmt: skip
    truth, middle = truths[0], RAYS // 2
    x, y = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    there = np.rint(x - truth).astype(int)
    inside = (there >= 0) & (there < SIZE[0])
    own, other = tops[0][middle::RAYS, middle::RAYS], tops[1][middle::RAYS, middle::RAYS]
    visible = inside & (other[y, there.clip(0, SIZE[0] - 1)] == own)
    return Pair(name, left, right, truth.astype(np.float32), visible, 80)


def plate(
    rng: np.random.Generator, disparity: float, half: np.ndarray, scales: tuple[float, float], slope: float
) -> Plate:
    centre, slopes = rng.uniform(0.1, 0.9, 2) * SIZE, rng.uniform(-slope, slope, 2)
    slopes *= min(1.0, 0.5 * disparity / (np.abs(slopes) @ half))  # all of it in front of the cameras
    return Plate(slopes, disparity - slopes @ centre, centre, half, rng.uniform(-0.5, 0.5), texture(rng, scales))


def texture(rng: np.random.Generator, scales: tuple[float, float]) -> np.ndarray:
    """Return gray levels (H, W), RAYS to a pixel."""
    side = FIELD * RAYS
    field = cv2.GaussianBlur(rng.normal(size=(side, side)).astype(np.float32), (0, 0), RAYS * rng.uniform(*scales))
    field /= field.std()
    if rng.random() < 0.3:
        step = np.arange(side) / RAYS * 2 * np.pi / rng.uniform(6, 14)
        field += 0.5 * np.sin(step * rng.uniform(0.3, 1) + (step * rng.uniform(-1, 1))[:, None]).astype(np.float32)
    return rng.uniform(70, 180) + rng.uniform(4, 35) * field


def view(plates: Sequence[Plate], side: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return an image (H, W), the numbers of the plates seen by its rays, and the disparities (H, W) of its pixels."""
    x, y = np.meshgrid(*((np.arange(RAYS * count) - RAYS // 2) / RAYS for count in SIZE))
    best, top, light = np.full(x.shape, -np.inf), np.zeros(x.shape, int), np.zeros(x.shape, np.float32)
    for number, each in enumerate(plates):
        column, disparity = each.seen(x, y, side)
        nearer = disparity > best
        where = [(RAYS * (axis + 100)).astype(np.float32) for axis in (column, y)]
        shown = cv2.remap(each.texture, *where, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        best, top, light = (
            np.where(nearer, disparity, best),
            np.where(nearer, number, top),
            np.where(nearer, shown, light),
        )
    middle = RAYS // 2
    return cv2.resize(light, SIZE, interpolation=cv2.INTER_AREA), top, best[middle::RAYS, middle::RAYS]
