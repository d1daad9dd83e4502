"""Curves that have a name, with starts computed from the data: close enough for the search, not estimates.

Curves of x predict y. Shapes (circle, line2d, plane, line3d) are fitted by the distance of the points from them, since
all their coordinates are measured. Lines and planes in space are written by the axis they are steepest along, so that
no direction is out of reach.
"""

from collections.abc import Callable, Mapping

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.errors import InsufficientData, InvalidInput
from camcal.estimate.curves.curve import Columns, Curve

Start = Mapping[str, float]
_HIGHEST_POWER = 20


def polynomial(degree: int) -> Callable[[Array, Array], Start]:
    """Return the start of a polynomial of this degree: the least-squares solution itself."""

    def start(x: Array, y: Array) -> Start:
        values = _solved(y, *(x**power for power in range(degree + 1)))
        return {f"a{power}": float(value) for power, value in enumerate(values)}

    return start


def exponential_of_quadratic(x: Array, y: Array) -> Start:
    """Return a, b, c of y = exp(a x² + b x + c): a parabola through log y, weighted by y as the errors are y's."""
    seen = y > 0
    weights = y[seen]
    if np.count_nonzero(seen) < 3:
        return {"a": 0.0, "b": 0.0, "c": 0.0}
    c, b, a = _solved(weights * np.log(weights), weights, weights * x[seen], weights * x[seen] ** 2)
    return {"a": float(a), "b": float(b), "c": float(c)}


