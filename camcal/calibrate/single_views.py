"""Changes of parameters in single views, models of changes that explain them, and the entrance pupil.

Let a view v have k parameters θ_v of its own beside its pose and its effects, while lens and board are common. What is
left of the normal equations is A θ = y, and A⁻¹ is the covariance of the estimates of all θ_v. Offsets that vary from
view to view without order have a variance τ² besides, so a change is looked for under A⁻¹ + τ² I, with the τ that suits
it best. From one linearisation also follows what every view alone says of the lens: its squared residuals as a function
of the lens, the pose following.

The entrance pupil of a wide lens moves along the axis with the angle of incidence. With the pupil of a ray at the angle
θ moved by e (θ/Θ)² towards the scene, Θ the largest angle of a corner, its pixel moves by -e (θ/Θ)² ∂u/∂Z: as much less
as the board is farther away, which no lens with one centre has. e is estimated beside the lens, all else following, in
one step from a solution; its variance is that of the scatter from view to view.
Source: Gennery, Generalized camera calibration including fish-eye lenses, IJCV 68, 2006 (the moving entrance pupil).
"""

import math
from collections.abc import Sequence
from functools import cached_property
from statistics import NormalDist

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.effects import posterior, scaled
from camcal.calibrate.estimator import Estimate
from camcal.calibrate.jackknife import influence
from camcal.calibrate.noise import FINEST, RAYLEIGH_MEDIAN, REJECTED, row_medians
from camcal.calibrate.problem import BoardProblem, State
from camcal.cameras.observations import whitened
from camcal.dataclass import dataclass, replace
from camcal.records import Brief
from camcal.solve.least_squares import assemble
from camcal.solve.losses import Cauchy, chi_square_beyond, student_bound
from camcal.solve.steps import Jacobian, NormalEquations, SingularError, Step, factorise, lower_inverse

_UNORDERED = np.concatenate([[0.0], np.geomspace(1e-5, 0.03, 25)])  # τ, a share of the parameter
# Of the log likelihood, what a τ above zero must gain: few cameras change their focal length from view to view.
_UNUSUAL = 3.0
_ROUNDING = 1e-12  # of the trace of a normal matrix
_KNOWN = 1e-6  # of the best known combination of offsets: combinations known less than that say nothing

_LOSS = Cauchy(3.0)
_ROUNDS = 20
_CHUNK = 64  # views

_OUTER = 0.9  # of the largest angle
_CLEARLY = 1.5  # times the bound that 95 % of what is none are within
_STEPS = 2  # the second stands where the scatter is that of a lens with this shift
_WIDE = np.radians(40)  # of the outermost corner: of narrower lenses nothing is asked


@dataclass(frozen=True, eq=False)
class Found:
    """A change: its index among those tried, its size (k,), and twice the log likelihood that it gains."""

    index: int
    size: Array
    gain: float

    def clear(self, places: float) -> float:
        """Return how far the gain is beyond that of the best of so many independent places by chance, in standard
        deviations.
        """
        chance = places * chi_square_beyond(self.gain, len(self.size))
        if chance <= 0:
            return math.inf
        return -NormalDist().inv_cdf(chance / 2) if chance < 1 else 0.0


def followed(equations: NormalEquations, pose: int, std: Array) -> NormalEquations:
    """Return the equations of the views' own parameters, which come last in their groups, when poses and effects of
    standard deviations (V, m), which come before them, follow these.
    """
    first = pose + std.shape[1]
    own = np.ones((len(std), equations.group_group.shape[-1] - first))
    prepared = scaled(equations, np.column_stack([std, own]))
    np.einsum("vii->vi", prepared.group_group)[:, first:] -= 1.0  # they have no prior
    return prepared.without_first(first)


