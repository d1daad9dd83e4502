"""The poses of many views as independent least-squares problems of six parameters, tx ty tz rx ry rz, and their minima.

From every start the lowest of each valley is refined; a plane has a second pose.
"""

from collections.abc import Iterator

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass, replace
from camcal.estimate.poses import states as se3
from camcal.estimate.poses.packed_correspondences import PackedCorrespondences
from camcal.estimate.poses.starts import starts
from camcal.estimate.poses.states import NEAR_PLANE, Extents
from camcal.geometry import rotation as so3
from camcal.solve.descent import Stopping
from camcal.solve.independent import Minima, Models, assemble, joined, minimise_each

ROUNDING = 1e-9  # px: what smaller residuals tell is the rounding of numbers, not noise
PART = 8192  # rows at a time, whose temporaries stay in the processor's cache
# The step that promises this is taken; what it leaves is far smaller.
_STOPPING = Stopping(relative_decrease=1e-6)
_ROUGH = Stopping(relative_decrease=1e-3)

# Minima are sought to the end up to this many times the lowest cost, and if their probability, with the noise estimated
# from the one view, may be this large.
_LEAST_WORTH, _DOUBT = 10.0, 1e-12
_STARTS = 4
_COMPARED = 12  # starts or minima of one view that are compared with each other, the lowest
_SAME_START = 0.1  # rad, and share of the distance: starts this near lead to one minimum
_SAME_MINIMUM = 1e-3
_HELD = 1e-14  # keeps the normal matrices of other minima from having no inverse


@dataclass(frozen=True, eq=False)
class Anchor:
    """Poses known beforehand: states (W, 3, 4) of the views, and the inverses Λ (W, 6, 6) of their covariances times
    the variance of a whitened pixel.
    """

    states: Array
    information: Array

    def models(self, states: Array, view: Array) -> Models:
        """Return the models of ½ dᵀ Λ d, where d is the step from the anchor of a view (S,) to its state (S, 3, 4)."""
        known, information = self.states[view], self.information[view]
        steps, slopes = se3.steps_from(states[:, :, :3], states[:, :, 3], known[:, :, :3], known[:, :, 3])
        weighted = slopes.swapaxes(-1, -2) @ information
        gradient = (weighted @ steps[..., None])[..., 0]
        pulls = (information @ steps[..., None])[..., 0]
        return Models(0.5 * np.einsum("sp,sp->s", pulls, steps), gradient, weighted @ slopes)


