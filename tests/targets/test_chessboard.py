"""Chessboards in images that make them hard to find; none of their corners may be wrong."""

import numpy as np
import pytest
from hard_scenes import SCENES, photographs

from camcal.targets.board import parse_board
from camcal.targets.checker.chessboard import find_chessboard

BOARD = parse_board("chessboard:9x6:20mm")
LIMITS = {"covered": 0.75}  # share of the corners that is seen
WRONG_PX = 1.0  # before corners are measured; the next one is 5 px away at least


@pytest.mark.parametrize("name", [name for name in SCENES if name not in ("16 MP", "no board")])
def test_boards_are_found_and_no_corner_is_wrong(name):
    (image, truth), *_ = photographs(SCENES[name], BOARD, 1, seed=3)
    detection = find_chessboard(image, BOARD)
    assert len(detection.ids) >= LIMITS.get(name, 0.95) * BOARD.count, detection.reason
    away = np.linalg.norm(detection.pixels - truth[detection.ids], axis=1)
    assert away.max() < WRONG_PX


def test_a_room_without_a_board_has_none():
    for image, _ in photographs(SCENES["no board"], BOARD, 2):
        for size in ("9x6", "3x3"):
            detection = find_chessboard(image, parse_board(f"chessboard:{size}"), partial=True)
            assert not detection.found


def test_a_picture_of_a_board_on_a_screen_is_not_taken_for_the_board_before_it():
    (image, truth), *_ = photographs(SCENES["barrel k1 -0.35"], BOARD, 1, seed=3)
    low, high = truth.min(axis=0), truth.max(axis=0)
    before = low.sum() > (np.array(image.shape[::-1]) - high).sum()
    free = np.s_[:128, :160] if before else np.s_[-128:, -160:]  # the corner of the image farther from the board
    image[free] = image[::8, ::8]
    detection = find_chessboard(image, BOARD)
    assert np.linalg.norm(detection.pixels - truth[detection.ids], axis=1).max() < WRONG_PX