def bell(x: Array, y: Array) -> Start:
    """Return a, mu, s, b of a bell: the extreme farthest from the level at the ends, and the width of its area."""
    x, y = _ordered(x, y)
    ends = max(len(x) // 10, 1)
    level = float(np.median(np.concatenate([y[:ends], y[-ends:]])))
    top = int(np.argmax(np.abs(y - level)))
    height = float(y[top] - level)
    area = float(np.trapezoid(y - level, x))
    spread = abs(area / height) / np.sqrt(2 * np.pi) if height else 0.0
    return {"a": height, "mu": float(x[top]), "s": spread or _width(x), "b": level}


def thin_lens(x: Array, y: Array) -> Start:
    """Return f of 1/f = 1/x + 1/y, the median over all rows."""
    seen = x + y != 0
    return {"f": float(np.median(x[seen] * y[seen] / (x + y)[seen])) if seen.any() else 1.0}


def power(x: Array, y: Array) -> Start:
    """Return a, g, b of y = a x^g + b: b by the darkest, then a line through the logarithms."""
    order = np.argsort(x)
    rising = y[order[-1]] >= y[order[0]]
    level = float(y[order[0]])
    above = (x > 0) & ((y > level) if rising else (y < level))
    if np.count_nonzero(above) < 2:
        return {"a": 1.0, "g": 1.0, "b": level}
    log_a, g = _solved(np.log(np.abs(y[above] - level)), np.ones(above.sum()), np.log(x[above]))
    return {"a": float(np.exp(log_a)) * (1 if rising else -1), "g": float(g), "b": level}


def noise(x: Array, y: Array) -> Start:
    """Return v0 and k of y = v0 + k x: the least-squares line."""
    v0, k = _solved(y, np.ones_like(x), x)
    return {"v0": float(v0), "k": float(k)}


def edge(x: Array, y: Array) -> Start:
    """Return b, a, x0, s of an edge: its ends, where it crosses the middle, and how far the slope's weight spreads."""
    x, y = _ordered(x, y)
    ends = max(len(x) // 10, 1)
    low, high = float(np.median(y[:ends])), float(np.median(y[-ends:]))
    if low == high:
        return {"b": low, "a": 1.0, "x0": float(np.median(x)), "s": _width(x)}
    share = np.clip((y - low) / (high - low), 0, 1)
    # for a blur s the area between the edge and a step at its middle is s·sqrt(2/π)
    middle = float(x[np.argmin(np.abs(share - 0.5))])
    area = float(np.trapezoid(np.abs(share - (x > middle)), x))
    return {"b": low, "a": high - low, "x0": middle, "s": area * np.sqrt(np.pi / 2) or _width(x)}


def _solved(target: Array, *columns: Array) -> Array:
    """Return the least-squares weights of columns, scaled first so that powers of large x do no harm."""
    matrix = np.stack(columns, axis=1)
    lengths = np.linalg.norm(matrix, axis=0)
    lengths[lengths == 0] = 1
    return np.asarray(np.linalg.lstsq(matrix / lengths, target, rcond=None)[0] / lengths)


def _ordered(x: Array, y: Array) -> tuple[Array, Array]:
    order = np.argsort(x, kind="stable")
    return x[order], y[order]


def _width(x: Array) -> float:
    return float(np.ptp(x)) / 6 or 1.0


def circle(columns: Columns) -> tuple[Curve, Start]:
    """Return the circle and its start, the algebraic fit. Source: Kåsa 1976."""
    x, y = columns["x"], columns["y"]
    centre_x, centre_y = float(np.mean(x)), float(np.mean(y))
    u, v = x - centre_x, y - centre_y
    a, b, c = np.linalg.lstsq(np.stack([2 * u, 2 * v, np.ones_like(u)], axis=1), u * u + v * v, rcond=None)[0]
    curve = Curve.of(
        "circle", ["sqrt((x - cx)**2 + (y - cy)**2) - r"], ("cx", "cy", "r"), {"diameter": "2*r"}, explicit=False
    )
    radius = float(np.sqrt(max(c + a * a + b * b, 0.0)))
    return curve, {"cx": centre_x + float(a), "cy": centre_y + float(b), "r": radius}


def line_2d(columns: Columns) -> tuple[Curve, Start]:
    """Return the line x cos θ + y sin θ = d and its start, the direction of the least spread."""
    points = _points(columns, "xy")
    normal = _directions(points)[-1]
    distance = float(normal @ points.mean(axis=0))
    sign = -1.0 if distance < 0 else 1.0
    angle = float(np.arctan2(sign * normal[1], sign * normal[0]))
    curve = Curve.of("line2d", ["x*cos(theta) + y*sin(theta) - d"], ("theta", "d"), explicit=False)
    return curve, {"theta": angle, "d": sign * distance}


def plane(columns: Columns) -> tuple[Curve, Start]:
    """Return the plane and its start: the coordinate its normal is closest to, such as z, as a x + b y + c."""
    points = _points(columns, "xyz")
    normal = _directions(points)[-1]
    up = int(np.argmax(np.abs(normal)))
    first, second = (axis for axis in range(3) if axis != up)
    a, b = -normal[first] / normal[up], -normal[second] / normal[up]
    c = points.mean(axis=0) @ normal / normal[up]
    across, along, height = ("xyz"[axis] for axis in (first, second, up))
    length = "sqrt(1 + a**2 + b**2)"
    curve = Curve.of(
        f"plane {height} = a*{across} + b*{along} + c",
        [f"(a*{across} + b*{along} + c - {height})/{length}"],
        ("a", "b", "c"),
        {f"n{across}": f"-a/{length}", f"n{along}": f"-b/{length}", f"n{height}": f"1/{length}", "d": f"c/{length}"},
        explicit=False,
    )
    return curve, {"a": float(a), "b": float(b), "c": float(c)}


def line_3d(columns: Columns) -> tuple[Curve, Start]:
    """Return the line and its start: two coordinates, such as x = x0 + x1 z, by the one it runs along."""
    points = _points(columns, "xyz")
    direction = _directions(points)[0]
    along = int(np.argmax(np.abs(direction)))
    others = [axis for axis in range(3) if axis != along]
    slopes = direction / direction[along]
    offsets = points.mean(axis=0) - slopes * points.mean(axis=0)[along]
    (u, v), w = ("xyz"[axis] for axis in others), "xyz"[along]
    curve = Curve.of(
        f"line3d {u} = {u}0 + {u}1*{w}, {v} = {v}0 + {v}1*{w}",
        _distance_from_line(u, v, w),
        (f"{u}0", f"{u}1", f"{v}0", f"{v}1"),
        explicit=False,
        components=2,
    )
    start = {f"{'xyz'[axis]}{power}": values[axis] for axis in others for power, values in enumerate((offsets, slopes))}
    return curve, {name: float(value) for name, value in start.items()}


def _distance_from_line(u: str, v: str, w: str) -> list[str]:
    """Return the three components of a point's distance from the line: what is left without the part along it."""
    p, q = f"({u} - {u}0)", f"({v} - {v}0)"
    share = f"({p}*{u}1 + {q}*{v}1 + {w})/(1 + {u}1**2 + {v}1**2)"
    return [f"{p} - {u}1*{share}", f"{q} - {v}1*{share}", f"{w} - {share}"]


def _points(columns: Columns, names: str) -> Array:
    return np.stack([columns[name] for name in names], axis=1)


def _directions(points: Array) -> Array:
    """Return the directions (rows) of the points' spread, the widest first; raises InsufficientData for one point."""
    spread = points - points.mean(axis=0)
    if not np.any(spread):
        raise InsufficientData("all points coincide")
    return np.asarray(np.linalg.svd(spread, full_matrices=True)[2])


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
        _explicit("expquad", "exp(a*x**2 + b*x + c)", "a b c", exponential_of_quadratic),
    ),
    "gauss": Family(
        "a bell of height a at mu with standard deviation s on a level b",
        ("x",),
        _explicit("gauss", "a*exp(-((x - mu)/s)**2/2) + b", "a mu s b", bell, fwhm="sqrt(8*log(2))*s"),
    ),
    "thin_lens": Family(
        "1/f = 1/x + 1/y of object distance x and image distance y",
        ("x",),
        _explicit("thin_lens", "x*f/(x - f)", "f", thin_lens),
    ),
    "gamma": Family(
        "a response y = a x^g + b",
        ("x",),
        _explicit("gamma", "a*x**g + b", "a g b", power),
    ),
    "noise": Family(
        "variance y over mean x of a sensor: v0 + k x",
        ("x",),
        _explicit("noise", "v0 + k*x", "v0 k", noise, read_noise="sqrt(v0)", read_noise_e="sqrt(v0)/k"),
    ),
    "edge": Family(
        "a blurred edge at x0 with blur s, from level b up by a",
        ("x",),
        _explicit(
            "edge",
            "b + a*(1 + erf((x - x0)/(sqrt(2)*s)))/2",
            "b a x0 s",
            edge,
            mtf50="sqrt(log(2)/2)/(pi*s)",
            rise_10_90="2.5631031310892007*s",
        ),
    ),
    "circle": Family("centre cx, cy and radius r", ("x", "y"), circle),
    "line2d": Family("x cos(theta) + y sin(theta) = d", ("x", "y"), line_2d),
    "plane": Family("a plane, one coordinate by the other two", ("x", "y", "z"), plane),
    "line3d": Family("a line, two coordinates by the third", ("x", "y", "z"), line_3d),
}


def family_named(name: str) -> Family | None:
    """Return the family of a name such as gauss or poly:3, None if it resembles a formula.

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
    build = _explicit(f"poly:{degree}", formula, " ".join(names), polynomial(int(degree)))
    return Family(f"a polynomial of degree {degree}", ("x",), build)
