"""ChArUco boards: corners by their model, places by markers that are read between them."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.geometry.pose import Pose
from camcal.simulate.render import Exposure, render
from camcal.simulate.scene import make_camera
from camcal.targets.board import parse_board
from camcal.targets.checker.charuco import find_charuco
from camcal.targets.detect import detect

SIZE = (640, 480)
CURRENT = parse_board("charuco:8x6:20mm:15mm:DICT_4X4_50:current")
LEGACY = replace(CURRENT, legacy=True)
WORDS = parse_board("charuco:8x6:20mm:14mm:DICT_6X6_250")


@cache
def view(board, seed=0, roll_deg=10.0, blur_px=0.8, noise_dn=2.0):
    rng = np.random.default_rng(seed)
    camera = make_camera(model_named("opencv5"), SIZE, np.radians(55), {"k1": -0.1})
    lean = np.radians([*rng.uniform(-30, 30, 2), roll_deg])
    turn = Pose.from_vector(lean, np.zeros(3)).rotation
    middle = np.array([*board.extent, 0.0]) / 2
    pose = Pose(turn, np.array([0.0, 0.0, 0.33]) - turn @ middle)
    exposure = Exposure(blur_px=blur_px, noise_dn=noise_dn, gradient=0.1)
    return render(camera, board, pose, rng=rng, exposure=exposure), camera.project(pose.apply(board.points())).pixels


@pytest.mark.parametrize("board", [CURRENT, LEGACY], ids=["current", "legacy"])
def test_corners_have_no_bias(board):
    errors = []
    for seed in range(6):
        image, truth = view(board, seed, roll_deg=10.0 * seed)
        detection = detect(image, board)
        assert len(detection.ids) == board.count
        errors.append(detection.pixels - truth[detection.ids])
    errors = np.concatenate(errors)
    assert np.abs(errors.mean(axis=0)).max() < 0.01
    assert np.sqrt((errors**2).mean()) < 0.05  # noise of 2 gray levels, and markers that leave a narrow margin


@pytest.mark.parametrize("roll_deg", [80.0, 175.0, -95.0])
@pytest.mark.parametrize("board", [CURRENT, LEGACY, WORDS], ids=["current", "legacy", "6x6"])
def test_ids_are_the_same_corners_however_the_board_is_turned(board, roll_deg):
    image, truth = view(board, 0, roll_deg)
    detection = find_charuco(image, board)
    assert len(detection.ids) >= board.count - 1
    assert np.linalg.norm(detection.pixels - truth[detection.ids], axis=1).max() < 0.3


def test_two_markers_say_where_a_small_part_is():
    image, truth = view(CURRENT)
    u, v = truth[16].astype(int)
    part = np.full_like(image, 120)
    part[v - 75 : v + 75, u - 75 : u + 75] = image[v - 75 : v + 75, u - 75 : u + 75]
    detection = find_charuco(part, CURRENT)
    assert 4 <= len(detection.ids) < CURRENT.count
    assert np.linalg.norm(detection.pixels - truth[detection.ids], axis=1).max() < 0.3


def test_a_hand_across_the_board_leaves_the_corners_on_both_sides():
    image, truth = view(CURRENT)
    covered = image.copy()
    u = int(truth[:, 0].mean())
    covered[:, u - 25 : u + 25] = 120
    detection = find_charuco(covered, CURRENT)
    assert {0, CURRENT.columns - 1} <= set(detection.ids)
    assert np.linalg.norm(detection.pixels - truth[detection.ids], axis=1).max() < 0.3


def assert_all_are_near(refused, truth):
    """Every corner of the truth was found, and nothing else."""
    nearest = np.linalg.norm(refused[:, None] - truth, axis=2)
    assert len(refused) == len(truth)
    assert nearest.min(axis=0).max() < 1


@pytest.mark.parametrize(("drawn", "wanted"), [(CURRENT, LEGACY), (LEGACY, CURRENT)], ids=["current", "legacy"])
def test_the_other_pattern_is_not_taken_for_the_board(drawn, wanted):
    image, truth = view(drawn)
    detection = find_charuco(image, wanted)
    assert not detection.found
    assert detection.reason.endswith("markers in other positions than on this board")
    assert_all_are_near(detection.refused, truth)


def test_a_board_of_unknown_pattern_is_found_in_both():
    unknown = replace(CURRENT, legacy=None)
    for board in (CURRENT, LEGACY):
        assert len(find_charuco(view(board)[0], unknown).ids) == CURRENT.count


def test_another_dictionary_is_not_read_and_the_corners_are_kept_for_pictures():
    image, truth = view(CURRENT)
    detection = find_charuco(image, replace(CURRENT, dictionary="DICT_5X5_100"))
    assert not detection.found
    assert_all_are_near(detection.refused, truth)


def test_a_mirrored_image_says_so():
    mirrored = np.ascontiguousarray(view(CURRENT)[0][:, ::-1])
    assert find_charuco(mirrored, CURRENT).reason.startswith("the image is mirrored")
