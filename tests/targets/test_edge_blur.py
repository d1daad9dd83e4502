"""The blur of a board's edges against the blur they were rendered with."""

import cv2
import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.simulate.render import Exposure, render
from camcal.targets.board import Board, parse_board
from camcal.targets.corner_measurement import edge_blur

SIZE = (480, 360)
CAMERA = Camera(model_named("pinhole"), SIZE, np.array([500.0, 500, 239.5, 179.5]))
PIXEL = 1 / 12  # px², variance of a pixel's own square


def photo(board, blur_px, roll=0.2, noise_dn=2.0):
    """Return the photograph of a board in the middle of the image, and its points."""
    turn = so3.exp(np.array([0.3, 0.2, roll]))
    middle = np.array([*board.extent, 0.0]) / 2
    pose = Pose(turn, np.array([0.0, 0.0, 2.2 * max(board.extent)]) - turn @ middle)
    exposure = Exposure(blur_px=blur_px, noise_dn=noise_dn)
    gray = render(CAMERA, board, pose, rng=np.random.default_rng(3), exposure=exposure)
    return gray, CAMERA.project(pose.apply(board.points())).pixels


BOARDS = [
    "chessboard:8x6:25mm", "charuco:8x6:25mm:18mm:DICT_4X4_50", "aprilgrid:5x4:25mm:0.3", "circles:8x6:25mm:15mm",
    "asymmetric_circles:4x9:25mm:18mm",
]  # fmt: skip


@pytest.mark.parametrize("spec", BOARDS)
@pytest.mark.parametrize("blur", [0.7, 1.5, 2.5])
def test_the_blur_is_that_of_the_rendering(spec, blur):
    gray, pixels = photo(parse_board(spec), blur)
    # 20 %: the gap between a square and a marker or tag is 7 px wide, and a blur of 2.5 px takes some of its contrast
    assert edge_blur(gray, pixels) == pytest.approx(np.sqrt(blur**2 + PIXEL), rel=0.2)


def test_noise_changes_little():
    quiet, loud = (edge_blur(*photo(Board("chessboard", 8, 6), 1.5, noise_dn=noise)) for noise in (0.5, 8.0))
    assert loud == pytest.approx(quiet, rel=0.1)  # noise adds to the slopes' squares, not to their fourth powers


@pytest.mark.parametrize("roll", [0.0, 0.4, 0.8])
@pytest.mark.parametrize("upright", [True, False])
def test_motion_counts_though_it_leaves_the_edges_along_it_sharp(roll, upright):
    gray, pixels = photo(Board("chessboard", 8, 6), 0.7, roll)
    kernel = np.ones((9, 1) if upright else (1, 9)) / 9
    # across an edge at 45° the motion is shortened to 6 px, whose slope is that of a blur of 6 / √(2π) = 2.4 px
    assert edge_blur(cv2.filter2D(gray, -1, kernel), pixels) > 2.0


def test_a_sharper_frame_is_told_from_a_blurred_one_of_a_small_board():
    board = Board("chessboard", 14, 12)
    sharp, soft = (edge_blur(*photo(board, blur)) for blur in (0.7, 1.4))
    assert soft > 1.4 * sharp  # the pixel's own included, they are 1.43 and 0.76 px


def test_points_on_the_rim_of_the_image_have_no_blur():
    gray, _ = photo(Board("chessboard", 8, 6), 1.0)
    rim = np.array([[0.0, 0.0], [20.0, 1.0], [1.0, 20.0]])
    assert np.isnan(edge_blur(gray, rim))


def test_an_even_image_does_not_fail():
    assert edge_blur(np.full((100, 100), 90, np.uint8), np.array([[40.0, 40], [60, 40], [40, 60]])) >= 0
