"""Shapes of simulated boards: the formulas at places where they can be read off."""

import numpy as np
import pytest

from camcal.simulate.render import FLAT, bow, cubic, stretch, twist
from camcal.targets.board import Board, basis

BOARD = Board("chessboard", 5, 3, 0.1)
MIDDLE, RIGHT, BOTTOM, CORNER = 7, 9, 12, 14  # ids of points at (0, 0), (1, 0), (0, 1), (1, 1)


def test_a_flat_board_is_as_drawn():
    assert np.array_equal(FLAT.points(BOARD), BOARD.points())
    assert FLAT.deflection(BOARD) == pytest.approx(0.0, abs=1e-15)  # metres; rounding of the plane fit


def test_a_bow_lifts_the_middle_over_the_sides():
    z = bow(1e-3, 0.5e-3).points(BOARD)[:, 2]
    assert z[[MIDDLE, RIGHT, BOTTOM, CORNER]] == pytest.approx([1.5e-3, 0.5e-3, 1e-3, 0.0])


def test_a_twist_lifts_two_corners_and_lowers_the_others():
    z = twist(0.5e-3).points(BOARD)[:, 2]
    assert z[[0, 4, 10, CORNER, MIDDLE]] == pytest.approx([0.5e-3, -0.5e-3, -0.5e-3, 0.5e-3, 0.0])


def test_a_cubic_is_zero_in_the_middle_and_at_the_sides():
    z = cubic(0.5e-3).points(BOARD)[:, 2]
    assert z[[MIDDLE, RIGHT, MIDDLE + 1]] == pytest.approx([0.0, 0.0, 0.5e-3 * (0.125 - 0.5)])


def test_a_stretch_lengthens_x_and_leaves_y():
    points = stretch(0.01).points(BOARD)
    assert np.ptp(points[:, 0]) == pytest.approx(1.01 * BOARD.extent[0])
    assert np.array_equal(points[:, 1], BOARD.points()[:, 1])


def test_shapes_add_up():
    both = bow(1e-3, 0.0) + twist(0.5e-3) + stretch(0.01)
    assert both.points(BOARD)[CORNER] == pytest.approx([0.402, 0.2, 0.5e-3])


def test_the_border_follows_the_formula_outside_the_points():
    outside = bow(1e-3, 0.0).apply(BOARD, np.array([[0.6, 0.1]]))  # x = 2 in units of half the width
    assert outside[0] == pytest.approx([0.6, 0.1, -3e-3])


def test_deflection_is_peak_to_peak_without_what_a_pose_takes():
    assert twist(0.5e-3).deflection(BOARD) == pytest.approx(1e-3)
    assert bow(1e-3, 0.0).deflection(BOARD) == pytest.approx(1e-3)


def test_every_shape_is_within_reach_of_what_calibration_estimates():
    shape = bow(1e-3, 0.5e-3) + twist(0.4e-3) + cubic(0.3e-3) + stretch(0.003)
    bent = shape.points(BOARD) - BOARD.points()
    terms = ("xy", "P2(x)", "P2(y)", "P3(x)", "x/y scale")
    rigid = np.zeros((BOARD.count, 3, 3))
    rigid[:, 2, 0], rigid[:, 2, 1] = 1.0, BOARD.points()[:, 0]  # height and tilt
    rigid[:, :2, 2] = BOARD.points()[:, :2] - np.array(BOARD.extent) / 2  # scale
    design = np.concatenate([basis(BOARD, terms), rigid], axis=2).reshape(-1, len(terms) + 3)
    left = bent.ravel() - design @ np.linalg.lstsq(design, bent.ravel(), rcond=None)[0]
    assert np.abs(left).max() < 1e-15  # metres: rounding
