"""Boards in drawn images: numbering, orientation, reasons, repeatability.

Accuracy on drawn boards is that of the drawing, 0.02 px (six rays a pixel); what real images give is measured in
benchmarks/detection.py and tests/real.
"""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from drawn import picture, pose, truth, upright

from camcal.errors import InvalidInput
from camcal.targets.board import Board, parse_board
from camcal.targets.checker.charuco import arrangement_votes, arrangements
from camcal.targets.detect import detect

ODD = Board("chessboard", 6, 5)  # colours tell the ends apart
EVEN = Board("chessboard", 6, 4)
SQUARE = Board("chessboard", 5, 5)
CHARUCO = parse_board("charuco:6x4:40mm:30mm:DICT_4X4_50:current")
LEGACY = replace(CHARUCO, legacy=True)
SIZE = (360, 270)
TILTED = pose([(92.3, 80.2), (267.1, 71.8), (250.9, 195.4), (105.2, 201.7)])
EXACT = 0.03  # px: the drawing's edges, seen by windows of twelve pixels


@cache
def view(board, noise=2.0):
    return picture(board, TILTED, SIZE, noise=noise)


def places(board, homography=TILTED):
    return truth(board, homography)


def assert_seen(detection, pixels, ids=None, atol=EXACT):
    np.testing.assert_array_equal(detection.ids, np.arange(len(pixels)) if ids is None else ids)
    np.testing.assert_allclose(detection.pixels, pixels[detection.ids], atol=atol)


@pytest.mark.parametrize("board", [ODD, EVEN, SQUARE, CHARUCO, LEGACY], ids=lambda board: f"{board.type}{board.rows}")
def test_every_corner_has_its_id(board):
    detection = detect(view(board), board)
    assert detection.reason is None
    assert_seen(detection, places(board), atol=2 * EXACT)  # noise of 2 gray levels adds 0.01 px


def turned_back(pixels, turns):
    """Return pixels of an image turned counter-clockwise as pixels of the image before."""
    width, height = SIZE if turns % 2 == 0 else SIZE[::-1]
    for _ in range(turns):
        pixels, (width, height) = np.column_stack([height - 1 - pixels[:, 1], pixels[:, 0]]), (height, width)
    return pixels


@pytest.mark.parametrize("turns", [1, 2, 3])
@pytest.mark.parametrize("board", [ODD, CHARUCO], ids=["chessboard", "charuco"])
def test_an_id_is_the_same_corner_however_the_camera_is_turned(board, turns):
    detection = detect(np.ascontiguousarray(np.rot90(view(board), turns)), board)
    np.testing.assert_array_equal(detection.ids, np.arange(board.count))
    before = detect(view(board), board).pixels
    np.testing.assert_allclose(turned_back(detection.pixels, turns), before, atol=EXACT)


@pytest.mark.parametrize("turns", range(4))
@pytest.mark.parametrize("board", [EVEN, SQUARE], ids=["half a turn", "a quarter turn"])
def test_rows_of_a_board_that_looks_the_same_turned_run_to_the_right(board, turns):
    detection = detect(np.ascontiguousarray(np.rot90(view(board), turns)), board)
    grid = detection.pixels.reshape(board.rows, board.columns, 2)
    along, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    assert along[0] * down[1] - along[1] * down[0] > 0  # seen from the front
    if board is SQUARE or turns % 2 == 0:
        assert along[0] > 0.9 * np.hypot(*along)


def test_a_chessboard_given_transposed_is_the_same_object_numbered_along_the_columns_given():
    straight, transposed = detect(view(ODD), ODD), detect(view(ODD), ODD.transposed())
    assert len(transposed.ids) == ODD.count
    corners = {tuple(pixel) for pixel in np.round(straight.pixels, 1)}
    assert {tuple(pixel) for pixel in np.round(transposed.pixels, 1)} == corners


@pytest.mark.parametrize(
    ("stated", "reason"),
    [
        ((5, 4), "a checker pattern of 6 x 5 corners, not 5 x 4"),
        ((6, 4), "a checker pattern of 6 x 5 corners, not 6 x 4"),
        ((7, 6), "only 6 x 5 of 7 x 6 corners visible"),
    ],
)
def test_a_board_of_another_size_is_not_taken_for_the_stated_one(stated, reason):
    detection = detect(view(ODD), Board("chessboard", *stated))
    assert not detection.found
    assert detection.reason == reason
    assert detection.other == Board("chessboard", 6, 5)


