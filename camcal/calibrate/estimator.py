"""Lens, poses, board and errors within views together with the scale of each of them, in alternation.

Every pass takes from the residuals the noise, of all corners, of a view's and of single ones; from one linearisation
the variances of the effects within views; solves for everything that is linear in it; and takes from the solution the
scales of the board's shape. All of them follow the data continuously: nothing is kept or dropped by a test, and what
counts for little now is looked at again in the next pass.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.corner_noise import PERIODS, CornerNoise, estimate_noise, period_shares
from camcal.calibrate.effects import EFFECTS, EffectColumns, effect_columns
from camcal.calibrate.noise import FINEST, ViewNoise, clipped, corner_weights, count_of, first_noise, lost, view_noise
from camcal.calibrate.problem import BoardProblem, Derivatives, State
from camcal.calibrate.scales import Scale
from camcal.calibrate.shape import board_scales, first_scales, offset_std, spent_on_offsets, under, with_terms
from camcal.calibrate.single_points import AT_ALL_TOGETHER, TOGETHER, point_equations
from camcal.calibrate.variances import EffectScales, Posterior, fit_effects, posterior, scaled
from camcal.solve.least_squares import Stopping, minimise
from camcal.solve.losses import Cauchy
from camcal.solve.steps import Factors, NormalEquations, Step, assemble, factorise

_LEAST, MOST = 4, 30  # passes
# Of a standard deviation, the largest change of a lens parameter by a pass: after which no other is needed, and with
# which the result may still be used where passes run out.
_SETTLED, _CALM = 5e-3, 0.3
# Noise, weights and lens answer to each other, and full steps may overshoot: so much of the way to new scales is gone,
# and less from then on where a pass takes back what the one before did.
_NEW, _LESS, _LEAST_SHARE, _BACK = 0.6, 0.6, 0.1, 0.25
_OUT_OF_PROPORTION, _HALVINGS = 3.0, 20  # times the residuals before a step; halvings of a step
_FINER = 0.4  # of the standard deviation that the images claim of a typical corner: the least that is believed
_POSING, _GROSS = Stopping(relative_decrease=1e-6, iterations=20), 3.0  # of lost views; σ where an error is gross
_LEAST_DOF = 0.05  # of the coordinates, however many parameters were paid for


@dataclass(frozen=True)
class Freedom:
    """What is estimated besides lens and poses: the board's smooth shape, its single points, effects within views (the
    names of EFFECTS).
    """

    smooth: bool = True
    points: bool = True
    effects: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Views:
    """What was detected: present: (V, P) the points that there are, whatever their weight. claimed: (V, P, 2, 2) px²,
    their covariances as their images give them, None: all alike.
    """

    present: Array
    claimed: Array | None = None


@dataclass(frozen=True, eq=False)
class Estimate:
    """Where the passes ended.

    problem: with the final noise, weights and priors. board: the scales of the classes of its shape. factors: of the
    last linear solve, effects in standard deviations. posterior: what it leaves open. converged: whether the lens had
    settled.
    """

    problem: BoardProblem
    state: State
    freedom: Freedom
    noise: ViewNoise
    corners: CornerNoise | None
    board: Mapping[str, Scale]
    effect_scales: EffectScales | None
    factors: Factors
    posterior: Posterior
    passes: int
    converged: bool


def estimate(
    problem: BoardProblem,
    state: State,
    views: Views,
    freedom: Freedom,
    start: Estimate | None = None,
    passes: int = MOST,
) -> Estimate:
    """Return the estimate that passes lead to from a state near it.

    start: an estimate of the same problem with less freedom, whose noise and board scales are taken over. passes: at
    most. Raises SingularError where the data leave parameters undetermined.
    """
    return _Passes(problem, state, views, freedom, start).run(passes)


class _Passes:
    """The alternation; its attributes are what a pass leaves for the next."""

    def __init__(
        self, problem: BoardProblem, state: State, views: Views, freedom: Freedom, start: Estimate | None
    ) -> None:
        present = views.present
        if freedom.smooth:
            problem, state = with_terms(problem, state)
        together = freedom.points and problem.board.count <= TOGETHER
        self.problem = replace(problem, loss=None, offsets=together)
        self.state, self.present, self.claimed, self.freedom = state, present, views.claimed, freedom
        self.corners = start.corners if start else None
        self.shares = np.zeros((*present.shape, 2, len(PERIODS)))
        self.board = dict(start.board) if start else first_scales()
        residuals = self.problem.residuals(state)
        self.noise = start.noise if start else first_noise(self.problem.distances(residuals), present)
        self.spent = start.posterior.spent if start else np.full(len(present), 6.0)
        self.effect_scales: EffectScales | None = None
        if freedom.effects:
            self.effect_scales = EffectScales.start(len(present), self.noise.sigma, max(problem.board.extent))
        self.columns: EffectColumns | None = None
        self.field = np.zeros((2, *present.shape))
        self.moved, self.share = np.zeros(len(problem.free)), _NEW
        # offsets of the points may follow the corners of a view or two exactly, as if these had no noise at all
        self.finest = FINEST if views.claimed is None else _FINER * _typical_std(views.claimed[present])

    def run(self, passes: int) -> Estimate:
        settled, number = np.inf, 0
        while number < passes and not (number >= _LEAST and settled < _SETTLED):
            number += 1
            factors, left, settled = self._pass(first=number == 1)
        if self.freedom.points and not self.problem.offsets and self.problem.board.count <= AT_ALL_TOGETHER:
            self.problem = replace(self.problem, offsets=True)
            factors, left, _ = self._pass(first=False)
        return Estimate(
            self.problem,
            self.state,
            self.freedom,
            self.noise,
            self.corners,
            self.board,
            self.effect_scales,
            factors,
            left,
            number,
            bool(settled < _CALM),
        )

    def _pass(self, *, first: bool) -> tuple[Factors, Posterior, float]:
        """Return the factors of a pass, what they leave open, and by how much a lens parameter moved, in standard
        deviations.
        """
        before = self.state.parameters
        derivatives = self.problem.derivatives(self.state)
        self._judge(derivatives, first=first)
        equations = self._linearised(derivatives)
        factors, step = self._solved(equations)
        self._move(step)
        self._pose_lost_views()
        left = posterior(factors)
        self.board = self.board | board_scales(self.problem, self.state, factors)
        offsets = 0.0
        if self.problem.offsets:
            offsets = spent_on_offsets(self.problem, factors)
        elif self.freedom.points:
            offsets = self._move_points()
        corners = count_of(self.problem.observations.weights)
        self.spent = left.spent + offsets * corners / corners.sum()
        left = replace(left, spent=self.spent)
        free = self.problem.free
        moved = (self.state.parameters - before)[free] / np.sqrt(np.diag(left.shared)[: len(free)])
        if moved @ self.moved < -_BACK * np.linalg.norm(moved) * np.linalg.norm(self.moved):
            self.share = max(_LESS * self.share, _LEAST_SHARE)
        self.moved = moved
        return factors, left, float(np.max(np.abs(moved), initial=0.0))

    def _judge(self, derivatives: Derivatives, *, first: bool) -> None:
        """Take noise and weights from the residuals.

        Beyond the domain of the lens of now they are those of its formula: a corner that had none could not pull the
        lens back.
        """
        residuals = np.where(derivatives.valid, derivatives.residuals, np.nan).reshape(self.field.shape) + self.field
        if self.claimed is not None and not first:
            self._weigh(residuals)
        distances = self.problem.distances(residuals)
        if not first:
            weights = self.problem.observations.weights
            self.noise = view_noise(distances, self.present, weights, self.spent, self.noise, self.share, self.finest)
        weights = corner_weights(distances, self.present, self.noise, self.spent)
        if not first:
            weights = np.where(
                weights > 0, self.share * weights + (1 - self.share) * self.problem.observations.weights, 0.0
            )
        observations = replace(self.problem.observations, weights=weights)
        problem = replace(self.problem, observations=observations, sigma=self.noise.sigma, noise=self.noise.views)
        self.problem = under(problem, self.board)

    def _weigh(self, residuals: Array) -> None:
        """Take the errors that corners have beyond their covariances from the residuals, and weigh them by both."""
        assert self.claimed is not None
        observations = self.problem.observations
        kept = self.present & np.isfinite(residuals).all(axis=0)
        # by their own median, not by the weights: these follow from the noise, and both would shrink each other
        even = clipped((residuals / np.sqrt(self.noise.views)[:, None])[:, kept].T)
        weights = np.ones(len(even))
        found = estimate_noise(even, self.claimed[kept], self.shares[kept], weights, self._unspent(), self.corners)
        self.corners = found if self.corners is None else self.corners.towards(found, self.share)
        total = self.corners.covariances(self.claimed.reshape(-1, 2, 2), self.shares.reshape(-1, 2, len(PERIODS)))
        self.problem = replace(self.problem, observations=observations.weighted(total.reshape(self.claimed.shape)))

    def _linearised(self, derivatives: Derivatives) -> NormalEquations:
        if self.claimed is not None and self.problem.board.crossed:
            self.shares = self._shares(derivatives)
        values = None
        if self.freedom.effects:
            self.columns = self._columns(derivatives)
            values = self.columns.values
        blocks = [self.problem.data(self.state, derivatives, values), *self.problem.priors(self.state)]
        size = 6 + (0 if values is None else values.shape[1])
        equations = assemble(blocks, self.problem.shared, len(self.present), size)
        if self.columns is not None and self.effect_scales is not None:
            self.effect_scales = fit_effects(equations, self.columns, self.effect_scales)
        return equations

    def _shares(self, derivatives: Derivatives) -> Array:
        """Return the shares (V, P, 2, n) that errors of each period have in the corners, in u and in v."""
        board, shape = self.problem.board, self.present.shape
        side = board.pitch if board.checker else (board.marker or board.pitch)
        by_point = derivatives.by_point.reshape(2, 3, *shape)
        axes = side * np.einsum("ijvp,vjk->vpik", by_point, self.state.rotations[:, :, :2])
        return period_shares(axes.reshape(-1, 2, 2)).reshape(*shape, 2, -1)

    def _columns(self, derivatives: Derivatives) -> EffectColumns:
        problem, shape = self.problem, self.present.shape
        by_height = np.einsum("ijvp,vj->ivp", derivatives.by_point.reshape(2, 3, *shape), self.state.rotations[:, :, 2])
        columns = effect_columns(
            problem.board,
            problem.observations.ids,
            problem.observations.pixels,
            derivatives.by_pose().reshape(2, 6, *shape),
            by_height,
            self.present,
        )
        return columns.of([index for index, effect in enumerate(EFFECTS) if effect.name in self.freedom.effects])

    def _solved(self, equations: NormalEquations) -> tuple[Factors, Step]:
        std = np.zeros((len(self.present), 0))
        if self.columns is not None and self.effect_scales is not None:
            std = self.effect_scales.std(self.columns.effect)
        factors = factorise(scaled(equations, std))
        step = factors.solve()
        return factors, Step(step.shared, np.concatenate([step.groups[:, :6], std * step.groups[:, 6:]], axis=1))

    def _move_points(self) -> float:
        """Solve for the offsets of the points, everything else held; return the degrees of freedom they take."""
        equations = point_equations(self.problem, self.state, self.problem.derivatives(self.state), self.field)
        side = max(self.problem.board.extent)
        self.board = self.board | equations.scales(side, self._unspent())
        std = offset_std(self.board, side)
        self.state = replace(self.state, offsets=equations.offsets(std))
        return equations.spent(std)

    def _unspent(self) -> float:
        """Return the degrees of freedom per coordinate that parameters have left over."""
        left = 1 - float(np.sum(self.spent)) / float(np.sum(count_of(self.problem.observations.weights)))
        return max(left, _LEAST_DOF)

    def _move(self, step: Step) -> None:
        """Take a step, or so much of it as leads to residuals that are not out of proportion."""
        longest = _OUT_OF_PROPORTION * max(self._typical(self.state), self.noise.sigma)
        for _ in range(_HALVINGS):
            state = self.problem.retract(self.state, step)
            if self._typical(state) <= longest:
                break
            step = Step(step.shared / 2, step.groups / 2)
        self.state = state
        if self.columns is not None:
            self.field = np.einsum("imvp,vm->ivp", self.columns.values, step.groups[:, 6:])

    def _pose_lost_views(self) -> None:
        """Pose the views that have lost most of their corners once more, all corners counting: an old pose under a lens
        that has moved on would be held against them for good.
        """
        views = np.flatnonzero(lost(self.problem.observations.weights, self.present))
        if not len(views):
            return
        poses, bare = self.problem.poses_only(self.state)
        observations = replace(poses.observations.take(views), weights=self.present[views].astype(float))
        poses = replace(poses, observations=observations, noise=None, loss=Cauchy(_GROSS))
        found = minimise(poses.within_domain(bare.take(views)), bare.take(views), _POSING).state
        rotations, translations = self.state.rotations.copy(), self.state.translations.copy()
        rotations[views], translations[views] = found.rotations, found.translations
        self.state = replace(self.state, rotations=rotations, translations=translations)

    def _typical(self, state: State) -> float:
        """Return the median length of the residuals, whitened px, infinite where the lens takes less than half."""
        distances = self.problem.distances(self.problem.residuals(state))[self.present]
        return float(np.median(np.where(np.isnan(distances), np.inf, distances)))


def _typical_std(covariances: Array) -> float:
    """Return the standard deviation of a coordinate of a typical corner, of covariances (N, 2, 2)."""
    return float(np.sqrt(np.median(np.trace(covariances, axis1=1, axis2=2)) / 2))
