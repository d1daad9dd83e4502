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

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from camcal.arrays import Array
from camcal.cameras.observations import planar_poses
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
_POLISH = 2  # Newton steps on the distances
_FIRST, _SECOND = [0, 0, 1], [1, 2, 2]  # the corners that each edge joins
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
    # the axis of the triplets comes last throughout: what is done to thousands of small matrices is done to few rows
    rays, points = (np.ascontiguousarray(each.transpose(1, 2, 0)) for each in (rays, points))
    with np.errstate(all="ignore"):
        edges = points[_FIRST] - points[_SECOND]
        lengths = np.sum(edges * edges, axis=1)
        cosines = np.sum(rays[_FIRST] * rays[_SECOND], axis=1)
        # without a scale, nothing is too small or too large
        unit = lengths.max(axis=0)
        lengths /= unit
        distances, triplet = _distances(lengths, cosines)
        distances = _polished(distances, lengths[:, triplet], cosines[:, triplet]) * np.sqrt(unit[triplet])
        positive = np.flatnonzero((distances > 0).all(axis=0))
        distances, triplet = distances[:, positive], triplet[positive]
        states = _aligned(distances[:, None] * rays[:, :, triplet], points[:, :, triplet])
        sound = np.isfinite(states).all(axis=(0, 1))
    return np.ascontiguousarray(states.transpose(2, 0, 1)[sound]), triplet[sound]


def _distances(lengths: Array, cosines: Array) -> tuple[Array, Array]:
    """Return distances (3, S) along the rays and their triplets (S,), from squared lengths (3, T) of the edges."""
    forms = np.zeros((3, 3, 3, lengths.shape[1]))
    for edge, (i, j) in enumerate(zip(_FIRST, _SECOND, strict=True)):
        forms[edge, i, i] = forms[edge, j, j] = 1.0
        forms[edge, i, j] = forms[edge, j, i] = -cosines[edge]
    first, second = (lengths[2] * forms[edge] - lengths[edge] * forms[2] for edge in (0, 1))
    x, y = _singular_member(first, second)
    directions = _lines(_planes(x * first + y * second), x * second - y * first)
    directions *= np.sign(directions.sum(axis=0))
    found = np.flatnonzero((directions > 0).all(axis=0))
    directions, triplet = directions[:, found], found % lengths.shape[1]
    square = _excess(directions, np.zeros((3, 1)), cosines[:, triplet]).sum(axis=0)
    return directions * np.sqrt(lengths.sum(axis=0)[triplet] / square), triplet


def _singular_member(first: Array, second: Array) -> tuple[Array, Array]:
    """Return x, y (T,), x² + y² = 1, for which x · first + y · second (3, 3, T) has no inverse."""
    of_first, of_second = _adjugate(first), _adjugate(second)
    # the forms and so their adjugates are symmetric
    pairs = (of_first, first, 3), (of_first, second, 1), (of_second, first, 1), (of_second, second, 3)
    coefficients = np.stack([np.sum(one * other, axis=(0, 1)) / of for one, other, of in pairs])
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


def _planes(singular: Array) -> tuple[Array, Array]:
    """Return the normals (3, T) of the two planes through the origin on which singular forms (3, 3, T) vanish, NaN
    without any.

    The adjugate of l mᵀ + m lᵀ is -p pᵀ with p = l × m, and adding [p]× leaves 2 m lᵀ or 2 l mᵀ alone.
    Source: Ding, Yang, Larsson, Olsson & Åström, Revisiting the P3P Problem, CVPR 2023.
    """
    adjugate, triplet = _adjugate(singular), np.arange(singular.shape[2])
    largest = np.abs(np.einsum("iit->it", adjugate)).argmax(axis=0)
    x, y, z = adjugate[:, largest, triplet] / np.sqrt(-adjugate[largest, largest, triplet])
    of_rank_one = singular.copy()
    for (row, column), value in zip(((1, 0), (0, 2), (2, 1)), (z, y, x), strict=True):
        of_rank_one[row, column] += value
        of_rank_one[column, row] -= value
    row, column = np.divmod(np.abs(of_rank_one).reshape(9, -1).argmax(axis=0), 3)
    return of_rank_one[:, column, triplet], of_rank_one[row, :, triplet].T


def _lines(planes: tuple[Array, Array], forms: Array) -> Array:
    """Return the directions (3, 4 T) in both planes of normals (3, T) on which forms (3, 3, T) vanish, NaN without
    any.
    """
    normals, forms = np.concatenate(planes, axis=1), np.concatenate([forms, forms], axis=2)
    along = _cross(normals, normals[[2, 0, 1]] * [[1.0], [-1.0], [1.0]])
    along /= np.sqrt(np.sum(along * along, axis=0))
    across = _cross(normals, along) / np.sqrt(np.sum(normals * normals, axis=0))
    of_along, of_across = (np.sum(forms * axis, axis=1) for axis in (along, across))
    pairs = (along, of_along), (along, of_across), (across, of_across)
    first, mixed, last = (np.sum(one * other, axis=0) for one, other in pairs)
    square = mixed * mixed - first * last
    size = mixed * mixed + np.abs(first * last)
    square = np.where((square < 0) & (square > -_DOUBLE * size), 0.0, square)
    root = -(mixed + np.copysign(np.sqrt(square), mixed))
    return np.concatenate([root * along + first * across, last * along + root * across], axis=1)


def _polished(distances: Array, lengths: Array, cosines: Array) -> Array:
    """Return distances (3, S) after Newton steps on the squared lengths (3, S) of edges, NaN where they do not fit."""
    for _ in range(_POLISH):
        one, two = distances[_FIRST], distances[_SECOND]
        a, b = one - cosines * two, two - cosines * one  # half the derivatives of an edge by its distances
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
    fits = np.abs(_excess(distances, lengths, cosines)).max(axis=0) < _FITS
    return np.where(fits, distances, np.nan)


def _excess(distances: Array, lengths: Array, cosines: Array) -> Array:
    """Return by how much the squared lengths of the edges (3, S) are too large."""
    one, two = distances[_FIRST], distances[_SECOND]
    return np.asarray(one * one + two * two - 2 * cosines * one * two - lengths)


def _aligned(seen: Array, points: Array) -> Array:
    """Return the states (3, 4, S) that take points (3, 3, S), one a row, to congruent ones."""
    axes = []
    for corners in (seen, points):
        first, second = corners[1] - corners[0], corners[2] - corners[0]
        normal = _cross(first, second)
        first /= np.sqrt(np.sum(first * first, axis=0))
        normal /= np.sqrt(np.sum(normal * normal, axis=0))
        axes.append((first, normal, _cross(first, normal)))
    states = np.empty((3, 4, seen.shape[2]))
    states[:, :3] = sum(one[:, None] * other[None] for one, other in zip(*axes, strict=True))
    states[:, 3] = seen.mean(axis=0) - np.sum(states[:, :3] * points.mean(axis=0), axis=1)
    return states


def _adjugate(matrices: Array) -> Array:
    """Return the matrices (3, 3, T) that give the determinant times the identity with `matrices`."""
    first, second, third = matrices
    return np.stack([_cross(second, third), _cross(third, first), _cross(first, second)], axis=1)


def _cross(first: Array, second: Array) -> Array:
    """Return first × second (3, S): what numpy's own takes several times as long for."""
    a, b, c = first
    x, y, z = second
    return np.stack([b * z - c * y, c * x - a * z, a * y - b * x])