def test_a_board_that_leaves_the_image_says_so_and_its_rim_is_no_row_of_corners():
    cut = np.ascontiguousarray(view(ODD)[:, : int(places(ODD)[-1, 0]) - 8])
    assert detect(cut, ODD).reason == "board partly outside the image (5 x 5 corners visible)"


def test_a_side_of_which_most_is_in_the_image_is_enough():
    cut = np.ascontiguousarray(view(ODD)[:, : int(places(ODD)[5, 0]) - 3])
    detection = detect(cut, ODD)
    assert set(range(ODD.count)) - set(detection.ids) <= {5, 11}
    np.testing.assert_allclose(detection.pixels, places(ODD)[detection.ids], atol=4 * EXACT)  # windows cut by the rim


def test_an_image_without_a_board_says_so():
    wall = np.random.default_rng(0).integers(90, 110, (120, 160)).astype(np.uint8)
    assert detect(wall, ODD).reason == "no chessboard found"
    assert detect(wall, CHARUCO).reason == "no marker of DICT_4X4_50 found"
    assert detect(wall[:20], ODD).reason == "an image of 160 x 20 pixels is too small for a board"


def test_a_large_image_is_searched_in_a_reduced_copy_and_measured_in_full():
    homography = upright(EVEN, (1600, 1200))
    image = (
        cv2.warpPerspective(  # a picture of known corners, enlarged: linear interpolation keeps edges where they are
            picture(EVEN, upright(EVEN, (400, 300)), (400, 300)),
            homography @ np.linalg.inv(upright(EVEN, (400, 300))),
            (1600, 1200),
        )
    )
    assert_seen(detect(image, EVEN), places(EVEN, homography), atol=4 * EXACT)


def test_the_same_image_gives_the_same_bytes_whatever_was_done_before():
    threads = cv2.getNumThreads()
    first = detect(view(ODD), ODD)
    cv2.setNumThreads(2)
    cv2.setRNGSeed(17)
    try:
        second = detect(view(ODD), ODD)
        assert cv2.getNumThreads() == 2
    finally:
        cv2.setNumThreads(threads)
    assert first.pixels.tobytes() == second.pixels.tobytes()


def test_a_charuco_board_seen_in_part_keeps_its_ids():
    cut = np.ascontiguousarray(view(CHARUCO)[:, : int(places(CHARUCO)[3, 0]) + 10])
    detection = detect(cut, CHARUCO)
    assert set(detection.ids) == {id_ for id_ in range(CHARUCO.count) if id_ % CHARUCO.columns <= 3}
    np.testing.assert_allclose(detection.pixels, places(CHARUCO)[detection.ids], atol=2 * EXACT)


def test_corners_beside_a_hidden_marker_are_found_by_their_look():
    hidden = view(CHARUCO).copy()
    u, v = places(CHARUCO).mean(axis=0).astype(int)
    hidden[v - 30 : v + 30, u - 30 : u + 30] = 128
    detection = detect(hidden, CHARUCO)
    away = np.abs(places(CHARUCO) - (u, v)).max(axis=1)
    assert set(np.flatnonzero(away > 45)) <= set(detection.ids)
    assert not set(np.flatnonzero(away < 25)) & set(detection.ids)


def test_markers_may_begin_at_another_id():
    board = replace(CHARUCO, first_marker=20)
    assert_seen(detect(view(board), board), places(board), atol=2 * EXACT)
    assert not detect(view(board), CHARUCO).found


@pytest.mark.parametrize(("drawn", "looked_for"), [(CHARUCO, LEGACY), (LEGACY, CHARUCO)])
def test_the_other_pattern_yields_nothing(drawn, looked_for):
    detection = detect(view(drawn), looked_for)
    assert not detection.found
    assert detection.reason.endswith("markers in other positions than on this board")


