"""Alternating estimation of lens, poses, board and errors within views with their variance components.

Every pass takes from the residuals the noise, of all corners, of a view's and of single ones; from one linearisation
the variances of the effects within views; solves for everything that is linear in it; and takes from the solution the
scales of the board's shape. All of them follow the data continuously: nothing is kept or dropped by a test, and what
counts for little now is examined again in the next pass.
"""

from collections.abc import Mapping

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.camera_part import CALM, AdditionalParameters, Alternation, CameraPart, KnownNoise, Place
from camcal.calibrate.effects import EFFECTS, EffectScales, Posterior, fit_effects, posterior, scaled
from camcal.calibrate.noise import (
    CornerNoise,
    ViewNoise,
    lost,
)
from camcal.calibrate.problem import POSE, BoardProblem, State
from camcal.calibrate.shape import (
    TOGETHER,
    Scale,
    board_scales,
    offset_std,
    point_equations,
    scales_towards,
    spent_on_offsets,
    with_terms,
)
from camcal.dataclass import dataclass, replace
from camcal.solve.descent import Stopping
from camcal.solve.least_squares import minimise
from camcal.solve.losses import Cauchy
from camcal.solve.steps import Factors, Step, factorise, lowest_along

# A step is as long as the cost along it is lowest: how near to that is near enough, how much shorter a trial may be,
# how many there are, and of the cost what cannot be seen in it.
_NEAR, _SHORTEST, _TRIALS, _UNSEEN = 0.75, 0.2, 12, 1e-11
_POSING, _GROSS = Stopping(relative_decrease=1e-6, iterations=20), 3.0  # of lost views; σ where an error is gross


@dataclass(frozen=True, eq=False)
class Estimate:
    """Where the passes ended.

    problem: with the final noise, weights and priors. board: the scales of the classes of its shape. coefficients:
    (V, m) of effects. factors: of the last linear solve, effects in standard deviations. linearised: the state that it
    began from. posterior: what it leaves open. converged: whether the lens had settled. model_error_px: what a typical
    corner is off by beyond its covariance, None without covariances.
    """

    problem: BoardProblem
    state: State
    additional: AdditionalParameters
    noise: ViewNoise
    corners: CornerNoise | None
    board: Mapping[str, Scale]
    effect_scales: EffectScales | None
    coefficients: Array
    factors: Factors
    linearised: State
    posterior: Posterior
    passes: int
    converged: bool
    model_error_px: float | None = None

    @property
    def known(self) -> KnownNoise:
        """The noise, for an estimate that goes on from this one."""
        return KnownNoise(self.noise, self.corners, self.posterior.spent)


def estimate(
    problem: BoardProblem,
    state: State,
    additional: AdditionalParameters,
    start: Estimate | None = None,
    *,
    brief: bool = False,
) -> Estimate:
    """Return the estimate that passes lead to from a state near it.

    start: an estimate of the same problem with no more freedom, whose noise and scales are taken over. brief: with few
    passes, to look at, single points of the board solved for in turn. Raises SingularError where the data leave
    parameters undetermined.
    """
    return _Passes(problem, state, additional, start, brief=brief).run()


