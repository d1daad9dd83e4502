"""Starts for curves of x, from the data alone: close enough for the search, not estimates."""

from collections.abc import Callable, Mapping

import numpy as np

from camcal.arrays import Array

Start = Mapping[str, float]


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
