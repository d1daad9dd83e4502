"""Which images a report shows as thumbnails, and how long their residuals are drawn."""

from dataclasses import replace

import numpy as np
import pytest

from camcal.calibrate.intrinsics import Calibration, View
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.report.page.thumbnails import MOST, magnification, thumbnails, views_of
from camcal.targets.board import Board, Surface

BOARD = Board("chessboard", 9, 6, 0.025)
CAMERA = Camera(model_named("pinhole"), (1000, 800), np.array([900.0, 900.0, 499.5, 399.5]))
VIEWS = (
    View("good.png", 54, 54, 0.1),
    View("empty.png", 0, reason="no board found"),
    View("bad.png", 54, 54, 0.4),
    View("lost.png", 54, reason="median reprojection error 9 px", rejected=True),
    View("fair.png", 54, 54, 0.2),
)


def calibration(views=VIEWS, length=1.0):
    """A calibration with residuals of one length, px."""
    corners = sum(view.kept for view in views)
    residuals = np.tile([0.6 * length, 0.8 * length], (corners, 1))
    rows = np.repeat(np.arange(len(views)), [view.kept for view in views])
    return Calibration(CAMERA, BOARD, Surface(BOARD), views, (), 0.1, 300, 0.2, residuals, residuals + 400.0, rows, 5)


def test_the_worst_images_come_first_and_those_without_a_board_last():
    shown, _ = thumbnails(calibration(), {})
    assert [each.title for each in shown] == ["lost.png", "bad.png", "fair.png", "good.png", "empty.png"]
    assert [each.title for each in thumbnails(calibration(), {}, most=2)[0]] == ["lost.png", "bad.png"]


def test_twelve_images_are_shown():
    views = tuple(replace(VIEWS[0], image=f"{index}.png") for index in range(20))
    assert len(thumbnails(calibration(views), {})[0]) == MOST == 12


@pytest.mark.parametrize(("length", "factor"), [(1.0, 50), (0.9, 50), (1.1, 20), (0.01, 5000), (90.0, 1)])
def test_residuals_are_drawn_up_to_a_twentieth_of_the_width_long(length, factor):
    assert magnification(views_of(calibration(length=length)), 1000) == factor


def test_an_image_shows_its_own_corners():
    shown, factor = thumbnails(calibration(), {"bad.png": "data:image/jpeg;base64,AA=="})
    bad = shown[1]
    assert (factor, bad.used, bad.photo) == (50, True, "data:image/jpeg;base64,AA==")
    assert bad.dots.count("M") == bad.arrows.count("M") == 54
    assert bad.words == "RMS 0.4 px, 54 corners"
    assert (shown[0].dots, shown[0].words) == ("", "not used: median reprojection error 9 px")
