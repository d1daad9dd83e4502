"""Formulas in text, such as exp(a*x**2 + b*x + c): parsed, never executed, and differentiated exactly.

The text becomes Python's syntax tree, of which only arithmetic, numbers, names and a fixed list of functions are taken;
nothing is evaluated by Python. Values carry their derivatives along by the chain rule, operation by operation (forward
mode: Griewank & Walther, Evaluating Derivatives, 2nd ed. 2008, chapter 3).
"""

import ast
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from camcal.arrays import Array, FloatArray
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.parsing import did_you_mean

CONSTANTS = {"pi": math.pi}
_LONGEST = 2000
_SHOWN = 80  # letters of a formula in a message
_DEEPEST = 200  # a sum of n terms is nested n deep
_HINTS: Mapping[type, str] = {
    ast.BitXor: "a power is written **, not ^",
    ast.Compare: "a model has one side only, without = or <",
    ast.Subscript: "functions need parentheses, not square brackets",
    ast.Tuple: "a number has a dot, not a comma",
    ast.Attribute: "a name has no dot in it",
}


@dataclass(frozen=True, eq=False)
class Dual:
    """A value (N,) or scalar, and its derivatives (K, N) or (K, 1); None for those of a constant."""

    value: FloatArray
    slopes: FloatArray | None = None

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


_BINARY: Mapping[type, Callable[[Dual, Dual], Dual]] = {
    ast.Add: Dual.__add__,
    ast.Sub: Dual.__sub__,
    ast.Mult: Dual.__mul__,
    ast.Div: Dual.__truediv__,
    ast.Pow: Dual.__pow__,
}


@dataclass(frozen=True)
class Expression:
    """A formula over named columns and parameters; made by `parse`."""

    text: str
    names: frozenset[str]
    tree: ast.expr

    def value(self, values: Mapping[str, Array | float]) -> FloatArray:
        """Return the value (N,) where every name has one; complex values are taken too."""
        return self.with_derivatives(values, ()).value

    def with_derivatives(self, values: Mapping[str, Array | float], by: Sequence[str]) -> Dual:
        """Return the value (N,) and its derivatives (K, N) by the names `by`; NaN or infinite where undefined."""
        seeds = np.eye(len(by))[:, :, None]
        known = {name: Dual(np.asarray(value)) for name, value in values.items()}
        known |= {name: Dual(np.asarray(values[name]), seed) for name, seed in zip(by, seeds, strict=True)}
        with np.errstate(all="ignore"):
            return _evaluated(self.tree, known)

    @property
    def analytic(self) -> bool:
        """Whether it can be differentiated by a complex step: abs is no analytic function."""
        return "abs" not in {node.id for node in ast.walk(self.tree) if isinstance(node, ast.Name)}

    @property
    def constants(self) -> frozenset[str]:
        """The constants that stand in it."""
        return frozenset(node.id for node in ast.walk(self.tree) if isinstance(node, ast.Name)) & CONSTANTS.keys()

    def require_known(self, known: Sequence[str], what: str) -> None:
        """Raise InvalidInput about the first name that is not among those known; `what` says what those are."""
        for name, position in _named(self.tree):
            if name not in known:
                hint = did_you_mean(name, known, otherwise=".")
                raise InvalidInput(f"{_place(self.text, position)}: unknown name {name!r}; {what}{hint}")


def parse(text: str) -> Expression:
    """Return the formula of a text.

    Raises InvalidInput, with the position in the text, for whatever is not arithmetic over numbers, names and the known
    functions.
    """
    if len(text) > _LONGEST:
        raise InvalidInput(f"a formula of {len(text)} characters (limit {_LONGEST})")
    source = text.strip()
    try:
        tree = ast.parse(source, mode="eval").body
    except SyntaxError as error:
        before = source[: max((error.offset or 1) - 1, 0)]
        raise InvalidInput(f"{_place(source, len(before.encode()))}: not a formula ({error.msg})") from error
    except (ValueError, MemoryError, RecursionError) as error:
        raise InvalidInput(f"{source[:40]!r} is not a formula") from error
    _check(tree, source, 0)
    return Expression(source, frozenset(name for name, _ in _named(tree)), tree)


