"""The calibration from start to solution: robust fits, symmetric boards, estimates and their average."""

from collections.abc import Callable, Sequence

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.camera_part import AdditionalParameters
from camcal.calibrate.effects import EFFECTS, SMOOTH
from camcal.calibrate.estimator import Estimate, estimate
from camcal.calibrate.evidence import Evidence, WithinViews, evidence_of_effects, within_views
from camcal.calibrate.initialise import (
    apply_symmetries,
    best_turns,
    opposed_views,
    poses_from_pixels,
    renumbered,
    sweep_focal,
    thinned,
)
from camcal.calibrate.jackknife import averaged, covariance_of, image_metric, influence, weights_of
from camcal.calibrate.noise import CUT, REJECTED, robust_sigma
from camcal.calibrate.problem import POSE, BoardProblem, State
from camcal.calibrate.shape import hold_to_print, odd_terms
from camcal.cameras.catalogue import WIDE_MODEL
from camcal.cameras.directions import direction_displacements, in_hull
from camcal.cameras.lens import CameraModel
from camcal.cameras.model import Camera
from camcal.cameras.observations import Observations
from camcal.cameras.plane_model import PlaneModel
from camcal.cameras.refit import fit_lens
from camcal.cameras.spline_modes import ReducedSpline
from camcal.dataclass import dataclass, replace
from camcal.errors import InsufficientData
from camcal.solve.descent import Stopping
from camcal.solve.least_squares import minimise
from camcal.solve.losses import Cauchy
from camcal.solve.steps import SingularError
from camcal.targets.board import Board

_FIRST_VIEWS = 40  # enough to find the lens; the rest then start next to their minimum
_FIRST_CORNERS = 40
_ROUGH = Stopping(relative_decrease=1e-4, iterations=50)
_FINE = Stopping(relative_decrease=1e-7, iterations=60)  # flat valleys of rational lenses are long
_POSING = Stopping(relative_decrease=1e-8, iterations=10)
_SETTLING = Stopping(iterations=2)  # the lens is known, the poses are next to their minimum
_ROUNDS = 8
_MAPPED = 200  # corners at which one lens is fitted to another
_GRID = (20, 15)  # of pixels at which lenses are compared
_LOSS = Cauchy(3.0)
_CLEARLY = 0.995  # of σ: where two sets of parameters fit alike, as those of narrow lenses do, the usual one is taken


# What the errors within views may be taken for, besides noise: anything smooth, or named causes as well.
_EFFECTS = ((SMOOTH.name,), tuple(effect.name for effect in EFFECTS))


@dataclass(frozen=True)
class ShapeOptions:
    """How far the board's shape may be estimated: not at all, in smooth terms, and then point by point as well."""

    smooth: bool = True
    offsets: bool = True

    @property
    def additional(self) -> AdditionalParameters:
        """What an estimate that takes errors within views for noise is free to do."""
        return AdditionalParameters(self.smooth, self.smooth and self.offsets)


@dataclass(frozen=True, eq=False)
class CalibrationFit:
    """A solution: lens, poses and board of all views.

    estimates: one that takes errors within views for noise, first, and those that model them. weights: of the
    estimates in `state`. turns: (V,) the symmetry by which each view was turned. covariance: (D, D) of lens and terms
    of the board, by the scatter from view to view; noise_covariance: (D, D) what noise alone would leave open. errors:
    what the errors within views are.
    """

    state: State
    estimates: tuple[Estimate, ...]
    weights: Array
    turns: Array
    covariance: Array
    noise_covariance: Array
    errors: WithinViews

    @property
    def plain(self) -> Estimate:
        """The estimate that takes errors within views for noise."""
        return self.estimates[0]

    @property
    def problem(self) -> BoardProblem:
        return self.plain.problem

    @property
    def first(self) -> tuple[Estimate, Array]:
        """What `fit_briefly` and `fit_plain` return."""
        return self.plain, self.turns

    def camera(self, size: tuple[int, int], covariance: Array) -> Camera:
        """Return the camera of images (width, height) with a covariance (D, D) of the parameters that views share."""
        model, free, parameters = self.problem.model, self.problem.free, self.state.parameters
        full = np.zeros((len(parameters), len(parameters)))
        full[np.ix_(free, free)] = covariance[: len(free), : len(free)]
        if isinstance(model, ReducedSpline):
            return model.camera(size, parameters, full)
        fixed = tuple(name for index, name in enumerate(model.parameter_names) if index not in free)
        return Camera(model, size, parameters, full, fixed)

    def pose_covariances(self) -> Array:
        """Return the covariances (V, 6, 6) of the poses: means over the estimates, each under the lens's own."""
        own = [each.factors.group_covariances(POSE, self.covariance) for each in self.estimates]
        return np.asarray(np.tensordot(self.weights, np.stack(own), axes=1))


