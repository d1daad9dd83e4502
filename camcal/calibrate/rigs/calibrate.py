"""Calibration of the cameras of a rig from captures of a board."""

from collections.abc import Mapping, Sequence
from itertools import combinations
from types import MappingProxyType

import numpy as np

from camcal.arrays import Array
from camcal.calibrate import intrinsics
from camcal.calibrate.between_views import between_views
from camcal.calibrate.fit import CalibrationFit
from camcal.calibrate.intrinsics import Calibration, Solved
from camcal.calibrate.rigs.effects import SHIFT
from camcal.calibrate.rigs.epipolar import epipolar_by_capture
from camcal.calibrate.rigs.fit import RigFit, fit_rig, with_other_models
from camcal.calibrate.rigs.links import Link, Placed, composed, link, place
from camcal.calibrate.rigs.measured import Measured, require_measured
from camcal.calibrate.rigs.mistakes import Mistakes, RigCamera, mistakes
from camcal.calibrate.rigs.paths import camera_links
from camcal.calibrate.rigs.placement import PlacedRig, Rows, groups_of, place_rig
from camcal.calibrate.rigs.problem import LensPrior
from camcal.calibrate.rigs.record import FIXED, PRIOR, Captures, ExposureMotion, RigCalibration, RigOptions
from camcal.calibrate.rigs.start import RigStart
from camcal.dataclass import dataclass, field, replace
from camcal.errors import CamcalError, InsufficientData, InvalidInput, NotConverged
from camcal.geometry.pose import Pose
from camcal.messages import Message
from camcal.solve.steps import SingularError
from camcal.targets.board import SCALE, Board, bare_term

_SEEN = 3.0  # times the noise of a corner: motion that is worth a message
_LEFT_OUT = 0.25  # of a camera's views, which fit no other camera

__all__ = ["Captures", "RigCalibration", "RigOptions", "calibrate_rig"]


def calibrate_rig(captures: Captures, board: Board, options: RigOptions) -> RigCalibration:
    """Return the cameras that saw a board in `captures` and where they are.

    Raises InsufficientData where no two cameras can be linked or captures are put together wrongly, NotConverged,
    InvalidInput.
    """
    if len(captures.cameras) < 2:
        raise InvalidInput("a rig needs two cameras or more")
    cameras = _alone(captures, board, options, options.starts)
    rows = Rows.of(captures, board, options.bodies)
    found = _mistakes(cameras, board, rows, captures.names)
    if found.excluded:
        wrong = {(capture, cameras.places[camera]) for capture, camera in found.excluded}
        captures = captures.without(wrong, "inconsistent with the other captures")
        cameras = _alone(captures, board, options)
    linked, placed, groups, first = _link_groups(cameras, board, rows, options)
    priors, measured = _priors(options, linked), _measured_of(options, placed, rows)
    try:
        result = fit_rig(linked.starts, placed, groups, priors, options.motion, measured)
    except (SingularError, np.linalg.LinAlgError) as error:
        raise InsufficientData(
            "some parameters of the rig are not determined by the captures: add captures with the board tilted, at "
            "several distances, in view of several cameras"
        ) from error
    if not result.plain.converged:
        raise NotConverged(f"rig calibration not converged after {result.plain.passes} passes: add captures")
    others = [options.others.get(name) for name in linked.names]
    if any(others):
        result = with_other_models(result, others, [start.solved.size for start in linked.starts])
    problem, count = result.problem, result.problem.board_start
    ratios = np.linalg.solve(result.noise_covariance[:count, :count], result.covariance[:count, :count])
    blocks = problem.measured_blocks(result.plain.state)
    require_measured(measured, blocks, result.plain.factors.shared_covariance(), np.trace(ratios) / count, rows.boards)
    found = replace(found, warnings=(*found.warnings, *placed.messages))
    used = tuple(captures.names[index] for index in first)
    return _record(result, linked, used, _left_out(captures, cameras, linked), found, placed.roots)


@dataclass(frozen=True, eq=False)
class _Cameras:
    """The cameras that could be calibrated alone: names, places among all cameras, and starts. refused: why the others
    could not, by their names.
    """

    names: tuple[str, ...]
    places: tuple[int, ...]
    starts: tuple[RigStart, ...]
    refused: Mapping[str, CamcalError] = field(default_factory=dict)

    def links(self, board: Board) -> dict[tuple[int, int], Link]:
        """Return the relative poses of all pairs that have captures in common."""
        result = {}
        for a, b in combinations(range(len(self.starts)), 2):
            found = link(self.starts[a].poses, self.starts[b].poses, board)
            if found is not None:
                result[a, b] = found
        return result

    def described(self) -> list[RigCamera]:
        """Return what is asked of the cameras to find mistakes."""
        return [
            RigCamera(name, start.poses, start.solved.fit.problem, start.solved.fit.state.parameters)
            for name, start in zip(self.names, self.starts, strict=True)
        ]


