"""Cells of corners, as a camera sees them: their edges, how these bend, and those beside them."""

from dataclasses import replace

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.targets.board import Board
from camcal.targets.corner_cells import Cells, sample_cells
from camcal.targets.corner_measurement import board_edges, seen_cells

BOARD = Board("chessboard", 7, 6, 0.03)
CAMERA = Camera(model_named("opencv5"), (640, 480), np.array([500.0, 505, 322, 238, -0.25, 0.06, 1e-3, -5e-4, 0]))
ROTATION = so3.exp(np.array([0.3, -0.4, 0.2]))
POSE = Pose(ROTATION, np.array([0.01, 0.0, 0.4]) - ROTATION @ np.array([0.09, 0.075, 0]))


def project(points):
    return CAMERA.project(POSE.apply(points)).pixels


def cells_seen(ids=None):
    ids = np.arange(BOARD.count) if ids is None else ids
    return seen_cells(BOARD, ids, BOARD.points()[ids], project, 20.0)


def test_edges_are_where_the_lens_bends_them():
    pixels, cells = cells_seen()
    for edge, axis in enumerate(np.eye(3)[:2] * BOARD.spacing):
        tangent = cells.steps[:, :, edge] / np.linalg.norm(cells.steps[:, :, edge], axis=1)[:, None]
        normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
        for share in (-0.4, -0.2, 0.3, 0.5):
            off = project(BOARD.points() + share * axis) - pixels
            along, away = (off * tangent).sum(axis=1), (off * normal).sum(axis=1)
            np.testing.assert_allclose(away, cells.bends[:, edge] / 2 * along**2, atol=0.01)  # px, of 20 along


def test_the_edges_beside_a_corner_go_through_its_neighbours():
    ids = np.arange(BOARD.count)
    pixels, cells = cells_seen()
    a, b, c = np.moveaxis(cells.beside.lines, -1, 0)
    for edge, stride in ((0, BOARD.columns), (1, 1)):
        inner = ~cells.beside.border[:, edge].any(axis=1)
        for neighbour in (ids[inner] - stride, ids[inner] + stride):
            x, y = (pixels[neighbour] - pixels[inner]).T[..., None]
            distance = np.abs(a[inner, edge] * x + b[inner, edge] * y + c[inner, edge]).min(axis=1)
            np.testing.assert_allclose(distance, 0, atol=1e-9)
    assert (c[:, :, 0] > 0).all()  # the first line lies on the right
    assert (c[:, :, 1] < 0).all()


def test_cells_of_some_points_are_those_among_all():
    ids = np.array([3, 11, 40])
    some, every = cells_seen(ids)[1], cells_seen()[1].take(ids)
    for name in ("steps", "bends", "reach", "depth"):
        np.testing.assert_allclose(getattr(some, name), getattr(every, name), atol=1e-12)
    np.testing.assert_allclose(some.beside.lines, every.beside.lines, atol=1e-9)


def test_blur_brings_the_next_edges_in():
    cells = cells_seen()[1]
    assert not cells.crowded(1.0)
    assert cells.crowded(6.0)
    assert not cells.take(np.zeros(0, np.intp)).crowded(6.0)
    assert not replace(cells, beside=None).crowded(6.0)


def test_bright_squares_hold_the_print():
    depth = board_edges(Board("charuco", 2, 2, 0.05, 0.04, "DICT_4X4_50"))[2]
    np.testing.assert_allclose(depth[0], [[1, 0.1], [0.1, 1]])  # dark before both edges and after both
    np.testing.assert_allclose(depth[1], [[0.1, 1], [1, 0.1]])


def test_the_tag_lies_between_the_corners_of_an_aprilgrid():
    _, reach, depth = board_edges(Board("aprilgrid", 2, 2, 0.13, 0.1, "tag36h11"))
    # lower left corner: the tag is after it both ways, the gap of 0.3 before; its border is 2 of 10 cells deep
    np.testing.assert_allclose(reach[0], [[0.3, 1], [0.3, 1]])
    np.testing.assert_allclose(depth[0], [[0.3, 0.3], [0.3, 0.2]])
    np.testing.assert_allclose(reach[2], [[1, 0.3], [1, 0.3]])
    np.testing.assert_allclose(depth[2], [[0.2, 0.3], [0.3, 0.3]])


def test_circles_have_no_crossing_edges():
    with pytest.raises(InvalidInput, match="has no checkerboard corners"):
        board_edges(Board("circles", 5, 4, 0.02, diameter=0.01))


def test_corners_that_the_lens_has_no_image_of_do_not_count_among_the_narrowest():
    steps = np.array([[[3.0, 1.0], [0.0, 4.0]], [[20.0, 0.0], [0.0, 30.0]], np.full((2, 2), np.nan)])
    cells = Cells(steps, np.zeros((3, 2)), np.ones((3, 2, 2)), np.ones((3, 2, 2)))
    assert cells.narrowest() == pytest.approx(12 / np.sqrt(17))  # the area over the longer side
    assert cells.take(np.array([1])).narrowest() == 20


def test_a_cell_whose_corners_fell_on_one_place_measures_nothing_and_leaves_the_others_as_they_are():
    gray = np.random.default_rng(1).uniform(0, 255, (60, 60))
    steps = np.tile(np.array([[12.0, 1.0], [0.5, 11.0]]), (2, 1, 1))
    fallen = steps.copy()
    fallen[1, :, 1] = 0.0
    ones = np.ones((2, 2, 2))
    pixels = np.array([[20.0, 20.0], [40.0, 35.0]])
    whole, found = (
        sample_cells(gray, pixels, Cells(own, np.zeros((2, 2)), ones, ones), 1.0) for own in (steps, fallen)
    )
    assert found.used[0].sum() == whole.used[0].sum() > 20
    assert np.isfinite(found.x).all()
