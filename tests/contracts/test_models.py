"""What every lens model of the catalogue promises. That a formula is the right one is shown here by golden vectors
where there are any, and in tests/cameras.
"""

import json
import pickle

import numpy as np
import pytest
import toy_model

from camcal.cameras.catalogue import MODELS as REGISTERED
from camcal.cameras.plane_model import PART
from camcal.errors import InvalidInput
from camcal.formats.cameras.ocamcalib import polynomial_camera
from camcal.simulate.scene import make_camera
from camcal.solve.differentiate import central_jacobian

IMAGE_SIZE = (641, 481)
# one lens of each kind of plane, on a tilted sensor
TILTED = [
    REGISTERED[f"{name}_tilted"]
    for name in ("pinhole", "opencv8", "eucm", "double_sphere", "mei", "equisolid", "fov", "ptlens", "fisheye624")
]
MODELS = {**REGISTERED, **{model.name: model for model in (*toy_model.MODELS, *TILTED)}}
every_model = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)


def sample_parameters(model, seed=1):
    """A lens of ordinary strength: fx ≠ fy, off-centre, every coefficient at work."""
    rng = np.random.default_rng(seed)
    parameters = model.start(IMAGE_SIZE, 500.0)
    parameters[:4] += [3.0, -4.0, 5.5, -7.25]
    parameters[4:] += rng.uniform(-0.02, 0.02, len(parameters) - 4)
    return parameters


def sample_points(model, parameters, count=200, seed=2):
    """Points inside the domain, up to 65° from the axis, 0.5 to 5 away; one on the axis."""
    rng = np.random.default_rng(seed)
    theta = rng.uniform(0, min(0.99 * model.domain(parameters).max_theta, np.radians(65)), count)
    theta[0] = 0.0
    azimuth, distance = rng.uniform(0, 2 * np.pi, count), rng.uniform(0.5, 5, count)
    if not model.is_central:
        distance[:] = 1.0  # twice as far is twice as far from the axis
    return distance[:, None] * rays(theta, azimuth)


def rays(theta, azimuth):
    return np.stack([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)], axis=-1)


def angles_between(directions, points):
    """The angles (rad), accurate near zero."""
    return np.arctan2(np.linalg.norm(np.cross(directions, points), axis=1), np.sum(directions * points, axis=1))


@every_model
def test_jacobian_by_parameters_is_the_slope_of_the_projection(model):
    parameters = sample_parameters(model)
    points = sample_points(model, parameters)
    numeric = central_jacobian(lambda p: model.project(p, points).pixels, parameters, 1e-4)
    analytic = model.project_with_jacobians(parameters, points).by_parameters(len(parameters))
    # rounding of pixels near 1000 over steps of 1e-4: 1e-9; the tilt's slopes reach 1e4 px per radian
    np.testing.assert_allclose(analytic, numeric, rtol=1e-8, atol=2e-8)


@every_model
def test_jacobian_by_point_is_the_slope_of_the_projection(model):
    parameters = sample_parameters(model)
    points = sample_points(model, parameters)
    numeric = central_jacobian(lambda d: model.project(parameters, points + d).pixels, np.zeros(3), 1e-4)
    analytic = model.project_with_jacobians(parameters, points).d_point
    # rounding of pixels near 1000 over steps of 1e-4: 1e-9
    np.testing.assert_allclose(analytic, numeric, rtol=1e-8, atol=2e-8)


@every_model
def test_projection_is_the_same_with_and_without_jacobians(model):
    parameters = sample_parameters(model)
    points = sample_points(model, parameters)
    plain, full = model.project(parameters, points), model.project_with_jacobians(parameters, points)
    np.testing.assert_array_equal(plain.pixels, full.pixels)
    assert plain.valid.all()
    assert full.valid.all()


def test_projection_meets_the_golden_vectors(real_data):
    path = real_data.parent / "reference" / "golden_vectors.json"
    if not path.is_file():
        pytest.skip(f"no golden vectors: {path} is not a file")
    vectors = [vector for vector in json.loads(path.read_text())["vectors"] if vector["model"] in MODELS]
    assert len(vectors) >= 6
    for vector in vectors:
        model, given = MODELS[vector["model"]], vector["params"]
        if "poly" in given:
            centre = given["cx"], given["cy"]
            found = polynomial_camera((640, 480), np.array(given["poly"]), np.array(given["stretch"]), centre, "")
            parameters = found.parameters
        else:
            parameters = np.array([given[name] for name in model.parameter_names])
        pixels = model.project(parameters, np.array(vector["points_cam"])).pixels
        np.testing.assert_allclose(pixels, vector["pixels"], atol=1e-9)  # the tolerance the vectors state


