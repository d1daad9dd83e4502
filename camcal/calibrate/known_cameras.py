"""New views of cameras that are known: what they say of lenses and of the places of cameras, by themselves.

The calibration is a wide prior, which only keeps in place what the new views leave open, and is taken out again. The
board is the one of the calibration as far as that knows its shape; noise and errors within views are those of the new
views, but no smaller than the noise of the calibration, which holds what its lens model leaves unexplained.
See docs/mathematics.md, "Check of a calibration".
"""

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.camera_part import AdditionalParameters, CameraPart
from camcal.calibrate.effects import EFFECTS
from camcal.calibrate.initialise import poses_from_pixels, thinned
from camcal.calibrate.noise import REJECTED, robust_sigma
from camcal.calibrate.problem import POSE, BoardProblem, State
from camcal.calibrate.rigs.estimator import RigEstimate, estimate_rig
from camcal.calibrate.rigs.fit import moved_between_exposures
from camcal.calibrate.rigs.links import best_turns_of_captures, turned
from camcal.calibrate.rigs.problem import LensPrior, RigProblem, RigState
from camcal.calibrate.shape import TOGETHER, first_scales
from camcal.cameras.model import Camera
from camcal.cameras.observations import Observations, by_pose
from camcal.dataclass import dataclass, replace
from camcal.errors import InsufficientData
from camcal.geometry.pose import Pose
from camcal.solve.descent import Stopping
from camcal.solve.least_squares import minimise
from camcal.solve.losses import Cauchy
from camcal.solve.steps import SingularError
from camcal.targets.board import CORNER_CLASSES, IN_PLANE, OUT_OF_PLANE, TERMS, Surface

# By how much a lens may have changed: relative, of its focal lengths together and of each; of the image's width, its
# principal point; and distortion coefficients, where the model's own prior is not narrower.
_ZOOM, _ASPECT, _CENTRE, _COEFFICIENT = 0.05, 3e-3, 0.02, 0.1
_LOSS, _POSING = Cauchy(3.0), Stopping(relative_decrease=1e-8, iterations=20)
_ROUNDS = 4
_LEAST_STD = 1e-9  # of a board's terms, in its unit: what is stated as known exactly


@dataclass(frozen=True, eq=False)
class KnownCamera:
    """A camera with its covariance, the noise of its calibration in px, and its new views with the capture (V,) that
    each of them belongs to.
    """

    camera: Camera
    sigma_px: float
    views: Observations
    captures: Array

    @property
    def free(self) -> Array:
        """The parameters (F,) that its calibration has estimated."""
        if self.camera.covariance is None:
            return np.zeros(0, np.intp)
        return np.flatnonzero(np.diag(self.camera.covariance) > 0)


@dataclass(frozen=True, eq=False)
class KnownBoard:
    """The board that new views show. surface: its shape by the calibration, flat where that was of another board or
    does not tell. views: of the calibration that its shape is from, 0 where it is not known.
    """

    surface: Surface
    views: float = 0.0

    @property
    def shape_known(self) -> bool:
        """Whether its shape is known from the calibration."""
        return self.views > 0


@dataclass(frozen=True, eq=False)
class NewViews:
    """What new views say of the free lens parameters of all cameras and of the poses of all but the first.

    information: (D, D) of the new views alone, what else they depend on following. score: (D,) the gradient of their
    log likelihood at what is known: where the information is regular, that times the change that they see. starts:
    where the free parameters of each camera begin, and the poses. sigma_px: noise of the corners of each camera.
    effects: of each camera, what errors within views move a corner by, px RMS, by the names of EFFECTS. rejected: of
    each camera, the share of its corners. board: how much the shape of the board differs from the known one, as mean
    square in standard deviations, and of how many directions; 0 of 0 where it is not known.
    """

    information: Array
    score: Array
    starts: tuple[int, ...]
    sigma_px: tuple[float, ...]
    effects: tuple[dict[str, float], ...]
    rejected: tuple[float, ...]
    board: tuple[float, int]
    by_place: Array


