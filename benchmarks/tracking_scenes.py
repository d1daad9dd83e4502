"""Videos of tags and boards with known poses: four kinds of motion, four targets, clean and dirty.

The projection and the motions are made here, of nothing that the package's own simulation uses. A video has 30 frames a
second of a camera of 1280 × 960 pixels and f = 800 px; pixels have a noise of 0.3 px. Dirty videos have gaps, frames
without a detection, corners that are off by 5 to 60 px and frames in which something else was taken for the target.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array

FOCAL, CENTRE, SIZE = 800.0, (639.5, 479.5), (1280, 960)
NOISE_PX = 0.3
RATE = 30.0
MOTIONS = ("hand", "arm", "fast", "drone")
TARGETS = ("20 px", "45 px", "100 px", "board")
TAG_SIDE = 0.1
_CORNERS = np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]) * TAG_SIDE / 2
_BOARD = np.array([[0.025 * (column - 4), 0.025 * (row - 2.5), 0] for row in range(6) for column in range(9)])
_BOARD_DISTANCE = 1.2
_DROPPED, _WRONG, _BAD_CORNERS = 0.05, 0.03, 0.03
_VIBRATION = 1e-3, 4e-3  # rad, range of the standard deviation of the camera's direction


@dataclass(frozen=True, eq=False)
class Video:
    """What a camera saw of a target in N frames, and where the target was.

    points: (P, 3) m. stamps: (N,) s. rotations, translations: camera_T_object, (N, 3, 3) and (N, 3) m. pixels:
    (N, P, 2), NaN in frames without a detection. right: (N,) whether a frame shows the target, not something else.
    """

    name: str
    points: Array
    stamps: Array
    rotations: Array
    translations: Array
    pixels: Array
    right: Array
    motion: str
    target: str
    dirty: bool


def videos(seeds: range, frames: int = 300) -> Iterator[Video]:
    """Yield the videos of all kinds, one for each seed."""
    for seed in seeds:
        for motion in MOTIONS:
            for target in TARGETS:
                for dirty in (False, True):
                    yield video(motion, target, dirty, seed, frames)


def video(motion: str, target: str, dirty: bool, seed: int, frames: int = 300) -> Video:
    """Return a video of `frames` frames."""
    key = [seed, MOTIONS.index(motion), TARGETS.index(target), int(dirty), 20261]
    rng = np.random.default_rng(key)
    points = _BOARD if target == "board" else _CORNERS
    distance = _BOARD_DISTANCE if target == "board" else FOCAL * TAG_SIDE / float(target.split(maxsplit=1)[0])
    stamps = np.arange(frames) / RATE
    tilt, place = _MOVES[motion](stamps, rng)
    places = np.array([0.0, 0.0, distance]) + place * np.array([0.25, 0.2, 0.15]) * distance
    rotations = _turned(tilt) @ np.diag([1.0, -1.0, -1.0])
    if motion == "drone":
        shake = _turned(rng.normal(size=(frames, 3)) * rng.uniform(*_VIBRATION))
        rotations, places = shake @ rotations, (shake @ places[..., None])[..., 0]
    pixels = _projected(points, rotations, places) + NOISE_PX * rng.normal(size=(frames, len(points), 2))
    right = np.ones(frames, dtype=bool)
    if dirty:
        _spoil(pixels, right, points, rotations, places, rng)
    name = f"{motion}, {target}, {'dirty' if dirty else 'clean'}, seed {seed}"
    return Video(name, points, stamps, rotations, places, pixels, right, motion, target, dirty)


def _waves(stamps: Array, rng: np.random.Generator, slow: float, quick: float, count: int = 3) -> Array:
    """Return motions (N, 3) of amplitude about 1: sums of waves whose frequencies lie between two, in Hz."""
    rates = rng.uniform(slow, quick, (count, 3))
    phases = rng.uniform(0, 2 * np.pi, (count, 3))
    weights = rng.uniform(0.4, 1.0, (count, 3))
    weights /= np.sqrt((weights**2).sum(axis=0))
    return np.asarray((weights * np.sin(2 * np.pi * rates * stamps[:, None, None] + phases)).sum(axis=1))


def _hand(stamps: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """A board in a hand: it turns slowly to and fro through the pose that faces the camera, and trembles a little."""
    tremor = 0.004 * _waves(stamps, rng, 4.0, 8.0)
    tilt = _waves(stamps, rng, 0.1, 0.5) * rng.uniform([0.3, 0.3, 0.2], [0.7, 0.7, 0.6]) + tremor
    return tilt + _lean(rng, 0.35), _waves(stamps, rng, 0.1, 0.5) * 0.6


def _arm(stamps: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """A robot: from pose to pose with the least jerk, resting at each."""
    return _point_to_point(stamps, rng, [0.7, 0.7, 0.8]), _point_to_point(stamps, rng, [0.7] * 3)


def _fast(stamps: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Something that is swung: up to 2 Hz and hundreds of degrees a second."""
    tilt = _waves(stamps, rng, 0.5, 2.0) * rng.uniform([0.3, 0.3, 0.3], [0.6, 0.6, 1.0])
    return tilt + _lean(rng, 0.4), _waves(stamps, rng, 0.4, 1.5) * 0.7


