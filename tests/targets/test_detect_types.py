"""Every type of board, photographed from all sides, is found with the numbers and places that the photograph has."""

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.simulate.render import Exposure, render
from camcal.targets.board import parse_board
from camcal.targets.detect import detect

CAMERA = Camera(model_named("opencv5"), (640, 480), [620.0, 620.0, 322.3, 238.1, -0.15, 0.03, 0.0, 0.0, 0.0])
BOARDS = [
    "chessboard:8x6:25mm",
    "chessboard:8x6:25mm:dots",
    "charuco:7x5:30mm:22mm:DICT_4X4_50",
    "aprilgrid:4x3:60mm:0.3",
    "circles:8x6:25mm:15mm",
    "circles:6x6:25mm:15mm",
    "asymmetric_circles:4x9:20mm:15mm",
    "asymmetric_circles:4x8:20mm:15mm",
]
EXACT = 0.05  # px: below 0.02 is measured for all types, and a wrong number is off by 10 px and more


def photograph(board, turn):
    """Return an image of a board turned in its plane by degrees and tilted, and where its points are."""
    turns = so3.exp(np.array([0.3, -0.25, 0.0])) @ so3.exp(np.array([0.0, 0.0, np.radians(turn)]))
    rotation = turns @ np.diag([1.0, board.z_sign, board.z_sign])
    distance = 2.4 * max(board.extent)
    pose = Pose(rotation, np.array([0.0, 0.0, distance]) - rotation @ np.array([*board.extent, 0.0]) / 2)
    image = render(CAMERA, board, pose, rng=np.random.default_rng(turn), exposure=Exposure(noise_dn=1.0))
    return image, CAMERA.project(pose.apply(board.points())).pixels


@pytest.mark.parametrize("turn", [10, 100, 190, 280])
@pytest.mark.parametrize("form", BOARDS)
def test_a_board_is_found_and_numbered_but_for_its_symmetries(form, turn):
    board = parse_board(form)
    image, truth = photograph(board, turn)
    detection = detect(image, board)
    assert detection.reason is None
    assert len(detection.ids) > 0.9 * board.count
    errors = [np.abs(detection.pixels - truth[turned[detection.ids]]).max() for turned in board.symmetries()]
    assert min(errors) < EXACT
    if detection.covariance is not None:
        assert np.linalg.eigvalsh(detection.covariance).min() > 0


@pytest.mark.parametrize("form", BOARDS)
def test_an_image_without_a_board_says_why(form):
    blank = np.full((240, 320), 200, np.uint8)
    detection = detect(blank, parse_board(form))
    assert not detection.found
    assert detection.reason


@pytest.mark.parametrize("form", ["charuco:7x5:30mm:22mm:DICT_4X4_50", "aprilgrid:4x3:60mm:0.3", BOARDS[1]])
def test_a_part_of_a_board_whose_points_can_be_told_apart_is_enough(form):
    board = parse_board(form)
    image, truth = photograph(board, 10)
    cut = int(truth[:, 0].max()) - 30
    detection = detect(np.ascontiguousarray(image[:, :cut]), board)
    assert 0.5 * board.count < len(detection.ids) < board.count
    assert np.abs(detection.pixels - truth[detection.ids]).max() < EXACT


def test_parts_of_a_grid_of_circles_are_refused_where_they_are_asked_for():
    with pytest.raises(InvalidInput, match="the whole grid must be visible"):
        detect(np.zeros((100, 100), np.uint8), parse_board("circles:8x6:25mm"), partial=True)


@pytest.mark.parametrize(
    ("form", "message"),
    [
        ("aprilgrid:30x20:60mm:0.3", "the board needs markers 0 to 599, tag36h11 ends at 586"),
        ("aprilgrid:3x3:60mm:0.3:tag36h9", "marker family 'tag36h9' is unknown; did you mean tag36h1"),
        ("chessboard:9x2:25mm", "inner corners is too small to be detected .minimum 3 x 3"),
    ],
)
def test_a_board_that_cannot_be_found_is_refused(form, message):
    with pytest.raises(InvalidInput, match=message):
        detect(np.zeros((100, 100), np.uint8), parse_board(form))
