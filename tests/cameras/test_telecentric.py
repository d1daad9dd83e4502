"""The telecentric lens: calibrated from planar views, undistorted, and refused where a distance is needed.

Boards stand at distances drawn at random, which the images do not show. It does not show how real lenses of this kind
are distorted.
"""

import numpy as np
import pytest

from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Options, calibrate
from camcal.cameras.catalogue import MODELS, model_named
from camcal.cameras.directions import lens_difference
from camcal.cameras.model import Camera, require_central
from camcal.cameras.observations import affine_poses
from camcal.cameras.refit import refit
from camcal.cli.main import app
from camcal.errors import InsufficientData, InvalidInput
from camcal.formats import detections, native
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.images.options import ViewOptions
from camcal.images.views import make_view
from camcal.report.calibration import headline
from camcal.simulate.scene import observe
from camcal.targets.board import Board
from camcal.targets.detection import Detections
from camcal.tasks.calibration.model_selection import select, solve_given
from camcal.tasks.calibration.undistort import move_pixels

SIZE, NOISE = (1280, 960), 0.15
BOARD = Board("chessboard", 11, 8, 0.004)
MODEL = MODELS["telecentric"]
TRUTH = Camera(MODEL, SIZE, [25000.0, 25060.0, 650.0, 470.0, 60.0, -3000.0])  # 3.3 % at the corner
REVERSED = np.diag([1.0, 1.0, -1.0])
GRID = np.stack(np.meshgrid(np.linspace(60, 1220, 12), np.linspace(60, 900, 9)), axis=-1).reshape(-1, 2)


def poses(seed, count=40, tilt=40):
    rng, middle, found = np.random.default_rng(seed), np.array([*BOARD.extent, 0.0]) / 2, []
    for _ in range(count):
        lean, azimuth = np.radians(tilt) * (0.1 + 0.9 * rng.random()), rng.uniform(0, 2 * np.pi)
        turn = so3.exp(np.array([0.0, 0.0, rng.normal(0, 0.5)]))
        rotation = so3.exp(lean * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])) @ turn
        place = np.array([rng.uniform(-0.01, 0.01), rng.uniform(-0.008, 0.008), rng.uniform(0.1, 5)])
        found.append(Pose(rotation, place - rotation @ middle))
    return found


def seen(seed, truth=TRUTH, **how):
    views = poses(seed, **how)
    return observe(truth, BOARD, views, rng=np.random.default_rng(1000 + seed), noise_px=NOISE)[0].views, views


def map_error(camera, truth=TRUTH):
    return np.sqrt(np.mean((lens_difference(truth, camera, GRID) ** 2).sum(axis=1)))


def test_a_plane_under_parallel_projection_has_two_poses_and_its_size():
    points = BOARD.points().T
    for index, pose in enumerate(poses(3, count=8)):
        places = 7.0 * (pose.rotation @ points + pose.translation[:, None])[:2]
        rotations, translations, sizes = affine_poses(places[:, None], points[:, None], np.ones((1, len(points[0]))))
        two = rotations[0], REVERSED @ rotations[0] @ REVERSED
        assert min(np.abs(each - pose.rotation).max() for each in two) < 1e-9, index
        np.testing.assert_allclose([sizes[0], np.linalg.det(rotations[0])], [7, 1], rtol=1e-12)
        np.testing.assert_allclose(translations[0, :2], 7 * pose.translation[:2], atol=1e-12)


def test_it_is_calibrated_as_well_as_from_the_truth_and_its_intervals_cover():
    within = []
    for seed in range(12):
        views, _ = seen(seed)
        own, from_truth = (
            calibrate(views, BOARD, Options(MODEL, guess=guess, shape=ShapeOptions(smooth=False))).camera
            for guess in (None, TRUTH)
        )
        assert map_error(own) < 1.001 * map_error(from_truth)  # at most 1.10 is wanted
        std = np.sqrt(own.covariance.diagonal())
        within.append(np.abs(own.parameters - TRUTH.parameters) < 1.96 * std)
        assert map_error(own) < 0.03  # of noise of 0.15 px in 3000 corners
    assert np.mean(within) > 0.88  # 95 % ± 3.6 % of 72 parameters that are correlated