@dataclass(frozen=True, eq=False)
class ViewOffsets:
    """values: (R,) combinations of the offsets in standard deviations, independent of one another. mixing: (R, V, k)
    the offsets' shares in them. information: (R,) of the combinations.
    """

    values: Array
    mixing: Array
    information: Array

    @classmethod
    def of(cls, equations: NormalEquations, own: Sequence[int]) -> "ViewOffsets":
        """Return the offsets of some of the parameters of the views, by equations whose groups are these, as `followed`
        returns them.
        """
        count, chosen = len(equations.group_group), np.asarray(own)
        blocks, views = np.zeros((count, len(own), count, len(own))), np.arange(count)
        blocks[views, :, views] = equations.group_group[:, chosen[:, None], chosen]
        matrix = blocks.reshape(count * len(own), -1)
        values, coupling = -equations.gradient.groups[:, chosen].ravel(), equations.group_shared[:, chosen]
        if coupling.shape[2]:
            coupling = coupling.reshape(len(values), -1)
            unit = np.sqrt(np.diag(equations.shared_shared))
            root = np.linalg.cholesky(equations.shared_shared / np.outer(unit, unit)) * unit[:, None]
            inverse = lower_inverse(root[None])[0]
            follow = coupling @ (inverse.T @ (inverse @ np.column_stack([coupling.T, equations.gradient.shared])))
            matrix, values = matrix - follow[:, :-1], values + follow[:, -1]
        information, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
        known = information > _KNOWN * information[-1]
        information, vectors = information[known], vectors[:, known]
        mixing = np.sqrt(information)[:, None] * vectors.T
        return cls(vectors.T @ values / np.sqrt(information), mixing.reshape(-1, count, len(own)), information)

    def likeliest(self, changes: Array, others: Array | None = None) -> Found:
        """Return the likeliest of changes (V, n) of the offsets, each tried by itself; others: (V, j) changes that are
        there whichever it is.
        """
        size, count = self.mixing.shape[2], changes.shape[1]
        columns = np.einsum("rvk,vn->rnk", self.mixing, changes)
        without = self._likelihoods
        if others is not None:
            common = np.einsum("rvk,vn->rnk", self.mixing, others).reshape(len(columns), 1, -1)
            without = without + self._gains(common)[0][:, 0] / 2
            columns = np.concatenate([columns, np.repeat(common, count, axis=1)], axis=2)
        gains, sizes = self._gains(columns)
        likelihoods = self._likelihoods[:, None] + gains / 2
        tau, index = np.unravel_index(int(np.argmax(likelihoods)), likelihoods.shape)
        gain = 2 * (likelihoods[tau, index] - without.max())
        return Found(int(index), sizes[tau, index, :size], float(gain))

    def unordered(self) -> tuple[float, float]:
        """Return τ and how clear it is, in standard deviations."""
        likelihoods = self._likelihoods + _UNUSUAL * (_UNORDERED > 0)
        best = int(np.argmax(likelihoods))
        return float(_UNORDERED[best]), float(np.sqrt(2 * (likelihoods[best] - likelihoods[0])))

    @cached_property
    def _weights(self) -> Array:
        """The weights (T, R) of the combinations under all τ."""
        return np.asarray(1 / (1 + _UNORDERED[:, None] ** 2 * self.information))

    @cached_property
    def _likelihoods(self) -> Array:
        """The log likelihoods (T,) of all τ without a change, up to a constant."""
        squares = np.log(self._weights).sum(axis=1) - self._weights @ self.values**2
        return np.asarray(0.5 * squares - _UNUSUAL * (_UNORDERED > 0))

    def _gains(self, columns: Array) -> tuple[Array, Array]:
        """Return by how much each of n sets of m columns (R, n, m) lowers the squares under all τ (T, n), and how large
        the columns are then (T, n, m).
        """
        combinations, count, size = columns.shape
        products = (columns[..., :, None] * columns[..., None, :]).reshape(combinations, -1)
        information = (self._weights @ products).reshape(-1, count, size, size)
        scores = (self._weights @ (columns.reshape(combinations, -1) * self.values[:, None])).reshape(-1, count, size)
        traces = np.trace(information, axis1=2, axis2=3)
        least = _KNOWN * traces.max(axis=1, initial=0.0)[:, None] + 1e-300
        sure = traces > least
        diagonal = np.einsum("tnmm->tnm", information)
        diagonal += np.where(sure, _ROUNDING * traces, 1.0)[..., None]
        sizes = np.where(sure[..., None], np.linalg.solve(information, scores[..., None])[..., 0], 0.0)
        return np.sum(scores * sizes, axis=2), sizes


