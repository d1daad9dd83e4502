"""AprilGrids in rendered images, whose corners are known; that ids and order are Kalibr's is shown by tests/real."""

from dataclasses import replace

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.simulate.render import Exposure, render
from camcal.simulate.scene import make_camera
from camcal.targets.aprilgrid import find_aprilgrid
from camcal.targets.board import parse_board

BOARD = parse_board("aprilgrid:4x3:60mm:0.3")
SIZE = (480, 360)
MEASURED = 0.03  # px: four standard deviations; the next corner is 14 px away
CAMERA = make_camera(model_named("opencv4"), SIZE, np.radians(70))
FISHEYE = make_camera(model_named("kannala_brandt4"), SIZE, np.radians(150))


def placed(board, camera, pitch_px, turn=(0.3, -0.2, 0.1), aside=(0.0, 0.0)):
    """Return the pose of a board whose tags are about so many pixels apart; aside: of the axis, in distances."""
    distance = camera.value("fx") * board.spacing / pitch_px
    rotation = so3.exp(np.array(turn)) @ np.diag([1.0, -1.0, -1.0])
    middle = np.array([*board.extent, 0.0]) / 2
    return Pose(rotation, distance * np.array([*aside, 1.0]) - rotation @ middle)


def picture(board=BOARD, camera=CAMERA, pose=None, seed=0, **exposure):
    pose = pose or placed(board, camera, 60)
    truth = camera.project(pose.apply(board.points())).pixels
    return render(camera, board, pose, rng=np.random.default_rng(seed), exposure=Exposure(**exposure)), truth


@pytest.fixture(scope="module")
def plain():
    return picture()


def errors(detection, truth):
    return detection.pixels - truth[detection.ids]


def test_all_corners_are_found_in_the_order_of_their_ids(plain):
    image, truth = plain
    detection = find_aprilgrid(image, BOARD)
    assert detection.ids.tolist() == list(range(48))
    assert np.abs(errors(detection, truth)).max() < MEASURED


def test_the_covariance_is_that_of_the_errors():
    squares = []
    for seed in range(4):
        image, truth = picture(seed=seed, pose=placed(BOARD, CAMERA, 60, turn=(0.4 * np.cos(seed), 0.3, seed)))
        detection = find_aprilgrid(image, BOARD)
        error = errors(detection, truth)
        squares.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(detection.covariance), error))
    assert 0.75 < np.mean(squares) / 2 < 1.3  # of 192 corners: a standard deviation is 0.07


def test_a_board_turned_upside_down_keeps_its_ids():
    image, truth = picture(pose=placed(BOARD, CAMERA, 60, turn=(0.2, 0.1, 3.0)))
    detection = find_aprilgrid(image, BOARD)
    assert len(detection.ids) == 48
    assert np.abs(errors(detection, truth)).max() < MEASURED


def test_tags_on_the_rim_of_a_fisheye_image_are_found():
    image, truth = picture(camera=FISHEYE, pose=placed(BOARD, FISHEYE, 40, turn=(0.1, 0.2, 0.2), aside=(1.0, 0.3)))
    detection = find_aprilgrid(image, BOARD)
    assert len(detection.ids) == 48
    assert np.abs(errors(detection, truth)).max() < 0.08  # tags are half as large there


def test_small_blurred_tags_that_cannot_be_read_one_by_one_are_read_together():
    """A cell of a tag is 1.7 pixels wide, the blur 1 pixel."""
    image, truth = picture(pose=placed(BOARD, CAMERA, 22, turn=(0.1, 0.1, 0.2)), blur_px=1.0)
    detection = find_aprilgrid(image, BOARD)
    assert len(detection.ids) == 48
    assert np.abs(errors(detection, truth)).max() < 0.1  # tags of 17 px have a third of the edges


def test_a_blur_that_brings_the_next_edges_in_moves_no_corner():
    """The gaps are 9 pixels wide, the blur 2 pixels."""
    image, truth = picture(pose=placed(BOARD, CAMERA, 40, turn=(0.1, 0.1, 0.2)), blur_px=2.0)
    detection = find_aprilgrid(image, BOARD)
    assert len(detection.ids) == 48
    assert np.sqrt((errors(detection, truth) ** 2).mean()) < 0.03  # 0.013 measured; with straight edges alone 0.2


