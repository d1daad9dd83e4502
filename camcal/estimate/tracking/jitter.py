"""Jitter of a series of poses, and vibration of camera or object.

Jitter is what is left of each pose when its two neighbours have predicted it. Shakes have three independent causes: the
camera turns about its own centre, the object is shifted, the object is turned. Each has a variance that all frames
share.
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array, FloatArray
from camcal.geometry import rotation as so3

_START = 2e-3  # rad, or share of the distance: initial value
_STRIDE = 1.5  # exponent of a step: the plain rule creeps


@dataclass(frozen=True)
class Jitter:
    """Root mean square of the noise of a pose: translation in m, rotation in rad; NaN for fewer than three poses."""

    translation: float
    rotation: float


def jitter(stamps: Array, rotations: Array, translations: Array, chains: Array) -> Jitter:
    """Return the jitter of poses.

    stamps: (N,) s. rotations: (N, 3, 3). translations: (N, 3), m. chains: (N,) poses of one number belong together.
    A pose between two others is compared with the point between them at its time; white noise of standard deviation σ
    gives σ, a smooth motion next to nothing.
    """
    inner = np.flatnonzero((chains[2:] == chains[1:-1]) & (chains[1:-1] == chains[:-2])) + 1
    if not len(inner):
        return Jitter(float("nan"), float("nan"))
    before, after = inner - 1, inner + 1
    share = ((stamps[inner] - stamps[before]) / (stamps[after] - stamps[before]))[:, None]
    between = translations[before] + share * (translations[after] - translations[before])
    turn = so3.log(rotations[after] @ rotations[before].swapaxes(-1, -2))
    halfway = so3.exp(share * turn) @ rotations[before]
    scale = np.sqrt(1 + share**2 + (1 - share) ** 2)
    shifts = (translations[inner] - between) / scale
    turns = so3.log(rotations[inner] @ halfway.swapaxes(-1, -2)) / scale
    return Jitter(*(float(np.sqrt(np.mean(np.sum(each**2, axis=1)))) for each in (shifts, turns)))


@dataclass(frozen=True)
class JitterStd:
    """Standard deviations of shakes: camera_turn (rad), object_shift (m), object_turn (rad), all per axis."""

    camera_turn: float = 0.0
    object_shift: float = 0.0
    object_turn: float = 0.0

    @classmethod
    def guess(cls, distance: float) -> "JitterStd":
        """Return an initial value for an object that is so far (m) away."""
        return cls(_START, _START * distance / 3, _START)

    @property
    def any(self) -> bool:
        """Whether anything shakes."""
        return max(self.camera_turn, self.object_shift, self.object_turn) > 0

    def covariance(self, translations: Array) -> FloatArray:
        """Return the covariances (N, 6, 6) of the shakes of poses; translations: (N, 3) m."""
        return np.asarray(sum(self._parts(translations)))

    def _parts(self, translations: Array) -> list[Array]:
        arm = np.concatenate([-so3.hat(translations), np.tile(np.eye(3), (len(translations), 1, 1))], axis=1)
        shift, turn = np.zeros((6, 6)), np.zeros((6, 6))
        shift[:3, :3] = turn[3:, 3:] = np.eye(3)
        every = np.ones((len(translations), 1, 1))
        return [
            self.camera_turn**2 * arm @ arm.swapaxes(-1, -2),
            self.object_shift**2 * shift * every,
            self.object_turn**2 * turn * every,
        ]

    def likelier(self, translations: Array, pulls: Array, informed: Array) -> "JitterStd":
        """Return the shaking of the next step to the highest evidence.

        pulls: (N, 6), Σ⁻¹ times the shakes as they were found. informed: (N, 6, 6) of `Spread`. MacKay's rule for one
        variance, cause by cause: σ² ← σ² Σ jᵀ Σ⁻¹ Σᵢ Σ⁻¹ j / Σ tr Σᵢ (H' - H' C H'), Σᵢ the cause's part of Σ.
        """
        result = []
        for name, part in zip(("camera_turn", "object_shift", "object_turn"), self._parts(translations), strict=True):
            squares = float(np.einsum("ni,nij,nj->", pulls, part, pulls))
            known = float(np.einsum("nij,nji->", informed, part))
            factor = squares / max(known, 0.05 * squares, 1e-12)
            result.append(getattr(self, name) * float(np.clip(factor**_STRIDE, 0.02, 20.0)) ** 0.5)
        return JitterStd(*result)
