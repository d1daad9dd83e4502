"""Projection uncertainty over distance: far away that of the map, least near the boards, and what lenses scatter by."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Options, calibrate
from camcal.cameras.catalogue import model_named
from camcal.cameras.directions import in_hull
from camcal.geometry import rotation as so3
from camcal.quality.projection_uncertainty import grid_pixels, projection_uncertainty
from camcal.quality.range_uncertainty import range_uncertainty
from camcal.simulate.scene import make_camera, observe, views
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
