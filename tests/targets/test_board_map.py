"""The map from a flat board to the pixels of a lens that is not known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.geometry.pose import Pose
from camcal.targets.board_map import Radial, map_of
from camcal.targets.board_types import grid_points

SIZE = (640, 480)
POSE = Pose.from_vector(np.array([0.5, -0.6, 0.3]), [-3.2, -2.1, 6.0])


def seen(points, coefficients, model="opencv5"):
    camera = Camera(model_named(model), SIZE, [500, 501, 326, 236, *coefficients])
    return camera.project(POSE.apply(np.column_stack([points, np.zeros(len(points))]))).pixels


@given(first=st.floats(-0.4, 0.3), second=st.floats(-0.1, 0.1))
def test_bending_undoes_straightening(first, second):
    radial = Radial(np.array([320.0, 240.0]), 400.0, np.array([first, second, 0.01]))
    pixels = np.random.default_rng(1).uniform([0, 0], SIZE, (50, 2))
    np.testing.assert_allclose(radial.bent(radial.straight(pixels)), pixels, atol=1e-6)  # of Newton's quadratic steps


@pytest.mark.parametrize(
    ("shape", "tolerance"),
    [((10, 8), 0.015), ((7, 5), 0.05)],  # strong lenses: what three terms leave, the polynomial follows in the main
)
@pytest.mark.parametrize(
    "lens", [(-0.3, 0.1, 1e-3, -1e-3, 0.0), (0.15, 0.0, 0.0, 0.0, 0.0)], ids=["barrel", "pincushion"]
)
def test_the_points_between_those_of_a_board_are_where_the_lens_shows_them(shape, tolerance, lens):
    points = grid_points(*shape) * 6 / (max(shape) - 1)
    spacing = 6 / (max(shape) - 1)
    between = points[np.all(points < points.max(axis=0) - 0.1, axis=1)] + spacing / 2
    found = map_of(points, seen(points, lens), SIZE)
    np.testing.assert_allclose(found.pixels(between), seen(between, lens), atol=tolerance)


def test_a_fisheye_is_followed_too():
    points = grid_points(10, 8) * 6 / 9
    lens = (0.05, -0.01, 0.0, 0.0)
    found = map_of(points, seen(points, lens, "kannala_brandt4"), SIZE)
    between = points[np.all(points < points.max(axis=0) - 0.1, axis=1)] + 1 / 3
    np.testing.assert_allclose(found.pixels(between), seen(between, lens, "kannala_brandt4"), atol=0.005)


def test_four_points_make_a_homography():
    corners = grid_points(2, 2) * 3
    pixels = seen(corners, (0.0, 0.0, 0.0, 0.0, 0.0))
    inside = np.array([[1.0, 2.0], [0.3, 2.9]])
    found = map_of(corners, pixels, SIZE)
    np.testing.assert_allclose(found.pixels(inside), seen(inside, (0.0,) * 5), atol=1e-6)  # an eigenvector of squares