@dataclass(frozen=True, eq=False)
class ViewQuadratics:
    """Of every view the squared residuals, px², as a function of a change of the lens in standard deviations of its
    prior, the view's pose following: constant (V,), slopes (V, K), curvature (V, K, K); count: (V,) coordinates.
    weights: (V, P) those of the corners.
    """

    constant: Array
    slopes: Array
    curvature: Array
    count: Array
    weights: Array

    def costs(self, change: Array) -> Array:
        """Return the squared residuals (V,) under a change (K,), or one for each view (V, K)."""
        change = np.broadcast_to(change, self.slopes.shape)
        costs = self.constant + np.einsum(
            "vi,vi->v", 2 * self.slopes + np.einsum("vij,vj->vi", self.curvature, change), change
        )
        return np.asarray(np.maximum(costs, FINEST**2 * self.count))

    def best(self, members: Array) -> Array:
        """Return the change (K,) that suits some of the views (V,) best; each counts by its own noise."""
        change: Array = np.zeros(self.slopes.shape[1])
        for _ in range(_ROUNDS):
            weights = members * self.count / self.costs(change)
            before: Array = change
            change = np.asarray(-np.linalg.solve(self._normal(weights), weights @ self.slopes))
            if np.abs(change - before).max() < 1e-6:
                break
        return np.asarray(change)

    def left_out(self) -> Array:
        """Return the squared residuals (V,) of every view under the lens that the other views give."""
        change = self.best(np.ones(len(self.count)))
        weights = self.count / self.costs(change)
        normal = self._normal(weights) - weights[:, None, None] * self.curvature
        slopes = weights @ self.slopes - weights[:, None] * self.slopes
        return self.costs(-np.linalg.solve(normal, slopes[..., None])[..., 0])

    def scores(self) -> Array:
        """Return how every view pulls at the lens of all of them, (V, K), in units in which pulls are alike."""
        change = self.best(np.ones(len(self.count)))
        weights = self.count / self.costs(change)
        scores = weights[:, None] * (self.slopes + self.curvature @ change)
        return np.asarray(np.linalg.solve(np.linalg.cholesky(self._normal(weights)), scores.T).T)

    def gain(self, smaller: Array) -> float:
        """Return by how much two lenses are likelier than one, nat per coordinate of the smaller group (V,)."""
        two = np.where(smaller, self.costs(self.best(smaller)), self.costs(self.best(~smaller)))
        one = self.costs(self.best(np.ones(len(smaller))))
        return float(np.sum(0.5 * self.count * np.log(one / two)) / self.count[smaller].sum())

    def _normal(self, weights: Array) -> Array:
        return np.asarray(np.einsum("v,vij->ij", weights, self.curvature) + np.eye(self.slopes.shape[1]))