@pytest.mark.slow
def test_a_board_of_unknown_pattern_is_found_in_both():
    for board in (CHARUCO, LEGACY):
        assert len(detect(view(board), replace(CHARUCO, legacy=None)).ids) == CHARUCO.count


def test_the_arrangements_of_a_board_begin_with_itself_and_hold_no_pair_alike():
    unknown = replace(CHARUCO, legacy=None)  # 6 × 4 squares: only even rows have a legacy pattern of their own
    assert arrangements(unknown) == (
        CHARUCO, LEGACY, CHARUCO.transposed(), LEGACY.transposed(),
    )  # fmt: skip
    odd = parse_board("charuco:7x5:40mm:30mm:DICT_4X4_50")
    assert [board.legacy for board in arrangements(odd)] == [False, False]
    assert arrangements(LEGACY) == (LEGACY, LEGACY.transposed())
    assert len(arrangements(parse_board("charuco:5x5:40mm:30mm:DICT_4X4_50"))) == 1


@pytest.mark.parametrize("drawn", [CHARUCO, LEGACY], ids=["current", "legacy"])
def test_markers_speak_for_the_arrangement_of_a_board_as_drawn_and_as_printed_inverted(drawn):
    candidates = arrangements(replace(CHARUCO, legacy=None))
    for image in (view(drawn), 255 - view(drawn)):
        votes = arrangement_votes(image, candidates)
        assert candidates[int(votes.argmax())] == drawn
        assert votes.sum() == votes.max()


def test_a_charuco_board_printed_white_on_black_is_read_and_said_to_be():
    image = view(CHARUCO)
    straight, inverted = detect(image, CHARUCO), detect(255 - image, CHARUCO)
    assert (straight.inverted, inverted.inverted) == (False, True)
    assert_seen(inverted, straight.pixels, straight.ids, atol=0.1)


@pytest.mark.parametrize("board", [ODD, EVEN], ids=["odd", "even"])
def test_a_chessboard_printed_white_on_black_is_read_and_said_to_be(board):
    image = view(board)
    straight, inverted = detect(image, board), detect(255 - image, board)
    assert (straight.inverted, inverted.inverted) == (False, True)
    pixels = straight.pixels[::-1] if board is ODD else straight.pixels  # its dark end is the other one
    assert_seen(inverted, pixels, atol=0.1)


@pytest.mark.parametrize(("hidden", "inverted"), [(1, True), (2, False)])
def test_a_chessboard_is_printed_white_on_black_where_three_sides_end_with_black(hidden, inverted):
    image = 255 - view(ODD)
    for y in [(-1.7, -1.0), (ODD.rows, ODD.rows + 0.7)][:hidden]:
        strip = np.array([(-1.7, y[0]), (ODD.columns + 0.7, y[0]), (ODD.columns + 0.7, y[1]), (-1.7, y[1])])
        corners = np.column_stack([strip / (ODD.columns - 1, ODD.rows - 1), np.ones(4)]) @ TILTED.T
        cv2.fillConvexPoly(image, np.rint(corners[:, :2] / corners[:, 2:]).astype(int), 130)
    detection = detect(image, ODD)
    assert (detection.found, detection.inverted) == (True, inverted)


def test_a_mirrored_charuco_image_says_so():
    assert detect(np.ascontiguousarray(view(CHARUCO)[:, ::-1]), CHARUCO).reason.startswith("the image is mirrored")


@pytest.mark.parametrize(
    ("board", "message"),
    [
        (replace(CHARUCO, dictionary="DICT_4x4_5"), "'DICT_4x4_5' is unknown; did you mean DICT_4X4_50?"),
        (replace(CHARUCO, first_marker=45), "the board needs markers 45 to 56, DICT_4X4_50 ends at 49"),
        (Board("chessboard", 6, 2), "6 x 2 inner corners is too small"),
    ],
)
def test_a_board_that_cannot_be_found_is_refused(board, message):
    with pytest.raises(InvalidInput, match=message.replace("?", r"\?")):
        detect(view(ODD), board)


def test_only_gray_images_of_eight_bits_are_searched():
    with pytest.raises(InvalidInput, match="8 bits, not in float64 of shape"):
        detect(view(ODD).astype(float), ODD)
