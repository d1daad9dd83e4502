"""Shapes through points, and their starts: circles, lines and planes by the distance of the points from them.

Lines and planes in space are written by the axis they are steepest along, so that no direction is out of reach.
"""

from collections.abc import Mapping

import numpy as np

from camcal.arrays import Array
from camcal.errors import InsufficientData
from camcal.estimate.curves.curve import Columns, Curve

Start = Mapping[str, float]


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
        freedom=2,
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
        raise InsufficientData("all points are one point")
    return np.asarray(np.linalg.svd(spread, full_matrices=True)[2])
