"""The eccentricity of projected circles: what is taken off, against the conic and against brute force."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares

from camcal.targets.board_types import grid_points
from camcal.targets.circles import projected_centres
from camcal.targets.ellipses import Ellipses, square_roots

POINTS = grid_points(7, 5)
RADIUS = 0.3
SIZE = (640, 480)
LEFT_PX = 5e-3  # rounds leave less than a hundredth of offsets


def seen_at(tilt, turn, distance=9.0, focal=600.0):
    """Return the homography (3, 3) of a board before a pinhole, lengths in pitches."""
    axis = np.array([np.cos(turn), np.sin(turn), 0])
    cross = np.cross(np.eye(3), -axis)
    rotation = np.eye(3) + np.sin(tilt) * cross + (1 - np.cos(tilt)) * cross @ cross
    shift = np.array([0, 0, distance]) - rotation @ [3, 2, 0]
    return np.array([[focal, 0, 330], [0, focal, 230], [0, 0, 1]]) @ np.column_stack([rotation[:, :2], shift])


def apply_homography(homography, points):
    moved = points @ homography[:, :2].T + homography[:, 2]
    return moved[..., :2] / moved[..., 2:]


def conics(homography, points, radius=RADIUS):
    """Return the ellipses of discs by their dual conics, E = H diag(r², r², -1) Hᵀ."""
    centres, axes = [], []
    for x, y in points:
        moved = homography @ np.array([[1, 0, x], [0, 1, y], [0, 0, 1]])
        dual = moved @ np.diag([radius**2, radius**2, -1]) @ moved.T
        dual /= dual[2, 2]
        centres.append(dual[:2, 2])
        axes.append(np.outer(dual[:2, 2], dual[:2, 2]) - dual[:2, :2])
    return Ellipses(np.array(centres), square_roots(np.array(axes)))


@given(tilt=st.floats(0, 1.1), turn=st.floats(0, 6.28))
def test_the_projected_centre_follows_from_the_ellipse(tilt, turn):
    homography = seen_at(tilt, turn)
    ellipses, true = conics(homography, POINTS), apply_homography(homography, POINTS)
    centres = projected_centres(ellipses, POINTS, RADIUS, SIZE)
    offsets = np.linalg.norm(ellipses.centres - true, axis=1)
    np.testing.assert_allclose(centres, true, rtol=0, atol=max(1e-2 * offsets.max(), 1e-6))


def test_the_ellipses_centres_are_far_from_it():
    homography = seen_at(0.8, 0.5)
    off = conics(homography, POINTS).centres - apply_homography(homography, POINTS)
    assert np.linalg.norm(off, axis=1).min() > 0.1


def test_the_radius_follows_from_the_areas():
    homography = seen_at(0.8, 0.5)
    centres = projected_centres(conics(homography, POINTS), POINTS, None, SIZE)
    np.testing.assert_allclose(centres, apply_homography(homography, POINTS), atol=LEFT_PX)


def fitted(outline):
    """Return centre and axes of the ellipse whose normal distance to an outline (K, 2) is least."""
    lengths = np.linalg.norm(np.roll(outline, -1, axis=0) - np.roll(outline, 1, axis=0), axis=1)

    def residuals(p):
        (u, v), inverse = (outline - p[:2]).T, np.linalg.inv([[p[2], p[3]], [p[3], p[4]]])
        unit = inverse @ [u, v]
        radius = np.hypot(*unit)
        return np.sqrt(lengths) * (radius - 1) * radius / np.hypot(*(inverse @ unit))

    spread = square_roots(2 * np.cov(outline.T)[None])[0]
    return least_squares(residuals, [*outline.mean(axis=0), *spread[[0, 0, 1], [0, 1, 1]]], xtol=1e-14).x


@pytest.mark.parametrize("k1", [-0.3, 0.3])
def test_a_lens_that_bends_the_board_moves_centres_as_it_moves_rims(k1):
    homography = seen_at(0.7, 2.0)

    def lens(points):
        plane = (apply_homography(homography, points) - [330, 230]) / 600  # its axis is off the image's middle
        return [330, 230] + 600 * plane * (1 + k1 * (plane**2).sum(axis=-1, keepdims=True))

    angles = 2 * np.pi * np.arange(90) / 90
    rims = lens(POINTS[:, None] + RADIUS * np.column_stack([np.cos(angles), np.sin(angles)]))
    ellipses = np.array([fitted(outline) for outline in rims])
    seen = Ellipses(ellipses[:, :2], ellipses[:, [2, 3, 3, 4]].reshape(-1, 2, 2))
    assert np.linalg.norm(seen.centres - lens(POINTS), axis=1).max() > 0.1
    # what a lens whose axis is 14 px off leaves of 0.1 px and more, a polynomial of degree 3 follows in the main
    np.testing.assert_allclose(projected_centres(seen, POINTS, RADIUS, SIZE), lens(POINTS), atol=0.01)
