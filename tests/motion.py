"""Moving objects with known truth: where they are over time, and the pixels a camera sees of them."""

import numpy as np

from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose, Trajectory

FRAMES = "camera_T_object"
_PULL = 0.5  # 1/s; slow beside what a filter follows, and keeps the object in the image
_WRONG = 50.0  # times as noisy is a frame that went wrong


def drifting(stamps: Array, middle: Pose, densities: tuple[float, float], rng: np.random.Generator) -> Trajectory:
    """Return a motion with white-noise acceleration that starts at rest at a pose, and that a weak pull keeps near it.

    stamps: (N,) s. densities: of translation, m²/s³, and rotation, rad²/s³.
    """
    offsets, rates = [np.zeros(6)], np.zeros(6)
    spread = np.sqrt(np.repeat(densities, 3))
    for dt in np.diff(stamps):
        root = np.linalg.cholesky([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        shift, change = root @ rng.normal(size=(2, 6)) * spread
        pull = -_PULL * (_PULL * offsets[-1] + rates)
        offsets.append(offsets[-1] + rates * dt + pull * dt**2 / 2 + shift)
        rates = rates + pull * dt + change
    return _about(stamps, middle, np.array(offsets))


def swaying(stamps: Array, middle: Pose, reach: float, turn: float, rng: np.random.Generator) -> Trajectory:
    """Return a motion to and fro about a pose: by `reach` metres and `turn` radians in each axis, 0.1 … 0.3 Hz."""
    rates, phases = 2 * np.pi * rng.uniform(0.1, 0.3, 6), rng.uniform(0, 2 * np.pi, 6)
    return _about(stamps, middle, np.repeat([reach, turn], 3) * np.sin(rates * stamps[:, None] + phases))


def _about(stamps: Array, middle: Pose, offsets: Array) -> Trajectory:
    rotations = so3.exp(offsets[:, 3:]) @ middle.rotation
    return Trajectory(FRAMES, stamps, rotations, middle.translation + offsets[:, :3])


def seen(
    camera: Camera,
    points: Array,
    truth: Trajectory,
    noise_px: float,
    rng: np.random.Generator,
    *,
    dropped: float = 0.0,
    outliers: float = 0.0,
) -> list[Array | None]:
    """Return the pixels (P, 2) of points (P, 3) in every frame, None for a share of dropped ones.

    A share `outliers` of the frames is 50 times as noisy, as with a detector that took other corners.
    """
    frames: list[Array | None] = []
    for rotation, translation in zip(truth.rotations, truth.translations, strict=True):
        pixels = camera.project(points @ rotation.T + translation).pixels
        spread = _WRONG if rng.random() < outliers else 1.0
        pixels = pixels + rng.normal(size=pixels.shape) * spread * noise_px
        frames.append(None if rng.random() < dropped else pixels)
    return frames