def _check(node: ast.expr, text: str, depth: int) -> None:
    """Raise InvalidInput for the first part of the tree that a formula may not have."""
    if depth > _DEEPEST:
        raise InvalidInput(f"{_place(text, node.col_offset)}: nested deeper than {_DEEPEST}")
    for part in _parts(node, text):
        _check(part, text, depth + 1)


def _parts(node: ast.expr, text: str) -> Sequence[ast.expr]:
    if isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
        return node.left, node.right
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.UAdd, ast.USub)):
        return (node.operand,)
    if isinstance(node, ast.Constant) and isinstance(node.value, (int, float)) and not isinstance(node.value, bool):
        if not abs(node.value) <= sys.float_info.max:
            raise InvalidInput(f"{_place(text, node.col_offset)}: a number beyond {sys.float_info.max:.2g}")
        return ()
    if isinstance(node, ast.Name):
        return ()
    if isinstance(node, ast.Call):
        return _arguments(node, text)
    refused = node.op if isinstance(node, (ast.BinOp, ast.UnaryOp)) else node
    hint = _HINTS.get(type(refused), "only numbers, names, + - * / **, parentheses and functions are supported")
    raise InvalidInput(f"{_place(text, node.col_offset)}: {hint}")


def _arguments(node: ast.Call, text: str) -> Sequence[ast.expr]:
    name = node.func.id if isinstance(node.func, ast.Name) else ""
    if name not in FUNCTIONS:
        known = did_you_mean(name, FUNCTIONS, f". Known are {', '.join(sorted(FUNCTIONS))}.")
        what = f"unknown function {name!r}{known}" if name else "only functions by name can be called"
        raise InvalidInput(f"{_place(text, node.col_offset)}: {what}")
    if node.keywords or len(node.args) != 1 or isinstance(node.args[0], ast.Starred):
        raise InvalidInput(f"{_place(text, node.col_offset)}: {name} takes one value")
    return node.args


def _named(node: ast.expr) -> Iterator[tuple[str, int]]:
    """Yield the names that need a value, with their positions, in the order of the text."""
    if isinstance(node, ast.Name) and node.id not in CONSTANTS:
        yield node.id, node.col_offset
    elif isinstance(node, ast.Call):
        yield from _named(node.args[0])
    elif isinstance(node, ast.UnaryOp):
        yield from _named(node.operand)
    elif isinstance(node, ast.BinOp):
        yield from _named(node.left)
        yield from _named(node.right)


def _evaluated(node: ast.expr, known: Mapping[str, Dual]) -> Dual:
    if isinstance(node, ast.Constant):
        return Dual(np.asarray(float(node.value)))  # type: ignore[arg-type]  # _parts took numbers only
    if isinstance(node, ast.Name):
        return known[node.id] if node.id in known else Dual(np.asarray(CONSTANTS[node.id]))
    if isinstance(node, ast.Call):
        return FUNCTIONS[node.func.id](_evaluated(node.args[0], known))  # type: ignore[attr-defined]  # likewise
    if isinstance(node, ast.UnaryOp):
        operand = _evaluated(node.operand, known)
        return operand if isinstance(node.op, ast.UAdd) else -operand
    if isinstance(node, ast.BinOp):
        return _BINARY[type(node.op)](_evaluated(node.left, known), _evaluated(node.right, known))
    raise TypeError(f"{type(node).__name__} in a checked formula")


def _place(text: str, offset: int) -> str:
    """Return where in a text something stands, and what is about it.

    offset: bytes of UTF-8 before it, as the syntax tree counts.
    """
    place = len(text.encode()[:offset].decode(errors="ignore"))
    first = max(place - _SHOWN // 2, 0) if len(text) > _SHOWN else 0
    shown = text[first : first + _SHOWN]
    before, after = "…" * (first > 0), "…" * (first + _SHOWN < len(text))
    return f"'{before}{repr(shown)[1:-1]}{after}', character {place + 1}"
