"""How much corners count: by the covariance that their images give them, and by what is wrong with all of them alike.

The covariance of a corner says what noise and blur leave open. Paper that is not flat, print that is not exact and a
lens model that is not quite right add errors that no image tells of. They are taken to be the same for all corners,
f² in each coordinate, and f is the one under which the residuals of a calibration are likeliest.
"""

import numpy as np
from scipy.optimize import minimize_scalar

from camcal.arrays import Array

_WIDEST = 1e3  # times the root mean square residual and its fraction: where f is looked for
_NEGLIGIBLE = 0.1  # of the typical claimed error; less makes no difference


def floor_of(residuals: Array, covariances: Array, freedom: float) -> float:
    """Return the standard deviation f (px) that every coordinate has beyond the covariances, 0 if there is none.

    residuals: (N, 2) px of a calibration. covariances: (N, 2, 2) px². freedom: degrees of freedom per coordinate, below
    1 as residuals of a fit are too small.
    """
    squared = float(np.mean(residuals**2)) / freedom
    claimed = float(np.median(np.trace(covariances, axis1=1, axis2=2))) / 2
    if squared == 0:
        return 0.0

    def unlikeliness(logarithm: float) -> float:
        total = covariances + np.exp(2 * logarithm) * np.eye(2)
        determinant = total[:, 0, 0] * total[:, 1, 1] - total[:, 0, 1] ** 2
        x, y = residuals.T
        chi2 = (total[:, 1, 1] * x * x - 2 * total[:, 0, 1] * x * y + total[:, 0, 0] * y * y) / determinant
        return float(np.sum(np.log(determinant) + chi2 / freedom))

    middle = np.log(squared) / 2
    best = minimize_scalar(unlikeliness, bounds=(middle - np.log(_WIDEST), middle + np.log(_WIDEST)), method="bounded")
    floor = float(np.exp(best.x))
    return floor if floor**2 > _NEGLIGIBLE**2 * claimed else 0.0
