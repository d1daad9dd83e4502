"""How much a series of poses trembles: what is left of each pose when its two neighbours have predicted it."""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.geometry import rotation as so3


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
