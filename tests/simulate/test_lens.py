"""Cameras made from a field of view."""

import numpy as np
import pytest

from camcal.cameras.catalogue import MODELS, model_named
from camcal.errors import InvalidInput
from camcal.simulate.scene import make_camera

SIZE = (1280, 960)


@pytest.mark.parametrize("model", [own for own in MODELS.values() if own.is_central], ids=lambda own: own.name)
@pytest.mark.parametrize("degrees", [20, 70, 120])
def test_the_image_is_as_wide_as_the_field_of_view(model, degrees):
    camera = make_camera(model, SIZE, np.radians(degrees), {})
    edges = camera.unproject(np.array([[-0.5, 479.5], [1279.5, 479.5]])).directions
    assert np.degrees(np.arccos(edges[0] @ edges[1])) == pytest.approx(degrees, abs=1e-6)


def test_a_typical_fisheye_is_the_same_in_both_models_but_for_a_little_decentring():
    four, decentred = (
        make_camera(model_named(name), SIZE, np.radians(190)) for name in ("kannala_brandt4", "kannala_brandt5t")
    )
    common = [decentred.value(name) for name in ("k1", "k2", "k3", "k4")]
    np.testing.assert_array_equal(common, four.parameters[4:])
    assert 0 < abs(decentred.value("p1")) < 0.001
    assert decentred.model.domain(decentred.parameters).max_theta == np.pi


def test_coefficients_are_set_by_name():
    camera = make_camera(model_named("opencv5"), SIZE, np.radians(60), {"k1": -0.1, "p2": 0.001})
    assert camera.value("k1") == -0.1
    assert camera.value("p2") == 0.001
    assert camera.value("k2") == 0


@pytest.mark.parametrize("degrees", [0, 180, 190, 400])
def test_a_field_of_view_that_no_pinhole_holds_is_refused(degrees):
    with pytest.raises(InvalidInput, match="field of view"):
        make_camera(model_named("pinhole"), SIZE, np.radians(degrees))


def test_a_coefficient_of_another_model_is_refused():
    with pytest.raises(InvalidInput, match="k5"):
        make_camera(model_named("opencv5"), SIZE, 1.0, {"k5": 0.1})


def test_an_image_without_size_is_refused():
    with pytest.raises(InvalidInput, match="16"):
        make_camera(model_named("opencv5"), (0, 480), 1.0)
