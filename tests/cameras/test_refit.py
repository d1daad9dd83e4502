"""A camera in the nearest lens model: exact where there is one, otherwise the least squares over the image."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from camcal.cameras.catalogue import MODELS
from camcal.cameras.directions import projection_covariances
from camcal.cameras.model import Camera
from camcal.cameras.refit import Region, refit
from camcal.cameras.validity import ImageCircle
from camcal.errors import InsufficientData

LENS = Camera(MODELS["opencv5"], (640, 480), [536.0, 535.0, 342.0, 236.0, -0.266, -0.0386, 1.8e-3, -2.8e-4, 0.238])


def test_a_richer_model_is_exact():
    found = refit(LENS, MODELS["opencv12"])
    assert found.max_px < 1e-9
    assert found.camera.image_size == LENS.image_size


def test_a_poorer_model_is_the_least_squares_over_the_image():
    found = refit(LENS, MODELS["opencv4"])
    grid = np.meshgrid(np.linspace(-0.5, 639.5, 31), np.linspace(-0.5, 479.5, 31))
    pixels = np.column_stack([axis.ravel() for axis in grid])
    rays = LENS.unproject(pixels).directions
    x, y = (rays[:, :2] / rays[:, 2:]).T

    def residuals(parameters):  # written out, not asked of the model
        fx, fy, cx, cy, k1, k2, p1, p2 = parameters
        r2 = x * x + y * y
        radial = 1 + k1 * r2 + k2 * r2 * r2
        u = fx * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) + cx
        v = fy * (y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y) + cy
        return np.concatenate([u - pixels[:, 0], v - pixels[:, 1]])

    expected = least_squares(residuals, LENS.parameters[:8], x_scale="jac", xtol=1e-12, ftol=1e-12, gtol=1e-12)
    assert found.camera.parameters == pytest.approx(expected.x, rel=1e-6, abs=1e-9)
    assert found.rms_px == pytest.approx(np.sqrt(2 * expected.cost / len(pixels)), rel=0.1)  # on other rays
    assert found.max_px >= np.hypot(*residuals(found.camera.parameters).reshape(2, -1)).max() - 1e-9


def test_a_model_that_ends_within_the_image_is_infinitely_far():
    wide = Camera(MODELS["kannala_brandt4"], (640, 480), [150.0, 150.0, 320.0, 240.0, 0.0, 0.0, 0.0, 0.0])
    folded = Camera(MODELS["opencv4"], (640, 480), [300.0, 300.0, 320.0, 240.0, -0.5, 0.0, 0.0, 0.0])
    assert refit(folded, MODELS["opencv8"]).max_px == np.inf  # the corners have no ray to begin with
    assert refit(wide, MODELS["kannala_brandt5t"]).max_px < 1e-9
    nowhere = Camera(MODELS["opencv4"], (640, 480), [0.001, 0.001, 1e6, 1e6, -0.5, 0.0, 0.0, 0.0])
    with pytest.raises(InsufficientData, match="the lens has a ray for 0 of 961 pixels"):
        refit(nowhere, MODELS["opencv8"])


FISHEYE = Camera(
    MODELS["kannala_brandt4"], (512, 512), [190.98, 190.97, 254.93, 256.9, 0.00348, 0.000715, -0.00205, 0.000203]
)


@pytest.mark.parametrize(
    ("lens", "model", "degrees", "rms_px", "max_px"),
    [  # measured with another least-squares program
        (LENS, "opencv4", 180, 0.42, 3.7),
        (FISHEYE, "opencv8", 75, 0.001, 0.006),
        (FISHEYE, "double_sphere", 100, 0.045, 0.37),
        (FISHEYE, "eucm", 100, 0.032, 0.28),
        (FISHEYE, "mei", 100, 0.018, 0.10),
    ],
)
def test_lenses_of_other_kinds_are_as_near_as_another_program_finds_them(lens, model, degrees, rms_px, max_px):
    found = refit(lens, MODELS[model], Region(max_theta=np.radians(degrees)))
    assert (found.rms_px, found.max_px) == (pytest.approx(rms_px, rel=0.15), pytest.approx(max_px, rel=0.2))
    assert found.max_theta == pytest.approx(min(np.radians(degrees), found.max_theta), abs=0.02)


@pytest.mark.parametrize("model", ["opencv4", "kannala_brandt4"])
def test_the_largest_difference_holds_on_a_grid_three_times_finer(model):
    found = refit(LENS, MODELS[model])
    axes = np.meshgrid(np.linspace(-0.5, 639.5, 303), np.linspace(-0.5, 479.5, 303))
    pixels = np.column_stack([axis.ravel() for axis in axes])
    apart = np.linalg.norm(found.camera.project(LENS.unproject(pixels).directions).pixels - pixels, axis=1)
    assert apart.max() <= found.max_px * (1 + 1e-4)


@pytest.mark.parametrize(("lens", "most_px"), [(FISHEYE, 0.002), (LENS, 0.15)])
def test_a_spline_is_near_any_lens_and_carries_its_covariance(lens, most_px):
    known = Camera(lens.model, lens.image_size, lens.parameters, np.diag(np.abs(lens.parameters) * 1e-6 + 1e-9))
    found = refit(known, MODELS["splined_stereographic"])
    assert found.max_px < most_px
    pixels = np.array([[100.0, 120.0], [250.0, 260.0], [400.0, 300.0]])
    before, after = (
        np.diagonal(projection_covariances(each, pixels), axis1=1, axis2=2) for each in (known, found.camera)
    )
    np.testing.assert_allclose(after, before, rtol=0.1)


def test_the_covariance_is_that_of_refits_of_scattered_lenses():
    rng = np.random.default_rng(3)
    root = np.diag([1.0, 1.0, 0.8, 0.9, 2e-3, 4e-3, 2e-4, 2e-4, 3e-3]) @ (np.eye(9) + 0.3 * rng.normal(size=(9, 9)))
    known = Camera(LENS.model, LENS.image_size, LENS.parameters, root @ root.T)
    found = refit(known, MODELS["kannala_brandt5t"])
    step = 1e-3 * root[:, 0]
    ends = [
        refit(Camera(LENS.model, LENS.image_size, LENS.parameters + sign * step, known.covariance), found.camera.model)
        for sign in (1, -1)
    ]
    rays = LENS.unproject(np.array([(20.0, 20.0), (320.0, 240.0), (600.0, 40.0), (100.0, 400.0)])).directions
    moved = (ends[0].camera.project(rays).pixels - ends[1].camera.project(rays).pixels) / 2
    by_parameters = found.camera.project_with_jacobians(rays).d_parameters
    expected = by_parameters @ found.jacobian @ step
    np.testing.assert_allclose(moved, expected, atol=0.03 * np.abs(expected).max())
    np.testing.assert_allclose(found.camera.covariance, found.jacobian @ known.covariance @ found.jacobian.T)


def test_places_that_are_known_well_are_fitted_better():
    sure = refit(LENS, MODELS["opencv4"]).camera
    root = np.zeros((9, 1))
    root[8] = 0.5  # k3, which moves the corners of the image most
    loose = refit(
        Camera(LENS.model, LENS.image_size, LENS.parameters, root @ root.T + np.diag(np.full(9, 1e-16))), sure.model
    ).camera
    pixels = np.array([[300.0, 200.0], [400.0, 300.0], [250.0, 240.0], [350.0, 150.0]])
    rays = LENS.unproject(pixels).directions
    apart = [np.linalg.norm(camera.project(rays).pixels - pixels, axis=1).mean() for camera in (sure, loose)]
    assert apart[1] < 0.7 * apart[0]


def test_a_region_leaves_out_what_is_beyond_its_angle_and_its_image_circle():
    disc = ImageCircle((512, 512), (255.0, 255.0), 200.0)
    found = refit(FISHEYE, MODELS["opencv8"], Region(disc))
    assert np.degrees(found.max_theta) == pytest.approx(59, abs=2)
    assert found.max_px < 1e-3 < refit(FISHEYE, MODELS["opencv8"], Region(max_theta=np.radians(80))).max_px
    with pytest.raises(InsufficientData, match="opencv8 has no place for the rays of this lens"):
        refit(FISHEYE, MODELS["opencv8"])
