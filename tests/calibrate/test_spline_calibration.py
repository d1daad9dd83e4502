"""Calibration of splines on simulated lenses: near the right parametric model where there is one, near the truth where
there is none. That real lenses are served well is not proved here; see benchmarks/spline_lenses.py.
"""

from dataclasses import replace

import numpy as np
import pytest
from observed import PARAMETERS, SIZE, make_scene, true_state

from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Options, calibrate, compare_models
from camcal.calibrate.problem import BoardProblem
from camcal.calibrate.spline import _of_spline, _with_spread
from camcal.cameras.catalogue import MODELS, model_named
from camcal.cameras.directions import direction_covariances, in_hull, lens_difference
from camcal.cameras.model import Camera
from camcal.cameras.observations import Observations
from camcal.cameras.spline_modes import ReducedSpline, reduced_spline
from camcal.errors import InvalidInput
from camcal.solve.differentiate import central_jacobian
from camcal.solve.least_squares import minimise
from camcal.tasks.calibration.calibrate import _solver_options
from camcal.tasks.calibration.options import CalibrateOptions
from camcal.tasks.rigs.rig_lenses import _asked

FLAT = ShapeOptions(smooth=False, offsets=False)
SPLINED = MODELS["splined_stereographic"]
WIDE = [600.0, 601.0, 803.0, 596.0, 0.02, -0.01, 0.004, -0.001]


def within(views):
    """Pixels on a grid within the hull of all corners."""
    corners = np.concatenate([view.pixels for view in views])
    axes = (np.linspace(low, high, 20) for low, high in zip(corners.min(axis=0), corners.max(axis=0), strict=True))
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    return grid[in_hull(grid, corners)]


def error(camera, truth, pixels):
    apart = lens_difference(truth, camera, pixels)
    return float(np.sqrt(np.nanmean((apart**2).sum(axis=1))))


def dented(parameters):
    """A spline that is a fisheye but for a dent of about 1 px."""
    base = Camera(model_named("kannala_brandt4"), SIZE, parameters)
    spline = SPLINED.configured({"knots": [24, 20], "fov_x_deg": 170})
    rays = base.unproject(np.stack(np.meshgrid(np.arange(0, 1600, 20.0), np.arange(0, 1200, 20.0)), -1).reshape(-1, 2))
    reduced = reduced_spline(base, rays.directions[rays.valid], np.ones(int(rays.valid.sum())), spline)
    knots = reduced.knots.copy()
    apart = (spline.grid.places() - [0.3, -0.2]) / 0.35
    knots[4:] += (0.004 * apart * np.exp(-0.5 * (apart**2).sum(axis=1, keepdims=True))).ravel()
    return Camera(spline, SIZE, knots)


@pytest.fixture(scope="module")
def fisheye():
    """A fisheye, what is seen of it, and its calibration as a spline."""
    scene = make_scene("kannala_brandt4", count=20, seed=2, parameters=WIDE)
    views = scene.observe(2, noise_px=0.1)
    return scene, views, calibrate(views, scene.board, Options(SPLINED, shape=FLAT))


def test_a_lens_that_a_parametric_model_describes_is_as_well_described_by_a_spline(fisheye):
    scene, views, found = fisheye
    right = calibrate(views, scene.board, Options(model_named("kannala_brandt4"), shape=FLAT))
    pixels = within(views)
    assert error(found.camera, scene.camera, pixels) < 1.5 * error(right.camera, scene.camera, pixels)
    assert found.camera.model.name == "splined_stereographic"
    assert abs(found.sigma_px - right.sigma_px) < 0.03 * right.sigma_px
    assert found.held_by_prior == ()
    # fx fy cx cy are those of the base, with standard deviations of their own
    np.testing.assert_allclose(found.camera.parameters[:4], right.camera.parameters[:4], atol=1.0)
    assert 0 < found.camera.std("fx") < 3 * right.camera.std("fx")


def test_a_dent_that_no_parametric_model_has_is_found_and_its_map_is_as_uncertain_as_stated():
    truth = dented(np.array(WIDE))
    scene = replace(make_scene("kannala_brandt4", count=30, seed=3, parameters=WIDE), camera=truth)
    views = scene.observe(3, noise_px=0.1)
    pixels = within(views)
    found, base = (
        calibrate(views, scene.board, Options(model, shape=FLAT)).camera
        for model in (SPLINED, model_named("kannala_brandt5t"))
    )
    assert error(found, truth, pixels) < 0.35 * error(base, truth, pixels)
    apart = lens_difference(found, truth, pixels)
    stds = np.sqrt(np.diagonal(direction_covariances(found, found.covariance, pixels), axis1=1, axis2=2))
    shown = np.isfinite(stds).all(axis=1)
    assert 0.8 < np.mean(np.abs(apart[shown]) < 1.96 * stds[shown]) <= 1


def test_it_is_uncertain_where_no_corner_is(fisheye):
    _, views, found = fisheye
    camera = found.camera
    values = np.linalg.eigvalsh(camera.covariance / np.outer(*2 * [np.sqrt(np.diag(camera.covariance))]))
    assert values.min() > -1e-9
    inside = within(views)
    outside = np.array([[2.0, 2.0], [1597.0, 3.0], [3.0, 1196.0], [1597.0, 1196.0]])
    stds = np.sqrt(direction_covariances(camera, camera.covariance, np.concatenate([inside, outside]))[:, 0, 0])
    assert np.nanmin(stds[len(inside) :]) > np.nanmedian(stds[: len(inside)])


