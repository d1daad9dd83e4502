"""Products of named transforms as text, such as "a_T_b * inv(c_T_b)": read without running it, frames checked."""

import ast
import difflib
from collections.abc import Mapping
from dataclasses import dataclass

from camcal.errors import InvalidInput
from camcal.geometry.named import JOINT, Derived, NamedTransform, frames_of

MAX_LENGTH = 2000  # characters; keeps the depth of brackets within what can be followed


@dataclass(frozen=True, eq=False)
class FrameProduct:
    """A derived transform, the frames it joins, and how it was written."""

    target: str
    source: str
    derived: Derived[str]
    text: str

    @property
    def name(self) -> str:
        """The name a_T_b."""
        return f"{self.target}{JOINT}{self.source}"


def evaluate(text: str, transforms: Mapping[str, NamedTransform]) -> FrameProduct:
    """Return the product that a text says: names a_T_b, * or @ between them, inv(), brackets.

    Raises InvalidInput for anything else, for a name that is not there, and where inner frames do not cancel.
    """
    if len(text) > MAX_LENGTH:
        raise InvalidInput(f"an expression of {len(text)} characters; at most {MAX_LENGTH} are read")
    try:
        tree = ast.parse(text.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise InvalidInput(f"{text[:60]!r} is no expression; write such as 'a_T_b * inv(c_T_b)'") from error
    try:
        return _value(tree.body, transforms)
    except RecursionError as error:
        raise InvalidInput("the expression has too many brackets within each other") from error


def _value(node: ast.expr, transforms: Mapping[str, NamedTransform]) -> FrameProduct:
    match node:
        case ast.Name(id=name):
            return _named(name, transforms)
        case ast.BinOp(left=left, op=ast.Mult() | ast.MatMult(), right=right):
            return _product(_value(left, transforms), _value(right, transforms))
        case ast.Call(func=ast.Name(id="inv"), args=[inner], keywords=[]):
            value = _value(inner, transforms)
            return FrameProduct(value.source, value.target, value.derived.inverse(), f"inv({value.text})")
        case _:
            raise InvalidInput(
                f"{ast.unparse(node)!r} is not understood; possible are names a_T_b, *, inv() and brackets"
            )


def _named(name: str, transforms: Mapping[str, NamedTransform]) -> FrameProduct:
    if name not in transforms:
        raise InvalidInput(f"no transform {name!r}{_advice(name, transforms)}")
    found = transforms[name]
    return FrameProduct(found.target, found.source, Derived.of(name, found.pose), name)


def _advice(name: str, transforms: Mapping[str, NamedTransform]) -> str:
    known = list(transforms)
    if JOINT in name:
        target, source = frames_of(name)
        if (reverse := f"{source}{JOINT}{target}") in transforms:
            return f"; write inv({reverse})"
    near = difflib.get_close_matches(name, known, n=1)
    return f". Did you mean {near[0]!r}?" if near else f"; there are {', '.join(known) or 'none'}"


def _product(left: FrameProduct, right: FrameProduct) -> FrameProduct:
    if left.source != right.target:
        raise InvalidInput(
            f"{left.text} * {right.text}: {left.source!r} does not meet {right.target!r}{_turned(left, right)}"
        )
    return FrameProduct(left.target, right.source, left.derived @ right.derived, f"{left.text} * {right.text}")


def _turned(left: FrameProduct, right: FrameProduct) -> str:
    """Return which of the two to invert so that they meet, in words; nothing if that does not help."""
    if left.source == right.source:
        return f"; did you mean {left.text} * inv({right.text})?"
    if left.target == right.target:
        return f"; did you mean inv({left.text}) * {right.text}?"
    return f": they are {left.name} and {right.name}"
