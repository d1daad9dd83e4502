"""ChArUco boards of which nothing is known are told by their images; what is none is not taken for one."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from drawn import picture, pose

from camcal.cameras.catalogue import model_named
from camcal.geometry.pose import Pose
from camcal.simulate.render import render
from camcal.simulate.scene import make_camera
from camcal.targets.board import Board, parse_board
from camcal.targets.checker.charuco import ends_after, find_charuco, rows_seen
from camcal.targets.checker.charuco_search import common_layout, is_like, search_charuco

SIZE = (640, 480)
BOARD = parse_board("charuco:7x6:30mm:22mm:DICT_5X5_100")
TILTED = pose([(150, 100), (500, 75), (515, 360), (135, 335)])


@cache
def drawn_once(board):
    return picture(board, TILTED, SIZE)


def shown(board):
    return drawn_once(board).copy()


def slow(*values):
    return pytest.param(*values, marks=pytest.mark.slow)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("drawn", "asked", "proposed"),
    [
        slow("7x6:30mm:22mm:DICT_5X5_100", "7x6:30mm:16mm:DICT_5X5_100", "7x6:30mm:22mm:DICT_5X5_100"),
        slow("7x6:30mm:18mm:DICT_5X5_100", "7x6:30mm:22mm:DICT_5X5_100", "7x6:30mm:18mm:DICT_5X5_100"),
        slow("7x6:30mm:22mm:DICT_5X5_100", "7x6:30mm:22mm:DICT_4X4_50", "7x6:30mm:22mm:DICT_5X5_50"),
        ("7x6:30mm:22mm:DICT_APRILTAG_36h11", "7x6:30mm:22mm:DICT_6X6_250", "7x6:30mm:22mm:DICT_APRILTAG_36h11"),
        slow("7x6:30mm:22mm:DICT_ARUCO_ORIGINAL", "7x6:30mm:22mm:DICT_5X5_100", "7x6:30mm:22mm:DICT_ARUCO_ORIGINAL"),
        ("7x6:30mm:22mm:DICT_5X5_100", "8x6:30mm:22mm:DICT_5X5_100", "7x6:30mm:22mm:DICT_5X5_100"),
        slow("7x6:30mm:22mm:DICT_5X5_100", "7x9:30mm:22mm:DICT_5X5_100", "7x6:30mm:22mm:DICT_5X5_100"),
        slow("7x6:30mm:22mm:DICT_5X5_100", "6x5:30mm:22mm:DICT_5X5_100", "7x6:30mm:22mm:DICT_5X5_100"),
        ("7x6:0.73:DICT_5X5_100:legacy", "8x6:0.6:DICT_6X6_250:current", "7x6:0.73:DICT_5X5_50:legacy"),
        slow("7x5:0.8:DICT_4X4_50", "5x5:0.5:DICT_7X7_50:legacy", "7x5:0.8:DICT_4X4_50"),
    ],
)
def test_another_board_is_told_by_its_squares_markers_and_dictionary(drawn, asked, proposed):
    wanted = parse_board(f"charuco:{asked}")
    layout = search_charuco(shown(parse_board(f"charuco:{drawn}")), wanted)
    found = layout.board(wanted)
    expected = parse_board(f"charuco:{proposed}")
    assert replace(found, marker=expected.marker) == expected
    assert found.marker / found.spacing == pytest.approx(expected.marker / expected.spacing, abs=0.02)  # half a pixel
    assert not is_like(layout, wanted)


def test_another_board_that_is_printed_white_on_black_is_told():
    layout = search_charuco(255 - shown(BOARD), parse_board("charuco:7x6:30mm:22mm:DICT_4X4_50"))
    assert is_like(layout, replace(BOARD, dictionary="DICT_5X5_50"))


@pytest.mark.parametrize("asked", ["7x6", "6x7"])
def test_the_board_itself_is_no_other_board(asked):
    wanted = parse_board(f"charuco:{asked}:30mm:21mm:DICT_5X5_100")
    assert is_like(search_charuco(shown(BOARD), wanted), wanted)


@pytest.mark.slow
@pytest.mark.parametrize("turns", [1, 2, 3])
def test_it_is_told_in_an_image_that_is_turned(turns):
    layout = search_charuco(np.ascontiguousarray(np.rot90(shown(BOARD), turns)), BOARD)
    assert is_like(layout, BOARD)


@pytest.mark.slow
def test_marker_ids_may_begin_anywhere():
    layout = search_charuco(shown(replace(BOARD, first_marker=17)), BOARD)
    assert (layout.first, layout.columns, layout.rows) == (17, 7, 6)


def test_a_hand_across_the_rows_hides_none_of_those_beyond_it():
    image = shown(BOARD)
    image[200:240] = 120
    layout = search_charuco(image, replace(BOARD, marker=0.016))
    assert (layout.columns, layout.rows) == (7, 6)


@pytest.mark.slow
def test_rows_out_of_sight_are_those_that_were_stated():
    image = shown(BOARD)
    image[300:] = 120  # what hides the last row is not white
    asked = replace(BOARD, marker=0.016)
    assert search_charuco(image, asked).rows == 6
    assert search_charuco(image, replace(asked, rows=8)).rows == 9


@pytest.mark.slow
def test_most_layouts_make_the_common_one_and_the_largest_says_how_many_rows():
    layout = search_charuco(shown(BOARD), BOARD)
    other = replace(layout, dictionary="DICT_4X4_1000")
    assert common_layout([other, layout, replace(layout, rows=4)]).kind == layout.kind
    assert common_layout([]) is None


@pytest.mark.slow
def test_nothing_is_proposed_where_there_is_no_such_board():
    rng = np.random.default_rng(0)
    noise = cv2.GaussianBlur(rng.integers(0, 256, SIZE[::-1]).astype(np.uint8), (0, 0), 2)
    walls = [np.full(SIZE[::-1], 120, np.uint8), cv2.normalize(noise, None, 0, 255, cv2.NORM_MINMAX)]
    for image in (*walls, shown(Board("chessboard", 7, 5)), *rendered()):
        assert search_charuco(image, BOARD) is None


def rendered():
    """Yield other boards, and a ChArUco board in a mirror."""
    camera = make_camera(model_named("pinhole"), SIZE, np.radians(55), {})
    for text in ("aprilgrid:4x3:40mm:0.3", "circles:7x5:30mm:20mm", "asymmetric_circles:4x7:25mm:20mm"):
        board = parse_board(text)
        middle = np.array([*board.extent, 0.0]) / 2
        at = Pose(np.diag([1.0, board.z_sign, board.z_sign]), np.array([0.0, 0.0, 0.45]))
        place = Pose(at.rotation, at.translation - at.rotation @ middle)
        yield render(camera, board, place, rng=np.random.default_rng(1))
    yield np.ascontiguousarray(shown(BOARD)[:, ::-1])


@pytest.mark.slow
def test_the_image_tells_where_rows_end():
    taller = replace(BOARD, rows=7)
    image = shown(BOARD)
    seen = find_charuco(image, taller)
    assert rows_seen(taller, seen.ids) == 6
    assert [ends_after(image, taller, rows, seen.ids, seen.pixels) for rows in (4, 5, 6, 7)] == [0, 0, 1, 0]
    image[300:] = 60
    seen = find_charuco(image, taller)
    assert not ends_after(image, taller, rows_seen(taller, seen.ids), seen.ids, seen.pixels)


def test_a_legacy_board_has_an_even_number_of_rows():
    assert rows_seen(replace(BOARD, legacy=True), np.arange(24)) == 6  # four rows of corners are five of squares
    assert rows_seen(BOARD, np.arange(24)) == 5
    assert rows_seen(BOARD, np.arange(0)) == 0
