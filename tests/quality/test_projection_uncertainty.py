"""The map of projection uncertainty against displacements of drawn lenses, and what must hold of any lens."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares

from camcal.cameras.catalogue import MODELS, model_named
from camcal.cameras.directions import lens_difference
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle
from camcal.errors import InvalidInput
from camcal.geometry import rotation as so3
from camcal.quality.assess import coverage
from camcal.quality.projection_uncertainty import (
    ProjectionUncertainty,
    in_polygon,
    known_region,
    projection_uncertainty,
)

SIZE = (1280, 960)
PARAMETERS = np.array([800.0, 802.0, 645.0, 474.0, -0.12, 0.06, 5e-4, -3e-4, 0.01])
STDS = np.array([0.5, 0.5, 0.6, 0.4, 2e-3, 6e-3, 2e-4, 1e-4, 5e-3])
CORNERS = np.array([[300.0, 150.0], [1000.0, 200.0], [1050.0, 700.0], [250.0, 820.0], [600.0, 500.0]])


def covariance(stds, seed=1):
    factor = np.random.default_rng(seed).normal(size=(len(stds), 2 * len(stds)))
    product = factor @ factor.T
    scale = np.asarray(stds) / np.sqrt(np.diag(product))
    return product * np.outer(scale, scale)


def opencv5(matrix=None, parameters=PARAMETERS):
    return Camera(model_named("opencv5"), SIZE, parameters, covariance(STDS) if matrix is None else matrix)


def displacements(camera, parameters, pixels, fitted):
    """Return how far other parameters move the directions of pixels (N, 2) after the rotation that fits them best."""
    rays, rotation = camera.unproject(pixels).directions, np.eye(3)
    for _ in range(2):  # one step, and the projection after it: the rotations are small
        turned = rays @ rotation.T
        projected = camera.model.project_with_jacobians(parameters, turned)
        by_turn = projected.d_point @ -so3.hat(turned)
        off = pixels - projected.pixels
        step = np.linalg.lstsq(by_turn[fitted].reshape(-1, 3), off[fitted].ravel(), rcond=None)[0]
        rotation = so3.exp(step) @ rotation
    return projected.pixels - pixels


@pytest.mark.slow
@pytest.mark.parametrize("observed", [pytest.param(None, id="image"), pytest.param(CORNERS, id="corners")])
def test_drawn_lenses_scatter_as_the_map_says(observed):
    camera = opencv5()
    found = projection_uncertainty(camera, observed=observed, grid=(9, 7))
    fitted = np.ones(63, bool) if observed is None else found.inside
    assert fitted.sum() >= 10
    lenses = np.random.default_rng(2).multivariate_normal(camera.parameters, camera.covariance, 1500)
    moved = np.stack([displacements(camera, lens, found.pixels, fitted) for lens in lenses])
    scatter = np.einsum("dni,dnj->nij", moved, moved) / len(moved)
    worst = np.sqrt(np.linalg.eigvalsh(scatter)[:, -1])
    rms = np.sqrt(np.trace(scatter, axis1=1, axis2=2) / 2)
    assert found.std_rms == pytest.approx(rms, rel=0.07)  # 1500 draws: 1.8 % for one pixel
    assert found.std_worst == pytest.approx(worst, rel=0.07)
    figures = found.figures()
    assert figures["rms_px"] == pytest.approx(np.sqrt(np.mean(rms**2)), rel=0.05)
    assert figures["worst_px"] == pytest.approx(worst.max(), rel=0.05)


def test_a_lens_that_is_known_exactly_has_no_uncertainty():
    found = projection_uncertainty(opencv5(np.zeros((9, 9))), observed=CORNERS)
    assert not found.covariances.any()
    assert set(found.figures().values()) == {0.0}


@pytest.mark.parametrize("fitted", [None, "corners"])
def test_the_difference_of_two_lenses_is_that_after_the_rotation_between_them(fitted):
    camera = opencv5()
    # as another lens model sees it: the principal point 12 px off, which is nearly a rotation
    other = opencv5(parameters=PARAMETERS + np.array([5.0, 6.0, 12.0, -9.0, 0.004, 0.0, 1e-4, 0.0, 0.0]))
    found = projection_uncertainty(camera, observed=CORNERS)
    chosen = found.inside if fitted else np.ones(len(found.pixels), bool)
    rays = camera.unproject(found.pixels).directions

    def apart(turn):
        return other.project(rays @ so3.exp(turn).T).pixels - found.pixels

    best = least_squares(lambda turn: apart(turn)[chosen].ravel(), np.zeros(3), xtol=1e-14, ftol=1e-14, gtol=1e-14).x
    difference = lens_difference(camera, other, found.pixels, found.inside if fitted else None)
    np.testing.assert_allclose(difference, apart(best), atol=1e-6)
    assert np.linalg.norm(best) > 0.015  # more than one linear step reaches


def test_where_either_lens_has_no_image_the_difference_is_not_known():
    straight = Camera(model_named("pinhole"), SIZE, np.array([800.0, 802.0, 645.0, 474.0]))
    folding = opencv5(parameters=np.array([*straight.parameters, -0.3, 0.0, 0.0, 0.0, 0.0]))  # 562 px off its centre
    pixels = np.array([[640.0, 480.0], *CORNERS, *(CORNERS + 20), [645.0 + 880.0, 474.0]])
    for one, other in ((straight, folding), (folding, straight)):
        difference = lens_difference(one, other, pixels)
        assert np.isnan(difference[-1]).all()
        assert np.isfinite(difference[:-1]).all()


@pytest.mark.parametrize("name", MODELS)
def test_k_times_the_standard_deviations_are_k_times_the_uncertainty(name):
    model = MODELS[name]
    camera = Camera(model, SIZE, model.start(SIZE, 800.0))
    count = len(camera.parameters)
    stds = [1e-3] * count
    once, thrice = (projection_uncertainty(camera, factor * covariance(stds)) for factor in (1, 9))
    assert np.isfinite(once.std_rms).all()
    assert (once.std_rms > 0).all()
    assert thrice.std_rms == pytest.approx(3 * once.std_rms)
    assert thrice.std_worst == pytest.approx(3 * once.std_worst)


@pytest.mark.parametrize(("focal", "least", "most"), [(20000.0, 0, 0.01), (300.0, 0.5, 5)])
def test_a_principal_point_of_a_long_lens_moves_like_a_rotation(focal, least, most):
    model = model_named("pinhole")
    known = np.diag([0.0, 0.0, 25.0, 0.0])  # cx to 5 px
    camera = Camera(model, SIZE, model.start(SIZE, focal), known)
    assert least < projection_uncertainty(camera).figures()["worst_px"] < most  # 5 (640 / 20000)² = 0.005


def test_a_rotation_of_the_camera_itself_is_not_counted():
    camera = Camera(model_named("equirectangular"), SIZE, np.array([300.0, 300.0, 639.5, 479.5]))
    known = np.diag([0.0, 0.0, 9.0, 0.0])  # cx: longitude, about the vertical axis
    assert projection_uncertainty(camera, known).figures()["worst_px"] < 1e-9


def test_the_rotation_is_fitted_where_corners_were_seen():
    camera = opencv5()
    over_image, over_corners = projection_uncertainty(camera), projection_uncertainty(camera, observed=CORNERS)
    inside = over_corners.inside
    assert np.mean(over_corners.std_rms[inside] ** 2) < np.mean(over_image.std_rms[inside] ** 2)
    assert np.mean(over_corners.std_rms**2) > np.mean(over_image.std_rms**2)
    figures = over_corners.figures()
    assert list(figures) == ["rms_px", "worst_px", "inside_rms_px", "inside_worst_px"]
    assert figures["inside_rms_px"] < figures["rms_px"]
    assert over_image.inside is None
    assert list(over_image.figures()) == ["rms_px", "worst_px"]


def test_the_pixels_inside_are_those_of_the_convex_hull():
    found = projection_uncertainty(opencv5(), observed=np.array([[100.0, 100], [900, 100], [100, 700]]))
    u, v = found.pixels.T
    expected = (u >= 100) & (v >= 100) & ((u - 100) / 800 + (v - 100) / 600 <= 1)
    assert np.array_equal(found.inside, expected)


@pytest.mark.parametrize("observed", [[[5.0, 5.0]], [[0.0, 0.0], [100.0, 100.0], [900.0, 900.0]], np.zeros((0, 2))])
def test_corners_on_one_line_cover_nothing(observed):
    found = projection_uncertainty(opencv5(), observed=np.array(observed))
    assert not found.inside.any()
    assert np.array_equal(found.covariances, projection_uncertainty(opencv5()).covariances)
    assert list(found.figures()) == ["rms_px", "worst_px"]


def test_there_is_none_where_the_lens_is_not_valid():
    folded = PARAMETERS.copy()
    folded[4:] = [-0.45, 0, 0, 0, 0]
    found = projection_uncertainty(opencv5(parameters=folded))
    outside = ~opencv5(parameters=folded).unproject(found.pixels).valid
    assert 0.05 < outside.mean() < 0.6
    assert np.array_equal(np.isnan(found.std_rms), outside)
    assert np.array_equal(np.isnan(found.std_worst), outside)
    assert np.isfinite(list(found.figures().values())).all()


def test_there_is_none_outside_of_the_image_circle():
    circle = ImageCircle(SIZE, (640.0, 480.0), 500.0)
    whole, found = (projection_uncertainty(opencv5(), observed=CORNERS, circle=own) for own in (None, circle))
    lit = np.hypot(*(whole.pixels - circle.centre).T) <= 500.0
    assert 0.3 < lit.mean() < 0.8
    assert np.array_equal(np.isfinite(found.std_rms), lit)
    np.testing.assert_allclose(found.covariances[lit], whole.covariances[lit], rtol=1e-12)
    assert found.figures()["rms_px"] < whole.figures()["rms_px"]


def test_a_camera_without_a_covariance_is_refused():
    with pytest.raises(InvalidInput, match="covariance"):
        projection_uncertainty(Camera(model_named("opencv5"), SIZE, PARAMETERS))


@pytest.mark.parametrize(("x", "cells"), [(127.4, 1), (127.6, 2)])
def test_a_cell_of_the_grid_ends_where_its_last_pixel_does(x, cells):
    """Pixel 0 reaches from -0.5 to 0.5: a tenth of 1280 pixels ends at 127.5."""
    pixels = np.array([[100.0, 50.0], [x, 50.0]])
    assert coverage(SimpleNamespace(camera=opencv5(), pixels=pixels))[0] == cells / 80


# region


def map_of(std_px, inside=None):
    """An uncertainty map of 1280 x 960 px, standard deviations (23, 31) px the same in all directions."""
    u, v = np.linspace(0, 1279, 31), np.linspace(0, 959, 23)
    std = np.broadcast_to(std_px(*np.meshgrid(u, v)) if callable(std_px) else std_px, (23, 31)).reshape(-1)
    return ProjectionUncertainty(u, v, std[:, None, None] ** 2 * np.eye(2), inside)


def from_middle(u, v):
    return np.hypot(u - 639.5, v - 479.5)


@pytest.mark.parametrize(("limit", "share"), [(0.5, 0.0), (0.99, 0.0), (1.01, 1.0), (2.0, 1.0)])
def test_a_map_is_known_where_its_standard_deviation_is_below_the_limit(limit, share):
    found = known_region(map_of(1.0), limit)
    assert (found.share, found.of_observed, found.limit_px) == (share, share, limit)
    if share:
        low, high = found.polygon.min(axis=0), found.polygon.max(axis=0)
        np.testing.assert_allclose([low, high], [[0, 0], [1279, 959]], atol=1e-9)


def test_the_polygon_is_where_the_standard_deviation_reaches_the_limit():
    found = known_region(map_of(lambda u, v: from_middle(u, v) / 300), 1.0)
    distances = from_middle(*found.polygon.T)
    np.testing.assert_allclose(distances, 300, rtol=0.03)  # linear between pixels 43 px apart, 200 steps on the way
    pixels = map_of(1.0).pixels
    assert found.share == pytest.approx(np.mean(from_middle(*pixels.T) < 300), rel=0.05)


def test_what_is_known_on_the_other_side_of_what_is_not_does_not_belong_to_the_region():
    gap = known_region(map_of(lambda u, v: np.where(np.abs(from_middle(u, v) - 350) < 60, 9.0, 0.1)), 1.0)
    assert from_middle(*gap.polygon.T).max() < 300


def test_the_region_is_around_the_corners_and_its_share_is_of_the_area_with_corners():
    inside = (np.meshgrid(np.linspace(0, 1279, 31), np.zeros(23))[0] < 640).ravel()
    known = map_of(lambda u, v: np.where(u < 330, 0.1, 9.0) + 0 * v, inside)
    found = known_region(known, 1.0)
    assert found.of_observed == pytest.approx(0.5, abs=0.08)  # one column of the grid less
    assert found.share == pytest.approx(0.26, abs=0.04)
    nowhere = known_region(map_of(9.0, inside), 1.0)
    assert (nowhere.share, nowhere.of_observed, len(nowhere.polygon)) == (0.0, 0.0, 0)


def test_pixels_without_a_ray_are_in_no_region_and_no_share():
    found = known_region(map_of(lambda u, v: np.where(from_middle(u, v) < 400, 0.1, np.nan)), 1.0)
    assert 0.8 < found.share < 1  # not those beside them
    assert from_middle(*found.polygon.T).max() < 430


@given(st.integers(0, 10**6), st.integers(3, 30))
def test_pixels_in_a_polygon_are_those_of_opencv(seed, corners):
    rng = np.random.default_rng(seed)
    angles = np.sort(rng.uniform(0, 2 * np.pi, corners))
    polygon = 100 + rng.uniform(5, 60, corners)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    pixels = rng.uniform(20, 180, (60, 2))
    sides = polygon.astype(np.float32)
    expected = [cv2.pointPolygonTest(sides[:, None], tuple(map(float, pixel)), True) for pixel in pixels]
    clear = np.abs(expected) > 1e-3  # OpenCV has 32 bits
    assert np.array_equal(in_polygon(pixels, polygon)[clear], np.array(expected)[clear] > 0)
    assert in_polygon(polygon, polygon).all()
    assert not in_polygon(pixels, np.zeros((0, 2))).any()
