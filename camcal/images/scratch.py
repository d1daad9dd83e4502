"""Memory that is used again from image to image."""

import numpy as np
from numpy.typing import DTypeLike

from camcal.arrays import Array


class Scratch:
    """Arrays by their role, for one thread; fresh memory for 12 MP takes as long as half of decoding them.

    What a role gives is overwritten when the role is asked for again.
    """

    def __init__(self) -> None:
        self._arrays: dict[str, Array] = {}

    def array(self, role: str, shape: tuple[int, ...], dtype: DTypeLike) -> Array:
        """Return an array of this shape and type, its content left from the last use."""
        known = self._arrays.get(role)
        if known is None or known.shape != shape or known.dtype != dtype:
            known = self._arrays[role] = np.empty(shape, dtype)
        return known
