"""Expected accuracy with a board before images are taken: the Cramér-Rao bound of planned views.

The bound is the covariance that no unbiased estimate can beat; the package's maximum-likelihood fits reach it.
Source: Kay, Fundamentals of Statistical Signal Processing: Estimation Theory, 1993, ch. 3.
"""

from collections.abc import Sequence
from math import erfc, sqrt

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.problem import BoardProblem, State
from camcal.cameras.model import Camera
from camcal.cameras.observations import Observations
from camcal.errors import InsufficientData
from camcal.estimate.pnp import estimate_poses
from camcal.estimate.poses.records import Correspondences, PoseOptions
from camcal.geometry.pose import Pose
from camcal.solve.least_squares import linearise
from camcal.solve.steps import Factors, SingularError, factorise
from camcal.targets.board import Board, Surface
from camcal.targets.detection import BoardDetection

_LEAST_STD = 1e-12  # of a term of a board's shape, in its unit


def forecast_pose(camera: Camera, points: Array, camera_T_object: Pose, noise_px: float) -> tuple[Array, float]:
    """Return the covariance (6, 6) that the pose of points (N, 3), given in the object frame, will have, and `p_wrong`.

    The order is tx ty tz rx ry rz (points' unit, rad). p_wrong: how often another minimum will fit better than the
    true one. noise_px: standard deviation of a pixel coordinate. The uncertainty of the camera's own parameters counts
    where it is known. Two minima whose exact χ² differ by D are exchanged by the noise with probability Φ(-√D / 2), the
    error of telling two known signals apart (Kay, Detection Theory, 1998, ch. 4).
    Raises InsufficientData if a point is outside the lens's domain or the points do not fix the pose.
    """
    projection = camera.project(camera_T_object.apply(points))
    if not projection.valid.all():
        raise InsufficientData("a point is outside what the lens can image; move the object away or to the middle")
    exact = Correspondences("the plan", points, projection.pixels)
    outcome = estimate_poses(camera, [exact], PoseOptions(noise_px=noise_px))[0]
    if outcome.value is None:
        raise outcome.error or InsufficientData("the points do not fix a pose")
    chances = [0.5 * erfc(sqrt(other.chi_square_difference / 8)) for other in outcome.value.alternatives]
    return outcome.value.covariance, max(chances, default=0.0)


def calibration_std(
    camera: Camera, board: Board, views: Sequence[BoardDetection], poses: Sequence[Pose], noise_px: float
) -> Array:
    """Return the standard deviations (K,) that the parameters of a calibration from these views will have.

    views: exact pixels of the board from `poses` (camera_T_board). noise_px: standard deviation of a pixel coordinate.
    Parameters that the camera holds fixed have 0. The board is taken to be as drawn.
    Raises InsufficientData if the views leave a parameter open.
    """
    names, free = camera.model.parameter_names, free_parameters(camera)
    result = np.zeros(len(names))
    try:
        factors = _factors(camera, Surface.flat(board), Observations.of(views), poses, noise_px)
        result[free] = np.sqrt(np.diag(factors.shared_covariance()))
    except SingularError as error:
        raise InsufficientData("some parameters are not determined by the views: plan more views, tilted") from error
    return result


def free_parameters(camera: Camera) -> Array:
    """Return the places (F,) of the lens parameters that a calibration of this camera does not hold."""
    names = camera.model.parameter_names
    return np.array([index for index, name in enumerate(names) if name not in camera.fixed], np.intp)


def view_information(
    camera: Camera, surface: Surface, views: Observations, poses: Sequence[Pose], noise_px: float
) -> Array:
    """Return the information (V, D, D) that each of some views has on the free lens parameters and the terms of a
    board's shape, its own pose eliminated; views: pixels of the board from `poses` (camera_T_board).

    Raises InsufficientData for a corner outside the lens's domain, SingularError if all of them leave a parameter open.
    """
    return _factors(camera, surface, views, poses, noise_px).group_information()


def _factors(camera: Camera, surface: Surface, views: Observations, poses: Sequence[Pose], noise_px: float) -> Factors:
    """Return the factors of a calibration's normal equations at the truth; the terms of the board's shape have their
    covariance's standard deviations as prior.
    """
    terms, board = surface.terms, surface.board
    problem = BoardProblem(
        camera.model,
        board,
        views,
        free_parameters(camera),
        terms,
        sigma=noise_px,
        points=surface.points(),
        term_std=np.maximum(surface.coefficients_std(), _LEAST_STD),
        lens_spread=camera.model.prior_std(camera.image_size, camera.value("fx")),  # as every calibration has it
    )
    state = State(
        camera.parameters,
        np.stack([pose.rotation for pose in poses]),
        np.stack([pose.translation for pose in poses]),
        np.zeros(len(terms)),
        np.zeros((board.count, 3)),
    )
    equations = linearise(problem, state)
    if equations is None:
        raise InsufficientData("a corner is outside what the lens can image")
    return factorise(equations)
