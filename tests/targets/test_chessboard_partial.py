"""Parts of chessboards: numbered where the image shows which part it is, refused where it does not."""

from functools import cache

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.geometry.pose import Pose
from camcal.simulate.render import Exposure, render
from camcal.simulate.scene import make_camera
from camcal.targets.board import parse_board
from camcal.targets.checker.chessboard import find_chessboard

SIZE = (640, 480)
ODD = parse_board("chessboard:9x6:20mm")
EVEN = parse_board("chessboard:8x6:20mm")
DOTTED = parse_board("chessboard:9x7:20mm:dots")
CLOSE = 0.5  # px; before corners are measured, where the border of the image cuts what is looked at


@cache
def view(board, roll_deg=12.0):
    """The image of a board that is tilted and turned, and its true corners."""
    camera = make_camera(model_named("opencv5"), SIZE, np.radians(55), {"k1": -0.1})
    turn = Pose.from_vector(np.radians([25.0, -20.0, roll_deg]), np.zeros(3)).rotation
    middle = np.array([*board.extent, 0.0]) / 2
    pose = Pose(turn, np.array([0.0, 0.0, 0.36]) - turn @ middle)
    image = render(camera, board, pose, rng=np.random.default_rng(1), exposure=Exposure(noise_dn=2.0))
    return image, camera.project(pose.apply(board.points())).pixels


def cut(board, left=0.0, top=0.0, right=0.0, bottom=0.0, roll_deg=12.0):
    """A view of which shares of the board's width and height are cut off, and the true corners in it."""
    image, truth = view(board, roll_deg)
    low, high = truth.min(axis=0), truth.max(axis=0)
    x0, y0 = (np.array([left, top]) * (high - low) + low).astype(int) * (np.array([left, top]) > 0)
    x1, y1 = np.where(np.array([right, bottom]) > 0, high - np.array([right, bottom]) * (high - low), SIZE).astype(int)
    return np.ascontiguousarray(image[y0:y1, x0:x1]), truth - (x0, y0)


def assert_true(detection, truth):
    assert detection.found, detection.reason
    assert np.linalg.norm(detection.pixels - truth[detection.ids], axis=1).max() < CLOSE


@pytest.mark.parametrize("side", ["left", "right", "top", "bottom"])
def test_three_sides_of_a_board_say_which_part_of_it_is_seen(side):
    image, truth = cut(ODD, **{side: 0.3})
    assert find_chessboard(image, ODD).reason.startswith(("board partly outside", "only"))
    detection = find_chessboard(image, ODD, partial=True)
    assert_true(detection, truth)
    assert ODD.count * 0.4 < len(detection.ids) < ODD.count


def test_a_corner_of_a_board_with_a_light_and_a_dark_end_is_enough():
    image, truth = cut(ODD, right=0.35, bottom=0.3)
    detection = find_chessboard(image, ODD, partial=True)
    assert not detection.found or np.linalg.norm(detection.pixels - truth[detection.ids], axis=1).max() < CLOSE


def test_the_middle_of_a_board_is_refused():
    image, _ = cut(ODD, left=0.25, right=0.25, top=0.2, bottom=0.2)
    detection = find_chessboard(image, ODD, partial=True)
    assert not detection.found
    assert detection.reason.endswith("which part of the board is ambiguous")


def test_a_part_without_a_side_of_the_board_is_numbered_by_its_dots():
    image, truth = cut(DOTTED, left=0.15, right=0.15, top=0.12, bottom=0.12)
    assert_true(find_chessboard(image, DOTTED, partial=True), truth)


def test_a_part_that_shows_neither_dots_nor_sides_is_refused():
    image, _ = cut(DOTTED, left=0.6, top=0.1, bottom=0.15, right=0.12)
    assert not find_chessboard(image, DOTTED, partial=True).found


@pytest.mark.parametrize("roll_deg", [0.0, 90.0, 170.0, -80.0])
def test_dots_number_a_whole_board_however_it_is_turned(roll_deg):
    image, truth = view(DOTTED, roll_deg)
    detection = find_chessboard(image, DOTTED)
    assert len(detection.ids) == DOTTED.count
    assert_true(detection, truth)


def test_a_board_without_the_dots_it_should_have_is_not_numbered():
    image, _ = view(parse_board("chessboard:9x7:20mm"))
    assert find_chessboard(image, DOTTED).reason == "the three dots that define its orientation are not visible"


def test_a_part_of_a_board_that_looks_the_same_turned_is_numbered_as_the_whole():
    image, truth = cut(EVEN, right=0.3)
    detection = find_chessboard(image, EVEN, partial=True)
    assert_true(detection, truth)  # its rows run to the right


def test_a_hand_over_the_rows_at_one_end_is_not_the_end_of_the_board():
    image, truth = view(ODD)
    covered = image.copy()
    rows = truth.reshape(ODD.rows, ODD.columns, 2)
    last = rows[-2, :, 1].min() - 8
    covered[int(last) :] = 140
    detection = find_chessboard(covered, ODD, partial=True)
    assert not detection.found or np.linalg.norm(detection.pixels - truth[detection.ids], axis=1).max() < CLOSE