def fit(plain: Estimate, turns: Array, image_size: tuple[int, int]) -> CalibrationFit:
    """Return the solution that goes on from the two results of `fit_plain`."""
    estimates = [plain]
    found = evidence_of_effects(plain) if plain.converged and len(plain.problem.free) else Evidence()
    for effects in _EFFECTS if found.share > 0 else ():
        following = _with_effects(estimates[-1], effects)
        estimates += [following] if following is not None and following.converged else []
    errors = WithinViews(found.share)
    if estimates[-1].additional.effects == _EFFECTS[-1]:
        errors = within_views(found, estimates[-1], image_size[1])
    return averaged_fit(tuple(estimates), errors, turns, image_size, [influence(own) for own in estimates])


def fit_plain(brief: Estimate, turns: Array, shape: ShapeOptions) -> tuple[Estimate, Array]:
    """Return the estimate that takes errors within views for noise, and the symmetry (V,) by which each view was
    turned, going on from the two results of `fit_briefly` with as much freedom of the board as `shape` gives.
    """
    result = estimate(brief.problem, brief.state, shape.additional, brief)
    return _turn_views(result, turns, lambda problem, state: estimate(problem, state, shape.additional, result), shape)


def fit_briefly(
    model: CameraModel,
    board: Board,
    observations: Observations,
    image_size: tuple[int, int],
    held: Array,
    guess: Array | None,
    shape: ShapeOptions,
) -> tuple[Estimate, Array]:
    """Return an estimate of few passes, to go on from and to compare lens models by, and the symmetry (V,) by which
    each view was turned.

    held: (K,) values of lens parameters that stay as they are, NaN where free. guess: (K,) a lens to start from. Raises
    InsufficientData where no start is found.
    """
    free = np.flatnonzero(np.isnan(held))
    count = len(observations.ids)
    chosen = np.unique(np.linspace(0, count - 1, min(count, _FIRST_VIEWS)).astype(np.intp))
    few = thinned(observations.take(chosen), _FIRST_CORNERS)
    problem, state = _robust(BoardProblem(model, board, few, free), image_size, held, guess)
    problem = replace(problem, observations=observations)
    if len(chosen) < count:
        state = _pose_all(problem, state)
        problem = replace(problem, sigma=_sigma(problem, state))
        state = minimise(problem.within_domain(state), state, _SETTLING).state
    problem = replace(problem.within_domain(state), sigma=_sigma(problem, state))
    state = minimise(problem, state, _FINE).state
    problem = _with_lens_priors(replace(problem, observations=observations), state, image_size)
    return _oriented(problem, state, shape)


