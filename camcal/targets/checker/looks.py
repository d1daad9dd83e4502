"""A quick look at places where corners of a checker pattern should be: are they, and where to a part of a pixel.

Around a corner the image is sampled along its two edges in the board's own directions, so that every corner looks the
same however it is tilted, and fitted linearly with the picture of a corner, its derivatives by both directions and a
plane. A few rounds of this lead to the corner (Baker and Matthews 2004, inverse compositional alignment).
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.special import erf

from camcal import opencv
from camcal.arrays import Array

# How far along the edges to look, as a share of the steps and in pixels at most: the last one samples every pixel or
# two, which it takes to tell where a sharp edge lies.
FAR = ((0.55, 200.0), (0.4, 50.0))
NEAR = ((0.3, 15.0), (0.2, 6.0))
VERDICT = (0.3, 40.0)
LEAST_PX = 2.0  # a reach that pixels can show
BESIDE_LEAST = 0.25  # of the reach, how far from an edge samples lie at least, however narrow the clearance
BLURS = (0.12, 0.4)  # of the reach: pictures of a sharp corner and of a blurred one
SAMPLES = 5  # on each side of the corner
SAMPLES_BESIDE = 3  # on each side of an edge
ROUNDS = 2
LARGEST_STEP = 0.5  # of the reach in a round


@dataclass(frozen=True, eq=False)
class Looks:
    """What is seen at N places.

    pixels: (N, 2). contrast: (N,) gray levels, half of bright minus dark, positive where the square before both steps
    is dark. agreement: (N,) share of the variance about a plane that the picture of a corner explains.
    """

    pixels: Array
    contrast: Array
    agreement: Array


@dataclass(frozen=True, eq=False)
class _Stencil:
    """Places (2, K) in reaches, and what to multiply the samples there with.

    solve: (3, K), gives the contrast and minus the contrast times the shift. plane: (K, K) takes the plane out.
    pictures: (B, K) corners of different blur without their planes, of length 1. peak: (B,) their contrast.
    """

    places: Array
    solve: Array
    plane: Array
    pictures: Array
    peak: Array


def look(gray: Array, pixels: Array, steps: Array, clearance: float = np.inf, *, far: bool = False) -> Looks:
    """Return the corners that are seen near pixels (N, 2) of `gray`, (H, W) uint8.

    steps: (N, 2, 2), columns are the vectors to the next corner along the row and down the column. clearance: how far
    from the nearer edge, in steps, samples may lie. far: the corner may be half a step away.
    """
    for limit in (*FAR, *NEAR) if far else NEAR:
        pixels = _approached(gray, pixels, steps, clearance, limit)
    return glance(gray, pixels, steps, clearance)


def glance(gray: Array, pixels: Array, steps: Array, clearance: float = np.inf) -> Looks:
    """Return what is seen of corners just at pixels (N, 2), see `look`."""
    stencil, frames = _stencil_for(steps, clearance, VERDICT)
    values = _values(gray, pixels, stencil, frames) @ stencil.plane
    total = (values**2).sum(axis=1)
    scores = values @ stencil.pictures.T
    best = np.abs(scores).argmax(axis=1)
    score = scores[np.arange(len(scores)), best]
    inside = ((pixels > -0.5) & (pixels < np.array(gray.shape[::-1]) - 0.5)).all(axis=1)
    rounding = values.shape[1] / 12  # gray levels squared
    agreement = np.where(inside, score**2 / (total + rounding), 0.0)
    return Looks(pixels, -score * stencil.peak[best], agreement)


def _approached(gray: Array, pixels: Array, steps: Array, clearance: float, limit: tuple[float, float]) -> Array:
    """Return the corners nearer to where they are, by a few rounds with one reach."""
    stencil, frames = _stencil_for(steps, clearance, limit)
    for _ in range(ROUNDS):
        values = _values(gray, pixels, stencil, frames) @ stencil.solve.T
        contrast = values[:, :1]
        flat = np.abs(contrast) < 1e-3
        shift = np.where(flat, 0.0, -values[:, 1:] / np.where(flat, 1.0, contrast))
        shift = np.clip(shift, -LARGEST_STEP, LARGEST_STEP)
        pixels = pixels + (frames @ shift[..., None])[..., 0]
    return pixels


def _values(gray: Array, pixels: Array, stencil: _Stencil, frames: Array) -> Array:
    """Return the gray levels (N, K) at the stencil's places around pixels (N, 2)."""
    x, y = (pixels[:, axis, None] + frames[:, axis] @ stencil.places for axis in (0, 1))
    return opencv.sampled(gray, x, y)


def _stencil_for(steps: Array, clearance: float, limit: tuple[float, float]) -> tuple[_Stencil, Array]:
    """Return the stencil and the frames (N, 2, 2): a reach along the row and down the column, pixels."""
    share, most = limit
    lengths = np.maximum(np.linalg.norm(steps, axis=1), 1e-9)
    reach = np.clip(share * lengths, LEAST_PX, most) / lengths
    beside = float(np.clip(clearance / share, BESIDE_LEAST, 1.0))
    return _stencil(round(beside, 2)), steps * reach[:, None]


@cache
def _stencil(beside: float) -> _Stencil:
    along, aside = _both_ways(SAMPLES), beside * _both_ways(SAMPLES if beside == 1 else SAMPLES_BESIDE)
    u, v = np.stack(np.meshgrid(along, aside)).reshape(2, -1)
    if beside < 1:
        u, v = np.concatenate([u, v]), np.concatenate([v, u])
    plane = np.stack([np.ones_like(u), u, v], axis=1)
    blur = BLURS[-1]
    slope_u, slope_v = (np.sqrt(2 / np.pi) / blur * np.exp(-((w / blur) ** 2) / 2) for w in (u, v))
    side_u, side_v = (erf(w / np.sqrt(2) / blur) for w in (u, v))
    design = np.column_stack([np.ones_like(u), side_u * side_v, slope_u * side_v, side_u * slope_v])
    without = np.eye(len(u)) - plane @ np.linalg.pinv(plane)
    pictures = np.stack([erf(u / np.sqrt(2) / blur) * erf(v / np.sqrt(2) / blur) for blur in BLURS]) @ without
    lengths = np.linalg.norm(pictures, axis=1)
    return _Stencil(
        np.stack([u, v]).astype(np.float32),
        np.linalg.pinv(design)[1:].astype(np.float32),
        without.astype(np.float32),
        (pictures / lengths[:, None]).astype(np.float32),
        1 / lengths,
    )


def _both_ways(count: int) -> Array:
    one = (np.arange(count) + 0.5) / count
    return np.concatenate([-one[::-1], one])
