"""Calibration of one camera from detections of a board: lens, poses, board shape, and their uncertainty."""

from collections.abc import Mapping, Sequence
from dataclasses import fields

import numpy as np

from camcal.arrays import Array, FloatArray, IntArray, readonly
from camcal.calibrate.between_views import BetweenViews, between_views
from camcal.calibrate.estimator import Estimate
from camcal.calibrate.evidence import WithinViews
from camcal.calibrate.fit import CalibrationFit, ShapeOptions, averaged_fit, fit, fit_briefly, fit_like, fit_plain
from camcal.calibrate.jackknife import influence, predict_views
from camcal.calibrate.noise import REJECTED, row_medians
from camcal.calibrate.problem import BoardProblem
from camcal.calibrate.refusals import (
    MIN_VIEWS,
    ROUGH,
    Misfit,
    misfit,
    require_fit,
    require_focal,
    require_one_camera,
    require_tilts,
    require_views,
    usable_views,
)
from camcal.calibrate.several_cameras import TwoCameras, two_cameras
from camcal.calibrate.shape import focal_correlations, surface_of
from camcal.calibrate.spline import fit_spline_briefly
from camcal.calibrate.view_records import RejectedCorner, View, rejected_corners, view_records
from camcal.cameras.catalogue import MODELS
from camcal.cameras.lens import CameraModel
from camcal.cameras.model import Camera
from camcal.cameras.observations import Observations
from camcal.cameras.spline import SplinedStereographic
from camcal.dataclass import dataclass, field, replace
from camcal.errors import InsufficientData, InvalidInput, NotConverged
from camcal.records import Brief
from camcal.solve.steps import SingularError
from camcal.targets.board import Board, Surface
from camcal.targets.detection import BoardDetection

__all__ = ["Calibration", "CandidateModel", "Options", "RejectedCorner", "View", "calibrate", "compare_models"]


@dataclass(frozen=True, eq=False)
class Options:
    """How to calibrate: the lens model, what to hold, where to start, how free the board is.

    fixed: lens parameters to hold, at the guess's value or else at the model's start (0 for coefficients).
    max_rejected: the share of corners that may be wrong (see gross.py) before the result is refused. named_groups:
    groups of images each of which may be another camera's, by their names.
    """

    model: CameraModel
    fixed: tuple[str, ...] = ()
    guess: Camera | None = None
    shape: ShapeOptions = field(default_factory=ShapeOptions)
    max_rejected: float = 0.1
    named_groups: tuple[frozenset[str], ...] = ()


@dataclass(frozen=True, eq=False)
class Calibration(Brief):
    """A camera with its covariance, the board's shape, and the record of every view and rejected corner.

    sigma_px: standard deviation of one pixel coordinate, estimated with these degrees_of_freedom (parameters deducted).
    rms_px: root mean square distance of the kept corners. residuals, pixels: (N, 2) of the kept corners, px;
    corner_views: (N,) the places of their views among the views.
    correlations: between the board's in-plane terms and fx, fy, where the former are in use.
    model_error_px: the error of a typical coordinate beyond the covariance that its image gives it, errors that repeat
    with the pixels included; None where no covariance was given.
    held_by_prior: lens parameters that the data hardly determine: their prior does.
    noise_covariance: (K, K) of the lens parameters if noise were all that is wrong with the corners; the camera's own
    covariance counts the errors within views as well. within_views: what these errors are. two_cameras: the groups
    that the views may fall into, each with a lens of its own, None where nothing supports any. between_views: what
    differs between views and ought to be the same.
    """

    camera: Camera
    board: Board
    surface: Surface
    views: tuple[View, ...]
    rejected: tuple[RejectedCorner, ...]
    sigma_px: float
    degrees_of_freedom: int
    rms_px: float
    residuals: FloatArray
    pixels: FloatArray
    corner_views: IntArray
    iterations: int
    correlations: Mapping[tuple[str, str], float] = field(default_factory=dict)
    model_error_px: float | None = None
    held_by_prior: tuple[str, ...] = ()
    noise_covariance: FloatArray | None = None
    within_views: WithinViews = field(default_factory=WithinViews)
    between_views: BetweenViews = field(default_factory=BetweenViews)
    two_cameras: TwoCameras | None = None

    @property
    def used(self) -> tuple[View, ...]:
        """The views that count."""
        return tuple(view for view in self.views if view.used)


