"""The rig from start to solution: single cameras, links, estimates of all cameras and their average."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.effects import EFFECTS, SMOOTH, EffectColumns, columns_at, likelihood_gain, motion_columns
from camcal.calibrate.fit import displacements
from camcal.calibrate.jackknife import covariance_of, image_metric, influence, weights_of
from camcal.calibrate.problem import POSE, State
from camcal.calibrate.rigs.effects import (
    MOTION_DOF,
    CaptureEffects,
    moved_poses,
    moved_views,
    with_motion,
)
from camcal.calibrate.rigs.epipolar import between_captures, left_out_errors
from camcal.calibrate.rigs.estimator import RigEstimate, estimate_rig
from camcal.calibrate.rigs.links import best_turns_of_captures, composed, turned
from camcal.calibrate.rigs.measured import BoardPoses, Measured
from camcal.calibrate.rigs.placement import PlacedRig
from camcal.calibrate.rigs.problem import LensPrior, RigProblem, RigState
from camcal.calibrate.rigs.start import RigStart, start_rig
from camcal.calibrate.shape import hold_to_print
from camcal.cameras.lens import CameraModel
from camcal.cameras.model import Camera
from camcal.cameras.refit import refit
from camcal.dataclass import dataclass, replace
from camcal.errors import InsufficientData
from camcal.geometry import rotation as so3
from camcal.solve.descent import Stopping
from camcal.solve.least_squares import assemble, minimise
from camcal.solve.losses import Cauchy
from camcal.solve.steps import SingularError

_LOSS, _ROUGH, _POSING = Cauchy(3.0), Stopping(relative_decrease=1e-6, iterations=30), Stopping(iterations=5)
_ROUNDS = 4
_EFFECTS = ((SMOOTH.name,), tuple(effect.name for effect in EFFECTS))
# Motion of the board between exposures is used: the gain of the restricted log likelihood by it, and epipolar errors
# between captures over those within them.
_CERTAIN, _BETWEEN = 10.0, 1.0


@dataclass(frozen=True, eq=False)
class RigFit:
    """A solution: all cameras, captures and the board.

    estimates: one that takes errors within views for noise, first, and those that model them. weights: of the estimates
    in `state`. covariance, noise_covariance: (D, D) of lenses, camera poses and terms of the board, by the scatter from
    capture to capture, and by noise alone. poses: of each camera the covariances (V, 6, 6) of camera_T_board. turns: of
    each camera the symmetries (V,) by which its views were turned. moved: (G, 6) by which the board moved, see
    `rigs.effects`.
    """

    state: RigState
    estimates: tuple[RigEstimate, ...]
    weights: Array
    covariance: Array
    noise_covariance: Array
    poses: tuple[Array, ...]
    turns: tuple[Array, ...]

    @property
    def plain(self) -> RigEstimate:
        """The estimate that takes errors within views for noise."""
        return self.estimates[0]

    @property
    def problem(self) -> RigProblem:
        return self.plain.problem

    def camera_states(self) -> tuple[State, ...]:
        """Return the state of each camera, whose poses camera_T_board follow the motion between exposures."""
        states = [self.problem.of_camera(self.state, camera) for camera in range(len(self.plain.parts))]
        if not self.plain.motion:
            return tuple(states)
        return tuple(
            moved_poses(self.problem.board, state, self.plain.motion_of(camera)) for camera, state in enumerate(states)
        )


def fit_rig(
    starts: Sequence[RigStart],
    placed: PlacedRig,
    groups: tuple[Array, Array, int],
    priors: dict[int, LensPrior],
    motion: bool | None,
    measured: Measured,
) -> RigFit:
    """Return the solution for cameras that are all linked, their places as in `placed`.

    groups: of the rows of captures (R,), the capture of a body and the place of the board, and the number of captures.
    motion: whether the board may have moved between exposures, None: where the data show it.
    """
    problem, state, turns = start_rig(starts, placed, groups, priors, measured)
    state = minimise(_robust(problem, state), state, _ROUGH).state
    plains = [start.solved.fit.plain for start in starts]
    additional = plains[0].additional
    known = [own.known for own in plains]
    plain = estimate_rig(problem, state, additional, known, plains[0].board, brief=True)
    for _ in range(_ROUNDS if additional.smooth and len(problem.board.symmetries()) > 1 else 0):
        better = best_turns_of_captures(plain.problem, plain.state)
        if not better.any():
            break
        problem, state = turned(problem, replace(plain.state, offsets=0 * plain.state.offsets), better)
        turns = tuple(
            composed(own, better[captures], problem.board)
            for own, captures in zip(turns, problem.captures, strict=True)
        )
        plain = estimate_rig(problem, state, additional, known, plains[0].board, brief=True)
    moves = not problem.bodies and (moved_between_exposures(plain) if motion is None else motion)
    # with motion from the noise of single cameras: to a rig without it, views whose board moved look noisy
    known = known if moves else list(plain.known)
    plain = estimate_rig(problem, plain.state, additional, known, plain.board, motion=moves)
    share = max(start.solved.fit.errors.share for start in starts)
    estimates = [plain]
    for effects in _EFFECTS if share > 0 and plain.converged else ():
        following = _with_effects(estimates[-1], effects)
        estimates += [following] if following is not None and following.converged else []
    return _averaged(tuple(estimates), share, turns, [start.solved.size for start in starts])


def with_other_models(fit: RigFit, models: Sequence[CameraModel | None], sizes: Sequence[tuple[int, int]]) -> RigFit:
    """Return a solution whose covariance tells that its lenses could as well have other models, None: as they have.

    Either is right with the same probability: half the square of how far the poses of the cameras move with the others.
    Source: Burnham & Anderson, Model Selection and Multimodel Inference, 2002, section 4.3.2 (unconditional variance).
    """
    plain, parts, lenses = fit.plain, list(fit.problem.parts), list(fit.plain.state.lenses)
    try:
        for camera, (model, size) in enumerate(zip(models, sizes, strict=True)):
            if model is not None:
                lenses[camera] = refit(Camera(parts[camera].model, size, lenses[camera]), model).camera.parameters
                spread = model.prior_std(size, float(lenses[camera][0]))
                parts[camera] = replace(parts[camera], model=model, free=np.arange(len(spread)), lens_spread=spread)
                parts[camera] = replace(parts[camera], lens_mean=None)
        problem, state = plain.problem.with_parts(parts), replace(plain.state, lenses=tuple(lenses))
        state = minimise(_robust(problem, state), state, _ROUGH).state
        other = estimate_rig(problem, state, plain.additional, plain.known, plain.board, motion=plain.motion)
    except (SingularError, InsufficientData, np.linalg.LinAlgError):
        return fit
    turns = other.state.camera_rotations @ plain.state.camera_rotations.transpose(0, 2, 1)
    moves = np.hstack([other.state.camera_translations - plain.state.camera_translations, so3.log(turns)])
    change = np.zeros(len(fit.covariance))
    for camera, move in enumerate(moves[1:], start=1):
        change[plain.problem.pose_columns(camera)] = move
    boards = plain.state.boards.steps_to(other.state.boards, plain.problem.attached)
    change[plain.problem.attached_start : plain.problem.board_start] = boards
    return replace(fit, covariance=fit.covariance + 0.5 * np.outer(change, change)) if other.converged else fit


def _with_effects(start: RigEstimate, effects: tuple[str, ...]) -> RigEstimate | None:
    """Return the estimate that models errors within views as `effects`, None where the data do not hold it."""
    additional = replace(start.additional, effects=effects)
    try:
        return estimate_rig(start.problem, start.state, additional, start.known, start.board, motion=start.motion)
    except SingularError:
        return None


def _robust(problem: RigProblem, state: RigState) -> RigProblem:
    """Return the problem whose wrong corners count for little; those beyond the lens's domain do not count."""
    parts = []
    for camera, part in enumerate(problem.parts):
        own = replace(part, loss=_LOSS).within_domain(problem.of_camera(state, camera))
        parts.append(own)
    return problem.with_parts(parts)