def _mistakes(cameras: _Cameras, board: Board, rows: Rows, names: Sequence[str]) -> Mistakes:
    """Return the mistakes in the captures of each board, see `mistakes`."""
    result = Mistakes()
    for number, member in enumerate(board.members.values()):
        own = np.flatnonzero(rows.board == number)
        if not len(own):
            continue
        described = [each.within(own) for each in cameras.described()]
        links = {
            (a, b): known
            for a, b in combinations(range(len(described)), 2)
            if (known := link(described[a].poses, described[b].poses, member)) is not None
        }
        found = mistakes(described, links, member, [names[row] for row in own.tolist()])
        excluded = {(int(own[capture]), camera) for capture, camera in found.excluded}
        result = Mistakes(
            (*result.warnings, *found.warnings), (*result.failures, *found.failures), result.excluded | excluded
        )
    return result


def _alone(
    captures: Captures,
    board: Board,
    options: RigOptions,
    starts_of: Mapping[str, CalibrationFit] = MappingProxyType({}),
) -> _Cameras:
    """Return the cameras calibrated from their own views; raises the first error unless two of them can be.

    starts_of: see RigOptions, where no capture is left out.
    """
    names, places, starts = [], [], []
    refused: dict[str, CamcalError] = {}
    _require_different(captures)
    for camera, name in enumerate(captures.cameras):
        how = _options_of(name, options)
        there = [index for index, row in enumerate(captures.views) if row[camera] is not None]
        views = [view for view in captures.of(camera) if view is not None]
        try:
            solved = intrinsics.solve(views, board, how, starts_of.get(name))
        except (InsufficientData, NotConverged) as error:
            other = next((view.other for view in views if view.other is not None), None)
            hint = f"; its images show a {other.words}" if other is not None else ""
            refused[name] = type(error)(error.message + hint)
            continue
        used = [index for index, reason in zip(there, solved.reasons, strict=True) if reason is None]
        names.append(name)
        places.append(camera)
        starts.append(RigStart(solved, np.array(used, np.intp)))
    if len(starts) < 2:
        name, why = next(iter(refused.items()))
        raise type(why)(f"camera {name}: {why.message}") from why
    return _Cameras(tuple(names), tuple(places), tuple(starts), refused)


def _require_different(captures: Captures) -> None:
    """Raise InsufficientData if two cameras have the same images."""
    for a, b in combinations(range(len(captures.cameras)), 2):
        pairs = [(row[a], row[b]) for row in captures.views]
        both = [(one, other) for one, other in pairs if one is not None and other is not None and one.found]
        same = [len(one.ids) == len(other.ids) and np.array_equal(one.pixels, other.pixels) for one, other in both]
        if both and 2 * sum(same) > len(both):
            text = f"{captures.cameras[a]} and {captures.cameras[b]} have the same images"
            raise InsufficientData(text, failures=[Message("same_images", text)])


def _options_of(name: str, options: RigOptions) -> intrinsics.Options:
    """Return how a camera is calibrated alone."""
    given, model = options.given.get(name), options.models[name]
    if options.lenses in (FIXED, PRIOR) and given is None:
        raise InvalidInput(f"camera {name}: no lens is given for it")
    fixed = given.model.parameter_names if given is not None and options.lenses == FIXED else ()
    return intrinsics.Options(
        model if given is None else given.model, fixed, given, options.shape, options.max_rejected
    )


def _link_groups(
    cameras: _Cameras, board: Board, rows: Rows, options: RigOptions
) -> tuple[_Cameras, PlacedRig, tuple[Array, Array, int], Array]:
    """Return the cameras that are linked, where they and the boards are, the groups of the rows of captures, see
    `fit_rig`, and the first row of each group.
    """
    linked = place(cameras.links(board), len(cameras.starts))
    poses = [start.poses for start in cameras.starts]
    placed = place_rig(poses, linked, rows, cameras.names, options.measured.relations)
    chosen = sorted(placed.cameras.rotations)
    if len(chosen) < 2:
        raise InsufficientData(
            f"no capture shows the board to two of the cameras {', '.join(cameras.names)}: images of one capture "
            "must be taken at the same time and matched; see --match"
            if len(rows.boards) == 1
            else f"nothing links the cameras {', '.join(cameras.names)}: no capture shows one board to two of them, or "
            "boards that are linked; see --match and --joined"
        )
    used = np.unique(np.concatenate([cameras.starts[camera].captures for camera in chosen]))
    groups, first = groups_of(rows, placed.bodies, used)
    kept = _Cameras(
        tuple(cameras.names[camera] for camera in chosen),
        tuple(cameras.places[camera] for camera in chosen),
        tuple(cameras.starts[camera] for camera in chosen),
    )
    at = Placed(
        {new: placed.cameras.rotations[old] for new, old in enumerate(chosen)},
        {new: placed.cameras.translations[old] for new, old in enumerate(chosen)},
    )
    return kept, replace(placed, cameras=at), (groups, rows.board, len(first)), first


def _measured_of(options: RigOptions, placed: PlacedRig, rows: Rows) -> Measured:
    """Return what is known of boards; raises InsufficientData for a distance between boards that nothing links."""
    for each in options.measured.distances:
        if len({placed.bodies[board] for board in each.boards}) > 1:
            names = " and ".join(rows.boards[board] for board in each.boards)
            raise InsufficientData(f"--distance {each.words}: the boards {names} are not linked by captures")
    return options.measured


