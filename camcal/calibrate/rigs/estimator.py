"""Alternating estimation of the lenses, poses, board and errors within views of all cameras of a rig.

Each pass takes noise and weights from the residuals of each camera as for one alone, then solves for everything that is
linear in all cameras together. See calibrate/estimator.py for what the passes have in common.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.camera_part import CALM, AdditionalParameters, Alternation, CameraPart, KnownNoise, Place
from camcal.calibrate.effects import EffectScales, Posterior, fit_effects, motion_columns, scaled
from camcal.calibrate.noise import count_of
from camcal.calibrate.problem import POSE
from camcal.calibrate.rigs.effects import SHIFT, TURN, CaptureEffects, moved_views, with_motion
from camcal.calibrate.rigs.problem import RigProblem, RigState
from camcal.calibrate.shape import (
    TOGETHER,
    PointEquations,
    Scale,
    board_scales,
    offset_std,
    point_equations,
    scales_towards,
    spent_by_block,
)
from camcal.dataclass import dataclass, replace
from camcal.solve.least_squares import assemble
from camcal.solve.steps import Block, Factors, NormalEquations, Step, factorise, lowest_along


@dataclass(frozen=True, eq=False)
class PartPosterior:
    """Of the V views of one camera. spent: (V,) degrees of freedom that their corners have spent, but for on_offsets
    (V,), those on offsets of points. poses: (V, 6, 6) covariances of camera_T_board.
    """

    spent: Array
    on_offsets: Array
    poses: Array


def part_posteriors(
    problem: RigProblem,
    state: RigState,
    factors: Factors,
    blocks: Sequence[Block],
    equations: Sequence[NormalEquations],
    slots: Sequence[Array],
    std: Array,
) -> tuple[PartPosterior, ...]:
    """Return what the factors of a rig's equations leave open of the views of each camera.

    blocks, equations: of the cameras alone, see `RigProblem.equations_of`. slots: of each camera the places (V, m_c) of
    its views' coefficients in a capture's group. std: (G, m) of the coefficients, in which the factors measure them.
    """
    shared, groups = factors.shared_covariance(), factors.group_covariances()
    coupling = factors.group_inverse.transpose(0, 2, 1) @ factors.reduced
    cross = -np.concatenate(list(coupling)).dot(shared).reshape(coupling.shape)  # (G, g, S)
    result = []
    for camera, (block, own) in enumerate(zip(blocks, equations, strict=True)):
        captures, columns = problem.captures[camera], problem.columns(camera)
        inside = np.concatenate([np.tile(np.arange(POSE), (len(captures), 1)), slots[camera]], axis=1)
        first = captures[:, None, None]
        unit = np.ones(inside.shape)
        unit[:, POSE:] = std[captures[:, None], slots[camera] - POSE]
        of_group = groups[first, inside[:, :, None], inside[:, None]] * (unit[:, :, None] * unit[:, None])
        across = cross[first, inside[:, :, None], columns] * unit[:, :, None]
        of_shared = shared[np.ix_(columns, columns)]
        dense = own.group_products.shape[1]
        spent = np.sum(of_group * own.group_group, axis=(1, 2)) + 2 * np.sum(across * own.group_shared, axis=(1, 2))
        spent += np.sum(own.group_products * of_shared[:dense, :dense], axis=(1, 2))
        views = len(captures), -1
        offsets = np.zeros(len(captures))
        if problem.offsets:
            ids = problem.parts[camera].observations.ids
            offsets = spent_by_block(block, ids, of_shared).reshape(views)[:, 0]
        poses = _pose_covariances(problem, state, camera, of_group, across, of_shared)
        result.append(PartPosterior(spent, offsets, poses))
    return tuple(result)


def _pose_covariances(
    problem: RigProblem, state: RigState, camera: int, of_group: Array, across: Array, of_shared: Array
) -> Array:
    """Return the covariances (V, 6, 6) of camera_T_board = camera_T_rig · rig_T_board."""
    lens = len(problem.parts[camera].free)
    by_capture, by_shared = problem.pose_jacobians(state, camera)
    result = by_capture @ of_group[:, :POSE, :POSE] @ by_capture.transpose(0, 2, 1)
    if not by_shared.shape[2]:
        return np.asarray(result)
    own = slice(lens, lens + by_shared.shape[2])
    mixed = by_capture @ across[:, :POSE, own] @ by_shared.transpose(0, 2, 1)
    result = result + mixed + mixed.transpose(0, 2, 1)
    return np.asarray(result + by_shared @ of_shared[own, own] @ by_shared.transpose(0, 2, 1))


# A step is as long as the cost along it is lowest, as in calibrate/estimator.py.
_NEAR, _SHORTEST, _TRIALS, _UNSEEN = 0.75, 0.2, 12, 1e-11
_LEAST_DOF = 0.05  # of the coordinates, however many parameters were paid for


@dataclass(frozen=True, eq=False)
class RigEstimate:
    """Where the passes ended; see calibrate.estimator.Estimate.

    motion: whether that of the board between exposures is modelled. parts: of each camera, its noise, weights and
    coefficients. views: of each camera, what its views leave open. coefficients: (G, m) of captures.
    """

    problem: RigProblem
    state: RigState
    additional: AdditionalParameters
    motion: bool
    parts: tuple[CameraPart, ...]
    board: Mapping[str, Scale]
    effects: CaptureEffects
    effect_scales: EffectScales
    coefficients: Array
    factors: Factors
    linearised: RigState
    posterior: Posterior
    views: tuple[PartPosterior, ...]
    passes: int
    converged: bool

    def motion_of(self, camera: int) -> Array:
        """Return the coefficients (V, 6) of the motion of a camera's views, 0 where there is none."""
        captures, slots = self.problem.captures[camera], self.effects.slots[camera]
        own = self.effects.of_kinds(SHIFT, TURN)[slots[0]]
        return self.coefficients[captures[:, None], slots[:, own]] if own.any() else np.zeros((len(captures), POSE))

    @property
    def known(self) -> tuple[KnownNoise, ...]:
        """The noise of each camera, for an estimate that goes on from this one."""
        return tuple(KnownNoise(part.noise, part.corners, part.spent) for part in self.parts)