def moved_between_exposures(plain: RigEstimate) -> bool:
    """Return whether the board moved between exposures by more than corners scatter.

    A lens that is described badly shifts the corners of a capture as well, but less than corners scatter: there, motion
    would take from the estimate of the lens.
    """
    return between_captures(plain.problem, plain.state) > _BETWEEN and motion_gain(plain) > _CERTAIN


def motion_gain(plain: RigEstimate) -> float:
    """Return the gain of the restricted log likelihood that motion of the board between exposures brings beside smooth
    errors within views, which could look like it.
    """
    problem = plain.problem
    problem = problem.with_parts([replace(part, offsets=False) for part in problem.parts])
    moved = moved_views(problem)
    if not any(views.any() for views in moved):
        return 0.0
    smooth, both = [], []
    for camera, (part, views) in enumerate(zip(plain.parts, moved, strict=True)):
        own, derivatives = problem.of_camera(plain.state, camera), part.place.derivatives
        smooth.append(columns_at(part.problem, own, derivatives, (SMOOTH.name,)))
        motion = motion_columns(problem.board, own.rotations, derivatives, part.present & views[:, None])
        both.append(with_motion(smooth[-1], motion if views.any() else None))
    return _gain(plain, problem, both) - _gain(plain, problem, smooth)


def _gain(plain: RigEstimate, problem: RigProblem, columns: Sequence[EffectColumns]) -> float:
    """Return the gain of the restricted log likelihood that effects with these columns of the cameras bring."""
    layout, state = CaptureEffects.of(columns, problem), plain.state
    equations = [
        problem.equations_of(
            state, camera, problem.of_camera(state, camera), part.place.derivatives, columns[camera].values
        )[1]
        for camera, part in enumerate(plain.parts)
    ]
    total = problem.joined(equations, [POSE + own for own in layout.slots], POSE + len(layout.effect))
    priors = assemble(problem.priors(state), problem.shared, 0, POSE)
    total = replace(total, shared_shared=total.shared_shared + priors.shared_shared)
    scales = layout.start(problem.count, [part.noise.sigma for part in plain.parts], max(problem.board.extent))
    return likelihood_gain(total, layout.effect, scales)