@dataclass(frozen=True, eq=False)
class PoseProblems:
    """P poses to find: each of one view, from the points of its masks; states (S, 3, 4) are frame_T_object.

    packed_views: what each camera sees. view: (P,) indices of the views. masks: (P, N) for every camera.
    """

    packed_views: tuple[PackedCorrespondences, ...]
    view: Array
    masks: tuple[Array, ...]
    anchor: Anchor | None = None

    @classmethod
    def of(cls, packed_views: tuple[PackedCorrespondences, ...], anchor: Anchor | None = None) -> "PoseProblems":
        """Return one problem a view, of all points present."""
        view = np.arange(len(packed_views[0].present))
        return cls(packed_views, view, tuple(packed.present for packed in packed_views), anchor)

    def take(self, chosen: Array) -> "PoseProblems":
        """Return some of the problems, or some several times."""
        return replace(self, view=self.view[chosen], masks=tuple(mask[chosen] for mask in self.masks))

    def masked(self, masks: tuple[Array, ...]) -> "PoseProblems":
        """Return the problems with other masks."""
        return replace(self, masks=masks)

    @property
    def counts(self) -> Array:
        """The number (P,) of points of each problem."""
        return np.asarray(sum(mask.sum(axis=1) for mask in self.masks))

    def squared(self, states: Array, which: Array) -> tuple[Array, ...]:
        """Return the squared whitened residuals (S, N) of all points present, for every camera; infinite as there."""
        return tuple(packed.squared(states, self.view[which]) for packed in self.packed_views)

    def cost(self, states: Array, which: Array) -> Array:
        """Return the costs (S,) of the points of the masks, infinite outside the lens's domain."""
        parts = zip(self.squared(states, which), self.masks, strict=True)
        cost = 0.5 * np.asarray(sum(np.where(mask[which], squared, 0.0).sum(axis=1) for squared, mask in parts))
        return cost if self.anchor is None else cost + self.anchor.models(states, self.view[which]).cost

    def linearise(self, states: Array, which: Array) -> Models:
        """Return the quadratic models at states (S, 3, 4) of the problems `which` (S,)."""
        count = len(which)
        if len(self.packed_views) == 1 and self.anchor is None and 0 < count * self.masks[0].shape[1] <= PART:
            return self._of_camera(0, states, which)
        total = Models(np.zeros(count), np.zeros((count, 6)), np.zeros((count, 6, 6)))
        for camera, mask in enumerate(self.masks):
            for part in _parts(count, mask.shape[1]):
                _add(total, part, self._of_camera(camera, states[part], which[part]))
        if self.anchor is not None:
            _add(total, slice(None), self.anchor.models(states, self.view[which]))
        return total

    def _of_camera(self, camera: int, states: Array, which: Array) -> Models:
        rows, _, inside = self.packed_views[camera].rows(states, self.view[which], self.masks[camera][which])
        if inside.all():
            return assemble(rows)
        rows[:, :, ~inside] = 0.0
        models = assemble(rows)
        models.cost[~inside] = np.inf
        return models

    def by_lens(self, states: Array, which: Array, camera: int) -> Array:
        """Return Jᵀ J_K (S, 6, K) of the pose and the parameters of one camera."""
        packed, masks = self.packed_views[camera], self.masks[camera]
        result = np.empty((len(which), 6, len(packed.camera.parameters)))
        for part in _parts(len(which), masks.shape[1]):
            here = which[part]
            rows, by_lens, _ = packed.rows(states[part], self.view[here], masks[here], lens=True)
            assert by_lens is not None
            by_lens = np.where(masks[here], by_lens, 0.0)
            pairs = zip(rows[:, :6].transpose(0, 2, 1, 3), by_lens.transpose(0, 2, 3, 1), strict=True)
            result[part] = sum(by_pose @ lens for by_pose, lens in pairs)
        return result

    def by_frame(self, states: Array, which: Array, camera: int) -> Array:
        """Return Jᵀ J_F (S, 6, 6) of the pose and the step of camera_T_frame of one camera.

        That step moves the points in the camera as a step of the pose does: R_F Exp(δr) = Exp(R_F δr) R_F.
        """
        count, turn = len(which), self.packed_views[camera].frame.rotation.T
        normal = np.empty((count, 6, 6))
        for part in _parts(count, self.masks[camera].shape[1]):
            normal[part] = self._of_camera(camera, states[part], which[part]).normal
        moved = np.zeros((count, 6, 6))
        moved[:, :3, :3] = moved[:, 3:, 3:] = turn
        moved[:, :3, 3:] = -so3.hat(states[:, :, 3]) @ turn
        return np.asarray(normal @ moved)

    def retract(self, states: Array, steps: Array) -> Array:
        """Return the states moved by steps (S, 6)."""
        return se3.retract(states, steps)

    def minimise(self, states: Array, which: Array, *, rough: bool = False) -> Minima:
        """Return the minima that starts (S, 3, 4) of the problems `which` (S,) lead to; rough: near enough for inliers.

        A start at which some points are outside the lens's domain first follows the others.
        """
        stopping = _ROUGH if rough else _STOPPING
        found = _settled(self, states, which, stopping)
        astray = np.flatnonzero(np.isinf(found.cost))
        if not astray.size:
            return found
        here = which[astray]
        parts = zip(self.squared(states[astray], here), self.masks, strict=True)
        inside = tuple(np.isfinite(squared) & mask[here] for squared, mask in parts)
        partial = replace(self, view=self.view[here], masks=inside)
        others = np.flatnonzero(np.isfinite(found.cost))
        followed = _settled(partial, states[astray], np.arange(len(astray)), stopping).states
        together = joined(found.take(others), _settled(self, followed, here, stopping))
        return together.take(np.argsort(np.concatenate([others, astray])))


def _settled(problems: PoseProblems, states: Array, which: Array, stopping: Stopping) -> Minima:
    counts = problems.counts[which]
    worth = _LEAST_WORTH + _DOUBT ** (-2 / np.maximum(2 * counts - 6, 1))
    return minimise_each(problems, states, which, stopping, counts * ROUNDING**2, worth)


def _parts(count: int, length: int) -> Iterator[slice]:
    step = max(PART // max(length, 1), 1)
    return (slice(start, min(start + step, count)) for start in range(0, count, step))


def _add(total: Models, part: slice, other: Models) -> None:
    total.cost[part] += other.cost
    total.gradient[part] += other.gradient
    total.normal[part] += other.normal


def pose_minima(problems: PoseProblems, extents: Extents) -> Minima:
    """Return the different minima of every problem, in the order of the problems and the lowest first.

    problems: one of each view, of all points present. A problem may have none: no start has its points in the domain.
    """
    if len(problems.packed_views) == 1:
        return _with_second_poses(problems, extents, *_starts_of(problems, extents))
    found = []
    for packed in problems.packed_views:
        own = PoseProblems.of((packed,))
        spread = Extents.of(packed.points, packed.present)
        minima = _with_second_poses(own, spread, *_starts_of(own, spread))
        found.append((minima.states, minima.which))
    found.append(anchors(problems))
    return refined(problems, *(np.concatenate(parts) for parts in zip(*found, strict=True)))


def _starts_of(problems: PoseProblems, extents: Extents) -> tuple[Array, Array]:
    """Return starts (S, 3, 4), frame_T_object, of what one camera sees, and their problems (S,)."""
    packed = problems.packed_views[0]
    states, which = starts(packed, extents)
    parts = (se3.compose(packed.inverse_frame, states), which), anchors(problems)
    return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])


