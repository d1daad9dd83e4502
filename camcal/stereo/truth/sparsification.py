"""Whether the pixels that a matcher calls uncertain are the ones that are wrong."""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array, readonly

_STEPS = 100
_LARGEST = 1 << 20  # pixels; of more than that every n-th is enough and sorted in no time


@dataclass(frozen=True, eq=False)
class Sparsification:
    """What average error is left when the least certain pixels are taken out, a hundredth of them at a time.

    by_sigma, by_error: (N,) pixels: with the largest sigma taken out first, and with the largest errors, which no
    sigma can do better. Ilg et al., ECCV 2018, sec. 4.
    """

    by_sigma: Array
    by_error: Array

    def __post_init__(self) -> None:
        for name in ("by_sigma", "by_error"):
            object.__setattr__(self, name, readonly(getattr(self, name), (None,), name))

    @property
    def area(self) -> float:
        """The area between the curves, AUSE, pixels: the mean over the shares taken out."""
        return float(np.mean(self.by_sigma - self.by_error))


def sparsify(error: Array, sigma: Array) -> Sparsification:
    """Return the curves of some pixels; those without sigma do not count, and without any the curves are NaN.

    error, sigma: (N,) pixels, the error without a sign, sigma NaN where it is not known.
    """
    predicted = np.isfinite(sigma)
    step = 1 + np.count_nonzero(predicted) // _LARGEST
    error, sigma = error[predicted][::step], sigma[predicted][::step]
    if not error.size:
        return Sparsification(np.full(_STEPS, np.nan), np.full(_STEPS, np.nan))
    kept = np.maximum(len(error) - np.arange(_STEPS) * len(error) // _STEPS, 1)
    by_sigma, by_error = (
        np.cumsum(error[np.argsort(certainty, kind="stable")], dtype=np.float64)[kept - 1] / kept
        for certainty in (sigma, error)
    )
    return Sparsification(by_sigma, by_error)
