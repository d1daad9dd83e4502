"""Pictures of corners: marks stand where corners are, in a small image as in a large one, and words say the rest."""

from dataclasses import replace

import numpy as np
import pytest

from camcal.report.overlays import MOST_WIDTH, Canvas, corner_overlay
from camcal.targets.board import Board
from camcal.targets.detect import detect
from camcal.targets.detection import BoardDetection

GREEN, YELLOW = (80, 255, 80), (0, 235, 255)  # blue, green, red


def view(size=(1000, 800), step=80.0, covariance=None, ids=None, columns=6, rows=4):
    """Return a view of a grid whose first corner is at 1.5 steps from the image's corner."""
    row, column = np.divmod(np.arange(columns * rows), columns)
    pixels = step * (np.column_stack([column, row]) + 1.5)
    kept = np.arange(len(pixels)) if ids is None else np.array(ids)
    some = None if covariance is None else np.broadcast_to(covariance, (len(kept), 2, 2))
    return BoardDetection("folder/photo.jpg", size, kept, pixels[kept], some)


def gray(size=(1000, 800), level=100):
    return np.full((size[1], size[0]), level, np.uint8)


def of_colour(picture, colour, tolerance=40):
    """Return the places (N, 2), x and y, of a colour."""
    near = (np.abs(picture.astype(int) - colour) < tolerance).all(axis=2)
    rows, columns = np.nonzero(near)
    return np.column_stack([columns, rows])


def colours_at(picture, pixel, radius=3):
    x, y = np.rint(pixel).astype(int)
    return picture[y - radius : y + radius + 1, x - radius : x + radius + 1].reshape(-1, 3).astype(int)


def saturation(colours):
    return np.ptp(colours, axis=1).max()


def test_every_corner_has_its_ring_and_the_rest_is_the_image():
    seen = view()
    picture = corner_overlay(gray(), seen)
    assert picture.shape[1] == 1000
    assert picture.shape[0] > 800
    assert all(saturation(colours_at(picture, pixel, 6)) > 60 for pixel in seen.pixels)
    assert np.ptp(picture[:80]) == 0
    assert np.ptp(picture[600:800, :90]) == 0


def test_the_line_runs_from_blue_to_red_along_the_ids():
    seen = view()
    picture = corner_overlay(gray(), seen)
    first, last = (colours_at(picture, seen.pixels[index : index + 2].mean(axis=0), 2) for index in (0, 22))
    first, last = (colours[np.ptp(colours, axis=1).argmax()] for colours in (first, last))
    assert first[0] > first[2] + 60
    assert last[2] > last[0] + 60


def test_a_green_square_is_around_the_first_corner_whichever_it_is():
    for ids in (None, [9, 8, 14, 15]):
        seen = view(ids=ids)
        expected = seen.pixels[seen.ids.argmin()]
        places = of_colour(corner_overlay(gray(), seen)[:800], GREEN)
        square = places[(np.abs(places - expected) < 15).all(axis=1)]
        assert len(square) > 50
        np.testing.assert_allclose((square.min(axis=0) + square.max(axis=0)) / 2, expected, atol=2.5)  # lines are thick


def test_ellipses_lie_as_the_covariance_does():
    spread = np.array([[0.0004, 0.0], [0.0, 0.0001]])  # 0.02 px along x, 0.01 px along y
    seen = view(covariance=spread)
    places = of_colour(corner_overlay(gray(), seen)[:800], YELLOW, 60)
    near = places[(np.abs(places - seen.pixels[8]) < 39).all(axis=1)]
    # 0.3 of 80 px is room for 1000 times 0.02 px
    np.testing.assert_allclose(np.ptp(near, axis=0), [40, 20], atol=3)  # lines are a pixel thick or two


def test_without_covariances_there_are_no_ellipses():
    assert len(of_colour(corner_overlay(gray(), view())[:800], YELLOW, 20)) == 0


