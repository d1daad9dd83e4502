"""The poses that meet three points exactly, for thousands of triplets at once.

With distances λ along the unit rays d, the three equations |λi di - λj dj|² = |xi - xj|² are two homogeneous quadratic
forms and a scale. A singular member of the forms' pencil is a pair of planes; each meets the other forms in two lines.
Source: Persson & Nordberg, Lambda Twist: An Accurate Fast Robust Perspective Three Point (P3P) Solver, ECCV 2018;
here with a homogeneous cubic, so that no member of the pencil is at infinity.
"""

import numpy as np

from camcal.arrays import Array
from camcal.estimate.poses import states as se3

_POLISH = 3  # Newton steps on the distances
_FIRST, _SECOND = [0, 0, 1], [1, 2, 2]  # the corners that each edge joins
_FITS = 1e-8  # of the longest edge squared
_DOUBLE = 1e-9  # a discriminant this little below zero is a double root's rounding


def poses_of_triplets(rays: Array, points: Array) -> tuple[Array, Array]:
    """Return states (S, 3, 4), camera_T_object, and which triplet (S,) each belongs to, up to four of one.

    rays: (T, 3, 3) unit, one a row. points: (T, 3, 3). Triplets in a line, or that no pose meets, have none.
    """
    with np.errstate(all="ignore"):
        edges = points[:, _FIRST] - points[:, _SECOND]
        lengths = np.einsum("tei,tei->te", edges, edges)
        cosines = np.einsum("tei,tei->te", rays[:, _FIRST], rays[:, _SECOND])
        # without a scale, nothing is too small or too large
        unit = np.sqrt(lengths.max(axis=1, keepdims=True))
        distances, triplet = _distances(lengths / unit**2, cosines)
        distances = unit[triplet] * _polished(distances, (lengths / unit**2)[triplet], cosines[triplet])
        states = _aligned(distances[:, :, None] * rays[triplet], points[triplet])
        sound = np.all(distances > 0, axis=1) & np.isfinite(states).all(axis=(1, 2))
    return states[sound], triplet[sound]


def _distances(lengths: Array, cosines: Array) -> tuple[Array, Array]:
    """Return distances (S, 3) along the rays and their triplets (S,), from squared lengths (T, 3) of the edges."""
    forms = np.zeros((len(lengths), 3, 3, 3))
    for edge, (i, j) in enumerate(zip(_FIRST, _SECOND, strict=True)):
        forms[:, edge, i, i] = forms[:, edge, j, j] = 1.0
        forms[:, edge, i, j] = forms[:, edge, j, i] = -cosines[:, edge]
    pencil = lengths[:, 2, None, None, None] * forms[:, :2] - lengths[:, :2, None, None] * forms[:, 2:]
    x, y = _singular_member(pencil[:, 0], pencil[:, 1])
    planes = _planes(x * pencil[:, 0] + y * pencil[:, 1])
    directions = _lines(planes, x * pencil[:, 1] - y * pencil[:, 0]).reshape(-1, 3)
    triplet = np.repeat(np.arange(len(lengths)), 4)
    directions *= np.sign(directions.sum(axis=1, keepdims=True))
    square = np.einsum("si,seij,sj->s", directions, forms[triplet], directions)
    distances = directions * np.sqrt(lengths.sum(axis=1)[triplet] / square)[:, None]
    sound = np.all(distances > 0, axis=1)
    return distances[sound], triplet[sound]


def _singular_member(first: Array, second: Array) -> tuple[Array, Array]:
    """Return x, y (T, 1, 1), x² + y² = 1, for which x · first + y · second (T, 3, 3) has no inverse."""
    of_first, of_second = _adjugate(first), _adjugate(second)
    coefficients = np.stack(
        [
            np.einsum("tij,tji->t", of_first, first) / 3,
            np.einsum("tij,tji->t", of_first, second),
            np.einsum("tij,tji->t", of_second, first),
            np.einsum("tij,tji->t", of_second, second) / 3,
        ]
    )
    turned = np.abs(coefficients[0]) < np.abs(coefficients[3])
    root = _isolated_root(np.where(turned, coefficients[::-1], coefficients))
    length = np.sqrt(1 + root * root)
    x, y = np.where(turned, 1.0, root) / length, np.where(turned, root, 1.0) / length
    return x[:, None, None], y[:, None, None]


