"""Mosaics for tests of whatever reads or filters them."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from camcal.raw.mosaic import sites

PEAK = {np.uint8: 255, np.uint16: 65535, np.float32: 1}


def random_mosaic(shape, dtype, seed=5):
    return (np.random.default_rng(seed).random(shape) * PEAK[dtype]).astype(dtype)


def sampled(colour_image, pattern):
    """Return the mosaic that a sensor behind the pattern makes of (H, W, 3) blue, green, red."""
    mosaic = np.empty(colour_image.shape[:2], colour_image.dtype)
    for channel, colour in enumerate("BGR"):
        for site in sites(pattern, colour):
            mosaic[site] = colour_image[..., channel][site]
    return mosaic


def plain_colour(shape, dtype):
    """Return an image (H, W, 3) of one colour, its three numbers far from each other."""
    colour = (np.array([0.8, 0.2, 0.6]) * PEAK[dtype]).astype(dtype)
    return np.broadcast_to(colour, (*shape, 3))


def scene(shape, seed=3):
    """Return an image (H, W, 3), 0 … 1, with edges, fine texture and colours that vary together, as scenes do."""
    rng = np.random.default_rng(seed)
    rows, columns = np.indices(shape)
    light = 0.5 + 0.2 * np.sin(columns / 2.9 + rows / 7.3) + 0.15 * np.sign(np.sin(rows / 5.1 - columns / 9.7))
    texture = 0.06 * rng.standard_normal(shape)
    tint = 0.1 * np.stack([np.sin(rows / 11 + columns / 17 + turn) for turn in (0, 2, 4)], -1)
    return np.clip(light[..., None] * np.array([0.7, 1.0, 0.8]) + texture[..., None] + tint, 0, 1)


def by_threads(work, items):
    """Do the work for each item in some order, several at a time: an `Each` of filters."""
    with ThreadPoolExecutor(3) as pool:
        list(pool.map(work, list(items)[::-1]))
