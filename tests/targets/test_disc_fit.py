"""The picture of a blurred disc, and dots fitted with it."""

import cv2
import numpy as np
import pytest
from scipy.integrate import trapezoid
from scipy.special import ndtr

from camcal.targets.disc_fit import fit_discs
from camcal.targets.ellipses import Ellipses, picture, rim

RAYS = 8  # per pixel and axis


def ellipse(long, short, turn):
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return rotation @ np.diag([long, short]) @ rotation.T


def drawn(size, ellipses, blur, *, noise=0.0, dark=40.0, bright=200.0):
    """Return an image (H, W) uint8 of dark ellipses, every pixel the mean of rays, blurred by a Gaussian."""
    pad = 8
    offsets = (np.arange(RAYS) + 0.5) / RAYS - 0.5
    x, y = ((np.arange(-pad, length + pad)[:, None] + offsets).ravel() for length in size)
    covered = np.zeros((len(y), len(x)), bool)
    for centre, axes in zip(ellipses.centres, ellipses.axes, strict=True):
        columns, rows = (np.flatnonzero(np.abs(line - place) < 13) for line, place in zip((x, y), centre, strict=True))
        away = np.stack(np.meshgrid(x[columns] - centre[0], y[rows] - centre[1]))
        inside = np.linalg.norm(np.tensordot(np.linalg.inv(axes), away, 1), axis=0) < 1
        covered[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] |= inside
    fine = np.where(covered, dark, bright)
    fine = cv2.GaussianBlur(fine, (0, 0), blur * RAYS)
    image = fine.reshape(len(y) // RAYS, RAYS, -1, RAYS).mean(axis=(1, 3))[pad:-pad, pad:-pad]
    noisy = image + np.random.default_rng(3).normal(0, noise, image.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def disc_under_blur(distance, radius, blur):
    """Return the blurred indicator of a disc, integrated over the chords across the line of sight."""
    y = np.linspace(-radius, radius, 20001)
    half, place = np.sqrt(radius**2 - y**2), radius + distance
    chord = ndtr((half - place) / blur) - ndtr((-half - place) / blur)
    return trapezoid(chord * np.exp(-0.5 * (y / blur) ** 2), y) / blur / np.sqrt(2 * np.pi)


@pytest.mark.parametrize(("radius", "blur", "tolerance"), [(13, 0.76, 2e-5), (6, 1.5, 1.5e-3), (6, 3.0, 4e-3)])
def test_the_picture_is_that_of_a_disc_under_a_gaussian(radius, blur, tolerance):
    """The rule of three points is exact to the second power of κ s; of the third little is left."""
    distance = np.linspace(-2 * blur, 2 * blur, 9) if blur < 3 else np.linspace(-2, 4, 9)
    value = picture(distance[None], np.full((1, 9), 1 / radius), np.array([[blur]]))[0]
    np.testing.assert_allclose(value[0], [disc_under_blur(d, radius, blur) for d in distance], atol=tolerance)


def test_the_pictures_derivatives_are_its_slopes():
    distance, curvature, blur, h = np.linspace(-3, 3, 13)[None], np.full((1, 13), 0.2), np.array([[1.3]]), 1e-5
    _, by_distance, by_blur = picture(distance, curvature, blur)
    along = picture(distance + h, curvature, blur)[0] - picture(distance - h, curvature, blur)[0]
    np.testing.assert_allclose(by_distance, along / 2 / h, atol=1e-6)  # the constants are of single precision
    wider = picture(distance, curvature, blur + h)[0] - picture(distance, curvature, blur - h)[0]
    np.testing.assert_allclose(by_blur, wider / 2 / h, atol=1e-6)  # likewise


@pytest.mark.parametrize("short", [9.0, 5.0, 2.5])
def test_distances_are_to_the_nearest_point_of_the_ellipse(short):
    axes = ellipse(10.0, short, 0.4)
    angles = np.linspace(0, 2 * np.pi, 20_000)
    outline = axes @ np.stack([np.cos(angles), np.sin(angles)])
    places = np.random.default_rng(4).uniform(-12, 12, (200, 2))
    brute = np.array([np.hypot(*(outline - place[:, None])).min() for place in places])
    near = brute < 2.4  # the band that fits look at
    inside = np.linalg.norm(places @ np.linalg.inv(axes), axis=1) < 1
    found = rim(*places[near].T[:, None], axes[None]).distance[0]
    assert near.sum() > 50
    np.testing.assert_allclose(found, np.where(inside, -brute, brute)[near], atol=1e-3)  # three steps of a search


@pytest.mark.parametrize("blur", [0.5, 1.2])
def test_ellipses_are_found_to_a_hundredth_of_a_pixel(blur):
    truth = Ellipses(np.array([[30.3, 31.8], [80.1, 30.6]]), np.stack([ellipse(12, 7, 0.7), ellipse(9, 8.5, 2.0)]))
    start = Ellipses(truth.centres + np.array([0.5, -0.4]), truth.axes + 0.5 * np.eye(2))
    fits = fit_discs(drawn((110, 62), truth, blur), start)
    # an edge drawn by eight rays is placed to 1/16 px where it runs along a row, and far better on the whole
    np.testing.assert_allclose(fits.ellipses.centres, truth.centres, atol=0.01)
    np.testing.assert_allclose(fits.ellipses.axes, truth.axes, atol=0.05)  # the rule of three points, and the rays
    np.testing.assert_allclose(fits.blur, blur, rtol=0.05)  # likewise
    assert fits.agreement.min() > 0.999  # whole gray levels and the rays, of a contrast of 160


def test_covariances_are_those_of_many_trials():
    row, column = np.divmod(np.arange(60), 10)
    shift = np.random.default_rng(5).uniform(-0.5, 0.5, (60, 2))
    truth = Ellipses(np.column_stack([column, row]) * 24.0 + 16 + shift, np.tile(ellipse(7, 4, 0.5), (60, 1, 1)))
    fits = fit_discs(drawn((248, 152), truth, 0.8, noise=4), truth)
    away = fits.ellipses.centres - truth.centres
    squared = np.einsum("ni,nij,nj->n", away, np.linalg.inv(fits.covariance), away)
    assert 0.7 < squared.mean() / 2 < 1.4  # chi² of 120 values over their number, to 3 σ
    assert np.median(fits.noise) == pytest.approx(4, rel=0.05)  # of some hundred samples a dot, over 60 dots


def test_a_dot_that_is_not_there_is_not_found():
    truth = Ellipses(np.array([[30.0, 30.0]]), ellipse(8, 8, 0)[None])
    start = Ellipses(np.array([[30.0, 30.0], [75.0, 30.0]]), np.tile(ellipse(8, 8, 0), (2, 1, 1)))
    fits = fit_discs(drawn((110, 62), truth, 0.8, noise=2), start)
    assert fits.agreement[0] > 0.99
    assert fits.agreement[1] < 0.6