def test_knots_that_are_given_are_used(fisheye):
    scene, views, _ = fisheye
    model = SPLINED.configured({"knots": [13, 11], "fov_x_deg": 160})
    found = calibrate(views, scene.board, Options(model, shape=FLAT))
    assert found.camera.model == model


def test_it_goes_on_from_a_brief_fit_and_says_how_well_it_predicts(fisheye):
    scene, views, _ = fisheye
    options = Options(SPLINED, shape=FLAT)
    [parametric] = compare_models(views, scene.board, options, [model_named("kannala_brandt4")])
    [own] = compare_models(views, scene.board, options, [SPLINED], parametric.fit)
    assert own.name == "splined_stereographic"
    assert abs(own.score - parametric.score) < 0.05
    assert own.calibration.camera.model.configuration


def test_single_parameters_are_not_held(fisheye):
    scene, views, _ = fisheye
    with pytest.raises(InvalidInput, match="--fix: the parameters of splined_stereographic are not held one by one"):
        calibrate(views, scene.board, Options(SPLINED, fixed=("cx",), shape=FLAT))


def test_few_parameters_move_the_knots_as_their_derivatives_say():
    base = Camera(model_named("opencv5"), SIZE, np.array(PARAMETERS["opencv5"]))
    rng = np.random.default_rng(1)
    corners = np.column_stack([rng.uniform(-0.6, 0.6, (2000, 2)), np.ones(2000)])
    spline = SPLINED.configured({"knots": [24, 22], "fov_x_deg": 90})
    reduced = replace(reduced_spline(base, corners, np.ones(2000), spline), spread=1e-3)
    assert isinstance(reduced, ReducedSpline)
    points = corners[:40] * rng.uniform(0.5, 2, (40, 1))
    # at the start it is the base lens, and so to first order
    np.testing.assert_allclose(
        reduced.project(reduced.start_values, points).pixels, base.project(points).pixels, atol=5e-3
    )
    moved = base.parameters * (1 + 1e-5)
    start = np.concatenate([moved, np.zeros(len(reduced.start_values) - len(moved))])
    np.testing.assert_allclose(
        reduced.project(start, points).pixels - reduced.project(reduced.start_values, points).pixels,
        base.model.project(moved, points).pixels - base.project(points).pixels,
        atol=1e-4,
    )
    parameters = reduced.start_values + rng.normal(0, 1e-4, len(reduced.start_values))
    found = reduced.project_with_jacobians(parameters, points)
    numeric = central_jacobian(lambda p: reduced.project(p, points).pixels, parameters, 1e-4)
    np.testing.assert_allclose(found.by_parameters(len(parameters)), numeric, rtol=1e-7, atol=1e-7)
    camera = reduced.camera(SIZE, parameters, np.diag(reduced.prior_std(SIZE, 900.0).clip(0, 1) ** 2))
    np.testing.assert_array_equal(camera.project(points).pixels, found.pixels)
    halved = reduced.rescale(parameters, (0.5, 0.5), (3.0, 4.0))
    np.testing.assert_allclose(
        reduced.project(halved, points).pixels, (found.pixels + 0.5) * 0.5 - 0.5 - [3.0, 4.0], atol=1e-9
    )


def test_corners_at_the_edge_of_the_knots_do_not_hold_a_spline_inside_them():
    scene = make_scene("kannala_brandt4", count=12, seed=2, parameters=WIDE)
    observations = Observations.of(scene.observe(2, noise_px=0.1))
    problem = BoardProblem(scene.camera.model, scene.board, observations, np.arange(8), sigma=0.1)
    narrow = SPLINED.configured({"knots": [14, 12], "fov_x_deg": 95})
    own, here = _of_spline(problem, true_state(scene), scene.camera, narrow)
    there = np.isfinite(own.residuals(here)).all(axis=0)
    assert 0 < np.sum(there & (own.observations.weights == 0)) < 0.1 * there.size
    assert there[own.observations.weights > 0].all()
    found = minimise(_with_spread(own, 1e-3, 1.0, SIZE), here)
    assert found.reason == "converged"  # not stopped at the boundary of the domain


def test_modes_share_nothing_with_base_and_rotations_over_the_corners():
    base = Camera(model_named("kannala_brandt4"), SIZE, np.array(WIDE))
    rng = np.random.default_rng(2)
    corners = np.column_stack([rng.uniform(-0.9, 0.9, (4000, 2)), np.ones(4000)])
    spline = SPLINED.configured({"knots": [16, 14], "fov_x_deg": 120})
    reduced = reduced_spline(base, corners, np.ones(4000), spline)
    start = reduced.start_values
    found = reduced.project_with_jacobians(start, corners).by_parameters(len(start)).reshape(8000, -1)
    found = found / np.linalg.norm(found, axis=0)
    assert np.abs(found[:, :8].T @ found[:, 8:]).max() < 1e-3  # the spline is the base to 1e-3


def test_colours_and_rigs_are_refused_in_one_line(tmp_path):
    options = CalibrateOptions((str(tmp_path),), tmp_path / "a.yaml", "chessboard:9x6", model="splined")
    options = replace(options, reading=replace(options.reading, colours=True))
    with pytest.raises(InvalidInput, match="--channels: lenses of single colours are not splined_stereographic"):
        _solver_options(options, None)
    with pytest.raises(InvalidInput, match="--model splined: a spline is calibrated by camcal calibrate"):
        _asked(["splined"], ["left", "right"])