def test_hidden_corners_are_left_out_and_the_others_keep_their_ids(plain):
    image, truth = plain
    hidden = image.copy()
    u, v = truth[20:24].mean(axis=0).astype(int)
    hidden[v - 28 : v + 28, u - 28 : u + 28] = 120  # tag 5
    detection = find_aprilgrid(hidden, BOARD)
    assert not set(detection.ids) & {20, 21, 22, 23}
    assert len(detection.ids) >= 36
    assert np.abs(errors(detection, truth)).max() < 0.1  # the patch cuts into some windows


def test_a_board_that_is_partly_outside_the_image_is_found():
    image, truth = picture(pose=placed(BOARD, CAMERA, 90, aside=(0.6, 0.2)))
    inside = ((truth > 12) & (truth < np.array(SIZE) - 13)).all(axis=1)
    assert 8 < inside.sum() < 40
    detection = find_aprilgrid(image, BOARD)
    assert set(np.flatnonzero(inside)) <= set(detection.ids)
    assert np.abs(errors(detection, truth)).max() < 0.1  # the image's rim cuts into some windows


def test_corners_of_a_board_cut_along_its_tags_are_no_crossings(plain):
    image, truth = plain
    cut = image.copy()
    outer = np.concatenate([truth[2::4][8:], truth[3::4][8:]])  # upper corners of the upper row
    line = np.polyfit(outer[:, 0], outer[:, 1], 1)
    cut[np.arange(SIZE[1])[:, None] < np.polyval(line, np.arange(SIZE[0]))] = 200
    detection = find_aprilgrid(cut, BOARD)
    upper = {4 * tag + corner for tag in range(8, 12) for corner in (2, 3)}
    assert not set(detection.ids) & upper
    assert len(detection.ids) == 40


def test_a_board_with_other_ids_says_what_is_in_sight(plain):
    other = replace(BOARD, first_marker=100)
    seen = find_aprilgrid(plain[0], other)
    assert seen.reason == "tags 0, 1, 2, 3, 4, 5 visible; this board has 100 to 111"
    assert len(seen.refused) >= 6 * 4
    assert (
        np.linalg.norm(seen.refused[:, None] - plain[1], axis=2).min(axis=1).max() < 8
    )  # rough outlines, of sides of 45 px


@pytest.mark.parametrize("size", [(3, 4), (5, 3), (3, 3)])
def test_a_board_of_another_number_of_tags_in_a_row_is_refused(plain, size):
    other = replace(BOARD, columns=size[0], rows=size[1])
    seen = find_aprilgrid(plain[0], other)
    assert not seen.found
    assert "tags" in seen.reason
    assert len(seen.refused)


def test_a_mirrored_image_is_called_by_its_name(plain):
    assert find_aprilgrid(np.ascontiguousarray(plain[0][:, ::-1]), BOARD).reason.startswith("mirror images of tags 0")


def test_images_without_tags_hold_no_board():
    noise = np.random.default_rng(3).integers(0, 256, (240, 320)).astype(np.uint8)
    for image in (noise, np.full((240, 320), 128, np.uint8), np.zeros((40, 33), np.uint8)):
        detection = find_aprilgrid(image, BOARD)
        assert not detection.found
        assert detection.reason == "no tag of tag36h11 with a black border of 2 cells found"


def test_one_tag_is_a_board():
    board = parse_board("aprilgrid:1x1:60mm:0.3")
    image, truth = picture(board, pose=placed(board, CAMERA, 120))
    detection = find_aprilgrid(image, board)
    assert detection.ids.tolist() == [0, 1, 2, 3]
    assert np.abs(errors(detection, truth)).max() < MEASURED


def test_the_same_image_gives_the_same_corners(plain):
    one, other = find_aprilgrid(plain[0], BOARD), find_aprilgrid(plain[0], BOARD)
    assert (one.pixels == other.pixels).all()
    assert (one.covariance == other.covariance).all()