def _isolated_root(coefficients: Array) -> Array:
    """Return the real root (T,) of cubics (4, T), highest power first, that stands farthest from the others."""
    b, c, d = coefficients[1:] / coefficients[0]
    p, q = c - b * b / 3, b * (2 * b * b - 9 * c) / 27 + d
    half, third = q / 2, p / 3
    square = half * half + third**3
    one = np.cbrt(-half - np.copysign(np.sqrt(np.maximum(square, 0.0)), half))
    one = one - np.where(one != 0, third / one, 0.0)
    reach = np.sqrt(np.maximum(-third, 0.0))
    three = -np.copysign(2 * reach, half) * np.cos(np.arccos(np.minimum(np.abs(half) / reach**3, 1.0)) / 3)
    root = np.where(square >= 0, one, three) - b / 3
    for _ in range(2):
        step = (((root + b) * root + c) * root + d) / ((3 * root + 2 * b) * root + c)
        root = root - np.where(np.isfinite(step), step, 0.0)
    return np.asarray(root)


def _planes(singular: Array) -> Array:
    """Return bases (T, 2, 2, 3) of the two planes through the origin on which singular forms (T, 3, 3) vanish."""
    values, vectors = np.linalg.eigh(np.nan_to_num(singular))
    low, null, high = vectors.transpose(2, 0, 1)
    of_low, of_high = (np.sqrt(np.maximum(value, 0.0))[:, None] for value in (-values[:, 0], values[:, 2]))
    pair = [np.stack([null, of_low * high + sign * of_high * low], axis=1) for sign in (-1, 1)]
    bases = np.stack(pair, axis=1)
    return np.asarray(bases / np.linalg.norm(bases, axis=-1, keepdims=True))


def _lines(planes: Array, forms: Array) -> Array:
    """Return the directions (T, 2, 2, 3) in planes (T, 2, 2, 3) on which forms (T, 3, 3) vanish, NaN without any."""
    on_plane = planes @ forms[:, None] @ planes.swapaxes(-1, -2)
    first, mixed, last = on_plane[..., 0, 0], on_plane[..., 0, 1], on_plane[..., 1, 1]
    square = mixed * mixed - first * last
    size = mixed * mixed + np.abs(first * last)
    square = np.where((square < 0) & (square > -_DOUBLE * size), 0.0, square)
    root = -(mixed + np.copysign(np.sqrt(square), mixed))
    along = np.stack([np.stack([root, first], axis=-1), np.stack([last, root], axis=-1)], axis=-2)
    return np.asarray(along @ planes)


def _polished(distances: Array, lengths: Array, cosines: Array) -> Array:
    """Return distances (S, 3) after Newton steps on the squared lengths (S, 3) of edges, NaN where they do not fit."""
    for _ in range(_POLISH):
        one, two = distances[:, _FIRST], distances[:, _SECOND]
        jacobian = np.zeros((len(distances), 3, 3))
        rows = np.arange(3)
        jacobian[:, rows, _FIRST] = 2 * (one - cosines * two)
        jacobian[:, rows, _SECOND] = 2 * (two - cosines * one)
        adjugate = _adjugate(jacobian)
        determinant = np.einsum("si,si->s", jacobian[:, 0], adjugate[:, :, 0])
        step = np.einsum("sij,sj->si", adjugate, _excess(distances, lengths, cosines)) / determinant[:, None]
        distances = distances - np.where(np.isfinite(step), step, 0.0)
    fits = np.abs(_excess(distances, lengths, cosines)).max(axis=1) < _FITS
    return np.where(fits[:, None], distances, np.nan)


def _excess(distances: Array, lengths: Array, cosines: Array) -> Array:
    """Return by how much the squared lengths of the edges (S, 3) are too large."""
    one, two = distances[:, _FIRST], distances[:, _SECOND]
    return np.asarray(one * one + two * two - 2 * cosines * one * two - lengths)


def _aligned(seen: Array, points: Array) -> Array:
    """Return the states (S, 3, 4) that take points (S, 3, 3), one a row, to congruent ones."""
    axes = []
    for corners in (seen, points):
        first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        normal = _cross(first, second)
        along = first / np.linalg.norm(first, axis=1, keepdims=True)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        axes.append(np.stack([along, normal, _cross(along, normal)], axis=2))
    rotation = axes[0] @ axes[1].transpose(0, 2, 1)
    moved = np.einsum("sij,sj->si", rotation, points.mean(axis=1))
    return se3.stacked(rotation, seen.mean(axis=1) - moved)


def _adjugate(matrices: Array) -> Array:
    """Return the matrices (T, 3, 3) that give the determinant times the identity with `matrices`."""
    rows = [matrices[:, row] for row in range(3)]
    return np.stack([_cross(rows[1], rows[2]), _cross(rows[2], rows[0]), _cross(rows[0], rows[1])], axis=2)


def _cross(first: Array, second: Array) -> Array:
    """Return first × second (S, 3): what numpy's own takes several times as long for."""
    a, b, c = first.T
    x, y, z = second.T
    return np.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=1)