def examine(known: Sequence[KnownCamera], poses: Sequence[Pose], board: KnownBoard) -> NewViews | None:
    """Return what new views say of cameras at poses camera_T_rig, the first of which is the rig's; None where the lens
    of a camera cannot take the corners at all. Raises InsufficientData where views leave parameters undetermined.
    """
    estimated = estimate_known(known, poses, board, {place: _wide(each) for place, each in enumerate(known)})
    if estimated is None:
        return None
    found, start = estimated
    additional = found.additional
    every = replace(additional, effects=tuple(effect.name for effect in EFFECTS))
    motion = len(known) > 1 and moved_between_exposures(found)
    with suppress(SingularError, np.linalg.LinAlgError):  # views that fit nowhere tell of no errors within them
        full = estimate_rig(found.problem, found.state, every, found.known, found.board, motion=motion)
        found = full if full.converged else found
    end = found.problem.board_start
    precision = np.linalg.inv(found.factors.shared_covariance()[:end, :end])
    information = precision - found.problem.prior_precision(found.state)[:end, :end]
    return NewViews(
        (information + information.T) / 2,
        precision @ found.problem.change(start, found.state),
        found.problem.lens_starts,
        tuple(part.noise.sigma for part in found.parts),
        tuple(_sizes(part) for part in found.parts),
        tuple(float(np.mean(part.problem.observations.weights[part.present] < REJECTED)) for part in found.parts),
        _board_change(found) if board.shape_known else (0.0, 0),
        _by_place(found),
    )


def estimate_known(
    known: Sequence[KnownCamera],
    poses: Sequence[Pose],
    board: KnownBoard,
    priors: dict[int, LensPrior],
    held: bool = False,
) -> tuple[RigEstimate, RigState] | None:
    """Return the estimate of new views of cameras at poses camera_T_rig, with priors of their lenses by the places of
    cameras, and where it started; None where the lens of a camera cannot take the corners at all.

    held: whether the cameras stay where they are in the rig. Errors within views are taken for noise.
    Raises InsufficientData where views leave parameters undetermined.
    """
    started = _start(known, poses, board, priors)
    if started is None:
        return None
    problem, start = replace(started[0], poses_held=held), started[1]
    additional = AdditionalParameters(not board.shape_known, problem.board.count <= TOGETHER)
    try:
        found = _estimate(problem, start, additional)
        for _ in range(_ROUNDS if len(problem.board.symmetries()) > 1 else 0):
            better = best_turns_of_captures(found.problem, found.state)
            if not better.any():
                break
            bare = replace(found.state, offsets=0 * found.state.offsets)
            found = _estimate(*turned(problem, bare, better), additional)
    except (SingularError, np.linalg.LinAlgError) as error:
        raise InsufficientData("the views do not determine where the board is: more corners are needed") from error
    return found, start


def wide_prior_of(known: KnownCamera) -> LensPrior:
    """Return the prior of a lens that may have changed."""
    return _wide(known)


def prior_of(known: KnownCamera) -> LensPrior:
    """Return the prior of a lens that has stayed as it is."""
    return _prior(known, np.zeros((len(known.camera.parameters),) * 2))


def _estimate(problem: RigProblem, state: RigState, additional: AdditionalParameters) -> RigEstimate:
    return estimate_rig(problem, state, additional, [None] * len(problem.parts), first_scales())


def _sizes(part: CameraPart) -> dict[str, float]:
    """Return what each effect moves a corner by, px RMS in either coordinate."""
    result = {}
    for place, effect in enumerate(EFFECTS):
        chosen = part.columns.effect == place
        moved = np.einsum("cmvp,vm->cvp", part.columns.values[:, chosen], part.place.coefficients[:, chosen])
        result[effect.name] = float(np.sqrt(np.mean(moved[:, part.present] ** 2)))
    return result


def _by_place(found: RigEstimate) -> Array:
    """Return the derivatives (2, 6, N) of the corners of the last camera by the step of its pose."""
    part, place = found.parts[-1], found.state.camera_translations[-1]
    if len(found.parts) == 1:
        return np.zeros((2, POSE, 0))
    arms = part.problem.camera_points(part.place.state).reshape(3, -1) - place[:, None]
    return by_pose(part.place.derivatives.by_point, arms)[:, :, part.present.ravel()]


def _board_change(found: RigEstimate) -> tuple[float, int]:
    """Return how much the terms of the board differ from the known ones: the mean square in standard deviations along
    the directions that the new views know better than the calibration did, and the number of these.
    """
    start, count = found.problem.board_start, found.problem.terms
    std = found.problem.parts[0].term_std
    if not count or std is None:
        return 0.0, 0
    own = found.factors.shared_covariance()[start : start + count, start : start + count] / np.outer(std, std)
    # an estimate is drawn to what is known: it scatters by as much as the known variance has shrunk
    shrunk, along = np.linalg.eigh(np.eye(count) - own)
    chosen = shrunk > 0.5
    squares = (along.T @ (found.state.shape / std))[chosen] ** 2 / shrunk[chosen]
    return (float(squares.mean()), int(chosen.sum())) if chosen.any() else (0.0, 0)


