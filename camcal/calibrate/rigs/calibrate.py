"""Calibration of the cameras of a rig from captures of a board."""

from dataclasses import replace

import numpy as np

from camcal.arrays import Array
from camcal.calibrate import intrinsics
from camcal.calibrate.between_views import between_views
from camcal.calibrate.intrinsics import Calibration, Solved
from camcal.calibrate.rigs.captures import Captures
from camcal.calibrate.rigs.effects import MOTION
from camcal.calibrate.rigs.fit import RigFit, RigStart, fit_rig
from camcal.calibrate.rigs.links import Link, Placed, link, place
from camcal.calibrate.rigs.problem import LensPrior
from camcal.calibrate.rigs.record import FIXED, PRIOR, ExposureMotion, RigCalibration, RigOptions
from camcal.errors import InsufficientData, InvalidInput, NotConverged
from camcal.geometry.pose import Pose
from camcal.solve.steps import SingularError
from camcal.targets.board import Board

__all__ = ["Captures", "RigCalibration", "RigOptions", "calibrate_rig"]


def calibrate_rig(captures: Captures, board: Board, options: RigOptions) -> RigCalibration:
    """Return the cameras that saw a board in `captures` and where they are.

    Raises InsufficientData where no two cameras can be linked or a camera cannot be calibrated, NotConverged,
    InvalidInput.
    """
    solved = [_alone(captures, camera, board, options) for camera in range(len(captures.cameras))]
    starts = [RigStart(own, _captures_of(captures, camera, own)) for camera, own in enumerate(solved)]
    links = _links(starts, board)
    placed = place(links, len(starts))
    _require_link(placed, captures)
    chosen = sorted(placed.rotations)
    used = np.unique(np.concatenate([starts[camera].captures for camera in chosen]))
    linked = [replace(starts[camera], captures=np.searchsorted(used, starts[camera].captures)) for camera in chosen]
    places = Placed(
        {new: placed.rotations[old] for new, old in enumerate(chosen)},
        {new: placed.translations[old] for new, old in enumerate(chosen)},
        {},
    )
    names = tuple(captures.cameras[camera] for camera in chosen)
    priors = _priors(options, names, linked)
    try:
        result = fit_rig(linked, places, len(used), priors, options.motion)
    except (SingularError, np.linalg.LinAlgError) as error:
        raise InsufficientData(
            "some parameters of the rig are not determined by the captures: add captures with the board tilted, at "
            "several distances, in view of several cameras"
        ) from error
    if not result.plain.converged:
        raise NotConverged(f"rig calibration not converged after {result.plain.passes} passes: add captures")
    return _record(result, linked, names, captures, used)


def _alone(captures: Captures, camera: int, board: Board, options: RigOptions) -> Solved:
    """Return the solution of one camera from its own views."""
    views = [view for view in captures.of(camera) if view is not None]
    how = _options_of(captures.cameras[camera], options)
    try:
        solved = intrinsics.solve(views, board, how)
        intrinsics.require_plausible(solved, how)
    except (InsufficientData, NotConverged, InvalidInput) as error:
        raise type(error)(f"camera {captures.cameras[camera]}: {error.message}") from error
    return solved


def _options_of(name: str, options: RigOptions) -> intrinsics.Options:
    """Return how a camera is calibrated alone."""
    given, model = options.given.get(name), options.models[name]
    if options.lenses in (FIXED, PRIOR) and given is None:
        raise InvalidInput(f"camera {name}: no lens is given for it")
    fixed = given.model.parameter_names if given is not None and options.lenses == FIXED else ()
    return intrinsics.Options(
        model if given is None else given.model, fixed, given, options.shape, options.max_rejected
    )


def _captures_of(captures: Captures, camera: int, solved: Solved) -> Array:
    """Return the capture (V,) of each view that is used."""
    there = [index for index, view in enumerate(captures.of(camera)) if view is not None]
    return np.array([index for index, reason in zip(there, solved.reasons, strict=True) if reason is None], np.intp)


def _links(starts: list[RigStart], board: Board) -> dict[tuple[int, int], Link]:
    result = {}
    for a in range(len(starts)):
        for b in range(a + 1, len(starts)):
            found = link(starts[a].poses, starts[b].poses, board)
            if found is not None:
                result[a, b] = found
    return result