@every_model
def test_unprojection_inverts_projection(model):
    parameters = sample_parameters(model)
    points = sample_points(model, parameters, 1000)
    found = model.unproject(parameters, model.project(parameters, points).pixels)
    assert found.valid.all()
    np.testing.assert_allclose(np.linalg.norm(found.directions, axis=1), 1, rtol=1e-15)
    from_origin = points if found.origins is None else points - found.origins
    assert angles_between(found.directions, from_origin).max() < 1e-9
    assert (found.origins is None) == model.is_central
    np.testing.assert_allclose(
        model.project(parameters, found.at(3.0)).pixels, model.project(parameters, points).pixels
    )


@every_model
def test_points_without_an_image_are_nan_and_do_not_touch_their_neighbours(model):
    parameters = sample_parameters(model)
    points = sample_points(model, parameters, 20)
    broken = points.copy()
    broken[[3, 5, 8, 13]] = [[0, 0, -1], [np.nan, 0, 1], [0, 0, 0], [np.inf, 0, 1]]
    bad = np.isin(np.arange(20), [3, 5, 8, 13])
    for result in (model.project(parameters, broken), model.project_with_jacobians(parameters, broken)):
        np.testing.assert_array_equal(result.valid, ~bad)
        assert np.isnan(result.pixels[bad]).all()
        np.testing.assert_array_equal(result.pixels[~bad], model.project(parameters, points).pixels[~bad])
    assert np.isnan(result.d_point[bad]).all()
    assert np.isnan(result.d_parameters[bad]).all()
    assert np.isfinite(result.d_parameters[~bad]).all()


@every_model
def test_pixels_that_are_no_numbers_have_no_ray(model):
    found = model.unproject(sample_parameters(model), np.array([[300.0, 200.0], [np.nan, 200.0], [300.0, np.inf]]))
    np.testing.assert_array_equal(found.valid, [True, False, False])
    assert np.isnan(found.directions[1:]).all()


@every_model
@pytest.mark.parametrize("seed", range(5))
def test_domain_is_where_points_are_valid(model, seed):
    parameters = sample_parameters(model, seed)
    limit = model.domain(parameters).max_theta
    azimuth = np.linspace(0, 2 * np.pi, 16)
    # a tilted sensor has a horizon of its own, and the knots of a spline make a rectangle
    disc = not {"tau_x", "dx_0_0"} & set(model.parameter_names)
    inside = limit if disc else min(limit, np.radians(45))
    assert model.project(parameters, rays(np.full(16, inside - 1e-6), azimuth)).valid.all()
    if limit < np.pi:
        assert not model.project(parameters, rays(np.full(16, limit + 1e-6), azimuth)).valid.any()


@every_model
def test_solver_may_leave_the_domain(model):
    parameters = sample_parameters(model)
    distorted = "k1" in model.parameter_names
    if distorted:
        parameters[model.parameter_names.index("k1")] = -1.0
    beyond = rays(np.array([1.2]), np.array([0.5]))
    strict = model.project_with_jacobians(parameters, beyond)
    free = model.project_with_jacobians(parameters, beyond, within_domain=False)
    assert strict.valid.all() == (not distorted)  # a lens without distortion has no fold
    assert free.valid.all()
    assert np.isfinite(free.d_parameters).all()
    assert not model.project_with_jacobians(parameters, np.array([[0.0, 0, -1]]), within_domain=False).valid.any()


@every_model
def test_rescaling_follows_the_pixel_centres(model):
    parameters = sample_parameters(model)
    points = sample_points(model, parameters)
    scale, offset = (0.5, 0.75), (11.0, -3.0)
    before = model.project(parameters, points).pixels
    after = model.project(model.rescale(parameters, scale, offset), points).pixels
    np.testing.assert_allclose(after, (before + 0.5) * scale - 0.5 - offset, atol=1e-10)  # rounding of 1e3 px


@every_model
def test_start_is_centred_and_undistorted(model):
    parameters = model.start(IMAGE_SIZE, 500.0)
    angle = 1e-4  # where every projection is a pinhole to 1e-12 rad
    pixels = model.project(parameters, rays(np.array([0.0, angle]), np.zeros(2))).pixels
    np.testing.assert_allclose(pixels, [[320, 240], [320 + 500 * angle, 240]], atol=1e-8)