@dataclass(frozen=True, eq=False)
class CandidateModel(Brief):
    """A lens model and how well it predicts: scores (V,) log likelihoods of the views; sigma_px: the scale of the
    errors of a coordinate, 0.85 standard deviations of Gaussian ones.

    reason: why it has no score, None if it has. calibration: a brief one with this model, None where it would be
    refused. map_px: RMS standard deviation of the projection over the image, once it was assessed. failures: codes of
    why it is refused, or of the criteria that it does not meet. pattern: whether its residuals depend on the place in
    the image, once it was assessed.
    """

    name: str
    scores: FloatArray | None = None
    corners: int = 0
    sigma_px: float | None = None
    reason: str | None = None
    calibration: Calibration | None = None
    map_px: float | None = None
    failures: tuple[str, ...] = ()
    pattern: bool = False

    @property
    def score(self) -> float:
        """The log likelihood of a corner on average, nat; -inf without one."""
        return float(self.scores.sum()) / self.corners if self.scores is not None else -np.inf


@dataclass(frozen=True, eq=False)
class FittedModel(CandidateModel):
    """A lens model with its brief fit, for a calibration that goes on from it, and with why that would be refused."""

    fit: CalibrationFit | None = None
    refusal: InsufficientData | None = None

    def without_fit(self) -> CandidateModel:
        """Return the model alone: a fit holds all that was estimated."""
        return CandidateModel(**{each.name: getattr(self, each.name) for each in fields(CandidateModel)})


@dataclass(frozen=True, eq=False)
class Solved:
    """A solution with what it was made from: the detections, and why some of them are not used (None: they are)."""

    fit: CalibrationFit
    detections: tuple[BoardDetection, ...]
    reasons: tuple[str | None, ...]
    size: tuple[int, int]
    cameras: TwoCameras | None

    @property
    def images(self) -> list[str]:
        """The names of the views that are used."""
        return [view.image for view, reason in zip(self.detections, self.reasons, strict=True) if reason is None]


def calibrate(
    detections: Sequence[BoardDetection], board: Board, options: Options, start: CalibrationFit | None = None
) -> Calibration:
    """Return the camera that saw a board in `detections`; start: as of `solve`, which says what is raised."""
    found = solve(detections, board, options, start)
    return record(found, found.fit.pose_covariances(), between_views(found.fit.estimates, found.images))


def solve(
    detections: Sequence[BoardDetection], board: Board, options: Options, start: CalibrationFit | None = None
) -> Solved:
    """Return the solution for the camera that saw a board in `detections`; start: a brief fit of `compare_models` with
    the same options, to go on from.

    Raises InsufficientData when the views cannot hold a calibration (too few, alike, fronto-parallel, too many
    rejected), NotConverged when the solver does not settle, InvalidInput for options that contradict each other.
    """
    size, reasons = usable_views(detections, board)
    usable = [view for view, reason in zip(detections, reasons, strict=True) if reason is None]
    try:
        if start is None:
            brief, turns = _fit_briefly(Observations.of(usable), board, size, options)
        else:
            brief, turns = start.first
        images = [view.image for view in usable]
        if (found := _misfit(brief, options)).roughness > ROUGH:  # no lens and no further pass makes that board fit
            require_fit(found, images, options.max_rejected, options.model.name)
        plain, turns = fit_plain(brief, turns, options.shape)
        cameras = two_cameras(plain, images, size, options.shape, options.named_groups)
        if plain.converged:  # before errors within views are modelled, which would take long for a wrong lens
            _require_plausible(plain, images, options, len(detections), cameras)
        result = fit(plain, turns, size)
    except (SingularError, np.linalg.LinAlgError) as error:
        raise InsufficientData(
            "some parameters are not determined by the views: add views tilted by 20° to 45° about both axes, "
            "or hold parameters with --fix"
        ) from error
    if not result.plain.converged:
        # the likeliest causes, and better things to say
        require_one_camera(cameras)
        require_tilts(result.state.rotations)
        raise NotConverged(
            f"calibration not converged after {result.plain.passes} passes with the lens model {options.model.name}"
        )
    _require_plausible(result, images, options, len(detections), cameras)
    if bounded := _at_limits(options, result.state.parameters, size):
        return solve(detections, board, bounded)
    return Solved(result, tuple(detections), tuple(reasons), size, cameras)