def _require_link(placed: Placed, captures: Captures) -> None:
    if len(placed.rotations) < 2:
        raise InsufficientData(
            f"no capture shows the board to two of the cameras {', '.join(captures.cameras)}: images of one capture "
            "must have been taken at the same time and be matched; see --match"
        )


def _priors(options: RigOptions, names: tuple[str, ...], starts: list[RigStart]) -> dict[int, LensPrior]:
    """Return the priors of lenses that are given with their covariance."""
    result = {}
    for camera, (name, start) in enumerate(zip(names, starts, strict=True)):
        given = options.given.get(name)
        if options.lenses != PRIOR or given is None:
            continue
        if given.covariance is None:
            raise InvalidInput(f"camera {name}: its file has no covariance, which a prior needs; see --lenses fixed")
        free = start.solved.fit.problem.free
        covariance = np.asarray(given.covariance)[np.ix_(free, free)]
        values, vectors = np.linalg.eigh(covariance)
        root = (vectors / np.sqrt(np.maximum(values, 1e-12 * values[-1]))).T
        result[camera] = LensPrior(np.asarray(given.parameters)[free], root)
    return result


def _record(
    result: RigFit,
    starts: list[RigStart],
    names: tuple[str, ...],
    captures: Captures,
    used: Array,
) -> RigCalibration:
    problem = result.problem
    calibrations = {
        name: _calibration(result, camera, start.solved)
        for camera, (name, start) in enumerate(zip(names, starts, strict=True))
    }
    poses = {
        name: Pose(result.state.camera_rotations[camera], result.state.camera_translations[camera])
        for camera, name in enumerate(names)
    }
    count = problem.board_start
    missing = [name for name in captures.cameras if name not in names]
    return RigCalibration(
        calibrations,
        poses,
        problem.names(names),
        result.covariance[:count, :count],
        captures=tuple(captures.names[index] for index in used),
        motion=_motion(result),
        unlinked={name: f"no capture shows the board to it and to any of {', '.join(names)}" for name in missing},
    )


def _calibration(result: RigFit, camera: int, solved: Solved) -> Calibration:
    """Return the record of one camera in the rig."""
    rig, plain = result.problem, result.plain
    part = plain.parts[camera]
    lens = np.arange(*rig.lens_starts[camera : camera + 2])
    own = np.concatenate([lens, np.arange(rig.board_start, rig.dense)])
    fit = solved.fit
    state = result.camera_states()[camera]
    posterior = replace(fit.plain.posterior, shared=result.noise_covariance[np.ix_(own, own)], spent=part.spent)
    estimate = replace(
        fit.plain,
        problem=part.problem,
        state=state,
        noise=part.noise,
        corners=part.corners,
        board=plain.board,
        posterior=posterior,
        passes=plain.passes,
        model_error_px=part.model_error_px,
    )
    fit = replace(
        fit,
        state=state,
        estimates=(estimate, *fit.estimates[1:]),
        turns=_turned(fit.turns, result.turns[camera], rig.board),
        covariance=result.covariance[np.ix_(own, own)],
        noise_covariance=result.noise_covariance[np.ix_(own, own)],
    )
    between = between_views(solved.fit.estimates, solved.images)
    return intrinsics.record(replace(solved, fit=fit), result.poses[camera], between)


def _turned(first: Array, then: Array, board: Board) -> Array:
    """Return the symmetries (V,) by which views are turned in the end, of the board's list of them."""
    table = np.stack(board.symmetries())
    composed = np.take_along_axis(table[then], table[first], axis=1)
    return np.array([int(np.flatnonzero((table == row).all(axis=1))[0]) for row in composed], np.intp)


def _motion(result: RigFit) -> ExposureMotion | None:
    """Return how far the board moved between the exposures of captures."""
    plain = result.plain
    if not plain.motion:
        return None
    chosen = plain.effects.of_kind(MOTION)
    std = plain.effect_scales.std(plain.effects.effect)
    moved = plain.coefficients[:, chosen].reshape(len(std), -1, 6)[:, :, :3]
    distances = np.linalg.norm(moved, axis=2)
    seen = distances[distances > 0]
    kinds = np.unique(plain.effects.effect[chosen])
    size = float(np.sqrt(np.mean(plain.effect_scales.variances[kinds])))
    return ExposureMotion(size, float(np.median(seen)), float(np.max(seen)))
