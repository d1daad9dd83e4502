"""The plane of a flat object, and what it looks the same as from far away."""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.estimate.tracking.free_motion import MotionState
from camcal.estimate.tracking.pixel_costs import PixelFrames


@dataclass(frozen=True)
class Flat:
    """The plane of an object: its normal (3,) and middle (3,)."""

    normal: Array
    middle: Array

    @classmethod
    def of(cls, frames: PixelFrames) -> "Flat | None":
        """Return the plane of all points of frames, None if they are in none."""
        points = np.unique(frames.points[frames.there], axis=0)
        middle = points.mean(axis=0)
        _, spreads, axes = np.linalg.svd(points - middle, full_matrices=False)
        return cls(axes[2], middle) if spreads[2] < 0.05 * spreads[1] else None

    def sight(self, rotations: Array, translations: Array) -> Array:
        """Return the unit directions (N, 3) from the camera to the middle."""
        seen = rotations @ self.middle + translations
        return np.asarray(seen / np.linalg.norm(seen, axis=-1, keepdims=True))

    def tilt(self, rotations: Array, translations: Array) -> Array:
        """Return the angles (N) between the normal and the line of sight, rad."""
        cosine = np.abs((self.sight(rotations, translations) * (rotations @ self.normal)).sum(axis=-1))
        return np.asarray(np.arccos(np.clip(cosine, 0, 1)))

    def mirrored(self, rotations: Array, translations: Array) -> tuple[Array, Array]:
        """Return the poses that look the same from far away: the plane reflected across the line of sight."""
        sight = self.sight(rotations, translations)
        across = np.eye(3) - 2 * sight[:, :, None] * sight[:, None, :]
        turned = across @ rotations @ (np.eye(3) - 2 * np.outer(self.normal, self.normal))
        return turned, translations + (rotations - turned) @ self.middle

    def mirrored_states(self, states: MotionState) -> MotionState:
        """Return the mirrored poses of states, turning the way that mirrored motions turn."""
        sight = self.sight(states.rotations, states.translations)[:, None]
        rates = states.rates.copy()
        turning = rates[..., 3:]
        # a reflection by I - 2 v vᵀ takes ω to -(I - 2 v vᵀ) ω: a turn about the line of sight stays
        rates[..., 3:] = 2 * sight * (turning * sight).sum(axis=-1, keepdims=True) - turning
        return MotionState(*self.mirrored(states.rotations, states.translations), rates)
