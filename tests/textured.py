"""Pairs drawn from one texture, so that every pixel's disparity and the error of its row are known."""

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

MARGIN = 100  # px of texture beyond the image


def textured_pair(disparity, rows=0.0, *, seed=1, grain=1.2):
    """Return a pair (H, W) uint8 with a disparity (H, W), pixels, and rows off by `rows`, right minus left.

    rows: one number, or (3,): what stereo.alignment calls rows. grain: px; the texture is noise as fine as that and
    coarser, alike at all sizes as in photographs. Nothing may hide anything: disparity rises by less than 1 per pixel.
    """
    height, width = disparity.shape
    rng = np.random.default_rng(seed)
    size = height + 2 * MARGIN, width + 2 * MARGIN
    blurred = [gaussian_filter(rng.normal(size=size), grain * factor) for factor in (1, 4, 16)]
    texture = 128 + 25 * sum(noise / noise.std() for noise in blurred)
    across, down = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    slope_u, slope_v, level = (0.0, 0.0, rows) if np.isscalar(rows) else rows
    # Row v of the left image is row v + dy of the right one; this inverts that for the right one's rows.
    there = (down - level - slope_u * across) / (1 + slope_v)
    return _sampled(texture, across - disparity, down), _sampled(texture, across, there)


def _sampled(texture, across, down):
    values = map_coordinates(texture, [down + MARGIN, across + MARGIN], order=3, mode="reflect")
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def waves(low, high, size=(320, 240)):
    """Return a disparity (H, W) that goes from low to high and back across the image, and is bent down it."""
    width, height = size
    across, down = np.meshgrid(np.linspace(0, 2 * np.pi, width), np.linspace(0, 2, height))
    return (low + high) / 2 + (high - low) / 2 * np.sin(across + down)


def noisy(image, sigma=5.0, seed=2):
    return np.clip(np.rint(image + np.random.default_rng(seed).normal(0, sigma, image.shape)), 0, 255).astype(np.uint8)


def darker(image, gamma=1.4, gain=0.8, offset=10.0):
    """Return an image of another exposure."""
    return np.clip(np.rint(gain * 255 * (image / 255) ** gamma + offset), 0, 255).astype(np.uint8)
