"""A board that is moved before cameras whose rows expose one after another, each camera by a clock of its own.

The motion is a sum of many sinusoids whose amplitudes fall with the frequency, as those of a hand do, and no spline; it
turns and moves a board about a place in view of all cameras. Truth is independent of what the package has for motions.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.targets.board import Board
from camcal.targets.detection import BoardDetection

BOARD = Board("chessboard", 9, 6, 0.025)
SIZE = (1280, 720)
LENS = Camera(model_named("opencv5"), SIZE, np.array([900.0, 903.0, 645.0, 352.0, -0.11, 0.05, 0.0004, -0.0003, 0.01]))


def rotations(vectors):
    """Return the rotations (N, 3, 3) by rotation vectors (N, 3): Rodrigues' formula."""
    angles = np.linalg.norm(vectors, axis=1)[:, None, None]
    x, y, z = (vectors / np.maximum(angles[:, :, 0], 1e-12)).T
    zero = np.zeros_like(x)
    hats = np.moveaxis(np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]), 2, 0)
    return np.eye(3) + np.sin(angles) * hats + (1 - np.cos(angles)) * hats @ hats


@dataclass(frozen=True, eq=False)
class Swing:
    """Offsets (m) and turns (rad) about a place: amplitudes, rates (rad/s) and phases (6, F)."""

    amplitudes: np.ndarray
    rates: np.ndarray
    phases: np.ndarray
    middle: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, 0.5]))
    tilt: np.ndarray = field(default_factory=lambda: np.array([0.25, -0.15, 0.05]))

    def at(self, times):
        """Return rig_T_board of the board's centre at times (N,): rotations (N, 3, 3) and places (N, 3)."""
        waves = np.sin(self.rates[:, :, None] * times + self.phases[:, :, None])
        moved = np.sum(self.amplitudes[:, :, None] * waves, axis=1).T
        return rotations(moved[:, 3:] + self.tilt), self.middle + moved[:, :3]


def by_hand(rng, degrees_per_second=30.0, metres_per_second=0.15, axes=(1, 1, 1, 1, 1, 1), fastest=2.0, sweep=0.35):
    """Return a motion whose RMS turning and moving have these speeds; axes: factors of x y z and the turns; fastest:
    Hz; sweep: rad of slow turns besides, without which a lens would not be determined.
    """
    hertz = rng.uniform(0.1, fastest, (6, 40))
    rates = 2 * np.pi * hertz
    amplitudes = rng.normal(size=(6, 40)) / (0.3**2 + hertz**2)
    phases = rng.uniform(0, 2 * np.pi, (6, 40))
    for rows, speed in ((slice(0, 3), metres_per_second), (slice(3, 6), np.radians(degrees_per_second))):
        amplitudes[rows] *= speed / np.sqrt(np.sum((amplitudes[rows] * rates[rows]) ** 2) / 2)
    amplitudes *= np.array(axes, float)[:, None]
    slow = np.array([[0.0], [0.0], [0.0], [sweep], [0.8 * sweep], [0.5 * sweep]])
    slowly = 2 * np.pi * rng.uniform(0.02, 0.06, (6, 1))
    return Swing(
        np.hstack([amplitudes, slow]), np.hstack([rates, slowly]), np.hstack([phases, rng.uniform(0, 6.28, (6, 1))])
    )


def still(rng):
    """Return no motion at all."""
    return by_hand(rng, axes=(0,) * 6)


def evenly(velocity):
    """Return the motion of a board that moves by velocity (3,) m/s and turns not at all: a very slow swing."""
    rate = 1e-4
    amplitudes = np.concatenate([np.asarray(velocity, float) / rate, np.zeros(3)])[:, None]
    return Swing(amplitudes, np.full((6, 1), rate), np.zeros((6, 1)))


@dataclass(frozen=True, eq=False)
class Clocked:
    """A camera: its lens, where it stands, and when it takes row y of H of frame n: at n / fps + offset +
    rate · n / fps + readout · y / H. jitter: s, of the moments that its stamps do not know.
    """

    lens: Camera = LENS
    turn: Sequence[float] = (0.0, 0.0, 0.0)
    place: Sequence[float] = (0.0, 0.0, 0.0)
    fps: float = 30.0
    offset: float = 0.0
    rate: float = 0.0
    readout: float = 0.0
    jitter: float = 0.0
    start: float = 0.0  # of the stamps, s

    def stamps(self, frames):
        return np.arange(frames) / self.fps + self.start

    def project(self, motion, times):
        """Return the pixels (N, C, 2) of a board's points at times (N,), each exposed at its own row."""
        centred = BOARD.points() - BOARD.points().mean(axis=0)
        [turn] = rotations(np.array([self.turn], float))
        count, height = len(centred), self.lens.image_size[1]
        pixels = np.full((len(times), count, 2), height / 2)
        for _ in range(6 if self.readout else 1):
            moments = times[:, None] + self.readout * pixels[:, :, 1] / height
            poses, places = motion.at(moments.ravel())
            seen = np.einsum("nij,nj->ni", poses, np.tile(centred, (len(times), 1))) + places
            pixels = self.lens.project(seen @ turn.T + np.asarray(self.place)).pixels.reshape(len(times), count, 2)
        return pixels

    def views(self, motion, frames, rng, noise_px=0.1, dropped=0.0, name=""):
        """Return the views of a board: those that lie in the image whole, less a share of dropped frames."""
        stamps = self.stamps(frames)
        moments = stamps + self.offset + self.rate * (stamps - self.start) + self.jitter * rng.normal(size=frames)
        pixels = self.project(motion, moments)
        pixels = pixels + noise_px * rng.normal(size=pixels.shape)
        inside = ((pixels > 5) & (pixels < np.array(self.lens.image_size) - 5)).all(axis=(1, 2))
        inside &= rng.random(frames) >= dropped
        ids = np.arange(len(BOARD.points()))
        return [
            BoardDetection(
                f"{name}{frame:05d}.png", self.lens.image_size, ids, pixels[frame], time=float(stamps[frame])
            )
            for frame in np.flatnonzero(inside)
        ]
