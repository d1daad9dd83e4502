"""One camera and a board in many views as a least-squares problem: the only place that knows the parameter layout.

Shared parameters, in this order: the free lens parameters, the coefficients of the board's shape, the offsets of
its points (x y z of point 0, of point 1, …). Each view's pose camera_T_board is a group of six: tx ty tz rx ry rz,
followed by the coefficients of effects within views where an estimator models them.
"""

from functools import cached_property

import numpy as np

from camcal.arrays import Array
from camcal.cameras.lens import CameraModel
from camcal.cameras.observations import Observations, by_pose, linearised, residuals, rotated_points, whitened
from camcal.cameras.spline_modes import ReducedSpline
from camcal.dataclass import dataclass, replace
from camcal.geometry.pose import retract
from camcal.solve.least_squares import assemble
from camcal.solve.losses import Loss
from camcal.solve.steps import Block, Jacobian, NormalEquations, Step
from camcal.targets.board import Board, basis

POSE = 6  # parameters of a view: tx ty tz rx ry rz
# Of its prior's standard deviation: above it the data bring less than three quarters of a coefficient's precision, so
# that more than a quarter is an assumption (1/σ² = 1/σ_data² + 1/σ_prior²).
_HELD_BY_PRIOR = 0.5
_FITS = 3.0  # times the noise: the distance within which a point fits


@dataclass(frozen=True, eq=False)
class State:
    """Lens parameters (K,), poses camera_T_board as rotations (V, 3, 3) and translations (V, 3), shape (S,) and
    offsets (C, 3) of the board's points.
    """

    parameters: Array
    rotations: Array
    translations: Array
    shape: Array
    offsets: Array

    def take(self, views: Array) -> "State":
        """Return the state of some of the views."""
        return replace(self, rotations=self.rotations[views], translations=self.translations[views])


@dataclass(frozen=True, eq=False)
class Derivatives:
    """Residuals (2, M) in pixels of M = V · P points, not whitened, and their derivatives by the points in the camera
    frame (2, 3, M) and by the free lens parameters (2, K, M). rotated: (3, M) the board's points in the camera's axes.
    valid: (M,) bool, the points that have an image; the others have zeros.
    """

    residuals: Array
    by_point: Array
    by_lens: Array
    rotated: Array
    valid: Array

    def by_board(self, rotations: Array) -> Array:
        """Return the derivatives (V, P, 2, 3) by x, y, z of the board; rotations: (V, 3, 3) camera_T_board."""
        by_point = self.by_point.reshape(2, 3, len(rotations), -1)
        return np.asarray(np.einsum("ijvp,vjk->vpik", by_point, rotations))

    def by_pose(self) -> Array:
        """Return the derivatives (2, 6, M) by tx ty tz rx ry rz."""
        return by_pose(self.by_point, self.rotated)