@pytest.mark.parametrize("size", [(250, 200), (640, 480), (5000, 4000)])
def test_marks_stand_at_the_same_share_of_the_picture_whatever_its_size(size):
    step = 0.08 * size[0]
    seen = view(size, step)
    picture = corner_overlay(gray(size), seen)
    assert 900 <= picture.shape[1] <= MOST_WIDTH
    scale = picture.shape[1] / size[0]
    for pixel in seen.pixels[[0, 5, -1]]:
        assert saturation(colours_at(picture, (pixel + 0.5) * scale - 0.5, 12)) > 60
    places = of_colour(picture[: int(size[1] * scale)], GREEN)
    ring = places[(np.abs(places - seen.pixels[0] * scale) < 40).all(axis=1)]
    middle = (ring.min(axis=0) + ring.max(axis=0)) / 2
    np.testing.assert_allclose(middle[1], seen.pixels[0, 1] * scale, atol=25)  # the id stands right above the square


def test_ids_are_written_where_there_is_room():
    wide, close = (corner_overlay(gray(), view(step=step))[:800] for step in (100.0, 30.0))
    assert len(of_colour(wide, (255, 255, 255), 100)) > 5 * len(of_colour(close, (255, 255, 255), 100))  # the last only


def test_an_image_without_the_board_has_the_reason_in_large_letters():
    reason = "only 3 x 2 of 6 x 5 corners visible, which is not enough for it"
    nothing = BoardDetection("a.png", (1000, 800), reason=reason)
    picture = corner_overlay(gray(), nothing)
    red = of_colour(picture[:800], (70, 70, 255))
    assert len(red) > 2000
    assert np.ptp(red[:, 0]) > 400
    assert red[:, 0].max() < 990
    assert len(of_colour(picture[:800], GREEN)) == 0


def test_corners_outside_the_picture_do_not_fail():
    far = BoardDetection("a.png", (1000, 800), np.arange(3), np.array([[1e6, 0.0], [-20.0, 400.0], [500.0, 400.0]]))
    assert corner_overlay(gray(), far).shape[1] == 1000


def test_a_single_corner_is_drawn():
    assert saturation(colours_at(corner_overlay(gray(), view(ids=[7])), view().pixels[7], 6)) > 60


def test_reduced_pictures_keep_the_places_of_pixels():
    canvas = Canvas.of(gray((5001, 3000)), MOST_WIDTH)
    assert canvas.pixels.shape == (1000, 1667, 3)
    assert canvas.place(np.array([1.0, 1.0])) == (0, 0)  # the middle of the first three by three pixels
    assert canvas.place(np.array([np.nan, 1.0])) is None


def test_points_that_were_refused_have_red_rings_and_are_counted():
    refused = np.array([[200.0, 300.0], [240.0, 300.0], [np.nan, np.nan]])
    nothing = replace(BoardDetection.nothing("only 2 corners", refused=refused), image="a.png")
    assert nothing.refused.shape == (2, 2)
    picture = corner_overlay(gray(), nothing)
    rings = of_colour(picture, (70, 70, 255))
    for pixel in refused[:2]:
        distances = np.linalg.norm(rings - pixel, axis=1)
        assert ((distances > 2) & (distances < 7)).sum() > 8
    without = corner_overlay(gray(), BoardDetection("a.png", reason="only 2 corners"))
    assert picture.shape[0] > without.shape[0]  # the line that counts them


def test_a_board_of_another_size_keeps_the_points_that_it_is_refused_with():
    board = np.full((480, 640), 200, np.uint8)
    for row in range(6):
        for column in range(9):
            if (row + column) % 2:
                board[60 + 50 * row : 110 + 50 * row, 80 + 50 * column : 130 + 50 * column] = 40
    seen = detect(board, Board("chessboard", 10, 7))
    assert "8 x 5" in seen.reason
    corners = np.stack(np.meshgrid(130 + 50 * np.arange(8), 110 + 50 * np.arange(5)), axis=-1).reshape(-1, 2) - 0.5
    nearest = np.linalg.norm(seen.refused[:, None] - corners, axis=2).min(axis=1)
    assert (len(seen.refused), nearest.max() < 1) == (40, True)