def _averaged(
    estimates: tuple[RigEstimate, ...], share: float, turns: tuple[Array, ...], sizes: Sequence[tuple[int, int]]
) -> RigFit:
    """Return the solution by estimates, in which those that model effects are weighted by the evidence for these."""
    plain = estimates[0]
    metric = _metric(plain, sizes)
    if metric is None:  # a lens that holds nowhere, as that of a wrong board may
        estimates, share = (plain,), 0.0
        metric = np.eye(plain.problem.board_start)
    left_out = [with_shares(influence(own), own) for own in estimates]
    products = None if plain.motion or len(estimates) == 1 else _prediction_products(estimates, left_out)
    weights = weights_of(left_out, metric, share, products)
    evidence, blocks = max(share, float(plain.motion)), _blocks(plain.problem)
    covariance = covariance_of(estimates, left_out, metric, weights, evidence, blocks, products)
    state = plain.state
    if len(estimates) > 1:
        state = _mean([own.state for own in estimates], weights)
    terms = dict(zip(plain.problem.parts[0].terms, state.shape.tolist(), strict=True))
    state, covariance = hold_to_print(plain.problem, state, terms, covariance)
    if not plain.motion:
        held, bare = plain.problem.captures_only(state)
        found = minimise(_within_domain(held, bare), bare, _POSING).state
        state = replace(state, rotations=found.rotations, translations=found.translations)
    poses = [
        np.tensordot(weights, np.stack([own.views[camera].poses for own in estimates]), axes=1)
        for camera in range(len(plain.parts))
    ]
    return RigFit(
        state,
        estimates,
        weights=weights,
        covariance=covariance,
        noise_covariance=plain.posterior.shared,
        poses=tuple(poses),
        turns=turns,
    )


def _within_domain(problem: RigProblem, state: RigState) -> RigProblem:
    return problem.with_parts(
        [part.within_domain(problem.of_camera(state, camera)) for camera, part in enumerate(problem.parts)]
    )