def anchors(problems: PoseProblems) -> tuple[Array, Array]:
    """Return the pose known beforehand, if there is one, as a start (S, 3, 4) of every problem (S,)."""
    if problems.anchor is None:
        return np.zeros((0, 3, 4)), np.zeros(0, np.intp)
    return problems.anchor.states[problems.view], np.arange(len(problems.view))


def _with_second_poses(problems: PoseProblems, extents: Extents, states: Array, which: Array) -> Minima:
    """Return the minima that starts lead to, and those that planes are mistaken for."""
    eye = problems.packed_views[0].eye
    flat = np.flatnonzero(extents.flatness[which] < NEAR_PLANE)
    second = extents.reflected(states[flat], which[flat], eye)
    of_second = which[flat]
    found = refined(problems, np.concatenate([states, second]), np.concatenate([which, of_second]))
    # the reflection of a start far from its minimum may lie in another valley than that of the minimum
    best = lowest(found)
    best = best[extents.flatness[found.which[best]] < NEAR_PLANE]
    best = best[~_tried(found.states[best], found.which[best], (states[flat], of_second), (second, of_second))]
    if not best.size:
        return found
    mirrors = extents.reflected(found.states[best], found.which[best], eye)
    return different(joined(found, problems.minimise(mirrors, found.which[best])))


def _tried(minima: Array, problem: Array, *starts: tuple[Array, Array]) -> Array:
    """Return the mask (S,) of minima (S, 3, 4) near the only start of their problems (S,), or near its reflection.

    The reflections of such minima lead where those of the starts did. starts: states and their problems, of each kind.
    """
    tried = np.zeros(len(problem), dtype=bool)
    for states, which in starts:
        order = np.argsort(which, kind="stable")
        first = order[np.searchsorted(which[order], problem)]
        single = np.bincount(which)[problem] == 1
        tried |= single & se3.near(states[first], minima, _SAME_START)
    return tried


def refined(problems: PoseProblems, states: Array, which: Array) -> Minima:
    """Return the different minima that the most promising starts (S, 3, 4) of problems (S,) lead to."""
    # two starts are faster followed than distinguished
    if np.bincount(which).max(initial=0) > 2:
        chosen = distinct(states, which, problems.cost(states, which), _SAME_START, _STARTS)
        states, which = states[chosen], which[chosen]
    return different(problems.minimise(states, which))


def different(minima: Minima) -> Minima:
    """Return the minima without repetitions, in the order of the problems and the lowest first."""
    inside = np.isfinite(minima.cost)
    if not inside.all():
        minima = minima.take(inside)
    # searches that ended early are near their minima only
    tolerance = np.where(minima.converged, _SAME_MINIMUM, _SAME_START)
    return minima.take(distinct(minima.states, minima.which, minima.cost, tolerance, _COMPARED))


def lowest(minima: Minima) -> Array:
    """Return the indices of the first of each problem, of minima in their order."""
    return firsts(minima.which)


def firsts(which: Array) -> Array:
    """Return the indices at which the problems (S,), in their order, begin."""
    begins = np.ones(len(which), dtype=bool)
    np.not_equal(which[1:], which[:-1], out=begins[1:])
    return begins.nonzero()[0]


def distinct(states: Array, which: Array, cost: Array, tolerance: Array | float, most: int) -> Array:
    """Return the indices of up to `most` states of each problem that no lower one is near to, problems in order and
    the lowest first; tolerance: rad, and share of the distance, (S,) or one for all.
    """
    order = np.lexsort((cost, which))
    first = firsts(which[order])
    if len(first) == len(order):
        return order
    length = np.diff(first, append=len(order))
    width = min(int(length.max(initial=0)), _COMPARED)
    ranks = np.arange(width)
    table = order[np.minimum(first[:, None] + ranks, len(order) - 1)]
    there = ranks < length[:, None]
    own = np.broadcast_to(tolerance, len(order))[table][:, None]
    close = se3.near(states[table][:, :, None], states[table][:, None], own)
    kept = there.copy()
    for rank in range(1, width):
        kept[:, rank] &= ~np.any(close[:, :rank, rank] & kept[:, :rank], axis=1)
    kept &= np.cumsum(kept, axis=1) <= most
    return np.asarray(table[kept])


def inverses(normal: Array) -> Array:
    """Return the inverses of normal matrices (S, P, P); of singular ones, something large."""
    scale = 1 / np.sqrt(np.maximum(np.einsum("sii->si", normal), np.finfo(float).tiny))
    both = scale[:, :, None] * scale[:, None, :]
    inverse = np.linalg.inv(normal * both + _HELD * np.eye(normal.shape[-1]))
    return np.asarray((inverse + inverse.transpose(0, 2, 1)) / 2 * both)