class _Passes(CameraPart, Alternation):
    """The alternation; its attributes are what a pass leaves for the next."""

    def __init__(
        self,
        problem: BoardProblem,
        state: State,
        additional: AdditionalParameters,
        start: Estimate | None,
        *,
        brief: bool,
    ) -> None:
        if additional.smooth:
            problem, state = with_terms(problem, state)
        together = additional.points and problem.board.count <= TOGETHER and not brief
        known = start.known if start else None
        super().__init__(replace(problem, loss=None, offsets=together), state, additional.effects, known)
        self.begin(additional, fresh=start is None, brief=brief)
        self.effect_scales = EffectScales.start(len(self.present), self.noise.sigma, max(problem.board.extent))
        if start:
            self.board = dict(start.board)
        if start and start.effect_scales:
            self._take_effects(start, start.effect_scales)

    def _take_effects(self, start: Estimate, scales: EffectScales) -> None:
        """Begin with the effects of an estimate that has some of them."""
        known = np.array([effect.name in start.additional.effects for effect in EFFECTS])
        self.effect_scales = replace(
            self.effect_scales,
            variances=np.where(known, scales.variances, self.effect_scales.variances),
            shares=np.where(known, scales.shares, self.effect_scales.shares),
        )
        self.place.coefficients[:, known[self.columns.effect]] = start.coefficients

    def run(self) -> Estimate:
        number, (factors, left, moved) = self.alternate()
        return Estimate(
            self.problem,
            self.place.state,
            additional=self.additional,
            noise=self.noise,
            corners=self.corners,
            board=self.board,
            effect_scales=self.effect_scales if self.additional.effects else None,
            coefficients=self.place.coefficients,
            factors=factors,
            linearised=self.linearised,
            posterior=left,
            passes=number,
            converged=moved < CALM,
            model_error_px=self.model_error_px,
        )

    def _pass(self, *, first: bool) -> tuple[Factors, Posterior, float]:
        """Return the factors of a pass, what they leave open, and by how much a lens parameter moved, in standard
        deviations.
        """
        before = self.place.state.parameters
        self.judge(first=first)
        offsets = np.zeros(len(self.present))
        if self.additional.points and not self.problem.offsets and not first:
            offsets = self._move_points()
        here = self.place
        self.linearised = here.state
        factors, end = self._move()
        left = posterior(factors)
        self.board = scales_towards(self.board, board_scales(self.problem, end, factors), self.share)
        if self.problem.offsets:
            offsets = spent_on_offsets(self.problem, here.state, here.derivatives, factors)
        self._pose_lost_views()
        self.spent, self.on_points = left.spent + offsets, float(offsets.sum())
        left = replace(left, spent=self.spent)
        free = self.problem.free
        moved = (self.place.state.parameters - before)[free] / np.sqrt(np.diag(left.shared)[: len(free)])
        return factors, left, self.note_change(moved, first=first)

    def _move_points(self) -> Array:
        """Solve for the offsets of the points, everything else held; return the degrees of freedom (V,) that the
        corners of each view spend on them.
        """
        state, derivatives = self.place.state, self.place.derivatives
        equations = point_equations(self.problem, state, derivatives, self.field(self.place))
        side = max(self.problem.board.extent)
        self.board = self.board | equations.scales(side, self.unspent())
        std = offset_std(self.board, side)
        offsets = equations.offsets(std)
        derivatives = self.problem.with_points_moved(state, derivatives, offsets - state.offsets)
        self.place = replace(self.place, state=replace(state, offsets=offsets), derivatives=derivatives)
        return equations.spent(std)

    def _move(self) -> tuple[Factors, State]:
        """Solve for everything that is linear, and go as much of the way as the cost falls; return the factors and the
        state at the end of the whole way, which is their minimum.
        """
        here, effects = self.place, self.columns.values if self.additional.effects else None
        equations = self.problem.equations(here.state, here.derivatives, effects)
        if self.additional.effects:
            likeliest = fit_effects(equations, self.columns.effect, self.effect_scales)
            self.effect_scales = self.effect_scales.towards(likeliest, self.share)
        std = self.effect_scales.std(self.columns.effect)
        factors = factorise(scaled(equations, std))
        step, cost = factors.solve(), self._cost(here, std)
        step = Step(step.shared, np.concatenate([step.groups[:, :POSE], std * step.groups[:, POSE:]], axis=1))
        promised = cost - (factors.equations.cost - factors.decrease())
        share = 1.0
        for _ in range(_TRIALS):
            self.place = self._towards(here, step, share)
            best = lowest_along(promised, share, self._cost(self.place, std) - cost)
            if best > _NEAR * share or promised < _UNSEEN * cost:
                break
            share = max(best, _SHORTEST * share)
        return factors, self.problem.retract(here.state, step)

    def point_count(self) -> int:
        return self.problem.board.count

    def points_together(self) -> bool:
        return self.problem.offsets

    def solve_points_together(self) -> None:
        self.problem = replace(self.problem, offsets=True)

    def _towards(self, here: Place, step: Step, share: float) -> Place:
        """Return the place a share of the way along a step, whose coefficients of effects are those of its end."""
        state = self.problem.retract(here.state, Step(share * step.shared, share * step.groups[:, :POSE]))
        coefficients = (1 - share) * here.coefficients + share * step.groups[:, POSE:]
        return Place(state, self.problem.derivatives(state), coefficients)

    def _cost(self, place: Place, std: Array) -> float:
        """Return the cost of a place, effects of standard deviations (V, m) and priors included."""
        priors = sum(np.sum(prior.residuals**2) for prior in self.problem.priors(place.state))
        return self.cost(place) + 0.5 * float(np.sum((place.coefficients / std) ** 2) + priors)

    def _pose_lost_views(self) -> None:
        """Pose the views that have lost most of their corners once more, all corners counting: an old pose under a lens
        that has moved on would be held against them for good.
        """
        views, state = np.flatnonzero(lost(self.problem.observations.weights, self.present)), self.place.state
        if not len(views):
            return
        poses, bare = self.problem.poses_only(state)
        observations = replace(poses.observations.take(views), weights=self.present[views].astype(float))
        poses = replace(poses, observations=observations, noise=None, loss=Cauchy(_GROSS))
        found = minimise(poses.within_domain(bare.take(views)), bare.take(views), _POSING).state
        rotations, translations = state.rotations.copy(), state.translations.copy()
        rotations[views], translations[views] = found.rotations, found.translations
        state = replace(state, rotations=rotations, translations=translations)
        self.place = replace(self.place, state=state, derivatives=self.problem.derivatives(state))
