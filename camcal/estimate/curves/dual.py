"""Numbers that carry their derivatives: the chain rule, operation by operation.

Source: Griewank & Walther, Evaluating Derivatives, 2nd ed. 2008, chapter 3 (forward mode).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array


@dataclass(frozen=True, eq=False)
class Dual:
    """A value (N,) or scalar, and its derivatives (K, N) or (K, 1); None for those of a constant."""

    value: Array
    slopes: Array | None = None

    def __add__(self, other: "Dual") -> "Dual":
        return Dual(self.value + other.value, _sum(self.slopes, other.slopes))

    def __neg__(self) -> "Dual":
        return Dual(-self.value, _scaled(self.slopes, -1.0))

    def __sub__(self, other: "Dual") -> "Dual":
        return self + -other

    def __mul__(self, other: "Dual") -> "Dual":
        slopes = _sum(_scaled(self.slopes, other.value), _scaled(other.slopes, self.value))
        return Dual(self.value * other.value, slopes)

    def __truediv__(self, other: "Dual") -> "Dual":
        value = self.value / other.value
        return Dual(value, _sum(_scaled(self.slopes, 1 / other.value), _scaled(other.slopes, -value / other.value)))

    def __pow__(self, other: "Dual") -> "Dual":
        base, power = self.value, other.value
        value = np.power(base, power)
        by_base = None if self.slopes is None else _scaled(self.slopes, power * np.power(base, power - 1))
        if other.slopes is None:
            return Dual(value, by_base)
        # 0**p stays 0 for every p > 0, so its slope by p is 0 although log 0 is not finite
        growth = np.where(value == 0, 0.0, value * np.log(np.where(base == 0, 1.0, base)))
        return Dual(value, _sum(by_base, _scaled(other.slopes, growth)))


Function = Callable[[Dual], Dual]


def _sum(first: Array | None, second: Array | None) -> Array | None:
    if first is None or second is None:
        return second if first is None else first
    return np.asarray(first + second)


def _scaled(slopes: Array | None, factor: Array | float) -> Array | None:
    return None if slopes is None else np.asarray(slopes * factor)


def _function(value: Callable[[Array], Array], slope: Callable[[Array, Array], Array]) -> Function:
    """Return a function of a dual from its value and its slope, which is given the argument and the value."""

    def function(argument: Dual) -> Dual:
        result = np.asarray(value(argument.value))
        if argument.slopes is None:
            return Dual(result)
        return Dual(result, argument.slopes * slope(argument.value, result))

    return function


def _erf(x: Array) -> Array:
    from scipy.special import erf

    return np.asarray(erf(x))


FUNCTIONS: Mapping[str, Function] = {
    "abs": _function(np.abs, lambda x, _: np.sign(x)),
    "acos": _function(np.arccos, lambda x, _: -1 / np.sqrt(1 - x * x)),
    "asin": _function(np.arcsin, lambda x, _: 1 / np.sqrt(1 - x * x)),
    "atan": _function(np.arctan, lambda x, _: 1 / (1 + x * x)),
    "cos": _function(np.cos, lambda x, _: -np.sin(x)),
    "cosh": _function(np.cosh, lambda x, _: np.sinh(x)),
    "erf": _function(_erf, lambda x, _: 2 / np.sqrt(np.pi) * np.exp(-x * x)),
    "exp": _function(np.exp, lambda _, y: y),
    "log": _function(np.log, lambda x, _: 1 / x),
    "log10": _function(np.log10, lambda x, _: 1 / (np.log(10) * x)),
    "sin": _function(np.sin, lambda x, _: np.cos(x)),
    "sinh": _function(np.sinh, lambda x, _: np.cosh(x)),
    "sqrt": _function(np.sqrt, lambda _, y: 0.5 / y),
    "tan": _function(np.tan, lambda _, y: 1 + y * y),
    "tanh": _function(np.tanh, lambda _, y: 1 - y * y),
}
