"""Paintings for a world that is to be matched: rich in scale, with edges, weak patches, and some that repeat."""

from collections.abc import Callable

import numpy as np

from camcal.arrays import Array

Texture = Callable[[int, np.random.Generator], Array]

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


KINDS: tuple[tuple[Texture, float], ...] = (
    (_leaves, 0.4),
    (_grain, 0.25),
    (_stripes, 0.1),
    (_bricks, 0.13),
    (_plaster, 0.12),
)
