"""A camera in the nearest lens model: exact where there is one, otherwise the least squares over the image."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from camcal.cameras.catalogue import MODELS
from camcal.cameras.model import Camera
from camcal.cameras.refit import refit
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
