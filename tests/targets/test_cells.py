"""Cells of corners: read off a grid, or from a camera, they say the same."""

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.targets.board import Board
from camcal.targets.board_edges import BoardEdges, bright_depths, seen_cells
from camcal.targets.cells import Cells
from camcal.targets.grid import curvature, surrounded

BOARD = Board("chessboard", 7, 6, 0.03)
CAMERA = Camera(model_named("opencv5"), (640, 480), np.array([500.0, 505, 322, 238, -0.25, 0.06, 1e-3, -5e-4, 0]))
ROTATION = so3.exp(np.array([0.3, -0.4, 0.2]))
POSE = Pose(ROTATION, np.array([0.01, 0.0, 0.4]) - ROTATION @ np.array([0.09, 0.075, 0]))


def project(points):
    return CAMERA.project(POSE.apply(points)).pixels


def seen_grid():
    return project(BOARD.points()).reshape(BOARD.rows, BOARD.columns, 2)


def test_a_circle_of_nodes_bends_by_one_over_its_radius():
    angle, radius = np.linspace(0, 1, 6), np.array([80.0, 100, 120, 140])
    grid = np.stack([np.outer(radius, np.cos(angle)), np.outer(radius, np.sin(angle))], axis=-1)
    bend = curvature(grid, 0)  # along the circles, counter-clockwise by the axes: towards the left normal
    np.testing.assert_allclose(
        bend, np.repeat(1 / radius[:, None], 6, axis=1), rtol=0.05
    )  # smoothed by a plane over radii
    np.testing.assert_allclose(curvature(grid, 1), 0, atol=1e-12)


def test_cells_of_a_grid_are_those_that_its_camera_sees():
    _, expected = seen_cells(BOARD, BOARD.points(), project)
    cells = Cells.of_grid(seen_grid())
    np.testing.assert_allclose(cells.steps, expected.steps, atol=2.5)  # outer nodes know one side only, half a step off
    np.testing.assert_allclose(cells.bends * 20**2 / 2, expected.bends * 20**2 / 2, atol=0.02)  # px, 20 px away
    np.testing.assert_array_equal(cells.beside.border, expected.beside.border)
    within = ~cells.beside.border
    # px: a chord instead of the tangent of the next line
    np.testing.assert_allclose(cells.beside.lines[within][:, 2], expected.beside.lines[within][:, 2], atol=0.1)
    np.testing.assert_allclose(cells.beside.lines[..., 2], expected.beside.lines[..., 2], atol=0.03 * 40)  # of a step
    np.testing.assert_allclose(cells.beside.lines[..., :2], expected.beside.lines[..., :2], atol=0.03)


def test_nodes_around_a_grid_are_where_the_lens_puts_them():
    row, column = np.mgrid[-1 : BOARD.rows + 1, -1 : BOARD.columns + 1]
    points = np.stack([column, row, 0 * row], axis=-1).reshape(-1, 3) * BOARD.pitch
    expected = project(points).reshape(*row.shape, 2)
    # a twentieth of a step: a cubic cannot follow a lens of 25 % beyond what it has seen
    np.testing.assert_allclose(surrounded(seen_grid()), expected, atol=0.05 * 40)


def test_missing_nodes_are_left_out_and_their_neighbours_manage():
    grid = seen_grid()
    grid[2, 3] = np.nan
    cells = Cells.of_grid(grid)
    assert len(cells) == BOARD.count - 1
    assert np.isfinite(cells.steps).all()
    assert np.isfinite(cells.beside.lines).all()


def test_bright_squares_hold_the_print():
    depth = bright_depths((2, 2), 1, 0.1)
    np.testing.assert_array_equal(depth[0, 0], [[1, 0.1], [0.1, 1]])  # dark before both edges and after both
    np.testing.assert_array_equal(depth[0, 1], [[0.1, 1], [1, 0.1]])


def test_the_tag_lies_between_the_corners_of_an_aprilgrid():
    edges = BoardEdges.of(Board("aprilgrid", 2, 2, 0.13, 0.1, "tag36h11"))
    # lower left corner: the tag is after it both ways, the gap of 0.3 before; its border is 2 of 10 cells deep
    np.testing.assert_allclose(edges.reach[0], [[0.3, 1], [0.3, 1]])
    np.testing.assert_allclose(edges.depth[0], [[0.3, 0.3], [0.3, 0.2]])
    np.testing.assert_allclose(edges.reach[2], [[1, 0.3], [1, 0.3]])
    np.testing.assert_allclose(edges.depth[2], [[0.2, 0.3], [0.3, 0.3]])


def test_circles_have_no_crossing_edges():
    with pytest.raises(InvalidInput, match="no edges cross"):
        BoardEdges.of(Board("circles", 5, 4, 0.02, diameter=0.01))
