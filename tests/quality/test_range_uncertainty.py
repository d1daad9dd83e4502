"""Projection uncertainty over distance: far away that of the map, least near the boards, and what lenses scatter by."""

from dataclasses import replace
from functools import cache
from math import inf

import numpy as np
import pytest

from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Options, calibrate
from camcal.cameras.catalogue import model_named
from camcal.cameras.directions import grid_pixels, in_hull
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.geometry import rotation as so3
from camcal.quality.camera_comparison import Calibrated
from camcal.quality.projection_uncertainty import projection_uncertainty
from camcal.quality.range_uncertainty import CalibrationBoards, camera_errors, range_uncertainty
from camcal.simulate.scene import make_camera, observe, views
from camcal.solve.losses import student_bound
from camcal.targets.board import Board

BOARD = Board("chessboard", 9, 6, 0.025)
CAMERA = make_camera(model_named("opencv5"), (1280, 960), np.radians(70))
POSES = views(CAMERA, BOARD, 8, rng=np.random.default_rng(0))
HOW = Options(CAMERA.model, shape=ShapeOptions(smooth=False, offsets=False))


@cache
def calibrated(seed):
    rng = np.random.default_rng(seed)
    return calibrate(observe(CAMERA, BOARD, POSES, rng=rng, noise_px=0.1)[0].views, BOARD, HOW)


def test_far_away_it_is_that_of_directions_and_least_among_the_boards():
    found, own = range_uncertainty(calibrated(0)), calibrated(0)
    map_px = projection_uncertainty(own.camera, observed=own.pixels).figures()["inside_rms_px"]
    assert found.std[-1] == pytest.approx(map_px, rel=0.1)
    distance, least = found.best
    assert found.near < distance < found.far
    assert least < map_px / 2
    assert found.std[0] > map_px


def test_a_lens_that_is_held_has_none():
    own = calibrated(0)
    assert range_uncertainty(replace(own, camera=replace(own.camera, covariance=np.zeros((9, 9))))) is None


def scatter(distance, count):
    """The RMS (px) of where calibrations project points, whose places all boards together say, a turn left out."""
    grid = grid_pixels(np.linspace(0, 1279, 15), np.linspace(0, 959, 11))
    pixels = grid[in_hull(grid, calibrated(0).pixels)]
    rays = CAMERA.unproject(pixels).directions
    by_turn = CAMERA.model.project_with_jacobians(CAMERA.parameters, rays).d_point @ -so3.hat(rays)
    squares = []
    for seed in range(count):
        found = calibrated(seed)
        steps = [view.camera_T_board @ pose.inverse() for view, pose in zip(found.views, POSES, strict=True)]
        shift = np.mean([step.translation for step in steps], axis=0)
        moved = found.camera.project(distance * rays + shift).pixels - pixels
        turn = np.linalg.lstsq(by_turn.reshape(-1, 3), moved.ravel(), rcond=None)[0]
        squares.append(np.mean((moved - by_turn @ turn) ** 2))
    return np.sqrt(np.mean(squares))


@pytest.mark.slow
@pytest.mark.parametrize("place", [0, 16, 20, 40])
def test_calibrations_scatter_as_the_curve_says(place):
    found = range_uncertainty(calibrated(0))
    # 24 lenses of few parameters: their RMS is known to some 10 %
    assert scatter(found.distances[place], 24) == pytest.approx(found.std[place], rel=0.25)


def pinhole(focal_std):
    covariance = np.zeros((4, 4))
    covariance[:2, :2] = focal_std**2  # fx and fy are off together
    return Camera(model_named("pinhole"), (1001, 801), np.array([800.0, 800.0, 500.0, 400.0]), covariance)


def middle(focal_std=4.0, views=inf):
    region = np.array([[440.0, 340.0], [560.0, 340.0], [560.0, 460.0], [440.0, 460.0]])
    return Calibrated("a camera", pinhole(focal_std), region, views=views)


def test_a_length_in_the_middle_is_as_uncertain_as_the_focal_length():
    found = camera_errors(middle(), None, 2.0, 0.1)
    assert found.length.std == pytest.approx(0.1 * 4 / 800, rel=0.02)
    assert found.length.bound == pytest.approx(1.96 * found.length.std, rel=1e-3)
    assert found.pixel == pytest.approx(2.0 / 800)


def test_a_shift_of_the_boards_moves_near_points_by_the_focal_length_over_the_distance():
    shift = np.zeros((3, 7))
    shift[0, 4] = 1e-6  # 1 mm to the side
    boards = CalibrationBoards(0.4, 0.8, 1.0, shift)
    exact = replace(middle(1e-6), region=None)
    near, far = (camera_errors(exact, boards, distance).point.std for distance in (0.5, 5.0))
    # a shift to the side is largely a turn: what is left differs over the image
    assert near == pytest.approx(10 * far, rel=1e-6)
    assert camera_errors(exact, boards, 0.5).by_boards
    assert not camera_errors(exact, None, 0.5).by_boards


def test_few_views_widen_the_bounds():
    sure, unsure = (camera_errors(middle(views=views), None, 1.0).point for views in (inf, 6))
    assert sure.std == unsure.std
    assert unsure.bound / sure.bound == pytest.approx(2.571 / 1.960, rel=2e-3)


@pytest.mark.parametrize(("dof", "table"), [(3, 3.182), (5, 2.571), (10, 2.228), (30, 2.042), (inf, 1.960)])
def test_bounds_are_those_of_students_table(dof, table):
    assert student_bound(dof) == pytest.approx(table, rel=0.01)


def test_what_is_not_known_is_said():
    with pytest.raises(InvalidInput, match=r"a camera states no covariance, .* calibrate with camcal"):
        camera_errors(middle(0.0), None, 1.0)
    with pytest.raises(InvalidInput, match="an object of 3 m has no two ends at 1 m from the camera"):
        camera_errors(middle(), None, 1.0, 3.0)
    assert camera_errors(middle(), None, 1.0, 0.9).length is None  # its ends are outside of what is known


def test_a_file_keeps_what_the_curve_says_of_its_distances():
    own = calibrated(0)
    boards, curve = CalibrationBoards.of(own), range_uncertainty(own)
    assert (boards.nearest, boards.farthest) == (pytest.approx(curve.near), pytest.approx(curve.far))
    assert 0.3 < boards.noise_share <= 1  # nothing but noise is wrong here
    known = Calibrated("own", own.camera, own.pixels[[np.argmin(own.pixels @ way) for way in SIDES]], views=8)
    for place in (4, 20, 36):
        found = camera_errors(known, boards, float(curve.distances[place]))
        assert found.point.std == pytest.approx(curve.std[place], rel=0.2)  # over another part of the image


SIDES = np.array([(np.cos(angle), np.sin(angle)) for angle in np.linspace(0, 2 * np.pi, 16, endpoint=False)])
