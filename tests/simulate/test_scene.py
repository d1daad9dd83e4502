"""Poses of simulated boards: they cover the image, show what they should, and come out the same again."""

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.simulate.scene import make_camera, observe, views
from camcal.targets.board import Board, parse_board

BOARD = Board("chessboard", 9, 6, 0.025)
CAMERAS = {
    "normal": make_camera(model_named("opencv5"), (1280, 960), np.radians(70)),
    "wide": make_camera(model_named("opencv8"), (1280, 720), np.radians(110)),
    "fisheye": make_camera(model_named("kannala_brandt4"), (1000, 1000), np.radians(180)),
}


def rng(seed=0):
    return np.random.default_rng(seed)


def pixels_of(camera, poses):
    return [view.pixels for view in observe(camera, BOARD, poses, rng=rng())[0].views]


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_all_corners_are_in_the_image(camera):
    assert all(len(pixels) == BOARD.count for pixels in pixels_of(camera, views(camera, BOARD, 30, rng=rng())))


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_partial_views_show_enough_and_some_are_cut(camera):
    counts = np.array([len(pixels) for pixels in pixels_of(camera, views(camera, BOARD, 40, rng=rng(), partial=True))])
    assert counts.min() >= 0.4 * BOARD.count
    assert 0.1 < np.mean(counts < BOARD.count) <= 0.5
    assert np.all(counts[::2] == BOARD.count)


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_twenty_views_reach_every_part_of_the_image(camera):
    pixels = np.concatenate(pixels_of(camera, views(camera, BOARD, 20, rng=rng())))
    cells = np.histogram2d(*(pixels / np.array(camera.image_size)).T, bins=3, range=((0, 1), (0, 1)))[0]
    assert cells.min() > 0.02 * len(pixels)


def test_an_aprilgrid_is_held_upright_and_seen_from_its_printed_side():
    board = parse_board("aprilgrid:6x4:88mm:0.3")
    camera = CAMERAS["normal"]
    detections, truth = observe(camera, board, views(camera, board, 20, rng=rng()), rng=rng())
    assert all(len(view.ids) == board.count for view in detections.views)
    normals = np.array([pose.rotation[:, 2] for pose in truth.poses])
    up = np.array([pose.rotation[:, 1] for pose in truth.poses])
    sights = np.array([pose.apply(np.array([*board.extent, 0.0]) / 2) for pose in truth.poses])
    cosines = np.sum(sights * normals, axis=1) / np.linalg.norm(sights, axis=1)
    assert cosines.max() <= -np.cos(np.radians(45)) + 1e-9  # z of the board towards the camera
    assert np.mean(up[:, 1] < -0.7) > 0.6  # y of the board upwards in the image, but for those in portrait format


def test_boards_are_tilted_both_ways_up_to_the_limit():
    poses = views(CAMERAS["normal"], BOARD, 60, rng=rng())
    middle = np.array([*BOARD.extent, 0.0]) / 2
    sights = np.array([pose.apply(middle) for pose in poses])
    normals = np.array([pose.rotation[:, 2] for pose in poses])
    cosines = np.sum(sights * normals, axis=1) / np.linalg.norm(sights, axis=1)
    tilts = np.degrees(np.arccos(cosines))
    assert tilts.max() <= 45 + 1e-9
    assert np.mean(tilts > 20) > 0.4
    assert np.ptp(normals[:, 0]) > 1
    assert np.ptp(normals[:, 1]) > 1


def test_distances_vary():
    distances = [np.linalg.norm(pose.translation) for pose in views(CAMERAS["normal"], BOARD, 30, rng=rng())]
    assert max(distances) > 1.8 * min(distances)


def test_the_same_seed_gives_the_same_poses():
    a, b, other = (views(CAMERAS["normal"], BOARD, 5, rng=rng(seed)) for seed in (3, 3, 4))
    assert all(np.array_equal(p.matrix(), q.matrix()) for p, q in zip(a, b, strict=True))
    assert not np.array_equal(a[0].matrix(), other[0].matrix())


def test_a_board_without_known_size_is_placed_in_squares():
    board = Board("chessboard", 9, 6)
    poses = views(CAMERAS["normal"], board, 5, rng=rng())
    in_metres = views(CAMERAS["normal"], BOARD, 5, rng=rng())
    assert np.allclose(poses[0].translation * 0.025, in_metres[0].translation, rtol=1e-9)


def test_a_lens_that_cannot_hold_the_board_is_refused():
    narrow = Camera(model_named("opencv5"), (640, 480), [400, 400, 320, 240, -8.0, 0, 0, 0, 0])
    with pytest.raises(InvalidInput, match="fits"):
        views(narrow, BOARD, 1, rng=rng())