def _metric(plain: RigEstimate, sizes: Sequence[tuple[int, int]]) -> Array | None:
    """Return the metric, px², of changes of lenses and camera poses: of directions over the images, and of the board's
    corners. None where no direction of an image is determined.
    """
    problem = plain.problem
    result = np.zeros((problem.board_start, problem.board_start))
    for camera, (part, size) in enumerate(zip(plain.parts, sizes, strict=True)):
        if len(part.problem.free):
            lens = slice(*problem.lens_starts[camera : camera + 2])
            found = displacements(part.problem, part.place.state, size)
            if not len(found):
                return None
            result[lens, lens] = image_metric(found)
        columns = np.concatenate([problem.pose_columns(camera), np.arange(problem.attached_start, problem.board_start)])
        if len(columns):
            weights = part.problem.observations.weights.ravel()
            slopes = part.place.derivatives.by_pose()
            views = slopes.reshape(2, POSE, len(part.present), -1).transpose(2, 0, 3, 1)
            by_shared = problem.pose_jacobians(plain.state, camera)[1]
            moved = (views.reshape(len(views), -1, POSE) @ by_shared).reshape(-1, by_shared.shape[2])
            counted = np.repeat(weights.reshape(len(views), 1, -1), 2, axis=1).ravel()
            result[np.ix_(columns, columns)] += (counted[:, None] * moved).T @ moved / weights.sum()
    return result


def _prediction_products(estimates: Sequence[RigEstimate], left_out: Sequence[Array]) -> Array | None:
    """Return the products (G, k, k), px², of the epipolar errors of each capture by what k estimates without it say;
    None where no capture is seen by two cameras.

    How far an estimate moves tells how good it is for one camera; lenses and poses of a rig move together.
    Source: Wolpert, Stacked generalization, Neural Networks 5, 1992.
    """
    counted = estimates[0].problem.parts  # whose weights say which corners count
    found = [
        left_out_errors(replace(own.problem, parts=counted), own.state, changes)
        for own, changes in zip(estimates, left_out, strict=True)
    ]
    captures, errors = found[0][0], np.stack([own for _, own in found])
    errors = np.where(np.isfinite(errors).all(axis=0), errors, 0.0)
    groups = [errors[:, captures == capture] for capture in range(len(left_out[0]))]
    return np.stack([own @ own.T for own in groups]) / len(captures) if errors.any() else None


def with_shares(left_out: Array, estimate: RigEstimate) -> Array:
    """Return what leaving out captures changes (G, D) where the heavy-tailed motion of the others follows.

    An observation of a Student distribution has (ν + p) / (ν + p + 2) of the information that its weight says.
    Source: Lange, Little & Taylor, Robust statistical modeling using the t distribution, JASA 84, 1989, appendix B.
    """
    if not estimate.motion:
        return left_out
    factors = np.ones(left_out.shape[1])
    of_poses = slice(estimate.problem.lens_starts[-1], estimate.problem.board_start)
    factors[of_poses] = (MOTION_DOF + POSE + 2) / (MOTION_DOF + POSE)
    return left_out * factors


def _blocks(problem: RigProblem) -> list[slice]:
    """Return where the free parameters of each lens, and those of each camera's pose are."""
    starts = [*problem.lens_starts, *range(problem.lens_starts[-1] + POSE, problem.board_start + 1, POSE)]
    return [slice(*ends) for ends in pairwise(starts) if ends[0] < ends[1]]


def _mean(states: Sequence[RigState], weights: Array) -> RigState:
    """Return the weighted mean of states of one rig; rotations are averaged about the first one's."""

    def mean(values: Sequence[Array]) -> Array:
        return np.asarray(np.tensordot(weights, np.stack(values), axes=1))

    def turned(values: Sequence[Array]) -> Array:
        back = values[0].transpose(0, 2, 1)
        return np.asarray(values[0] @ so3.exp(mean([so3.log(back @ own) for own in values])))

    return RigState(
        tuple(mean(own) for own in zip(*(state.lenses for state in states), strict=True)),
        turned([state.camera_rotations for state in states]),
        mean([state.camera_translations for state in states]),
        rotations=turned([state.rotations for state in states]),
        translations=mean([state.translations for state in states]),
        shape=mean([state.shape for state in states]),
        offsets=mean([state.offsets for state in states]),
        boards=BoardPoses(
            turned([state.boards.rotations for state in states]), mean([state.boards.translations for state in states])
        ),
    )
