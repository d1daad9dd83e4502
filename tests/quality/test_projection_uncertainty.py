"""The map of projection uncertainty against displacements of drawn lenses, and what must hold of any lens."""

from types import SimpleNamespace

import numpy as np
import pytest

from camcal.cameras.catalogue import MODELS, model_named
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle
from camcal.errors import InvalidInput
from camcal.geometry import rotation as so3
from camcal.quality.assess import coverage
from camcal.quality.projection_uncertainty import projection_uncertainty

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
    assert coverage(SimpleNamespace(camera=opencv5(), pixels=pixels)).cells == cells / 80
