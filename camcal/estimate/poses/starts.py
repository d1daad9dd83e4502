"""Initial poses of many views of one camera: by the object-space error, or exact poses of three points.

The error in space are the distances of the points from the rays they should lie on. Σ ‖(I - d dᵀ)(R x + t)‖² is
quadratic in [R t], so that a linear solution starts a search among rotations alone; the best translation follows the
rotation. Rays in place of pixels serve every lens, also for points beyond 90° from its axis.
Sources: Lu, Hager & Mjolsness, PAMI 2000 (the error); Terzakis & Lourakis, SQPnP, ECCV 2020 (eigenvectors as starts).

Poses that meet three points are solved for thousands of triplets at once. With distances λ along the unit rays d, the
three equations |λi di - λj dj|² = |xi - xj|² are two homogeneous quadratic forms and a scale. A singular member of the
forms' pencil is a pair of planes; each meets the other forms in two lines.
Source: Persson & Nordberg, Lambda Twist: An Accurate Fast Robust Perspective Three Point (P3P) Solver, ECCV 2018;
here with a homogeneous cubic, so that no member of the pencil is at infinity.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from camcal.arrays import Array
from camcal.cameras.observations import planar_poses
from camcal.dataclass import dataclass
from camcal.estimate.poses import states as se3
from camcal.estimate.poses.packed_correspondences import PackedCorrespondences
from camcal.estimate.poses.states import IN_PLANE, NEAR_PLANE, Extents
from camcal.geometry import rotation as so3
from camcal.solve.descent import Stopping
from camcal.solve.independent import Models, minimise_each

_STARTS = 4  # eigenvectors, each with both signs
_STOPPING = Stopping(relative_decrease=1e-3, iterations=15, damping=1e-3)
_HELD = 1e-12  # keeps points on a single ray, whose distance is open, from being singular
_PAIRS = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])  # where the upper triangle of a 3 × 3 matrix stands
_UPPER = np.triu_indices(3)
_GENERATORS = so3.hat(np.eye(3))

FEW = 5  # points for which every choice of three gives starts: noise may have the others lead astray
_LEAST = 4  # points below which only triplets give starts

# poses that meet three points
Form = tuple[Array, ...]  # the components of vectors, or of symmetric matrices: xx xy xz yy yz zz
Rows = Array | Sequence[Array]
_POLISH = 2  # Newton steps on the distances
_FIRST, _SECOND = [0, 0, 1], [1, 2, 2]  # the corners that each edge joins
_FULL = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])  # where the components of a diagonal and of what is beside it stand
_FITS = 1e-8  # of the longest edge squared
_DOUBLE = 1e-9  # a discriminant this little below zero is a double root's rounding


@dataclass(frozen=True, eq=False)
class SpaceErrors:
    """The errors in space of W views: (vec R)ᵀ Ω vec R with the best translation, which is `follow` · vec R.

    form: Ω (W, 9, 9). follow: (W, 3, 9). facing: (W, 12), positive on a state's rows [R t] of points in front.
    Points are in a frame with the origin at their mean; vec R goes row by row.
    """

    form: Array
    follow: Array
    facing: Array

    @classmethod
    def of(cls, rays: Array, points: Array, mask: Array) -> "SpaceErrors":
        """Return the errors of points (3, W, N) on unit rays (3, W, N), where the mask (W, N) is True."""
        weights = mask.astype(float)
        upper = [weights * ((row == column) - rays[row] * rays[column]) for row, column in zip(*_UPPER, strict=True)]
        powers = [points[row] * points[column] for row, column in zip(*_UPPER, strict=True)]
        across = np.stack(upper).transpose(1, 0, 2)
        moments = np.stack([*powers, *points, np.ones_like(weights)]).transpose(1, 2, 0)
        sums = (across @ moments)[:, _PAIRS]  # (W, a, c, moment) of P_ac
        squares = sums[..., :6][..., _PAIRS]  # (W, a, c, b, d) of P_ac x_b x_d
        count = len(weights)
        quadratic = squares.transpose(0, 1, 3, 2, 4).reshape(count, 9, 9)
        linear, constant = sums[..., 6:9].reshape(count, 3, 9), sums[..., 9]
        held = weights.sum(axis=1)[:, None, None] * _HELD * np.eye(3)
        follow = -np.linalg.solve(constant + held, linear)
        form = quadratic + linear.transpose(0, 2, 1) @ follow
        homogeneous = np.concatenate([points, np.ones((1, *weights.shape))])
        seen = (rays * weights).transpose(1, 0, 2) @ homogeneous.transpose(1, 2, 0)
        return cls(form, follow, seen.reshape(count, 12))

    def states(self, rotations: Array, which: Array) -> Array:
        """Return the states (S, 3, 4) of rotations (S, 3, 3) with their best translations."""
        translations = np.einsum("sij,sj->si", self.follow[which], rotations.reshape(-1, 9))
        return se3.stacked(rotations, translations)

    def in_front(self, states: Array, which: Array) -> Array:
        """Return the mask (S,) of states that put the points on the side the rays point to."""
        return np.asarray(np.einsum("si,si->s", self.facing[which], states.reshape(-1, 12)) > 0)

    def minima(self) -> tuple[Array, Array]:
        """Return states (S, 3, 4) at minima of the errors, and the views (S,) they belong to; several a view."""
        count = len(self.form)
        values, vectors = np.linalg.eigh(self.form)
        roots = np.sqrt(np.maximum(values, 0.0))[:, :, None] * vectors.transpose(0, 2, 1)
        starts = vectors[:, :, :_STARTS].transpose(0, 2, 1).reshape(count, _STARTS, 3, 3)
        rotations = so3.nearest(np.concatenate([starts, -starts], axis=1)).reshape(-1, 3, 3)
        which = np.repeat(np.arange(count), 2 * _STARTS)
        found = minimise_each(_Turns(roots), rotations, which, _STOPPING)
        states = self.states(found.states, which)
        front = self.in_front(states, which)
        return states[front], which[front]


@dataclass(frozen=True, eq=False)
class _Turns:
    """The search among rotations (S, 3, 3): residuals roots · vec R with roots (W, 9, 9)."""

    roots: Array

    def linearise(self, rotations: Array, which: Array) -> Models:
        roots = self.roots[which]
        residuals = np.einsum("sij,sj->si", roots, rotations.reshape(-1, 9))
        moved = np.einsum("kab,sbc->sack", _GENERATORS, rotations).reshape(-1, 9, 3)
        jacobian = roots @ moved
        gradient = np.einsum("sik,si->sk", jacobian, residuals)
        return Models(0.5 * np.sum(residuals**2, axis=1), gradient, jacobian.transpose(0, 2, 1) @ jacobian)

    def retract(self, rotations: Array, steps: Array) -> Array:
        return so3.exp(steps) @ rotations


def starts(packed: PackedCorrespondences, extents: Extents) -> tuple[Array, Array]:
    """Return states (S, 3, 4), camera_T_object, and which view (S,) each belongs to; extents: of the views.

    A view of a plane has one, of a solid object several, of fewer than three points none.
    """
    counts = packed.present.sum(axis=1)
    enough = counts >= _LEAST
    flat, solid = enough & (extents.flatness < NEAR_PLANE), enough & (extents.flatness > IN_PLANE)
    parts = [(np.zeros((0, 3, 4)), np.zeros(0, np.intp))]
    # a call for no view at all would take as long as one for a few
    if flat.any():
        views = np.flatnonzero(flat)
        here, mask = extents.take(views), packed.present[views]
        scale = (here.spread[:, 0] / np.sqrt(mask.sum(axis=1)))[:, None]
        rotations, shifts = planar_poses(packed.rays[:, views], here.in_plane(packed.points[:, views]) / scale, mask)
        parts.append((se3.compose(se3.stacked(rotations, shifts * scale), here.plane_T_object), views))
    if solid.any():
        parts.append(_of_solids(packed, extents, np.flatnonzero(solid)))
    if (few := (counts >= 3) & (counts <= FEW)).any():
        parts.append(_of_triplets(packed, np.flatnonzero(few)))
    return np.concatenate([states for states, _ in parts]), np.concatenate([view for _, view in parts])


def _of_solids(packed: PackedCorrespondences, extents: Extents, views: Array) -> tuple[Array, Array]:
    here = extents.take(views)
    errors = SpaceErrors.of(packed.rays[:, views], here.in_plane(packed.points[:, views]), packed.present[views])
    states, which = errors.minima()
    return se3.compose(states, here.plane_T_object[which]), views[which]


def _of_triplets(packed: PackedCorrespondences, views: Array) -> tuple[Array, Array]:
    """Return the poses that meet three points exactly, for every choice of three."""
    corners = [(view, *three) for view in views for three in combinations(np.flatnonzero(packed.present[view]), 3)]
    table = np.array(corners, dtype=np.intp).reshape(-1, 4)
    rays, points = (each[:, table[:, :1], table[:, 1:]].transpose(1, 2, 0) for each in (packed.rays, packed.points))
    states, triplet = poses_of_triplets(rays, points)
    return se3.stacked(so3.nearest(states[:, :, :3]), states[:, :, 3]), table[triplet, 0]


def poses_of_triplets(rays: Array, points: Array) -> tuple[Array, Array]:
    """Return states (S, 3, 4), camera_T_object, and which triplet (S,) each belongs to, up to four of one.

    rays: (T, 3, 3) unit, one a row. points: (T, 3, 3). Triplets in a line, or that no pose meets, have none.
    """
    # the axis of the triplets comes last throughout, and small matrices are taken apart: rows stay in the cache
    rays, points = (np.ascontiguousarray(each.transpose(1, 2, 0)) for each in (rays, points))
    with np.errstate(all="ignore"):
        edges = points[_FIRST] - points[_SECOND]
        lengths = np.stack([_dot(edge, edge) for edge in edges])
        cosines = np.stack([_dot(rays[one], rays[other]) for one, other in zip(_FIRST, _SECOND, strict=True)])
        # without a scale, nothing is too small or too large
        unit = lengths.max(axis=0)
        lengths /= unit
        distances, triplet = _distances(lengths, cosines)
        distances = _polished(distances, lengths[:, triplet], cosines[:, triplet]) * np.sqrt(unit[triplet])
        positive = np.flatnonzero(distances.min(axis=0) > 0)
        distances, triplet = distances[:, positive], triplet[positive]
        seen = [distance * ray[:, triplet] for distance, ray in zip(distances, rays, strict=True)]
        normal = _cross(edges[0], edges[1])
        dual = np.stack([*_cross(normal, edges[1]), *_cross(edges[0], normal), *normal]) / _dot(normal, normal)
        states = _aligned(seen, dual[:, triplet], points[0][:, triplet])
        sound = np.isfinite(states.sum(axis=(0, 1)))
    states = states.transpose(2, 0, 1)
    return (states, triplet) if sound.all() else (states[sound], triplet[sound])


def _distances(lengths: Array, cosines: Array) -> tuple[Array, Array]:
    """Return distances (3, S) along the rays and their triplets (S,), from squared lengths (3, T) of the edges.

    Mₑ is the form of edge e, λi² + λj² - 2 λi λj cos. Members of the pencil are x (c M₀ - a M₂) + y (c M₁ - b M₂),
    where the edges have the lengths a, b, c.
    """
    (a, b, c), (p, q, r) = lengths, cosines
    x, y = _singular_member(lengths, cosines)
    singular = c * (x + y), -c * p * x, -c * q * y, (c - a) * x - b * y, r * (a * x + b * y), (c - b) * y - a * x
    other = c * (x - y), c * p * y, -c * q * x, (a - c) * y - b * x, r * (b * x - a * y), (c - b) * x + a * y
    directions = _lines(_planes(singular), tuple(np.concatenate([each, each]) for each in other))
    directions *= np.sign(directions.sum(axis=0))
    found = np.flatnonzero(directions.min(axis=0) > 0)
    directions, triplet = directions[:, found], found % len(a)
    square = sum(_excess(directions, np.zeros((3, 1)), cosines[:, triplet]))
    return directions * np.sqrt(lengths.sum(axis=0)[triplet] / square), triplet


def _singular_member(lengths: Array, cosines: Array) -> tuple[Array, Array]:
    """Return x, y (T,), x² + y² = 1, for which the member of the pencil has no inverse: its determinant over c² is a
    cubic.
    """
    (a, b, c), (p, q, r) = lengths, cosines
    sine, along, across, mixed = 1 - r * r, c * p * p, c * q * q, 2 * c * p * q * r
    first, last = a * (a * sine - c), b * (b * sine - c)
    middle = c * (c - a - b) + 2 * a * b * sine
    coefficients = np.stack(
        [
            first + along * a,
            first + middle - along * (c - b) + mixed * a,
            last + middle - across * (c - a) + mixed * b,
            last + across * b,
        ]
    )
    turned = np.abs(coefficients[0]) < np.abs(coefficients[3])
    root = _isolated_root(np.where(turned, coefficients[::-1], coefficients))
    length = np.sqrt(1 + root * root)
    return np.where(turned, 1.0, root) / length, np.where(turned, root, 1.0) / length


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


def _planes(singular: Form) -> Array:
    """Return the normals (3, 2 T) of the two planes through the origin on which singular forms (T,) vanish, NaN
    without any.

    The adjugate of l mᵀ + m lᵀ is -p pᵀ with p = l × m, and adding [p]× leaves 2 m lᵀ or 2 l mᵀ alone.
    Source: Ding, Yang, Larsson, Olsson & Åström, Revisiting the P3P Problem, CVPR 2023.
    """
    xx, xy, xz, yy, yz, zz = singular
    diagonal = np.stack([yy * zz - yz * yz, xx * zz - xz * xz, xx * yy - xy * xy])
    cross = np.stack([xz * yz - xy * zz, xy * yz - xz * yy, xy * xz - xx * yz])
    largest, triplet = np.abs(diagonal).argmax(axis=0), np.arange(len(xx))
    column = np.concatenate([diagonal, cross])[_FULL[:, largest], triplet]
    x, y, z = column / np.sqrt(-diagonal[largest, triplet])
    of_rank_one = np.stack([xx, xy - z, xz + y, xy + z, yy, yz - x, xz - y, yz + x, zz])
    row, column = np.divmod(np.abs(of_rank_one).argmax(axis=0), 3)
    of_rank_one = of_rank_one.reshape(3, 3, -1)
    return np.concatenate([of_rank_one[:, column, triplet], of_rank_one[row, :, triplet].T], axis=1)


def _lines(normals: Array, forms: Form) -> Array:
    """Return the directions (3, 2 T) in planes of normals (3, T) on which forms (T,) vanish, NaN without any."""
    x, y, z = normals
    along = _cross(normals, (z, -x, y))
    across = _cross(normals, along)
    of_along = _applied(forms, along)
    first, mixed, last = _dot(along, of_along), _dot(across, of_along), _dot(across, _applied(forms, across))
    square = mixed * mixed - first * last
    size = mixed * mixed + np.abs(first * last)
    square = np.where((square < 0) & (square > -_DOUBLE * size), 0.0, square)
    root = -(mixed + np.copysign(np.sqrt(square), mixed))
    pairs = list(zip(along, across, strict=True))
    ends = [root * one + first * other for one, other in pairs], [last * one + root * other for one, other in pairs]
    return np.concatenate([np.stack(end) for end in ends], axis=1)


def _applied(form: Form, vector: Rows) -> Form:
    """Return the products of symmetric matrices and vectors, component by component."""
    xx, xy, xz, yy, yz, zz = form
    x, y, z = vector
    return xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z


def _polished(distances: Array, lengths: Array, cosines: Array) -> Array:
    """Return distances (3, S) after Newton steps on the squared lengths (3, S) of edges, NaN where they do not fit."""
    for _ in range(_POLISH):
        (x, y, z), (p, q, r) = distances, cosines
        a, b = (x - p * y, x - q * z, y - r * z), (y - p * x, z - q * x, z - r * y)  # half an edge's derivatives
        e = _excess(distances, lengths, cosines)
        minor, of_last = e[1] * b[2] - b[1] * e[2], a[1] * b[2]
        step = np.stack(
            [
                -e[0] * b[1] * a[2] - b[0] * minor,
                a[0] * minor - e[0] * of_last,
                a[1] * (e[0] * a[2] - b[0] * e[2]) - a[0] * e[1] * a[2],
            ]
        ) / (-2 * (a[0] * b[1] * a[2] + b[0] * of_last))
        distances = distances - np.where(np.isfinite(step), step, 0.0)
    one, two, three = _excess(distances, lengths, cosines)
    fits = np.maximum(np.maximum(np.abs(one), np.abs(two)), np.abs(three)) < _FITS
    return np.where(fits, distances, np.nan)


def _excess(distances: Array, lengths: Array, cosines: Array) -> Form:
    """Return by how much the squared lengths of the edges (3, S) are too large."""
    pairs = zip(distances[_FIRST], distances[_SECOND], lengths, cosines, strict=True)
    return tuple(one * one + two * two - 2 * cosine * one * two - length for one, two, length, cosine in pairs)


def _aligned(seen: Rows, dual: Array, corner: Array) -> Array:
    """Return the states (3, 4, S) that take triangles to congruent ones, of corners seen, three of (3, S).

    dual: (9, S) three vectors g with gᵢ · fⱼ = δᵢⱼ, f the edges from a triangle's first corner (3, S) and their cross
    product.
    """
    first, second = seen[1] - seen[0], seen[2] - seen[0]
    states = np.empty((3, 4, corner.shape[1]))
    for row, one, two, three, place in zip(states, first, second, _cross(first, second), seen[0], strict=True):
        for column in range(3):
            row[column] = one * dual[column] + two * dual[3 + column] + three * dual[6 + column]
        row[3] = place - _dot(row, corner)
    return states


def _dot(first: Rows, second: Rows) -> Array:
    return np.asarray(first[0] * second[0] + first[1] * second[1] + first[2] * second[2])


def _cross(first: Rows, second: Rows) -> Form:
    """Return first × second, component by component."""
    (a, b, c), (x, y, z) = first, second
    return b * z - c * y, c * x - a * z, a * y - b * x