def _start(
    known: Sequence[KnownCamera], poses: Sequence[Pose], board: KnownBoard, priors: dict[int, LensPrior]
) -> tuple[RigProblem, RigState] | None:
    """Return problem and state with the cameras as they are known, and the board where they see it; None where a lens
    cannot take all corners.
    """
    surface, count = board.surface, 1 + max(int(each.captures.max()) for each in known)
    rotations, translations = np.zeros((count, 3, 3)), np.zeros((count, 3))
    placed, parts = np.zeros(count, bool), []
    for each, pose in zip(known, poses, strict=True):
        lens = each.camera
        seen = poses_from_pixels(lens.model, lens.parameters, surface.board, thinned(each.views))
        if seen is None:
            return None
        problem = BoardProblem(
            lens.model,
            surface.board,
            each.views,
            np.zeros(0, np.intp),
            points=surface.points(),
            loss=_LOSS,
        )
        state = State(lens.parameters, *seen, np.zeros(0), np.zeros((surface.board.count, 3)))
        problem = replace(problem, sigma=_sigma(problem, state))
        state = minimise(problem.within_domain(state), state, _POSING).state
        new = ~placed[each.captures]
        back = pose.inverse()
        rotations[each.captures[new]] = back.rotation @ state.rotations[new]
        translations[each.captures[new]] = state.translations[new] @ back.rotation.T + back.translation
        placed[each.captures] = True
        parts.append(_part(replace(problem, sigma=_sigma(problem, state)), state, each, board))
    start = RigState(
        tuple(each.camera.parameters for each in known),
        np.stack([pose.rotation for pose in poses]),
        np.stack([pose.translation for pose in poses]),
        rotations=rotations,
        translations=translations,
        shape=np.zeros(len(parts[0].terms)),
        offsets=np.zeros((surface.board.count, 3)),
    )
    return RigProblem(tuple(parts), tuple(each.captures for each in known), count, priors), start


def _part(problem: BoardProblem, state: State, known: KnownCamera, board: KnownBoard) -> BoardProblem:
    """Return the problem of one camera with its board as it is known."""
    problem = replace(problem, free=known.free, loss=None, finest=known.sigma_px)
    if not board.shape_known:
        return replace(problem, terms=TERMS)
    surface, side = board.surface, max(board.surface.board.extent)
    by_board = problem.derivatives(state).by_board(state.rotations)
    scale = float(np.sqrt(np.median(np.sum(by_board[..., :2] ** 2, axis=(2, 3)) / 2)))
    noise = known.sigma_px / scale
    spread = {
        name: side * surface.classes[name][0] if name in surface.classes else side * own.median
        for name, own in CORNER_CLASSES.items()
    }
    # a point's offset has been seen in every view of the calibration; across the board only by tilted ones
    flat = (spread[IN_PLANE] ** -2 + board.views / noise**2) ** -0.5
    height = (spread[OUT_OF_PLANE] ** -2 + board.views / (2 * noise**2)) ** -0.5
    return replace(
        problem,
        terms=surface.terms,
        term_std=np.maximum(surface.coefficients_std(), _LEAST_STD),
        offset_std=np.array([flat, flat, height]),
        board_known=True,
    )


def _sigma(problem: BoardProblem, state: State) -> float:
    return robust_sigma(problem.distances(problem.residuals(state)), problem.observations.weights > 0)


def _wide(known: KnownCamera) -> LensPrior:
    """Return the prior of a lens that may have changed: what is known of it, and by how much lenses change."""
    return _prior(known, changes(known.camera))


def _prior(known: KnownCamera, changed: Array) -> LensPrior:
    free, count = known.free, len(known.camera.parameters)
    covariance = changed + (np.zeros((count, count)) if known.camera.covariance is None else known.camera.covariance)
    root = np.linalg.inv(np.linalg.cholesky(covariance[np.ix_(free, free)]))
    return LensPrior(known.camera.parameters[free], root)


def freed(camera: Camera) -> Camera:
    """Return a camera of whose lens no covariance is known with that of how lenses change."""
    if camera.covariance is not None and camera.covariance.any():
        return camera
    held = np.isin(camera.model.parameter_names, [*camera.fixed])
    covariance = changes(camera)
    covariance[held], covariance[:, held] = 0.0, 0.0
    return replace(camera, covariance=covariance)


def changes(camera: Camera) -> Array:
    """Return the covariance (K, K) of how a lens may have changed."""
    focal, width = float(camera.parameters[0]), camera.image_size[0]
    names = camera.model.parameter_names
    std = np.minimum(camera.model.prior_std(camera.image_size, focal), _COEFFICIENT)
    common = np.zeros(len(names))
    for place, name in enumerate(names):
        if name in ("fx", "fy"):
            std[place], common[place] = _ASPECT * focal, _ZOOM * focal
        elif name in ("cx", "cy"):
            std[place] = _CENTRE * width
    return np.asarray(np.diag(std**2) + np.outer(common, common))