@every_model
def test_results_do_not_depend_on_layout_or_number_of_points(model):
    parameters = sample_parameters(model)
    points = sample_points(model, parameters, PART + 300)
    by_rows = np.ascontiguousarray(points.T).T
    whole, alone = model.project_with_jacobians(parameters, by_rows), model.project_with_jacobians(parameters, points)
    tail = model.project_with_jacobians(parameters, points[PART - 5 :])
    np.testing.assert_array_equal(whole.d_parameters, alone.d_parameters)
    # vector units may round the odd elements at an end differently
    np.testing.assert_allclose(whole.d_point[PART - 5 :], tail.d_point, rtol=1e-12, atol=1e-12)


@every_model
def test_jacobians_are_laid_out_for_sums_over_points(model):
    parameters = sample_parameters(model)
    result = model.project_with_jacobians(parameters, sample_points(model, parameters))
    for jacobian in (result.d_point, result.d_parameters):
        assert jacobian.transpose(1, 2, 0).flags.c_contiguous


@every_model
def test_no_points_give_no_pixels(model):
    parameters = sample_parameters(model)
    assert model.project_with_jacobians(parameters, np.zeros((0, 3))).d_point.shape == (0, 2, 3)
    assert model.unproject(parameters, np.zeros((0, 2))).directions.shape == (0, 3)


@every_model
def test_wrong_shapes_are_refused(model):
    parameters = sample_parameters(model)
    with pytest.raises(InvalidInput, match="points has shape"):
        model.project(parameters, np.zeros((4, 2)))
    with pytest.raises(InvalidInput, match="parameters has shape"):
        model.project(np.append(parameters, 0.0), np.zeros((4, 3)))


@every_model
def test_model_survives_the_way_to_a_worker_process(model):
    assert pickle.loads(pickle.dumps(model)) == model


@every_model
def test_every_coefficient_has_a_prior_and_no_other_parameter_has_one(model):
    spread = model.prior_std((1600, 1200), 1200.0)
    assert spread.shape == (len(model.parameter_names),)
    # fx fy cx cy: where rays are parallel any principal point does as well, without distortion
    assert (np.isinf(spread[:4]) == [True, True, model.is_central, model.is_central]).all()
    np.testing.assert_array_equal(model.prior_mean[4:], model.start((1600, 1200), 1200.0)[4:])
    assert not model.prior_mean[:4].any()
    assert np.isfinite(spread[4:]).all()
    assert (spread[4:] > 0).all()
    finer = [1, 1, 2, 2, *np.ones(len(spread) - 4)]  # the same lens at another resolution
    np.testing.assert_array_equal(spread * finer, model.prior_std((3200, 2400), 2400.0))


@every_model
@pytest.mark.parametrize("of", ["stages", "colour_stages"])
def test_stages_free_ever_more_of_the_parameters_and_focal_lengths_first(model, of):
    stages = getattr(model, of)
    assert {"fx", "fy"} <= set(stages[0])
    for stage, following in zip(stages, (*stages[1:], model.parameter_names), strict=True):
        assert set(stage) <= set(following)


@every_model
def test_an_ordinary_lens_is_within_the_limits_and_one_to_one_over_a_wide_image(model):
    assert set(model.typical) <= set(model.parameter_names)
    assert set(model.limits) == set(model.parameter_names)
    camera = make_camera(model, (1280, 960), np.radians(100))
    for name, (low, high) in model.limits.items():
        assert low <= camera.value(name) <= high
    corners = np.array([[-0.5, -0.5], [1279.5, -0.5], [1279.5, 959.5], [-0.5, 959.5]])
    assert camera.unproject(corners).valid.all()


@every_model
def test_it_is_a_pinhole_only_where_points_on_a_plane_keep_their_shape(model):
    for parameters in (model.start(IMAGE_SIZE, 500.0), sample_parameters(model)):
        points = sample_points(model, parameters)
        fx, fy, cx, cy = parameters[:4]
        expected = points[:, :2] / points[:, 2:] * [fx, fy] + [cx, cy]
        straight = np.abs(model.project(parameters, points).pixels - expected).max() < 1e-9
        assert model.is_pinhole(parameters) == straight


@every_model
def test_it_says_what_it_is(model):
    assert model.summary
    assert model.name not in model.aliases
