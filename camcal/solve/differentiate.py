"""Numerical derivatives, to check the analytic ones by.

Numerator layout throughout: a Jacobian has a row for each value and a column for each variable, J[i, j] = ∂f_i/∂x_j.
A function on a manifold is differentiated as a function of the step: `lambda d: f(retract(state, d))` at zero.
"""

from collections.abc import Callable

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass

Function = Callable[[Array], Array]

_STEP = np.finfo(float).eps ** 0.2  # of a variable: balances rounding against the fifth derivative
_TINY = 1e-100  # a step so small that its square is lost beside anything


@dataclass(frozen=True)
class JacobianCheck:
    """How far an analytic Jacobian is from a numerical one, and where it is worst.

    error: the largest difference, as a share of the largest number in its column. method: complex or central.
    """

    error: float
    row: tuple[int, ...]
    column: int
    analytic: float
    numeric: float
    method: str


def central_jacobian(function: Function, at: Array, step: float | Array | None = None) -> Array:
    """Return the derivatives (..., K) of a function of a vector (K,), by central differences at two distances.

    step: the larger distance for each variable, by default in proportion to it. Extrapolated to the fourth order
    (Richardson 1911): errors are near 1e-12 of the function's size over the step for functions of ordinary curvature.
    """
    at = np.asarray(at, dtype=float)
    steps = np.broadcast_to(_STEP * np.maximum(np.abs(at), _STEP) if step is None else np.asarray(step), at.shape)
    columns = [_slope(function, at, unit * size, size) for unit, size in zip(np.eye(len(at)), steps, strict=True)]
    return np.stack(columns, axis=-1)


def _slope(function: Function, at: Array, far: Array, size: float) -> Array:
    wide = (np.asarray(function(at + far)) - np.asarray(function(at - far))) / (2 * size)
    near = (np.asarray(function(at + far / 2)) - np.asarray(function(at - far / 2))) / size
    return np.asarray((4 * near - wide) / 3)


def complex_jacobian(function: Function, at: Array) -> Array:
    """Return the derivatives (..., K) of a function of a vector (K,) that takes complex numbers, exact to rounding.

    The function must be analytic: no abs, no comparison, no conjugate.
    Source: Squire & Trapp, Using Complex Variables to Estimate Derivatives of Real Functions, 1998.
    """
    at = np.asarray(at, dtype=float)
    columns = [np.asarray(function(at + 1j * _TINY * unit)).imag / _TINY for unit in np.eye(len(at))]
    return np.stack(columns, axis=-1)


def check_jacobian(function: Function, jacobian: Array, at: Array, *, analytic: bool = False) -> JacobianCheck:
    """Return how far a Jacobian (..., K) of a function is from its numerical one at a vector (K,).

    analytic: the function takes complex numbers, so that the complex step can be used.
    """
    numeric = complex_jacobian(function, at) if analytic else central_jacobian(function, at)
    flat, expected = (matrix.reshape(-1, len(at)) for matrix in (np.asarray(jacobian), numeric))
    sizes = np.abs(expected).max(axis=0, initial=np.finfo(float).tiny)
    differences = np.abs(flat - expected) / sizes
    errors = np.where(np.isnan(differences), np.inf, differences)
    worst = int(np.argmax(errors))
    row, column = divmod(worst, len(at))
    place = tuple(int(index) for index in np.unravel_index(row, numeric.shape[:-1]))
    values = float(errors.flat[worst]), place, column, float(flat[row, column]), float(expected[row, column])
    return JacobianCheck(*values, "complex" if analytic else "central")
