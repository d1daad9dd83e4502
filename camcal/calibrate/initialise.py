"""Initial camera and board poses for any lens model, without an initial guess.

The lens starts without distortion at a focal length found by a sweep: for each candidate the pixels become rays,
the rays give every view's homography and pose, and the candidate whose poses reproject best wins. Unlike the closed
form for pinholes (Zhang 2000) this serves lenses beyond 180° alike.

Which way round a symmetric board was seen is settled from there. A chessboard with columns + rows even looks the same
turned by 180°, a square one by 90°. A flat board fits either way, a bent one does not: numbering some views from the
wrong end would average its shape away.
"""

from dataclasses import replace

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.noise import CUT
from camcal.calibrate.problem import BoardProblem, State
from camcal.cameras.lens import CameraModel
from camcal.cameras.observations import Observations, affine_poses, planar_poses
from camcal.geometry import rotation as so3
from camcal.solve.descent import Stopping
from camcal.solve.least_squares import minimise
from camcal.solve.losses import Cauchy
from camcal.targets.board import Board

_CORNERS = 24  # a pose to start from needs no more corners of a view
_SEED = 6
_SWEPT_VIEWS = 20
_UNLIKE = 4.0  # times the typical view's error: more than this is not held against a lens
_FOCALS = np.geomspace(0.2, 8.0, 13)  # in image sides: 136° to 7° for a pinhole

MARGIN = 9.0  # a fall of χ² by 3σ turns a view; less is noise
_POSES = Stopping(relative_decrease=1e-6, iterations=20)


def thinned(observations: Observations, corners: int = _CORNERS) -> Observations:
    """Return at most `corners` points of every view, spread over its list: one of each of as many parts, by chance. In
    equal steps they could all be of one column.
    """
    length = observations.ids.shape[1]
    if length <= corners:
        return observations
    present = np.count_nonzero(observations.weights, axis=1)[:, None]
    order = np.argsort(observations.weights == 0, axis=1, kind="stable")
    part = np.arange(corners)
    place = part + np.where(present > corners, np.random.default_rng(_SEED).random(corners), 0.0)
    pick = (np.maximum(present, 1) * place / corners).astype(np.intp)
    columns = np.take_along_axis(order, pick, axis=1)
    first_use = np.column_stack([np.ones(len(pick), bool), np.diff(pick, axis=1) > 0])
    rows = np.arange(len(columns))[:, None]
    weights = observations.weights[rows, columns] * first_use
    return replace(
        observations,
        ids=observations.ids[rows, columns],
        pixels=observations.pixels[:, rows, columns],
        weights=weights,
        whitening=None,
        present=weights > 0,
        covariance=None,
    )


def poses_from_rays(rays: Array, board: Board, observations: Observations) -> tuple[Array, Array]:
    """Return camera_T_board of every view, rotations (V, 3, 3) and translations (V, 3), from unit rays (3, V, P)."""
    width, height = board.extent
    scale, centre = max(width, height) / 2, np.array([width / 2, height / 2, 0.0])
    points = ((board.points() - centre) / scale)[observations.ids].transpose(2, 0, 1)
    rotations, translations = planar_poses(rays, points, observations.weights > 0)
    return rotations, translations * scale - rotations @ centre


def poses_from_places(places: Array, board: Board, observations: Observations) -> tuple[Array, Array, Array]:
    """Return camera_T_board of every view, rotations (V, 3, 3) and translations (V, 3), and how large the board appears
    (V,), from places (2, V, P) under parallel projection; the boards stand in front, anywhere.
    """
    centre = np.array([*board.extent, 0.0]) / 2
    points = (board.points() - centre)[observations.ids].transpose(2, 0, 1)
    rotations, translations, sizes = affine_poses(places, points, observations.weights > 0)
    away = np.array([0.0, 0.0, 2.0 * sum(board.extent)])
    return rotations, translations + away - rotations @ centre, sizes


