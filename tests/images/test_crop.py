"""Boxes inside and around an outline."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camcal.images.views import enclosing_box, largest_box

TURN = np.linspace(0, 2 * np.pi, 2000, endpoint=False)


def polygon(corners, per_side=500):
    corners = np.array(corners, dtype=float)
    share = np.linspace(0, 1, per_side, endpoint=False)[:, None]
    return np.concatenate([a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])


def barrel(bend_x, bend_y):
    """The outline of a barrel lens: a rectangle whose sides bend inwards."""
    sides = polygon([[-1.2, -0.8], [1.2, -0.8], [1.2, 0.8], [-1.2, 0.8]], 200)
    return sides * (1 - np.column_stack([bend_x * (0.64 - sides[:, 1] ** 2), bend_y * (1.44 - sides[:, 0] ** 2)]))


def area(box):
    return (box[2] - box[0]) * (box[3] - box[1])


def strictly_inside(outline, box):
    return ((outline > box[:2] + 1e-9) & (outline < box[2:] - 1e-9)).all(axis=1)


def test_a_rectangle_is_its_own_largest_box():
    outline = polygon([[-2, -1], [3, -1], [3, 1], [-2, 1]])
    np.testing.assert_allclose(largest_box(outline, None), [-2, -1, 3, 1], atol=0.05)  # 1 % of the aspect
    np.testing.assert_allclose(enclosing_box(outline, None), [-2, -1, 3, 1])


@pytest.mark.parametrize("aspect", [0.5, 1.0, 1.5])
def test_the_largest_box_in_a_circle_has_its_corners_on_it(aspect):
    circle = np.column_stack([np.cos(TURN), np.sin(TURN)])
    box = largest_box(circle, aspect)
    assert (box[2] - box[0]) / (box[3] - box[1]) == pytest.approx(aspect)
    np.testing.assert_allclose(np.hypot(box[[0, 2, 0, 2]], box[[1, 1, 3, 3]]), 1, atol=2e-3)  # samples 0.003 apart


def test_the_largest_box_in_a_circle_is_a_square():
    box = largest_box(np.column_stack([np.cos(TURN), np.sin(TURN)]), None)
    assert area(box) == pytest.approx(2, rel=0.01)  # flat about the best aspect


@settings(max_examples=20)
@given(st.floats(0, 0.25), st.floats(0, 0.25), st.floats(-0.3, 0.3), st.floats(-0.2, 0.2))
def test_a_box_in_a_barrel_is_inside_and_as_large_as_an_exhaustive_search_finds(bend_x, bend_y, shift_x, shift_y):
    outline = barrel(bend_x, bend_y) + np.array([shift_x, shift_y])
    box = largest_box(outline, 1.5)
    assert not strictly_inside(outline, box).any()
    stretch = [1.5, 1.0]
    centres = np.stack(np.meshgrid(np.linspace(-0.6, 0.6, 31), np.linspace(-0.4, 0.4, 21)), axis=-1).reshape(-1, 2)
    reach = np.abs((outline - centres[:, None]) / stretch).max(axis=2).min(axis=1)
    height = (box[3] - box[1]) / 2
    # a box may give 1 % of its distance from the axis for standing nearer to it
    assert height >= reach.max() - 0.01 * np.abs(centres / stretch).sum(axis=1).max() - 0.005


def test_a_box_stays_on_the_axis_where_moving_gains_nothing():
    box = largest_box(polygon([[-3, -1], [3, -1], [3, 1], [-3, 1]]), 1.0)
    np.testing.assert_allclose(box, [-1, -1, 1, 1], atol=1e-6)


@pytest.mark.parametrize(("aspect", "expected"), [(1.0, [-3, -3, 3, 3]), (6.0, [-6, -1, 6, 1]), (3.0, [-3, -1, 3, 1])])
def test_an_enclosing_box_grows_to_its_shape_about_the_middle(aspect, expected):
    np.testing.assert_allclose(enclosing_box(polygon([[-3, -1], [3, -1], [3, 1], [-3, 1]]), aspect), expected)


@pytest.mark.parametrize("inset", [0.0, 1e-300, 1e-9, 1e-4, 0.3])
def test_the_largest_box_is_found_wherever_the_axis_lies(inset):
    """On the outline or next to it the search once took a step of that distance, or none, again and again."""
    along, down = np.linspace(0, 2, 81), np.linspace(-1, 1, 81)
    outline = np.array([(x, y) for x in along for y in (-1, 1)] + [(x, y) for y in down for x in (0, 2)])
    box = largest_box(outline - (inset, 0.0), 1.0)
    np.testing.assert_allclose(box, [-inset, -1, 2 - inset, 1], atol=0.02)