def estimate_rig(
    problem: RigProblem,
    state: RigState,
    additional: AdditionalParameters,
    known: Sequence[KnownNoise | None],
    board: Mapping[str, Scale],
    *,
    motion: bool = False,
    brief: bool = False,
) -> RigEstimate:
    """Return the estimate that passes lead to from a state near it.

    known: the noise of each camera, None where it is yet to be learned. board: scales of the board's shape. brief: with
    few passes. Raises SingularError where the data leave parameters undetermined.
    """
    return _RigPasses(problem, state, additional, known=known, board=board, motion=motion, brief=brief).run()


@dataclass(frozen=True, eq=False)
class _RigPlace:
    """A state, the places of all cameras, and the coefficients (G, m) of captures."""

    state: RigState
    places: tuple[Place, ...]
    coefficients: Array


class _RigPasses(Alternation):
    """The alternation; its attributes are what a pass leaves for the next."""

    def __init__(
        self,
        problem: RigProblem,
        state: RigState,
        additional: AdditionalParameters,
        known: Sequence[KnownNoise | None],
        board: Mapping[str, Scale],
        *,
        motion: bool,
        brief: bool,
    ) -> None:
        together = additional.points and problem.board.count <= TOGETHER
        self.problem = problem.with_parts([replace(part, loss=None, offsets=together) for part in problem.parts])
        self.board, self.motion = dict(board), motion
        self.parts = [
            CameraPart(part, self.problem.of_camera(state, camera), additional.effects, known[camera])
            for camera, part in enumerate(self.problem.parts)
        ]
        moved = moved_views(self.problem)
        for part, views in zip(self.parts, moved, strict=True):
            if motion and views.any():
                own, showing = part.place, part.present & views[:, None]
                columns = motion_columns(self.problem.board, own.state.rotations, own.derivatives, showing)
                part.columns = with_motion(part.columns, columns)
        self.effects = CaptureEffects.of([part.columns for part in self.parts], self.problem)
        sigmas = [part.noise.sigma for part in self.parts]
        self.effect_scales = self.effects.start(self.problem.count, sigmas, max(self.problem.board.extent))
        coefficients = np.zeros((self.problem.count, len(self.effects.effect)))
        self.begin(additional, fresh=None in known, brief=brief)
        self._go_to(self._place(state, coefficients))

    def point_count(self) -> int:
        return self.problem.board.count

    def points_together(self) -> bool:
        return self.problem.offsets

    def solve_points_together(self) -> None:
        self.problem = self.problem.with_parts([replace(part, offsets=True) for part in self.problem.parts])
        for part, own in zip(self.parts, self.problem.parts, strict=True):
            part.problem = own

    def run(self) -> RigEstimate:
        passes, (factors, left, moved) = self.alternate()
        return RigEstimate(
            self.problem,
            self.place.state,
            additional=self.additional,
            motion=self.motion,
            parts=tuple(self.parts),
            board=self.board,
            effects=self.effects,
            effect_scales=self.effect_scales,
            coefficients=self.place.coefficients,
            factors=factors,
            linearised=self.linearised,
            posterior=left,
            views=self.views,
            passes=passes,
            converged=moved < CALM,
        )

    def _place(self, state: RigState, coefficients: Array) -> _RigPlace:
        places = []
        for camera, part in enumerate(self.parts):
            own = self.problem.of_camera(state, camera)
            values = coefficients[self.problem.captures[camera][:, None], self.effects.slots[camera]]
            places.append(Place(own, part.problem.derivatives(own), values))
        return _RigPlace(state, tuple(places), coefficients)

    def _go_to(self, place: _RigPlace) -> None:
        self.place = place
        for part, own in zip(self.parts, place.places, strict=True):
            part.place = own

    def _pass(self, *, first: bool) -> tuple[Factors, Posterior, float]:
        before = self.place.state
        for part in self.parts:
            part.share, part.board = self.share, self.board
            part.judge(first=first)
        self.problem = self.problem.with_parts([part.problem for part in self.parts])
        offsets = [np.zeros(len(part.present)) for part in self.parts]
        if self.additional.points and not self.problem.offsets:
            offsets = self._move_points()
        here = self.place
        self.linearised = here.state
        blocks, equations = self._equations()
        factors, end, std = self._move(equations)
        self.views = part_posteriors(
            self.problem, here.state, factors, blocks, equations, [POSE + own for own in self.effects.slots], std
        )
        start = self.problem.board_start
        scales = board_scales(self.problem.parts[0], self.problem.of_camera(end, 0), factors, start)
        self.board = scales_towards(self.board, scales, self.share)
        self.on_points = float(sum(own.sum() for own in offsets) + sum(view.on_offsets.sum() for view in self.views))
        for part, view, own in zip(self.parts, self.views, offsets, strict=True):
            part.spent = view.spent + view.on_offsets + own
        dense = self.problem.dense
        left = Posterior(
            factors.shared_covariance()[:dense, :dense], np.concatenate([part.spent for part in self.parts])
        )
        moved = self.problem.change(before, self.place.state) / np.sqrt(np.diag(left.shared)[:start])
        return factors, left, self.note_change(moved, first=first)

    def _equations(self) -> tuple[list[Block], list[NormalEquations]]:
        """Return the block and the equations of each camera alone."""
        found = [
            self.problem.equations_of(
                self.place.state,
                camera,
                part.place.state,
                part.place.derivatives,
                part.columns.values if part.columns.values.shape[1] else None,
            )
            for camera, part in enumerate(self.parts)
        ]
        return [block for block, _ in found], [equations for _, equations in found]

    def _move(self, equations: Sequence[NormalEquations]) -> tuple[Factors, RigState, Array]:
        """Solve for everything that is linear, and go as much of the way as the cost falls; return the factors, the
        state at the end of the whole way, and the standard deviations (G, m) of the coefficients.
        """
        here, effect = self.place, self.effects.effect
        total = self.problem.joined(equations, [POSE + own for own in self.effects.slots], POSE + len(effect))
        total = _added(total, assemble(self.problem.priors(here.state), self.problem.shared, 0, POSE))
        if len(effect):
            likeliest = fit_effects(total, effect, self.effect_scales)
            self.effect_scales = self.effect_scales.towards(likeliest, self.share)
        std = self.effect_scales.std(effect) if len(effect) else np.zeros((self.problem.count, 0))
        factors = factorise(scaled(total, std))
        step, cost = factors.solve(), self._cost(here, std)
        step = Step(step.shared, np.concatenate([step.groups[:, :POSE], std * step.groups[:, POSE:]], axis=1))
        promised = cost - (factors.equations.cost - factors.decrease())
        share = 1.0
        for _ in range(_TRIALS):
            self._go_to(self._towards(here, step, share))
            best = lowest_along(promised, share, self._cost(self.place, std) - cost)
            if best > _NEAR * share or promised < _UNSEEN * cost:
                break
            share = max(best, _SHORTEST * share)
        return factors, self.problem.retract(here.state, step), std

    def _towards(self, here: _RigPlace, step: Step, share: float) -> _RigPlace:
        """Return the place a share of the way along a step, whose coefficients of effects are those of its end."""
        state = self.problem.retract(here.state, Step(share * step.shared, share * step.groups[:, :POSE]))
        return self._place(state, (1 - share) * here.coefficients + share * step.groups[:, POSE:])

    def _cost(self, place: _RigPlace, std: Array) -> float:
        """Return the cost of a place, effects of standard deviations (G, m) and priors included."""
        corners = sum(part.cost(own) for part, own in zip(self.parts, place.places, strict=True))
        priors = sum(np.sum(prior.residuals**2) for prior in self.problem.priors(place.state))
        return float(corners + 0.5 * (np.sum((place.coefficients / std) ** 2) + priors))

    def _move_points(self) -> list[Array]:
        """Solve for the offsets of the points, everything else held; return the degrees of freedom (V,) that the
        corners of each view of each camera spend on them.
        """
        found = [
            point_equations(part.problem, part.place.state, part.place.derivatives, part.field(part.place))
            for part in self.parts
        ]
        information = np.sum([own.information for own in found], axis=0)
        vector = np.sum([own.vector for own in found], axis=0)
        equations = [PointEquations(information, vector, own.by_corner, own.ids) for own in found]
        side = max(self.problem.board.extent)
        self.board = self.board | equations[0].scales(side, self._unspent())
        std = offset_std(self.board, side)
        state = replace(self.place.state, offsets=equations[0].offsets(std))
        self._go_to(self._place(state, self.place.coefficients))
        return [own.spent(std) for own in equations]

    def _unspent(self) -> float:
        """Return the degrees of freedom per coordinate that parameters have left over."""
        spent = sum(float(part.spent.sum()) for part in self.parts)
        count = sum(float(count_of(part.problem.observations.weights).sum()) for part in self.parts)
        return max(1 - spent / count, _LEAST_DOF)


def _added(equations: NormalEquations, priors: NormalEquations) -> NormalEquations:
    """Return equations with those of priors on shared parameters."""
    gradient = Step(equations.gradient.shared + priors.gradient.shared, equations.gradient.groups)
    return replace(
        equations,
        cost=equations.cost + priors.cost,
        gradient=gradient,
        shared_shared=equations.shared_shared + priors.shared_shared,
    )