def poses_from_pixels(
    model: CameraModel, parameters: Array, board: Board, observations: Observations
) -> tuple[Array, Array] | None:
    """Return the poses of every view under a given lens, or None where the lens cannot take a pixel."""
    rays = model.unproject(parameters, observations.pixels.reshape(2, -1).T)
    if not rays.valid[observations.weights.ravel() > 0].all():
        return None
    found = np.nan_to_num(rays.at()).T.reshape(3, *observations.weights.shape)
    if not model.is_central:
        return poses_from_places(found[:2], board, observations)[:2]
    return poses_from_rays(found, board, observations)


def sweep_focal(
    model: CameraModel,
    board: Board,
    observations: Observations,
    image_size: tuple[int, int],
    fixed: Array | None = None,
) -> State | None:
    """Return the state of the focal length whose poses reproject best, or None if no candidate can take the pixels.

    fixed: (K,) lens parameters to keep, NaN for those that are free.
    """
    few = thinned(observations.take(np.arange(len(observations.ids))[:: -(-len(observations.ids) // _SWEPT_VIEWS)]))
    best: tuple[float, float, State] | None = None
    candidates = list(_FOCALS) if fixed is None or np.isnan(fixed).any() else [1.0]
    if len(candidates) > 1 and not model.is_central:  # every view shows how large its board appears
        away = few.pixels - model.start(image_size, 1.0)[2:4, None, None]
        candidates = [float(np.median(poses_from_places(away, board, few)[2])) / max(image_size)]
    for _ in range(2):
        for focal in candidates:
            parameters = model.start(image_size, focal * max(image_size))
            if fixed is not None:
                parameters = np.where(np.isnan(fixed), parameters, fixed)
            state = _posed(model, parameters, board, few)
            error = np.inf if state is None else _typical_error(model, board, few, state)
            if state is not None and np.isfinite(error) and (best is None or error < best[0]):
                best = (error, focal, state)
        if best is None:
            return None
        ratio = _FOCALS[1] / _FOCALS[0]
        candidates = [best[1] * ratio**power for power in (-0.5, -0.25, 0.25, 0.5)]
    return _posed(model, best[2].parameters, board, thinned(observations)) if best else None


def _posed(model: CameraModel, parameters: Array, board: Board, observations: Observations) -> State | None:
    poses = poses_from_pixels(model, parameters, board, observations)
    return None if poses is None else State(parameters, *poses, np.zeros(0), np.zeros((board.count, 3)))


def _typical_error(model: CameraModel, board: Board, observations: Observations, state: State) -> float:
    """Return the mean over views of the median distance in pixels, of no view more than four times the typical one's:
    one whose points are numbered wrongly fits no lens. Points that have no image count as far off.
    """
    problem = BoardProblem(model, board, observations, np.zeros(0, np.intp))
    distances = np.linalg.norm(problem.residuals(state), axis=0)
    distances = np.where(np.isnan(distances), np.inf, distances)
    distances[observations.weights == 0] = np.nan
    medians = np.nanmedian(distances, axis=1)
    typical = float(np.median(medians))
    return float(np.mean(np.minimum(medians, _UNLIKE * typical))) if np.isfinite(typical) else np.inf


def renumbered(problem: BoardProblem, turns: Array) -> BoardProblem:
    """Return the problem with view v numbered by symmetry turns[v] of the board."""
    ids = np.take_along_axis(np.stack(problem.board.symmetries())[turns], problem.observations.ids, axis=1)
    return replace(problem, observations=replace(problem.observations, ids=ids))


def apply_symmetries(problem: BoardProblem, state: State, turns: Array) -> tuple[BoardProblem, State]:
    """Return problem and state with view v numbered by symmetry turns[v] of the board, the poses turned along."""
    motions = [symmetry_motion(problem.board, permutation) for permutation in problem.board.symmetries()]
    rotations = np.stack([motion[0] for motion in motions])[turns]
    shifts = np.stack([motion[1] for motion in motions])[turns]
    moved = np.einsum("vij,vj->vi", state.rotations, shifts) + state.translations
    return renumbered(problem, turns), replace(state, rotations=state.rotations @ rotations, translations=moved)


def symmetry_motion(board: Board, permutation: Array) -> tuple[Array, Array]:
    """Return the rotation (3, 3) and shift (3,) that take the drawn point permutation[id] to the point id."""
    points, centre = board.points(), board.points().mean(axis=0)
    moment = (points - centre).T @ (points[permutation] - centre)
    moment[2, 2] = np.linalg.norm(moment)  # the board stays face up
    rotation = so3.nearest(moment)
    return rotation, centre - rotation @ centre


def best_turns(problem: BoardProblem, state: State) -> tuple[Array, State]:
    """Return for every view the symmetry (V,) under which the board's shape fits it best, 0 where none is better, and
    the state with the poses of the views so turned.

    Every present point (V, P) has its say: a view may have been rejected because it was numbered from another end.
    """
    poses, bare = problem.poses_only(state)
    present = problem.observations.present
    observations = replace(poses.observations, weights=present.astype(float))
    poses = replace(poses, observations=observations, loss=Cauchy(CUT))
    states, costs = [bare], [view_costs(poses, bare)]
    for index, permutation in enumerate(problem.board.symmetries()[1:], start=1):
        if looks_the_same(problem.board, problem.board_points(state), permutation):
            states.append(bare)
            costs.append(costs[0])
            continue
        trial, start = apply_symmetries(poses, bare, np.full(len(present), index))
        states.append(minimise(trial.within_domain(start), start, _POSES).state)
        costs.append(view_costs(trial, states[-1]))
    gains = costs[0] - np.stack(costs)
    views, best = np.arange(len(present)), np.argmax(gains, axis=0)
    turns = np.where(gains[best, views] > MARGIN, best, 0)
    rotations = np.stack([trial.rotations for trial in states])[turns, views]
    translations = np.stack([trial.translations for trial in states])[turns, views]
    return turns, replace(state, rotations=rotations, translations=translations)


def looks_the_same(board: Board, points: Array, permutation: Array) -> bool:
    """Return whether a shape fits itself when turned, so that no view could tell."""
    rotation, shift = symmetry_motion(board, permutation)
    return bool(np.abs(points[permutation] @ rotation.T + shift - points).max() < 1e-9 * max(board.extent))


def view_costs(problem: BoardProblem, state: State) -> Array:
    """Return χ² of each view (V,), every point counted up to the cut of outliers."""
    squared = np.nan_to_num(problem.distances(problem.residuals(state)) / problem.sigma, nan=np.inf) ** 2
    present = problem.observations.weights > 0
    return np.asarray(np.where(present, np.minimum(squared, CUT**2), 0.0).sum(axis=1))


def opposed_views(scores: Array, information: Array) -> Array:
    """Return a guess (V,) of which views were numbered from the other end, as 0 or 1; all 0 without evidence.

    scores: (V, 4) each view's pull on the cubic terms. information: (4, 4) what all views know of them.
    Turning a view by 180° changes the sign of its pull. When views of both kinds are mixed the pulls cancel and no
    shape is seen to choose by; their main axis still tells the two kinds apart.
    """
    pulls = np.linalg.solve(np.linalg.cholesky(information), scores.T)
    axis = np.linalg.eigh(pulls @ pulls.T)[1][:, -1]
    signs = np.where(axis @ pulls < 0, -1.0, 1.0)
    gain = np.sum((pulls @ signs) ** 2) - np.sum(pulls.sum(axis=1) ** 2)
    # signs chosen on noise alone would raise χ² by some 0.6 to 0.9 per view
    if gain < MARGIN + 1.5 * len(signs):
        return np.zeros(len(signs), np.intp)
    return np.asarray(signs * np.sign(signs.sum() or 1.0) < 0, dtype=np.intp)
