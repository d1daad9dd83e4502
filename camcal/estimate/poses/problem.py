"""The poses of many views as independent least-squares problems of six parameters, tx ty tz rx ry rz."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from camcal.arrays import Array
from camcal.estimate.poses import states as se3
from camcal.estimate.poses.sightings import Sightings
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
        turn = so3.log(states[:, :, :3] @ known[:, :, :3].transpose(0, 2, 1))
        steps = np.concatenate([states[:, :, 3] - known[:, :, 3], turn], axis=1)
        jacobian = np.zeros((len(steps), 6, 6))
        jacobian[:, :3, :3] = np.eye(3)
        jacobian[:, 3:, 3:] = np.linalg.inv(so3.exp_jacobian(turn))
        pulls = (information @ steps[..., None])[..., 0]
        gradient = np.einsum("spi,sp->si", jacobian, pulls)
        normal = jacobian.transpose(0, 2, 1) @ information @ jacobian
        return Models(0.5 * np.einsum("sp,sp->s", pulls, steps), gradient, normal)


@dataclass(frozen=True, eq=False)
class PoseProblems:
    """P poses to find: each of one view, from the points of its masks; states (S, 3, 4) are frame_T_object.

    sights: what each camera sees. view: (P,) indices of the views. masks: (P, N) for every camera.
    """

    sights: tuple[Sightings, ...]
    view: Array
    masks: tuple[Array, ...]
    anchor: Anchor | None = None

    @classmethod
    def of(cls, sights: tuple[Sightings, ...], anchor: Anchor | None = None) -> "PoseProblems":
        """Return one problem a view, of all points present."""
        view = np.arange(len(sights[0].present))
        return cls(sights, view, tuple(sight.present for sight in sights), anchor)

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
        return tuple(sight.squared(states, self.view[which]) for sight in self.sights)

    def cost(self, states: Array, which: Array) -> Array:
        """Return the costs (S,) of the points of the masks, infinite outside the lens's domain."""
        parts = zip(self.squared(states, which), self.masks, strict=True)
        cost = 0.5 * np.asarray(sum(np.where(mask[which], squared, 0.0).sum(axis=1) for squared, mask in parts))
        return cost if self.anchor is None else cost + self.anchor.models(states, self.view[which]).cost

    def linearise(self, states: Array, which: Array) -> Models:
        """Return the quadratic models at states (S, 3, 4) of the problems `which` (S,)."""
        count = len(which)
        if len(self.sights) == 1 and self.anchor is None and 0 < count * self.masks[0].shape[1] <= PART:
            return self._of_camera(0, states, which)
        total = Models(np.zeros(count), np.zeros((count, 6)), np.zeros((count, 6, 6)))
        for camera, mask in enumerate(self.masks):
            for part in _parts(count, mask.shape[1]):
                _add(total, part, self._of_camera(camera, states[part], which[part]))
        if self.anchor is not None:
            _add(total, slice(None), self.anchor.models(states, self.view[which]))
        return total

    def _of_camera(self, camera: int, states: Array, which: Array) -> Models:
        rows, _, inside = self.sights[camera].rows(states, self.view[which], self.masks[camera][which])
        if inside.all():
            return assemble(rows)
        rows[:, :, ~inside] = 0.0
        models = assemble(rows)
        models.cost[~inside] = np.inf
        return models

    def by_lens(self, states: Array, which: Array, camera: int) -> Array:
        """Return Jᵀ J_K (S, 6, K) of the pose and the parameters of one camera."""
        sight, masks = self.sights[camera], self.masks[camera]
        result = np.empty((len(which), 6, len(sight.camera.parameters)))
        for part in _parts(len(which), masks.shape[1]):
            here = which[part]
            rows, by_lens, _ = sight.rows(states[part], self.view[here], masks[here])
            by_lens = np.where(masks[here], by_lens, 0.0)
            pairs = zip(rows[:, :6].transpose(0, 2, 1, 3), by_lens.transpose(0, 2, 3, 1), strict=True)
            result[part] = sum(by_pose @ lens for by_pose, lens in pairs)
        return result

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
