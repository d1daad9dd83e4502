"""Curves that have a name, with starts computed from the data.

Curves of x predict y. Shapes (circle, line2d, plane, line3d) are fitted by the distance of the points from them, since
all their coordinates are measured.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.estimate.curves import starts
from camcal.estimate.curves.curve import Columns, Curve
from camcal.estimate.curves.starts import Start

_HIGHEST_POWER = 20


@dataclass(frozen=True)
class Family:
    """A kind of curve: what it means, the columns it reads, and how it and its start come from them."""

    meaning: str
    roles: tuple[str, ...]
    build: Callable[[Columns], tuple[Curve, Start]]

    @property
    def explicit(self) -> bool:
        """Whether it predicts y from x."""
        return self.roles == ("x",)


def _explicit(
    name: str, formula: str, parameters: str, start: Callable[[Array, Array], Start], **derived: str
) -> Callable[[Columns], tuple[Curve, Start]]:
    def build(columns: Columns) -> tuple[Curve, Start]:
        return Curve.of(name, [formula], parameters.split(), derived), start(columns["x"], columns["y"])

    return build


FAMILIES: Mapping[str, Family] = {
    "expquad": Family(
        "y = exp(a x² + b x + c)",
        ("x",),
        _explicit("expquad", "exp(a*x**2 + b*x + c)", "a b c", starts.exponential_of_quadratic),
    ),
    "gauss": Family(
        "a bell of height a at mu with standard deviation s on a level b",
        ("x",),
        _explicit("gauss", "a*exp(-((x - mu)/s)**2/2) + b", "a mu s b", starts.bell, fwhm="sqrt(8*log(2))*s"),
    ),
    "thin_lens": Family(
        "1/f = 1/x + 1/y of object distance x and image distance y",
        ("x",),
        _explicit("thin_lens", "x*f/(x - f)", "f", starts.thin_lens),
    ),
    "gamma": Family(
        "a response y = a x^g + b",
        ("x",),
        _explicit("gamma", "a*x**g + b", "a g b", starts.power),
    ),
    "noise": Family(
        "variance y over mean x of a sensor: v0 + k x",
        ("x",),
        _explicit("noise", "v0 + k*x", "v0 k", starts.noise, read_noise="sqrt(v0)", read_noise_e="sqrt(v0)/k"),
    ),
    "edge": Family(
        "a blurred edge at x0 with blur s, from level b up by a",
        ("x",),
        _explicit(
            "edge",
            "b + a*(1 + erf((x - x0)/(sqrt(2)*s)))/2",
            "b a x0 s",
            starts.edge,
            mtf50="sqrt(log(2)/2)/(pi*s)",
            rise_10_90="2.5631031310892007*s",
        ),
    ),
    "circle": Family("centre cx, cy and radius r", ("x", "y"), starts.circle),
    "line2d": Family("x cos(theta) + y sin(theta) = d", ("x", "y"), starts.line_2d),
    "plane": Family("a plane, one coordinate by the other two", ("x", "y", "z"), starts.plane),
    "line3d": Family("a line, two coordinates by the third", ("x", "y", "z"), starts.line_3d),
}


def family_named(name: str) -> Family | None:
    """Return the family of a name such as gauss or poly:3, None if it looks like a formula.

    Raises InvalidInput for a word that is no family, naming the nearest.
    """
    word, _, degree = name.strip().partition(":")
    word = word.replace("-", "_")
    if word == "poly":
        return _polynomial(degree)
    if word in FAMILIES and not degree:
        return FAMILIES[word]
    return None


def _polynomial(degree: str) -> Family:
    if not degree.isdecimal() or int(degree) > _HIGHEST_POWER:
        raise InvalidInput(f"poly:{degree}: write poly:N with a degree N of 0 … {_HIGHEST_POWER}, such as poly:2")
    powers = range(int(degree) + 1)
    names = [f"a{power}" for power in powers]
    terms = ["a0", "a1*x", *(f"a{power}*x**{power}" for power in powers[2:])]
    formula = " + ".join(terms[: len(powers)])
    build = _explicit(f"poly:{degree}", formula, " ".join(names), starts.polynomial(int(degree)))
    return Family(f"a polynomial of degree {degree}", ("x",), build)