def fit_like(
    other: Estimate, turns: Array, model: CameraModel, image_size: tuple[int, int], held: Array
) -> tuple[Estimate, Array] | None:
    """Return what `fit_briefly` does, going on from what it returned for the same views with another lens model; None
    where the model cannot take all corners in the poses of that.
    """
    problem, state = other.problem, other.state
    if model.is_central != problem.model.is_central:  # what are distances to one are none to the other
        return None
    pixels = problem.observations.pixels + problem.residuals(state)
    kept = (problem.observations.weights >= REJECTED) & np.isfinite(pixels).all(axis=0)
    some = slice(None, None, max(int(kept.sum()) // _MAPPED, 1))
    start = model.start(image_size, float(state.parameters[0]))
    lens = fit_lens(model, problem.camera_points(state)[:, kept].T[some], pixels[:, kept].T[some], start)
    if lens is None:
        return None
    lens = np.where(np.isnan(held), lens, held)
    everything = replace(problem.observations, weights=problem.observations.present.astype(float), whitening=None)
    problem = replace(problem, model=model, free=np.flatnonzero(np.isnan(held)), loss=_LOSS, observations=everything)
    state = replace(state, parameters=lens)
    problem = _with_lens_priors(replace(problem, noise=None), state, image_size)
    problem = replace(problem.within_domain(state), sigma=_sigma(problem, state))
    state = minimise(problem, state, _FINE).state
    problem = replace(problem, observations=everything)
    return estimate(problem, state, other.additional, brief=True), turns


def _with_effects(start: Estimate, effects: tuple[str, ...]) -> Estimate | None:
    """Return the estimate that models errors within views as `effects`, None where the data do not hold it."""
    try:
        return estimate(start.problem, start.state, replace(start.additional, effects=effects), start)
    except SingularError:
        return None


def averaged_fit(
    estimates: tuple[Estimate, ...],
    errors: WithinViews,
    turns: Array,
    image_size: tuple[int, int],
    left_out: Sequence[Array],
) -> CalibrationFit:
    """Return the solution by estimates, in which those that model effects are weighted by the evidence for these.

    left_out: of each estimate, see `influence`.
    """
    plain = estimates[0]
    moved = displacements(plain.problem, plain.state, image_size) if len(plain.problem.free) else np.zeros((0, 2, 0))
    if not len(moved):  # the lens is held, or holds nowhere, as that of a wrong board may
        return CalibrationFit(
            plain.state,
            (plain,),
            weights=np.ones(1),
            turns=turns,
            covariance=plain.posterior.shared,
            noise_covariance=plain.posterior.shared,
            errors=errors,
        )
    metric = image_metric(moved)
    weights = weights_of(left_out, metric, errors.share)
    state = plain.state
    if len(estimates) > 1:
        state = averaged([own.state for own in estimates], weights)
    covariance = covariance_of(estimates, left_out, metric, weights, errors.share)
    terms = dict(zip(plain.problem.terms, state.shape.tolist(), strict=True))
    state, covariance = hold_to_print(plain.problem, state, terms, covariance)
    if state is not plain.state:
        state = replace(state, **_posed_again(plain.problem, state))
    return CalibrationFit(
        state,
        estimates,
        weights=weights,
        turns=turns,
        covariance=covariance,
        noise_covariance=plain.posterior.shared,
        errors=errors,
    )


def _posed_again(problem: BoardProblem, state: State) -> dict[str, Array]:
    """Return rotations and translations of all views under the lens and board of `state`, errors taken for noise: those
    poses reproject the corners best, as poses that are later found with this camera will.
    """
    poses, bare = problem.poses_only(state)
    found = minimise(poses.within_domain(bare), bare, _POSING).state
    return {"rotations": found.rotations, "translations": found.translations}


def displacements(problem: BoardProblem, state: State, image_size: tuple[int, int]) -> Array:
    """Return how the free lens parameters move directions (N, 2, K) over the part of the image that corners cover."""
    camera = Camera(problem.model, image_size, state.parameters)
    corners = problem.observations.pixels[:, problem.observations.weights >= REJECTED].T
    low, high = corners.min(axis=0), corners.max(axis=0)
    axes = [np.linspace(start, end, count) for start, end, count in zip(low, high, _GRID, strict=True)]
    pixels = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    pixels = pixels[in_hull(pixels, corners)]
    found = direction_displacements(camera, pixels)
    return np.asarray(found[np.isfinite(found).all(axis=(1, 2))][:, :, problem.free])


def _start(problem: BoardProblem, image_size: tuple[int, int], held: Array, guess: Array | None) -> State:
    """Return a first state: from the guess, or from the focal length that explains the views best."""
    fixed = guess if guess is not None else held
    state = sweep_focal(problem.model, problem.board, problem.observations, image_size, fixed)
    if state is None:
        raise InsufficientData(
            f"no start was found for the lens model {problem.model.name}: its domain does not hold these corners; "
            f"try another --model ({WIDE_MODEL} for wide lenses) or a --guess"
        )
    return state


def _with_lens_priors(problem: BoardProblem, state: State, image_size: tuple[int, int]) -> BoardProblem:
    """Return the problem with the weak priors of a lens of the focal length of `state`."""
    model, focal = problem.model, float(state.parameters[0])
    return replace(problem, lens_spread=model.prior_std(image_size, focal), lens_mean=model.start(image_size, focal))


def _sigma(problem: BoardProblem, state: State) -> float:
    return robust_sigma(problem.distances(problem.residuals(state)), problem.observations.weights > 0)


def _robust(
    problem: BoardProblem, image_size: tuple[int, int], held: Array, guess: Array | None
) -> tuple[BoardProblem, State]:
    """Return problem and state after robust solves from each start of the lens model, those that fit best.

    Two sets of parameters may describe a lens nearly alike, and no step leads from one to the other.
    """
    found = _settled(problem, image_size, held, guess)
    model = problem.model
    starts = model.other_start if isinstance(model, PlaneModel) else {}
    other = np.array([starts.get(name, np.nan) for name in model.parameter_names])
    if guess is not None or not (np.isnan(held) & ~np.isnan(other)).any():
        return found
    try:
        second = _settled(problem, image_size, np.where(np.isnan(held), other, held), None)
    except InsufficientData:  # only of a start that is not needed
        return found
    return second if second[0].sigma < _CLEARLY * found[0].sigma else found


def _settled(
    problem: BoardProblem, image_size: tuple[int, int], held: Array, guess: Array | None
) -> tuple[BoardProblem, State]:
    """Return problem and state after robust solves at a falling σ, the stiffest lens parameters first.

    From a start without distortion the residuals are the distortion: principal point and higher coefficients would
    run after them before the poses have settled.
    """
    state = _start(problem, image_size, held, guess)
    problem = _with_lens_priors(problem, state, image_size)
    names = problem.model.parameter_names
    everything = problem.free
    stages = [np.array([i for i in everything if names[i] in stage], np.intp) for stage in problem.model.stages]
    for free in (*stages, everything, everything):
        problem = replace(problem, free=free, loss=_LOSS, sigma=_sigma(problem, state))
        state = minimise(problem.within_domain(state), state, _ROUGH).state
    return replace(problem, sigma=_sigma(problem, state)), state


def _pose_all(problem: BoardProblem, state: State) -> State:
    """Return the state with poses for every view of the problem, under the lens of `state`."""
    few = thinned(problem.observations)
    poses = poses_from_pixels(problem.model, state.parameters, problem.board, few)
    if poses is None:
        raise InsufficientData(
            "a view has fewer than four corners inside the domain of the lens model: try another --model "
            f"({WIDE_MODEL} for wide lenses)"
        )
    return replace(state, rotations=poses[0], translations=poses[1])


def _oriented(problem: BoardProblem, state: State, shape: ShapeOptions) -> tuple[Estimate, Array]:
    """Return a brief estimate with every view of a symmetric board numbered from the end that fits its shape best, and
    the symmetries (V,) by which they were turned.
    """

    def first(problem: BoardProblem, state: State) -> Estimate:
        return estimate(problem, state, shape.additional, brief=True)

    result, turns = first(problem, state), np.zeros(len(problem.observations.present), np.intp)
    symmetries = len(problem.board.symmetries())
    if not shape.smooth or symmetries == 1:
        return result, turns
    opposed = opposed_views(*odd_terms(result.problem, result.state, result.factors))
    if opposed.any():
        sorted_apart = opposed * (symmetries // 2)
        trial = first(*apply_symmetries(result.problem, result.state, sorted_apart))
        sigma = result.noise.sigma
        if _chi_square(result, sigma) - _chi_square(trial, sigma) > len(turns):
            result, turns = trial, sorted_apart
    return _turn_views(result, turns, first, shape)


def _turn_views(
    result: Estimate, turns: Array, again: Callable[[BoardProblem, State], Estimate], shape: ShapeOptions
) -> tuple[Estimate, Array]:
    """Return an estimate, made `again` as long as views fit the board's shape better from another of its ends, and the
    symmetries (V,) by which all of them were turned then; turns: those so far.
    """
    symmetries = len(result.problem.board.symmetries())
    for _ in range(_ROUNDS if shape.smooth and symmetries > 1 else 0):
        better, state = best_turns(result.problem, result.state)
        if not better.any():
            break
        # the points of the board start again
        result = again(renumbered(result.problem, better), replace(state, offsets=0 * state.offsets))
        turns = (turns + better) % symmetries
    return result, turns


def _chi_square(result: Estimate, sigma: float) -> float:
    """Return χ² of all present points, rejected ones counted at the cut, so that solutions can be compared."""
    squared = (
        np.nan_to_num(result.problem.distances(result.problem.residuals(result.state)), nan=np.inf) ** 2 / sigma**2
    )
    return float(np.minimum(squared[result.problem.observations.present], CUT**2).sum())