def _drone(stamps: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """A camera in the wind: velocities that are pulled back to nothing and pushed at random."""
    wind = []
    for pull, push in ((0.8, 0.35), (0.6, 0.5)):
        state, rate, series = np.zeros(3), np.zeros(3), []
        for _ in stamps:
            rate = rate + (-pull * rate - 0.6 * state) / RATE + push * np.sqrt(1 / RATE) * rng.normal(size=3)
            state = state + rate / RATE
            series.append(state)
        wind.append(np.array(series))
    return 0.6 * wind[0] + _lean(rng, 0.5), np.clip(wind[1], -1.2, 1.2)


def _lean(rng: np.random.Generator, most: float) -> Array:
    about, tilt = rng.uniform(0, 2 * np.pi), rng.uniform(0, most)
    return np.array([tilt * np.cos(about), tilt * np.sin(about), 0.0])


def _point_to_point(stamps: Array, rng: np.random.Generator, reach: list[float]) -> Array:
    """Return a motion (N, 3) between random points: 10 τ³ - 15 τ⁴ + 6 τ⁵ in 0.6 to 1.6 s, then a rest."""
    here, now = rng.uniform(-1, 1, 3) * reach, 0.0
    result = np.zeros((len(stamps), 3))
    while now <= stamps[-1]:
        there = rng.uniform(-1, 1, 3) * reach
        lasting, rest = rng.uniform(0.6, 1.6), rng.uniform(0.1, 0.8)
        share = np.clip((stamps - now) / lasting, 0, 1)[:, None]
        later = stamps >= now
        result[later] = (here + (there - here) * share**3 * (10 - 15 * share + 6 * share**2))[later]
        here, now = there, now + lasting + rest
    return result


_MOVES = {"hand": _hand, "arm": _arm, "fast": _fast, "drone": _drone}


def _turned(vectors: Array) -> Array:
    """Return the rotations (N, 3, 3) by vectors (N, 3), rad."""
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    x, y, z = (vectors / np.maximum(angle[:, :, 0], 1e-12)).T
    nil = np.zeros_like(x)
    cross = np.stack([nil, -z, y, z, nil, -x, -y, x, nil], axis=1).reshape(-1, 3, 3)
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)


def _projected(points: Array, rotations: Array, places: Array) -> Array:
    seen = points @ rotations.swapaxes(-1, -2) + places[..., None, :]
    return np.asarray(FOCAL * seen[..., :2] / seen[..., 2:] + CENTRE)


def _spoil(
    pixels: Array, right: Array, points: Array, rotations: Array, places: Array, rng: np.random.Generator
) -> None:
    """Take detections away and make others wrong, in place."""
    frames, count = pixels.shape[:2]
    bad = rng.random((frames, count)) < _BAD_CORNERS
    about = rng.uniform(0, 2 * np.pi, (frames, count))
    far = rng.uniform(5, 60, (frames, count))
    pixels += np.where(bad, far, 0.0)[..., None] * np.stack([np.cos(about), np.sin(about)], axis=-1)
    for frame in np.flatnonzero(rng.random(frames) < _WRONG):
        right[frame] = False
        kind = rng.integers(3)
        if kind == 0:  # something else, elsewhere
            turn = _turned(rng.normal(size=(1, 3)) * 0.6)[0] @ rotations[frame]
            place = places[frame] * rng.uniform(0.7, 1.3) + rng.normal(size=3) * 0.1 * places[frame, 2]
            pixels[frame] = _projected(points, turn[None], place[None])[0] + rng.normal(size=(count, 2)) * NOISE_PX
        elif kind == 1:  # the right corners in a wrong order
            pixels[frame] = np.roll(pixels[frame], int(rng.integers(1, count)), axis=0)
        else:  # noise
            pixels[frame] += rng.normal(size=(count, 2)) * 50 * NOISE_PX
    missing = rng.random(frames) < _DROPPED
    for _ in range(3):
        start = int(rng.integers(0, frames))
        missing[start : start + int(rng.integers(4, 25))] = True
    missing[:2] = False
    pixels[missing] = np.nan
    right[missing] = False