def view_quadratics(problem: BoardProblem, state: State) -> ViewQuadratics:
    """Return the information of views on the lens; corners count little that are far off within their view."""
    derivatives, (views, points) = problem.derivatives(state), problem.observations.ids.shape
    shown = (problem.observations.weights > 0) & derivatives.valid.reshape(views, points)
    distances = np.where(shown, np.hypot(*derivatives.residuals).reshape(views, points), np.nan)
    typical = row_medians(distances, shown)
    relative = np.nan_to_num(distances) * RAYLEIGH_MEDIAN / np.maximum(typical, FINEST)[:, None]
    weights = shown * _LOSS.weight(relative**2)
    lens, spread = problem.free, problem.lens_spread
    scale = np.abs(state.parameters[lens]) if spread is None else spread[lens]
    scale = np.where(np.isfinite(scale) & (scale > 0), scale, np.maximum(np.abs(state.parameters[lens]), 1.0))
    parts = [
        np.concatenate([derivatives.residuals[:, None], derivatives.by_lens * scale[:, None]], axis=1),
        derivatives.by_pose(),
    ]
    products = []
    for first in range(0, views, _CHUNK):
        some = slice(first, first + _CHUNK)
        root = np.sqrt(weights[some])
        columns, pose = (
            (part.reshape(2, -1, views, points)[:, :, some] * root)
            .transpose(2, 0, 3, 1)
            .reshape(len(root), 2 * points, -1)
            for part in parts
        )
        basis = np.linalg.qr(pose)[0]
        left = columns - basis @ (basis.transpose(0, 2, 1) @ columns)
        products.append(left.transpose(0, 2, 1) @ left)
    gram = np.concatenate(products)
    return ViewQuadratics(gram[:, 0, 0], gram[:, 1:, 0], gram[:, 1:, 1:], 2.0 * shown.sum(axis=1), weights)


@dataclass(frozen=True)
class EntrancePupil(Brief):
    """The shift, towards the scene, of the entrance pupil for rays at an angle (rad) against that on the axis.

    shift, std: in the board's unit. moved_px: RMS by which that moves the outermost corners, against ones far away.
    views: that show it.
    """

    shift: float
    std: float
    angle: float
    moved_px: float
    views: int

    @property
    def seen(self) -> bool:
        """Whether it is not chance."""
        return abs(self.shift) > _CLEARLY * student_bound(max(self.views - 1, 1)) * self.std


def entrance_pupil(estimate: Estimate) -> EntrancePupil | None:
    """Return the shift that a solution leaves to be seen, None for a lens that is not wide or not free, and where all
    boards are equally far away.
    """
    central, state = replace(estimate.problem, offsets=False), estimate.state
    points = central.camera_points(state)
    angles = np.arctan2(np.hypot(points[0], points[1]), points[2])
    kept = central.observations.weights >= REJECTED
    largest = float(np.max(angles, where=kept, initial=0.0))
    if largest < _WIDE or not central.model.is_central or not len(central.free):
        return None
    try:
        return _fit_shift(estimate, central, angles, largest)
    except (SingularError, np.linalg.LinAlgError):
        return None


def _fit_shift(estimate: Estimate, central: BoardProblem, angles: Array, largest: float) -> EntrancePupil:
    """Return the shift, the last one of the parameters that views share, without a prior."""
    state, place, shift, table = estimate.state, central.shared, 0.0, central.observations
    for number in range(_STEPS):
        derivatives = central.derivatives(state)
        column = -derivatives.by_point[:, 2] * (angles.ravel() / largest) ** 2
        block = central.data(state, replace(derivatives, residuals=derivatives.residuals + shift * column))
        root = None if table.whitening is None else table.whitening.reshape(2, 2, -1)
        own = Jacobian(whitened(root, column)[:, None].transpose(2, 0, 1), np.array([place]))
        blocks, last = [replace(block, shared=(*block.shared, own)), *central.priors(state)], number == _STEPS - 1
        factors = factorise(assemble(blocks, place + 1, *central.groups, products=last))
        step = factors.solve()
        shift += float(step.shared[place])
        state = central.retract(state, Step(step.shared[:place], step.groups))
    left = posterior(factors)
    scatter: Array = influence(replace(estimate, factors=factors, posterior=left))[:, place]
    std = np.sqrt(max(float(scatter @ scatter), left.shared[place, place]))
    outer = ((table.weights >= REJECTED) & (angles > _OUTER * largest)).ravel()
    moved_px = abs(shift) * float(np.sqrt(np.mean(np.sum(column[:, outer] ** 2, axis=0))))
    return EntrancePupil(shift, float(std), largest, moved_px, len(scatter))
