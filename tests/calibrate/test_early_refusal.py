"""What a brief fit settles is not solved for: views of two cameras, another board, views without tilt.

Each takes many times as long as a calibration of good views, if every lens model is compared and solved for.
"""

from dataclasses import replace

import numpy as np
import pytest
from observed import make_scene

from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Options
from camcal.cameras.catalogue import DEFAULT_MODEL, model_named
from camcal.errors import InsufficientData
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.progress import SILENT, Timed
from camcal.targets.board import Board
from camcal.tasks.calibration.model_selection import solve

FIRST = [1200.0, 1203.0, 805.0, 590.0, -0.12, 0.06, 0.0005, -0.0003, 0.01]
OPTIONS = Options(model_named(DEFAULT_MODEL), shape=ShapeOptions(offsets=False))
LENGTH, RIGHT = 1200.0, "b"


def views_of(folder, count, seed, focal=LENGTH, centre=(805.0, 590.0)):
    scene = make_scene(count=count, seed=seed, parameters=[focal, focal * 1.0025, *centre, *FIRST[4:]])
    return [replace(view, image=f"{folder}/{view.image}") for view in scene.observe(seed, noise_px=0.1)]


def two_cameras(focal, count=8):
    return views_of("a", 10, 1) + views_of(RIGHT, count, 2, focal, (793.0, 606.0))


def named(views, options=OPTIONS):
    return replace(options, named_groups=(frozenset(view.image for view in views if view.image[0] == RIGHT),))


def stages(views, board, options, *, choose=True):
    """What a calibration comes to, and the names of the stages that it entered."""
    timings = {}
    try:
        found = solve(views, board, options, choose=choose, progress=Timed(SILENT, timings))
    except InsufficientData as error:
        found = error
    return found, set(timings)


@pytest.mark.parametrize("choose", [True, False])
def test_views_of_two_cameras_by_their_names_are_not_solved_for(choose):
    views, board = two_cameras(1240.0), make_scene(count=1).board
    found, entered = stages(views, board, named(views), choose=choose)
    assert [failure.code for failure in found.assessment.failures] == ["several_cameras_by_name"]
    assert {name[0] for name in found.calibration.two_cameras.groups[1]} == {RIGHT}
    assert found.candidates == ()
    assert "solving" not in entered


def test_groups_of_one_camera_by_their_names_are_solved_for_as_ever():
    views, board = two_cameras(LENGTH)[:10] + views_of(RIGHT, 8, 2), make_scene(count=1).board
    found, entered = stages(views, board, named(views))
    assert found.assessment.trustworthy
    assert found.calibration.two_cameras is None
    assert "solving" in entered


def test_views_that_no_lens_explains_are_of_two_cameras_without_names_too():
    views, board = two_cameras(2300.0), make_scene(count=1).board
    error, entered = stages(views, board, OPTIONS)
    assert [failure.code for failure in error.failures] == ["views_of_two_cameras"]
    assert "solving" not in entered


@pytest.mark.parametrize("choose", [True, False])
def test_corners_that_are_numbered_for_another_board_are_refused_at_once(choose):
    views, board = views_of("a", 12, 1), make_scene(count=1).board
    error, entered = stages(views, Board("chessboard", board.rows, board.columns, board.square), OPTIONS, choose=choose)
    assert [failure.code for failure in error.failures] == ["board_does_not_fit"]
    assert "solving" not in entered


@pytest.mark.parametrize("choose", [True, False])
def test_views_without_tilt_are_refused_by_two_lens_models_and_not_solved_for(choose):
    scene = make_scene(count=8, seed=3)
    turns = np.random.default_rng(3).normal(0, 0.2, 8)
    poses = [
        Pose(so3.exp(np.array([0.0, 0.0, turn])), pose.translation)
        for turn, pose in zip(turns, scene.poses, strict=True)
    ]
    scene = replace(scene, poses=tuple(poses))
    error, entered = stages(scene.observe(3, noise_px=0.1), scene.board, OPTIONS, choose=choose)
    assert [failure.code for failure in error.failures] == ["no_tilted_views"]
    assert "solving" not in entered


def test_a_lens_model_that_views_leave_open_is_refused_with_what_became_of_others():
    """Far in the middle of the image, fourteen coefficients leave the focal length open, and nothing else passes."""
    scene = make_scene(count=6, seed=4)
    rng = np.random.default_rng(4)
    centre = np.array([*scene.board.extent, 0.0]) / 2
    poses = []
    for _ in scene.poses:
        turn = so3.exp(np.array([*rng.uniform(-0.4, 0.4, 2), 0.0]))
        aim = np.array([*rng.uniform(-0.05, 0.05, 2), 1.0])
        poses.append(Pose(turn, 4.0 * aim - turn @ centre))
    views = replace(scene, poses=tuple(poses)).observe(4, noise_px=0.1)
    error, entered = stages(views, scene.board, replace(OPTIONS, model=model_named("opencv14")), choose=False)
    assert [failure.code for failure in error.failures] == ["undetermined_focal_length"]
    assert "none of " in error.message
    assert "solving" not in entered