def _left_out(captures: Captures, cameras: _Cameras, linked: _Cameras) -> dict[str, str]:
    """Return why cameras are not in the rig, by their names."""
    others = ", ".join(linked.names)
    return {
        name: cameras.refused[name].message
        if name in cameras.refused
        else f"no capture shows the board to it and {others}"
        for name in captures.cameras
        if name not in linked.names
    }


def _priors(options: RigOptions, cameras: _Cameras) -> dict[int, LensPrior]:
    """Return the priors of lenses that are given with their covariance."""
    result = {}
    for camera, (name, start) in enumerate(zip(cameras.names, cameras.starts, strict=True)):
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
    cameras: _Cameras,
    captures: tuple[str, ...],
    unlinked: Mapping[str, str],
    found: Mistakes,
    roots: Sequence[int],
) -> RigCalibration:
    problem, names = result.problem, cameras.names
    calibrations = {
        name: _calibration(result, camera, start.solved)
        for camera, (name, start) in enumerate(zip(names, cameras.starts, strict=True))
    }
    poses = {
        name: Pose(result.state.camera_rotations[camera], result.state.camera_translations[camera])
        for camera, name in enumerate(names)
    }
    count, motion, members = problem.board_start, _motion(result), tuple(problem.board.members)
    boards = {
        f"{members[root]}_T_{members[board]}": result.state.boards.pose(board)
        for board, root in zip(problem.attached, roots, strict=True)
    }
    squares, counts = epipolar_by_capture(result.problem, result.state)
    warnings = [Message("unlinked_camera", f"not in the rig: {why}", where=name) for name, why in unlinked.items()]
    if motion is not None and _shows(result, motion):
        text = (
            f"board moved {1e3 * motion.median:.2g} mm (median) between the exposures of a capture: synchronise the "
            "cameras, or hold the board still"
        )
        warnings.append(Message("exposure_motion", text, {"median_mm": 1e3 * motion.median}))
    return RigCalibration(
        calibrations,
        poses,
        problem.names(names, tuple(boards)),
        result.covariance[:count, :count],
        captures=captures,
        motion=motion,
        unlinked=unlinked,
        epipolar_rms_px=float(np.sqrt(squares.sum() / counts.sum())) if counts.any() else None,
        epipolar_by_capture=np.sqrt(squares / np.where(counts, counts, np.nan)),
        boards=boards,
        links=camera_links(result, names, [own.solved.fit.pose_covariances() for own in cameras.starts]),
        scales=_scales(result),
        warnings=(*warnings, *found.warnings),
        failures=(*found.failures, *_misfits(calibrations, cameras)),
    )


def _scales(result: RigFit) -> dict[str, tuple[float, float]]:
    """Return the factors of boards and their standard deviations, where distances tell them."""
    problem = result.problem
    terms = problem.parts[0].terms
    std = np.sqrt(np.diag(result.covariance))[problem.board_start :]
    return {
        term.rpartition(":")[0]: (1 + float(result.state.shape[place]), float(std[place]))
        for place, term in enumerate(terms)
        if bare_term(term) == SCALE
    }


def _misfits(calibrations: Mapping[str, Calibration], cameras: _Cameras) -> list[Message]:
    """Return the failures of cameras many of whose views fit the rig less well than themselves."""
    result = []
    for name, start in zip(cameras.names, cameras.starts, strict=True):
        wrong, count = sum(view.rejected for view in calibrations[name].views), len(start.captures)
        if wrong > _LEFT_OUT * count:
            text = f"{wrong} of {count} views of {name} do not fit the other cameras: check that images are matched"
            result.append(Message("inconsistent_captures", text, {"views": wrong}))
    return result


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
        turns=composed(fit.turns, result.turns[camera], rig.board),
        covariance=result.covariance[np.ix_(own, own)],
        noise_covariance=result.noise_covariance[np.ix_(own, own)],
    )
    between = between_views(solved.fit.estimates, solved.images)
    return intrinsics.record(replace(solved, fit=fit), result.poses[camera], between)


def _shows(result: RigFit, motion: ExposureMotion) -> bool:
    """Return whether the motion of a capture is far above the noise of its corners."""
    part = result.plain.parts[-1]
    depth = float(np.median(part.place.state.translations[:, 2]))
    return motion.median * float(part.place.state.parameters[0]) / depth > _SEEN * part.noise.sigma


def _motion(result: RigFit) -> ExposureMotion | None:
    """Return how far the board moved between the exposures of captures."""
    plain = result.plain
    if not plain.motion:
        return None
    chosen = plain.effects.of_kinds(SHIFT)
    moved = plain.coefficients[:, chosen].reshape(len(plain.coefficients), -1, 3)
    distances = np.linalg.norm(moved, axis=2)
    seen = distances[distances > 0]
    kinds = np.unique(plain.effects.effect[chosen])
    size = float(np.sqrt(np.mean(plain.effect_scales.variances[kinds])))
    return ExposureMotion(size, float(np.median(seen)), float(np.max(seen)), tuple(distances.max(axis=1).tolist()))