def test_poses_are_known_but_for_their_distance_and_the_sign_of_their_tilt():
    views, truth = seen(5)
    found = calibrate(views, BOARD, Options(MODEL))
    assert found.sigma_px == pytest.approx(NOISE, rel=0.05)
    for view, pose in zip(found.views, truth, strict=True):
        own = view.camera_T_board
        two = own.rotation, REVERSED @ own.rotation @ REVERSED
        assert min(np.abs(so3.log(each @ pose.rotation.T)).max() for each in two) < 0.02
        middle = np.array([*BOARD.extent, 0.0]) / 2
        assert own.rotation @ middle + own.translation == pytest.approx(
            [*(pose.rotation @ middle + pose.translation)[:2], 2 * sum(BOARD.extent)], abs=2e-3
        )
        assert view.pose_covariance[2, 2] == pytest.approx(max(BOARD.extent) ** 2, rel=0.01)


def test_a_lens_without_distortion_and_views_from_the_front_do_not_leave_it_open():
    plain = Camera(MODEL, SIZE, [25000.0, 25060.0, 639.5, 479.5, 0.0, 0.0])
    views = seen(7, plain, tilt=40)[0] + seen(8, plain, count=10, tilt=0.0)[0]
    found = calibrate(views, BOARD, Options(MODEL, shape=ShapeOptions(smooth=False)))
    assert {"cx", "cy"} <= set(found.held_by_prior)
    assert map_error(found.camera, plain) < 0.03
    assert abs(found.camera.value("fx") / 25000 - 1) < 1e-3


def test_undistorted_points_of_a_line_are_on_a_line_and_a_view_fills_its_image():
    view = make_view(TRUTH)
    assert view.model is MODEL
    assert not view.parameters[4:].any()
    line = np.column_stack([np.linspace(-0.02, 0.02, 9), np.linspace(0.01, -0.012, 9), np.linspace(0.2, 3, 9)])
    moved = move_pixels(TRUTH, view, TRUTH.project(line).pixels)
    np.testing.assert_allclose(moved, view.project(line).pixels, atol=1e-9)
    edges = np.array([[0.0, 0.0], [1279, 0], [1279, 959], [0, 959]])
    source = move_pixels(view, TRUTH, edges)
    assert ((source > -1e-6) & (source < np.array(SIZE) - 1 + 1e-6)).all()
    with pytest.raises(InvalidInput, match="parallel"):
        make_view(TRUTH, ViewOptions(projection="cylinder"))


def test_what_needs_a_distance_or_another_lens_refuses_it_in_one_line(tmp_path, capsys):
    with pytest.raises(InvalidInput, match="parallel"):
        refit(TRUTH, MODELS["opencv5"])
    with pytest.raises(InvalidInput, match="parallel"):
        require_central(MODEL)
    path = tmp_path / "lens.yaml"
    native.write(path, CameraFile({"camera": CameraEntry(TRUTH)}))
    for words in (
        ["pnp", str(path), "x.csv"],
        ["check", str(path), "x.csv"],
        ["advise", str(path)],
        ["optics", str(path)],
    ):
        with pytest.raises(SystemExit) as ended:
            app(words)
        said = capsys.readouterr().err
        assert ended.value.code == 2, said
        assert "lens.yaml: the rays of the lens model telecentric are parallel" in said
    table = tmp_path / "seen.csv"
    detections.write(table, Detections(BOARD, tuple(seen(1)[0])))
    for words in (
        ["inspect", str(path), "--at", "0.2m"],
        ["rig", f"left={table}", f"right={table}", "--model", "telecentric", "-o", str(tmp_path / "rig.yaml")],
    ):
        with pytest.raises(SystemExit) as ended:
            app(words)
        assert ended.value.code == 2
        assert "the rays of the lens model telecentric are parallel" in capsys.readouterr().err
    with pytest.raises(SystemExit) as ended:
        app(["simulate", "chessboard:9x6:25mm", "--model", "telecentric", "-o", str(tmp_path / "scene")])
    assert ended.value.code == 2
    with pytest.raises(SystemExit) as ended:
        app(["inspect", str(path)])
    assert ended.value.code == 0
    assert "field of view 49.44 x 37.53 mm" in capsys.readouterr().out
    assert headline(calibrate(seen(1)[0], BOARD, Options(MODEL))).endswith(" px/m")


@pytest.mark.parametrize("refused", [select, solve_given], ids=["chosen", "given"])
def test_it_is_proposed_for_views_of_it_in_which_no_focal_length_shows(refused):
    views, options = seen(3, count=12)[0], Options(model_named("opencv5"))
    proposed = "if the lens is telecentric, use --model telecentric, which passes all checks in a brief calibration"
    with pytest.raises(InsufficientData, match=rf"focal length not determined .*; {proposed}"):
        refused(views, BOARD, options)
