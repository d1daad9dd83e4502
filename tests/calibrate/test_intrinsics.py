"""Calibration end to end on synthetic corners: truth recovered, uncertainty honest, degenerate input refused."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from observed import PARAMETERS, make_scene
from scipy.stats import chi2

from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Options, calibrate
from camcal.calibrate.problem import BoardProblem, State
from camcal.calibrate.refusals import require_focal, require_tilts
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.cameras.observations import Observations
from camcal.errors import InsufficientData, InvalidInput
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.simulate.scene import observe
from camcal.solve.least_squares import linearise
from camcal.solve.steps import factorise
from camcal.targets.board import Board
from camcal.targets.detection import BoardDetection


def sigmas(calibration, truth):
    return (calibration.camera.parameters - truth.parameters) / np.sqrt(np.diag(calibration.camera.covariance))


@pytest.mark.parametrize("model", PARAMETERS)
def test_truth_is_recovered_within_four_sigma(model):
    scene = make_scene(model)
    calibration = calibrate(scene.observe(3, noise_px=0.1), scene.board, Options(scene.camera.model))
    assert np.abs(sigmas(calibration, scene.camera)).max() < 4  # 1 in 16 000 per parameter
    assert calibration.sigma_px == pytest.approx(0.1, rel=0.1)  # 2 700 coordinates: 1.4 % standard deviation
    assert len(calibration.used) == len(scene.poses)


def test_priors_leave_the_coefficients_of_a_fisheye_model_to_the_data_at_a_long_focal_length():
    model = model_named("kannala_brandt4")
    scene = make_scene(model.name, parameters=[3000.0, 3001.0, 803.0, 596.0, 0.02, -0.01, 0.004, -0.001])
    seen = scene.observe(3, noise_px=0.1)
    calibration = calibrate(seen, scene.board, Options(model, shape=ShapeOptions(smooth=False)))
    assert not calibration.rejected
    assert calibration.held_by_prior == ()
    without = BoardProblem(model, scene.board, Observations.of(seen), np.arange(8), sigma=calibration.sigma_px)
    rotations, translations = (
        np.stack([getattr(view.camera_T_board, part) for view in calibration.views])
        for part in ("rotation", "translation")
    )
    points = scene.board.count
    state = State(calibration.camera.parameters, rotations, translations, np.zeros(0), np.zeros((points, 3)))
    unregularised = np.sqrt(np.diag(factorise(linearise(without, state)).shared_covariance()))
    ours = np.sqrt(np.diag(calibration.noise_covariance))
    np.testing.assert_allclose(ours, unregularised, rtol=0.02)  # k4: 210, of a prior of 6561
    assert ours[-1] > 100  # by far more than the prior of a denominator's k4 would let through


@pytest.mark.slow
def test_coefficients_that_the_data_hardly_determine_are_held_by_their_priors(scene):
    seen = scene.observe(3, noise_px=0.1)
    assert calibrate(seen, scene.board, Options(scene.camera.model)).held_by_prior == ()
    rational = model_named("opencv8")
    calibration = calibrate(seen, scene.board, Options(rational))
    spread = rational.prior_std(scene.camera.image_size, scene.camera.value("fx"))
    ratios = np.sqrt(np.diag(calibration.noise_covariance)) / spread
    # numerator and denominator do the same to a lens that needs no denominator
    assert {"k4", "k5"} & set(calibration.held_by_prior)
    for name, ratio in zip(rational.parameter_names, ratios, strict=True):
        assert ratio < (1.05 if name in calibration.held_by_prior else 0.55)  # the focal length moved since the start
        assert (name in calibration.held_by_prior) <= (ratio > 0.45)
    held = calibrate(seen, scene.board, Options(rational, fixed=("k4", "k5", "k6")))
    assert held.held_by_prior == ()


def test_noise_free_views_give_the_truth(scene):
    calibration = calibrate(scene.observe(0), scene.board, Options(scene.camera.model))
    np.testing.assert_allclose(calibration.camera.parameters, scene.camera.parameters, rtol=1e-5, atol=1e-6)
    assert calibration.rms_px < 1e-4


def test_opencv_finds_the_same_minimum_on_a_rigid_board(scene):
    seen = scene.observe(5, noise_px=0.1)
    options = Options(scene.camera.model, shape=ShapeOptions(smooth=False))
    ours = calibrate(seen, scene.board, options)
    assert not ours.rejected  # or the two would not see the same corners
    points = scene.board.points().astype(np.float32)
    rms, matrix, distortion, *_ = cv2.calibrateCamera(
        [points[view.ids] for view in seen],
        [view.pixels.astype(np.float32) for view in seen],
        scene.camera.image_size,
        None,
        None,
        criteria=(3, 200, 1e-12),
    )
    # residuals of three standard deviations count a little less than in least squares
    assert ours.rms_px == pytest.approx(rms, rel=1e-3)
    theirs = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *distortion.ravel()]
    spread = np.sqrt(np.diag(ours.camera.covariance))
    # weights, and effects within views that are not there, move the minimum by a small part of its uncertainty
    assert np.abs((ours.camera.parameters - theirs) / spread).max() < 0.3


@pytest.mark.slow
def test_claimed_uncertainty_is_the_one_found_in_repetitions():
    scene = make_scene(count=15)
    runs = [
        calibrate(scene.observe([7, seed], noise_px=0.1), scene.board, Options(scene.camera.model))
        for seed in range(40)
    ]
    errors = np.array([run.camera.parameters - scene.camera.parameters for run in runs])
    squared = [e @ np.linalg.solve(run.camera.covariance, e) for e, run in zip(errors, runs, strict=True)]
    low, high = chi2.ppf([0.0005, 0.9995], 9 * len(runs))
    assert low < np.sum(squared) < high


def test_the_same_observations_give_the_same_bits(scene):
    seen = scene.observe(9, noise_px=0.1)
    first, second = (calibrate(seen, scene.board, Options(scene.camera.model)) for _ in range(2))
    assert np.array_equal(first.camera.parameters, second.camera.parameters)
    assert np.array_equal(first.camera.covariance, second.camera.covariance)


def test_fixed_parameters_stay_and_have_no_uncertainty(scene):
    calibration = calibrate(scene.observe(3, noise_px=0.1), scene.board, Options(scene.camera.model, fixed=("k3",)))
    assert calibration.camera.value("k3") == 0.0
    assert calibration.camera.std("k3") is None
    assert calibration.camera.fixed == ("k3",)


def test_a_guess_holds_what_is_fixed(scene):
    options = Options(scene.camera.model, fixed=("fx", "fy"), guess=scene.camera)
    calibration = calibrate(scene.observe(3, noise_px=0.1), scene.board, options)
    assert calibration.camera.value("fx") == scene.camera.value("fx")
    with pytest.raises(InvalidInput, match="--guess"):
        calibrate(scene.observe(3), scene.board, replace(options, guess=None))
    with pytest.raises(InvalidInput, match="no parameter 'k9'"):
        calibrate(scene.observe(3), scene.board, Options(scene.camera.model, fixed=("k9",)))


def test_partial_views_are_used():
    scene = make_scene(partial=True, count=30)
    seen = scene.observe(2, noise_px=0.1)
    assert min(len(view.ids) for view in seen) < scene.board.count
    calibration = calibrate(seen, scene.board, Options(scene.camera.model))
    assert np.abs(sigmas(calibration, scene.camera)).max() < 4


def test_weights_from_covariances_are_better_than_none(scene):
    rng, noise = np.random.default_rng(8), np.array([0.05, 0.2])
    seen = [
        replace(
            view,
            pixels=view.pixels + noise[index % 2] * rng.normal(size=view.pixels.shape),
            covariance=np.tile(noise[index % 2] ** 2 * np.eye(2), (len(view.ids), 1, 1)),
        )
        for index, view in enumerate(scene.observe(0))
    ]
    weighted = calibrate(seen, scene.board, Options(scene.camera.model))
    assert np.abs(sigmas(weighted, scene.camera)).max() < 4
    assert weighted.sigma_px == pytest.approx(np.sqrt(0.05 * 0.2), rel=0.1)  # of a typical corner
    assert weighted.model_error_px < 0.01  # the covariances say it all
    alike = [replace(view, covariance=None) for view in seen[1::2]]
    coarse = calibrate(alike, scene.board, Options(scene.camera.model))
    assert weighted.camera.std("fx") < 0.5 * coarse.camera.std("fx")  # four times the noise, half the views


def test_many_views_start_from_a_few():
    scene = make_scene(count=90)
    calibration = calibrate(scene.observe(4, noise_px=0.1), scene.board, Options(scene.camera.model))
    assert len(calibration.used) == 90
    assert np.abs(sigmas(calibration, scene.camera)).max() < 4


def test_fewer_than_three_views_are_refused(scene):
    with pytest.raises(InsufficientData, match="2 usable views of 2"):
        calibrate(scene.observe(0)[:2], scene.board, Options(scene.camera.model))
    with pytest.raises(InsufficientData, match="0 usable views"):
        calibrate(
            [BoardDetection("a.png", (640, 480), reason="no board found")], scene.board, Options(scene.camera.model)
        )


def test_one_image_repeated_is_refused(scene):
    view = scene.observe(0, noise_px=0.1)[0]
    copies = [replace(view, image=f"{index}.png") for index in range(10)]
    with pytest.raises(InsufficientData, match="9 more are duplicates"):
        calibrate(copies, scene.board, Options(scene.camera.model))


def test_a_repeated_image_counts_once(scene):
    seen = list(scene.observe(0, noise_px=0.1))
    calibration = calibrate([*seen, replace(seen[3], image="copy.png")], scene.board, Options(scene.camera.model))
    assert calibration.views[-1].reason == f"duplicate of {seen[3].image} (all corners within 0.02 px)"
    assert len(calibration.used) == len(seen)


@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_fronto_parallel_views_are_refused(scene, noise):
    rng = np.random.default_rng(2)
    flat = [
        Pose(so3.about_z(rng.uniform(-0.3, 0.3)), np.array([*rng.uniform(-0.25, -0.1, 2), rng.uniform(0.5, 0.9)]))
        for _ in range(15)
    ]
    seen, _ = observe(scene.camera, scene.board, flat, rng=rng, noise_px=noise)
    with pytest.raises(InsufficientData, match=r"focal length|not determined"):
        calibrate(seen.views, scene.board, Options(scene.camera.model))


def test_images_of_another_size_are_listed_not_used(scene):
    seen = list(scene.observe(0, noise_px=0.1))
    other = replace(seen[0], image="other.png", size=(640, 480))
    calibration = calibrate([*seen[1:], other], scene.board, Options(scene.camera.model))
    assert "640x480 differs from the others' 1600x1200" in calibration.views[-1].reason


def test_views_without_enough_corners_carry_their_reason(scene):
    seen = list(scene.observe(0, noise_px=0.1))
    few = replace(seen[0], ids=seen[0].ids[:4], pixels=seen[0].pixels[:4])
    line = replace(seen[1], ids=seen[1].ids[:9], pixels=seen[1].pixels[:9])
    calibration = calibrate([few, line, *seen[2:]], scene.board, Options(scene.camera.model))
    assert calibration.views[0].reason == "only 4 corners, 6 are needed: show more of the board"
    assert calibration.views[1].reason == "all corners are collinear: show more of the board"


def test_a_board_of_unknown_size_calibrates_in_squares(scene):
    unknown = Board("chessboard", 9, 6)
    seen = scene.observe(3, noise_px=0.1)
    metric = calibrate(seen, scene.board, Options(scene.camera.model))
    squares = calibrate(seen, unknown, Options(scene.camera.model))
    np.testing.assert_allclose(squares.camera.parameters, metric.camera.parameters, rtol=1e-6)
    ratio = squares.views[0].camera_T_board.translation / metric.views[0].camera_T_board.translation
    np.testing.assert_allclose(ratio, 1 / 0.040, rtol=1e-6)


def test_a_lens_beyond_180_degrees_needs_no_hint():
    camera = Camera(
        model_named("kannala_brandt4"), (1200, 1200), np.array([330.0, 331, 602, 597, 0.01, -0.004, 0.001, 0])
    )
    board = Board("chessboard", 8, 6, 0.05)
    rng = np.random.default_rng(3)
    poses = []
    for azimuth in np.linspace(0, 2 * np.pi, 24, endpoint=False):
        axis = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        swing = so3.exp(axis * rng.uniform(0.4, 1.45)) @ so3.exp(0.5 * rng.normal(size=3))
        direction = so3.exp(axis * rng.uniform(0.6, 1.35)) @ np.array([0.0, 0.0, 0.45])
        poses.append(Pose(swing, direction - swing @ np.array([0.175, 0.125, 0.0])))
    seen, _ = observe(camera, board, poses, rng=rng, noise_px=0.1)
    beyond = [np.arccos((camera.unproject(view.pixels).directions[:, 2]).min()) for view in seen.views if view.found]
    assert max(beyond) > np.radians(90)
    calibration = calibrate(seen.views, board, Options(camera.model))
    assert np.abs(sigmas(calibration, camera)).max() < 4


def test_a_view_that_is_much_noisier_counts_for_less_and_keeps_its_pose(scene):
    rng = np.random.default_rng(12)
    seen = list(scene.observe(3, noise_px=0.1))
    seen[4] = replace(seen[4], pixels=seen[4].pixels + 0.8 * rng.normal(size=seen[4].pixels.shape))
    calibration = calibrate(seen, scene.board, Options(scene.camera.model))
    noisy = calibration.views[4]
    assert noisy.used
    assert noisy.kept > 0.9 * noisy.points
    truth = scene.poses[4]
    # eight times the noise of the others, at which a corner of 54 says what it would alone
    assert np.linalg.norm(noisy.camera_T_board.translation - truth.translation) < 0.01
    assert np.abs(sigmas(calibration, scene.camera)).max() < 4


def test_a_view_of_another_numbering_is_listed_and_does_no_harm(scene):
    seen = list(scene.observe(3, noise_px=0.1))
    seen[6] = replace(seen[6], ids=np.random.default_rng(2).permutation(seen[6].ids))
    calibration = calibrate(seen, scene.board, Options(scene.camera.model))
    assert calibration.views[6].kept < 0.2 * calibration.views[6].points
    assert sum(view.used for view in calibration.views) >= len(seen) - 1
    assert np.abs(sigmas(calibration, scene.camera)).max() < 4


@pytest.mark.parametrize(("tilt_deg", "refused"), [(4.5, True), (5.5, False)])
def test_boards_within_five_degrees_of_one_direction_are_refused(tilt_deg, refused):
    tilts = np.radians(tilt_deg) * np.array([0, 1, -1, 0.5])
    rotations = np.stack([so3.about_x(tilt) for tilt in tilts])
    rotations[0] = so3.about_x(-0.5 * np.radians(tilt_deg))  # the mean direction stays the axis
    if refused:
        with pytest.raises(InsufficientData, match=r"nearly parallel views \(board tilts below 5°\)"):
            require_tilts(rotations)
    else:
        require_tilts(rotations)


def test_a_focal_length_is_known_to_a_twentieth_at_least():
    require_focal(1000.0, 49.0)
    with pytest.raises(InsufficientData, match=r"focal length not determined by the views \(1000 ± 51 px\)"):
        require_focal(1000.0, 51.0)