@dataclass(frozen=True, eq=False)
class BoardProblem:
    """The residuals, in pixels over `sigma`, of a board seen in many views.

    free: indices of the lens parameters that move. terms: the shape terms in use. offsets: whether the offsets of the
    board's points move as well. sigma: the noise of a pixel coordinate; priors count against it. points: (C, 3) the
    board as it is known to be, None for as drawn. lens_spread: (K,) standard deviations of the weak priors on the
    lens parameters about lens_mean (K,), or else the model's prior_mean, inf for none. term_std: (S,), offset_std: (3,)
    those of the board's terms and offsets, in its unit; board_known: whether they stay as they are, not follow what
    views show.
    noise: (V,) the variance of a view's corners over that of a typical view; finest: px, the least it may be.
    """

    model: CameraModel
    board: Board
    observations: Observations
    free: Array
    terms: tuple[str, ...] = ()
    offsets: bool = False
    sigma: float = 1.0
    loss: Loss | None = None
    points: Array | None = None
    lens_spread: Array | None = None
    lens_mean: Array | None = None
    term_std: Array | None = None
    offset_std: Array | None = None
    board_known: bool = False
    noise: Array | None = None
    finest: float = 0.0

    @property
    def shared(self) -> int:
        return len(self.free) + len(self.terms) + (3 * self.board.count if self.offsets else 0)

    @property
    def groups(self) -> tuple[int, int]:
        return len(self.observations.ids), POSE

    @cached_property
    def shape_basis(self) -> Array:
        """The displacement (C, 3, S) of the board's points by the terms of its shape."""
        return basis(self.board, self.terms)

    @cached_property
    def shared_names(self) -> tuple[str, ...]:
        """The names of the shared parameters, in their order."""
        lens = tuple(self.model.parameter_names[index] for index in self.free)
        points = range(self.board.count) if self.offsets else ()
        return lens + self.terms + tuple(f"point {point} {axis}" for point in points for axis in "xyz")

    def shared_values(self, state: State) -> Array:
        """Return the free lens parameters and the terms of the board's shape (D,) of a state."""
        return np.concatenate([state.parameters[self.free], state.shape])

    def prior_precision(self, _: State) -> Array:
        """Return the precision (D, D) of the priors of the same parameters."""
        lens = np.zeros(len(self.free)) if self.lens_spread is None else self.lens_spread[self.free] ** -2.0
        terms = np.zeros(len(self.terms)) if self.term_std is None else self.term_std**-2.0
        return np.diag(np.concatenate([lens, terms]))

    def board_points(self, state: State) -> Array:
        """Return the points (C, 3) of the board as the state has it."""
        known = self.board.points() if self.points is None else self.points
        return np.asarray(known + self.shape_basis @ state.shape + state.offsets)

    def within_domain(self, state: State) -> "BoardProblem":
        """Return the problem without the points that the lens cannot take at this state."""
        lost = np.isnan(self.residuals(state)).any(axis=0)
        return replace(
            self, observations=replace(self.observations, weights=np.where(lost, 0.0, self.observations.weights))
        )

    def poses_only(self, state: State) -> "tuple[BoardProblem, State]":
        """Return the problem and state of the poses alone, lens and board held as the state has them."""
        problem = replace(
            self,
            free=np.zeros(0, np.intp),
            terms=(),
            offsets=False,
            points=self.board_points(state),
            lens_spread=None,
        )
        return problem, replace(state, shape=np.zeros(0), offsets=0 * state.offsets)

    def retract(self, state: State, step: Step) -> State:
        """Return the state moved by a step."""
        lens, shape = len(self.free), len(self.free) + len(self.terms)
        parameters = state.parameters.copy()
        parameters[self.free] += step.shared[:lens]
        rotations, translations = retract(state.rotations, state.translations, step.groups[:, :6])
        offsets = state.offsets + step.shared[shape:].reshape(-1, 3) if self.offsets else state.offsets
        return State(parameters, rotations, translations, state.shape + step.shared[lens:shape], offsets)

    def distances(self, residuals: Array) -> Array:
        """Return the lengths (V, P) of residuals (2, V, P), whitened where covariances are known."""
        residuals = whitened(self.observations.whitening, residuals)
        return np.asarray(np.sqrt(residuals[0] ** 2 + residuals[1] ** 2))

    def residuals(self, state: State) -> Array:
        """Return projected minus observed pixels (2, V, P), NaN outside the lens's domain; not divided by σ."""
        _, points = self._points(state)
        return residuals(self.model, state.parameters, points, self.observations.pixels)

    def blocks(self, state: State) -> list[Block] | None:
        """Return the observations and the priors, or None where a point has no image at all, or has left the lens's
        domain and fits: what the formula makes of it there would hold the lens in a minimum of its own.
        """
        derivatives, counts = self.derivatives(state, within_domain=True), self.observations.weights.ravel() > 0
        outside = counts & ~derivatives.valid
        if outside.any():
            beyond, root = self.derivatives(state, only=outside), self.observations.whitening
            left = whitened(None if root is None else root.reshape(2, 2, -1)[:, :, outside], beyond.residuals)
            if not beyond.valid.all() or np.any(np.hypot(*left) < _FITS * self.sigma):
                return None
            for name in ("residuals", "by_point", "by_lens"):
                getattr(derivatives, name)[..., outside] = getattr(beyond, name)
        return [self.data(state, derivatives), *self.priors(state)]

    def observed(self, state: State) -> list[Block]:
        """Return the observations, by the lens's formula beyond its domain as well."""
        return [self.data(state, self.derivatives(state))]

    def derivatives(
        self, state: State, *, within_domain: bool = False, only: Array | slice = slice(None)
    ) -> "Derivatives":
        """Return the residuals and their derivatives at a state, by the lens's formula beyond its domain as well unless
        only points within it are to have an image; only: (M,) bool, of some of the points.
        """
        rotated, points = (part.reshape(3, -1)[:, only] for part in self._points(state))
        pixels = self.observations.pixels.reshape(2, -1)[:, only]
        seen = linearised(self.model, state.parameters, points, pixels, within_domain=within_domain)
        by_lens = seen.by_lens if len(self.free) else np.zeros((2, 0, len(seen.valid)))
        by_lens = by_lens if len(self.free) == by_lens.shape[1] else by_lens[:, self.free]
        return Derivatives(seen.residuals, seen.by_point, by_lens, rotated, seen.valid)

    def with_points_moved(self, state: State, derivatives: "Derivatives", change: Array) -> "Derivatives":
        """Return the derivatives of a state whose board's points are then moved by `change` (C, 3), to first order."""
        moved = np.einsum("vij,vpj->ivp", state.rotations, change[self.observations.ids]).reshape(3, -1)
        residuals = derivatives.residuals + np.sum(derivatives.by_point * moved, axis=1)
        return replace(derivatives, residuals=residuals, rotated=derivatives.rotated + moved)

    def data(self, state: State, derivatives: "Derivatives", effects: Array | None = None) -> Block:
        """Return the observations as a block; effects: (2, m, V, P) columns that follow those of a view's pose."""
        residuals, by_point, by_lens = derivatives.residuals, derivatives.by_point, derivatives.by_lens
        further = [] if effects is None else [effects.reshape(2, effects.shape[1], -1)]
        if self.observations.whitening is not None:
            parts, root = (residuals, by_point, by_lens, *further), self.observations.whitening.reshape(2, 2, -1)
            residuals, by_point, by_lens, *further = (whitened(root, part) for part in parts)
        shared = [Jacobian(by_lens.transpose(2, 0, 1), np.arange(len(self.free)))]
        shared += self._shape_jacobians(by_point, state.rotations)
        group = by_pose(by_point, derivatives.rotated)
        group = np.concatenate([group, *further], axis=1) if further else group
        weights = self.observations.weights
        if self.noise is not None:
            weights = weights / self.noise[:, None]
        return Block(
            residuals.T,
            tuple(shared),
            group.transpose(2, 0, 1),
            rows_per_group=self.observations.ids.shape[1],
            weights=weights.ravel() / self.sigma**2,
            loss=self.loss,
        )

    def equations(self, state: State, derivatives: "Derivatives", effects: Array | None = None) -> NormalEquations:
        """Return the normal equations of the observations and the priors; effects: as `data` has them."""
        blocks = [self.data(state, derivatives, effects), *self.priors(state)]
        size = POSE + (0 if effects is None else effects.shape[1])
        return assemble(blocks, self.shared, len(self.observations.ids), size)

    def camera_points(self, state: State) -> Array:
        """Return the board's points in the camera frame (3, V, P)."""
        return self._points(state)[1]

    def _points(self, state: State) -> tuple[Array, Array]:
        """Return the board's points rotated and in the camera frame, both (3, V, P)."""
        rotated = rotated_points(state.rotations, self.board_points(state).T[:, self.observations.ids])
        return rotated, rotated + state.translations.T[:, :, None]

    def _shape_jacobians(self, by_point: Array, rotations: Array) -> list[Jacobian]:
        """Return the derivatives by the shape's coefficients and by the points' offsets."""
        if not self.terms and not self.offsets:
            return []
        views = self.observations.ids.shape
        gradient = by_point.reshape(2, 3, *views)
        axes = [_dot(rotations[:, :, axis].T[:, :, None], gradient.transpose(1, 0, 2, 3)) for axis in range(3)]
        if not self.model.is_central:
            axes[2] = np.zeros_like(axes[2])  # of heights: their images have the sign of a tilt, which is open
        start, result = len(self.free), []
        if self.terms:
            values = np.zeros((2, len(self.terms), *views))
            for index in range(len(self.terms)):
                for axis in range(3):
                    displacement = self.shape_basis[:, axis, index]
                    if displacement.any():
                        values[:, index] += axes[axis] * displacement[self.observations.ids]
            columns = np.arange(start, start + len(self.terms))
            result.append(Jacobian(values.reshape(2, len(self.terms), -1).transpose(2, 0, 1), columns))
        if self.offsets:
            first = start + len(self.terms) + 3 * self.observations.ids.reshape(-1, 1)
            stacked = np.stack(axes, axis=1).reshape(2, 3, -1)
            result.append(Jacobian(stacked.transpose(2, 0, 1), first + np.arange(3)))
        return result

    def priors(self, state: State) -> list[Block]:
        """Return the priors of the lens, of the board's terms and of the offsets."""
        return self.lens_priors(state) + self.board_priors(state, len(self.free)) + self._pose_priors()

    def _pose_priors(self) -> list[Block]:
        """Return what holds poses where they are that no image of the lens shows: how far away a board is, and to which
        side it is tilted where it is hardly tilted.
        """
        if self.model.is_central:
            return []
        views, side = len(self.observations.ids), max(self.board.extent)
        slopes = np.tile(np.diag([1 / side, 1.0, 1.0]), (views, 1, 1))
        return [Block(np.zeros((views, 3)), (), slopes, rows_per_group=1, group_columns=np.array([2, 3, 4]))]

    def lens_priors(self, state: State, start: int = 0) -> list[Block]:
        """Return the priors of the lens, whose free parameters stand from `start` on among those that views share."""
        if self.lens_spread is None or not len(self.free):
            return []
        spread = self.lens_spread[self.free]
        mean = self.model.prior_mean if self.lens_mean is None else self.lens_mean
        apart = (state.parameters - mean)[self.free]
        return [_prior(apart / spread, 1 / spread, start)]

    def held_by_prior(self, stds: Array) -> tuple[str, ...]:
        """Return the lens parameters that their priors hold; stds: (S,) of the shared parameters as solved for."""
        if self.lens_spread is None or isinstance(self.model, ReducedSpline):
            return ()
        held = stds[: len(self.free)] > _HELD_BY_PRIOR * self.lens_spread[self.free]
        return tuple(np.array(self.shared_names[: len(self.free)])[held].tolist())

    def board_priors(self, state: State, start: int) -> list[Block]:
        """Return the priors of the board's terms and offsets, which stand from `start` on."""
        result = []
        if self.terms and self.term_std is not None:
            result.append(_prior(state.shape / self.term_std, 1 / self.term_std, start))
        if self.offsets and self.offset_std is not None:
            slopes = np.tile(1 / self.offset_std, self.board.count)
            result.append(_prior(state.offsets.ravel() * slopes, slopes, start + len(self.terms)))
        return result


def _dot(first: Array, second: Array) -> Array:
    """Return Σ first_i · second_i over the leading axis of three."""
    return np.asarray(first[0] * second[0] + first[1] * second[1] + first[2] * second[2])


def _prior(residuals: Array, slopes: Array, start: int) -> Block:
    columns = np.arange(start, start + len(residuals))[:, None]
    return Block(residuals[:, None], (Jacobian(slopes[:, None, None], columns),))
