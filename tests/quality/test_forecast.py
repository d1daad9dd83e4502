"""Forecasts against what becomes of simulated images: scatter of poses, wrong minima, and a calibration's own ±."""

import numpy as np
import pytest

from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Options, calibrate
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InsufficientData
from camcal.estimate.pnp import estimate_poses
from camcal.estimate.poses.records import Correspondences, PoseOptions
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.quality.forecast import calibration_std, forecast_pose
from camcal.simulate.scene import observe, views
from camcal.targets.board import parse_board

SIZE = (1280, 960)
BOARD = parse_board("chessboard:9x6:25mm")
TAG = 0.05 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])


def pinhole(covariance=None):
    model = model_named("pinhole")
    return Camera(model, SIZE, model.start(SIZE, 800.0), covariance)


def posed(points, transform, noise, count, seed):
    """Return the poses that are found in images with noise."""
    rng, exact = np.random.default_rng(seed), pinhole().project(transform.apply(points)).pixels
    noisy = [Correspondences(str(i), points, exact + noise * rng.normal(size=exact.shape)) for i in range(count)]
    return [outcome.value for outcome in estimate_poses(pinhole(), noisy, PoseOptions(noise_px=noise))]


def test_poses_scatter_as_forecast():
    transform = Pose.from_vector(np.array([0.1, 0.5, 0.2]), np.array([-0.08, -0.05, 0.6]))
    covariance, p_wrong = forecast_pose(pinhole(), BOARD.points(), transform, 0.3)
    found = posed(BOARD.points(), transform, 0.3, 150, seed=1)
    places = np.array([estimate.transform.translation for estimate in found])
    turns = np.array([so3.log(estimate.transform.rotation @ transform.rotation.T) for estimate in found])
    std = np.concatenate([places.std(axis=0), turns.std(axis=0)])
    assert std == pytest.approx(np.sqrt(np.diag(covariance)), rel=0.2)  # 150 draws: ± 6 %
    assert p_wrong < 1e-6


def test_the_share_of_wrong_poses_of_a_far_tag_is_as_forecast():
    transform = Pose(so3.about_y(np.radians(25)), np.array([0.0, 0.0, 2.5]))
    _, p_wrong = forecast_pose(pinhole(), TAG, transform, 0.3)
    found = posed(TAG, transform, 0.3, 600, seed=2)
    away = [np.linalg.norm(so3.log(estimate.transform.rotation @ transform.rotation.T)) for estimate in found]
    wrong = np.mean(np.array(away) > np.radians(25))  # nearer to the mirrored pose, which is 50° away
    assert 0.05 < wrong < 0.4
    assert p_wrong == pytest.approx(wrong, rel=0.35)  # 600 draws: ± 1.5 %; far minima bend the bound


def test_what_is_not_known_of_the_lens_is_not_known_of_the_pose():
    focal_together = np.zeros((4, 4))
    focal_together[:2, :2] = 4.0  # fx and fy are 2 px off, both
    transform = Pose(np.eye(3), np.array([0.0, 0.0, 0.6]))
    known, unknown = (forecast_pose(pinhole(c), BOARD.points(), transform, 0.01)[0] for c in (None, focal_together))
    assert np.sqrt(unknown[2, 2]) == pytest.approx(0.6 * 2 / 800, rel=1e-3)  # and the noise beside it
    assert known[2, 2] < 1e-3 * unknown[2, 2]


def test_twice_the_noise_is_twice_the_scatter():
    transform = Pose(so3.about_y(0.4), np.array([0.0, 0.0, 0.6]))
    once, twice = (forecast_pose(pinhole(), BOARD.points(), transform, noise)[0] for noise in (0.1, 0.2))
    assert twice == pytest.approx(4 * once, rel=1e-6)


def test_an_object_behind_the_camera_has_no_forecast():
    with pytest.raises(InsufficientData, match="outside what the lens can image"):
        forecast_pose(pinhole(), TAG, Pose(np.eye(3), np.array([0.0, 0.0, -1.0])), 0.3)


def test_a_calibration_states_the_uncertainty_that_was_forecast():
    model = model_named("opencv4")
    camera = Camera(model, SIZE, np.array([800.0, 800.0, 640.0, 480.0, -0.1, 0.02, 0.0, 0.0]))
    rng = np.random.default_rng(4)
    poses = views(camera, BOARD, 12, rng=rng)
    exact, _ = observe(camera, BOARD, poses, rng=rng)
    forecast = calibration_std(camera, BOARD, exact.views, poses, 0.2)
    noisy, _ = observe(camera, BOARD, poses, rng=rng, noise_px=0.2)
    found = calibrate(noisy.views, BOARD, Options(model=model, shape=ShapeOptions(smooth=False, offsets=False)))
    stated = np.sqrt(np.diag(found.noise_covariance))
    assert stated == pytest.approx(forecast, rel=0.1)  # the noise is estimated to 3 %, the views move a little


def test_parameters_that_are_held_have_no_uncertainty():
    camera = Camera(model_named("pinhole"), SIZE, pinhole().parameters, fixed=("cx", "cy"))
    rng = np.random.default_rng(4)
    poses = views(camera, BOARD, 5, rng=rng)
    exact, _ = observe(camera, BOARD, poses, rng=rng)
    std = calibration_std(camera, BOARD, exact.views, poses, 0.2)
    assert (std[:2] > 0).all()
    assert (std[2:] == 0).all()


def test_views_that_are_all_alike_have_no_forecast():
    camera, flat = pinhole(), Pose(np.eye(3), np.array([-0.1, -0.06, 0.5]))
    exact, _ = observe(camera, BOARD, [flat], rng=np.random.default_rng(0))
    with pytest.raises(InsufficientData, match="not determined by the views: plan more views"):
        calibration_std(camera, BOARD, exact.views, [flat], 0.2)
