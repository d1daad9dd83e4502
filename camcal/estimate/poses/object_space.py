"""Poses by the error in space: the distances of the points from the rays they should lie on.

Σ ‖(I - d dᵀ)(R x + t)‖² is quadratic in [R t], so that a linear solution starts a search among rotations alone; the
best translation follows the rotation. Rays in place of pixels serve every lens, also for points beyond 90° from its
axis. Sources: Lu, Hager & Mjolsness, PAMI 2000 (the error); Terzakis & Lourakis, SQPnP, ECCV 2020 (its eigenvectors as
starts).
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.estimate.poses import states as se3
from camcal.geometry import rotation as so3
from camcal.solve.descent import Stopping
from camcal.solve.independent import Models, minimise_each

_STARTS = 4  # eigenvectors, each with both signs
_STOPPING = Stopping(relative_decrease=1e-3, iterations=15, damping=1e-3)
_HELD = 1e-12  # keeps points on a single ray, whose distance is open, from being singular
_PAIRS = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])  # where the upper triangle of a 3 × 3 matrix stands
_UPPER = np.triu_indices(3)
_GENERATORS = so3.hat(np.eye(3))


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

    def of_planes(self) -> Array:
        """Return states (W, 3, 4) of points that lie in or near z = 0: the homography of least error made a pose."""
        columns = np.array([0, 1, 3, 4, 6, 7])
        flat = self.form[:, columns[:, None], columns]
        first = np.linalg.eigh(flat)[1][:, :, 0].reshape(-1, 3, 2)
        third = (so3.hat(first[:, :, 0]) @ first[:, :, 1, None])[..., 0]
        size = np.linalg.norm(first, axis=1).mean(axis=1)[:, None, None]
        third /= np.maximum(np.linalg.norm(third, axis=1, keepdims=True), np.finfo(float).tiny)
        which = np.arange(len(first))
        turns = so3.nearest(np.concatenate([first / size, third[..., None]], axis=2))
        # the sign of the homography is open, and with it that of the first two columns
        one, other = (self.states(turns * signs, which) for signs in ([1, 1, 1], [-1, -1, 1]))
        return np.where(self.in_front(one, which)[:, None, None], one, other)

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