def compare_models(
    detections: Sequence[BoardDetection],
    board: Board,
    options: Options,
    models: Sequence[CameraModel],
    start: CalibrationFit | None = None,
) -> tuple[CandidateModel, ...]:
    """Return how well lens models predict views, in their order, each with a brief calibration, which takes errors
    within views for noise; options.model does not matter. start: the brief fit of another model to go on from.

    Raises InsufficientData for too few views.
    """
    size, reasons = usable_views(detections, board)
    usable = [view for view, reason in zip(detections, reasons, strict=True) if reason is None]
    observations = Observations.of(usable)
    result: list[CandidateModel] = []
    plausible = start
    for own in (replace(options, model=model) for model in models):
        try:
            brief, turns = _fit_briefly(observations, board, size, own, plausible.first if plausible else None)
            left_out = influence(brief)
            scores, sigma = predict_views(brief, left_out)
            fit = averaged_fit((brief,), WithinViews(1.0), turns, size, [left_out])
            candidate = FittedModel(own.model.name, scores, int(observations.present.sum()), sigma, fit=fit)
            solved = Solved(fit, tuple(detections), tuple(reasons), size, None)
            try:
                if start is None and not result:  # one answer does for all lens models
                    mixed = _misfit(fit, own).may_be_mixed(own.max_rejected)
                    groups = two_cameras(brief, solved.images, size, own.shape, own.named_groups, by_lens=mixed)
                    solved = replace(solved, cameras=groups)
                _require_plausible(fit, solved.images, own, len(detections), solved.cameras)
                found = record(solved, fit.pose_covariances(), BetweenViews())
                result.append(replace(candidate, calibration=found))
                plausible = plausible or fit
            except InsufficientData as error:
                codes = tuple(message.code for message in error.failures)
                result.append(replace(candidate, failures=codes, refusal=error))
        except (SingularError, np.linalg.LinAlgError):
            result.append(CandidateModel(own.model.name, reason="some parameters are not determined by the views"))
        except (InsufficientData, InvalidInput) as error:
            result.append(CandidateModel(own.model.name, reason=error.message))
    return tuple(result)


def _fit_briefly(
    observations: Observations,
    board: Board,
    size: tuple[int, int],
    options: Options,
    other: tuple[Estimate, Array] | None = None,
) -> tuple[Estimate, Array]:
    """Return what `fit_briefly` makes of the observations under the options; other: that of another lens model, for one
    that goes on from it.
    """
    if isinstance(options.model, SplinedStereographic):
        if options.fixed:
            raise InvalidInput(f"--fix: the parameters of {options.model.name} are not held one by one; leave it out")
        return fit_spline_briefly(
            options.model,
            size,
            lambda base, start: _fit_briefly(observations, board, size, replace(options, model=base), start),
            other,
        )
    held, guess = _held(options, size)
    if other is not None and guess is None:
        found = fit_like(*other, options.model, size, held)
        if found is not None:
            return found
    return fit_briefly(options.model, board, observations, size, held=held, guess=guess, shape=options.shape)


def _held(options: Options, size: tuple[int, int]) -> tuple[Array, Array | None]:
    """Return the held lens parameters (K,), NaN where free, and the whole lens to start from, if one is known."""
    names, guess = options.model.parameter_names, options.guess
    unknown = [name for name in options.fixed if name not in names]
    if unknown:
        others = [name for name, model in MODELS.items() if set(options.fixed) <= set(model.parameter_names)]
        hint = f"; models that have it: {', '.join(others)} (--model)" if others else ""
        missing = f"{options.model.name} has no parameter {unknown[0]!r}"
        raise InvalidInput(f"--fix: {missing}; it has {', '.join(names)}{hint}")
    if guess is not None and guess.image_size != size:
        wrong, right = "x".join(map(str, guess.image_size)), "x".join(map(str, size))
        raise InvalidInput(f"--guess: the camera is for {wrong} images, these are {right}")
    start = options.model.start(size, float(max(size)))
    if guess is not None:
        for index, name in enumerate(names):
            if name in guess.model.parameter_names:
                start[index] = guess.value(name)
    elif {"fx", "fy"} & set(options.fixed):
        raise InvalidInput("--fix fx or fy needs a --guess with their values")
    held = np.array([start[i] if name in options.fixed else np.nan for i, name in enumerate(names)])
    return held, start if guess is not None else None


