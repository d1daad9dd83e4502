"""A first camera and first board poses for any lens model, without a hint.

The lens starts without distortion at a focal length found by a sweep: for each candidate the pixels become rays,
the rays give every view's homography and pose, and the candidate whose poses reproject best wins. Unlike the closed
form for pinholes (Zhang 2000) this serves lenses beyond 180° alike.
"""

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.problem import BoardProblem, State
from camcal.cameras.model import CameraModel
from camcal.cameras.observations import Observations
from camcal.cameras.planar_poses import planar_poses
from camcal.targets.board import Board

_CORNERS = 24  # a pose to start from needs no more corners of a view
_SEED = 6
_SWEPT_VIEWS = 20
_UNLIKE = 4.0  # times the typical view's error: more than this is not held against a lens
_FOCALS = np.geomspace(0.2, 8.0, 13)  # in image sides: 136° to 7° for a pinhole


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
    return Observations(observations.ids[rows, columns], observations.pixels[:, rows, columns], weights)


def poses_from_rays(rays: Array, board: Board, observations: Observations) -> tuple[Array, Array]:
    """Return camera_T_board of every view, rotations (V, 3, 3) and translations (V, 3), from unit rays (3, V, P)."""
    width, height = board.extent
    scale, centre = max(width, height) / 2, np.array([width / 2, height / 2, 0.0])
    points = ((board.points() - centre) / scale)[observations.ids].transpose(2, 0, 1)
    rotations, translations = planar_poses(rays, points, observations.weights > 0)
    return rotations, translations * scale - rotations @ centre


def poses_from_pixels(
    model: CameraModel, parameters: Array, board: Board, observations: Observations
) -> tuple[Array, Array] | None:
    """Return the poses of every view under a given lens, or None where the lens cannot take a pixel."""
    rays = model.unproject(parameters, observations.pixels.reshape(2, -1).T)
    if not rays.valid[observations.weights.ravel() > 0].all():
        return None
    directions = np.nan_to_num(rays.directions).T.reshape(3, *observations.weights.shape)
    return poses_from_rays(directions, board, observations)


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