def _at_limits(options: Options, parameters: Array, size: tuple[int, int]) -> Options | None:
    """Return the options with every parameter (K,) that an estimate has beyond its limits held there, None if none is:
    the best lens of the model is at its limit then, and beyond it a camera file could not be read.
    """
    if isinstance(options.model, SplinedStereographic):
        return None
    names, limits = options.model.parameter_names, options.model.limits
    low, high = np.array([limits[name] for name in names]).T
    within = np.clip(parameters, low, high)
    beyond = tuple(name for name, kept, found in zip(names, within, parameters, strict=True) if kept != found)
    if not beyond:
        return None
    fixed = (*options.fixed, *beyond)
    return replace(options, fixed=fixed, guess=Camera(options.model, size, within))


def _require_plausible(
    fit: CalibrationFit | Estimate,
    images: Sequence[str],
    options: Options,
    total: int,
    cameras: TwoCameras | None = None,
) -> None:
    """Raise InsufficientData where a solution cannot be one of this board and this lens.

    images: of its views; total: how many there were to begin with.
    """
    problem, state = fit.problem, fit.state
    used = _kept(problem, problem.residuals(state)).any(axis=1)
    if used.sum() >= MIN_VIEWS:
        require_tilts(state.rotations[used])
    require_fit(_misfit(fit, options), images, options.max_rejected, options.model.name, cameras)
    require_views(int(used.sum()), total, 0)


def _misfit(fit: CalibrationFit | Estimate, options: Options) -> Misfit:
    return misfit(fit.problem, fit.state, fit.problem.residuals(fit.state), options.max_rejected)


def _kept(problem: BoardProblem, residuals: Array) -> Array:
    """Return the corners (V, P) that count; residuals: (2, V, P) px."""
    # the solver may pass the edge of the lens's domain; what it leaves beyond has no residual to count
    return np.asarray((problem.observations.weights >= REJECTED) & np.isfinite(residuals).all(axis=0))


def record(solved: Solved, covariances: Array, between: BetweenViews) -> Calibration:
    """Return the record of a solution; raises InsufficientData where it leaves the focal length open.

    covariances: (V, 6, 6) of the poses of the views that are used.
    """
    result, detections, reasons, size = solved.fit, solved.detections, list(solved.reasons), solved.size
    problem, state, plain = result.problem, result.state, result.plain
    residuals = problem.residuals(state)
    kept = _kept(problem, residuals)
    medians = row_medians(np.nan_to_num(np.hypot(*residuals), nan=np.inf), problem.observations.present)
    covariance = result.covariance
    camera = result.camera(size, covariance)
    noise_covariance = result.camera(size, result.noise_covariance).covariance
    for focal, std in zip(*camera.focal_lengths(), strict=True):
        require_focal(float(focal), float(std))
    views = view_records(
        result,
        detections,
        reasons=reasons,
        covariances=covariances,
        residuals=residuals,
        kept=kept,
        medians=medians,
    )
    places = np.flatnonzero([reason is None for reason in reasons])
    return Calibration(
        camera,
        problem.board,
        surface=surface_of(problem, state, plain.board, covariance),
        views=views,
        rejected=rejected_corners(result, detections, reasons, problem.observations.present & ~kept, residuals),
        sigma_px=plain.noise.sigma,
        degrees_of_freedom=max(int(2 * kept.sum() - plain.posterior.spent.sum()), 1),
        rms_px=float(np.sqrt(np.mean(np.sum(residuals[:, kept] ** 2, axis=0)))),
        residuals=readonly(residuals[:, kept].T, (None, 2), "residuals"),
        pixels=readonly(problem.observations.pixels[:, kept].T, (None, 2), "pixels"),
        corner_views=readonly(places[np.nonzero(kept)[0]], (None,), "corner_views", np.intp),
        iterations=sum(own.passes for own in result.estimates),
        correlations=focal_correlations(problem.shared_names, covariance),
        model_error_px=plain.model_error_px,
        held_by_prior=problem.held_by_prior(np.sqrt(np.diag(result.noise_covariance))),
        noise_covariance=noise_covariance,
        within_views=result.errors,
        between_views=between,
        two_cameras=solved.cameras,
    )
