"""The layout of the calibration problem: Jacobians against differences, partial views, covariances, priors."""

from dataclasses import replace

import numpy as np
import pytest
from observed import make_scene

from camcal.calibrate.problem import BoardProblem, State
from camcal.cameras.catalogue import MODELS
from camcal.cameras.observations import Observations
from camcal.solve.least_squares import assemble
from camcal.solve.steps import Step
from camcal.targets.board import TERMS


def state_of(scene, terms, rng):
    return State(
        np.array(scene.camera.parameters),
        np.stack([pose.rotation for pose in scene.poses]),
        np.stack([pose.translation for pose in scene.poses]),
        1e-3 * rng.normal(size=len(terms)),
        1e-4 * rng.normal(size=(scene.board.count, 3)),
    )


def cost(problem, state):
    return assemble(problem.blocks(state), problem.shared, *problem.groups).cost


@pytest.mark.parametrize("covariances", [False, True])
@pytest.mark.parametrize("offsets", [False, True])
def test_gradient_is_the_derivative_of_the_cost(offsets, covariances):
    rng = np.random.default_rng(4)
    scene = make_scene(count=4)
    observations = Observations.of(scene.observe(2, noise_px=0.3))
    if covariances:
        shapes = rng.normal(size=(*observations.ids.shape, 2, 2))
        observations = observations.weighted(0.1 * np.eye(2) + shapes @ shapes.swapaxes(2, 3))
    problem = BoardProblem(
        scene.camera.model, scene.board, observations, np.array([0, 2, 4, 5]), TERMS, offsets, sigma=0.3
    )
    problem = replace(problem, lens_spread=scene.camera.model.prior_std(scene.camera.image_size, 1200.0))
    state = state_of(scene, TERMS, rng)
    equations = assemble(problem.blocks(state), problem.shared, *problem.groups)
    for _ in range(4):
        direction = Step(rng.normal(size=problem.shared), rng.normal(size=problem.groups))
        scale = np.concatenate([[1, 1, 1e-3, 1e-3], np.full(problem.shared - 4, 1e-4)])
        direction = Step(direction.shared * scale, direction.groups * 1e-4)

        def at(factor, direction=direction):
            moved = Step(factor * direction.shared, factor * direction.groups)
            return cost(problem, problem.retract(state, moved))

        numeric = (at(1e-4) - at(-1e-4)) / 2e-4
        # central differences of a cost near 1e3 with steps of 1e-4: nine digits of it, six of the slope
        assert equations.gradient.dot(direction) == pytest.approx(numeric, rel=1e-5)


def test_partial_views_count_only_what_was_seen():
    scene = make_scene(count=3)
    seen = scene.observe(1)
    part = [replace(seen[0], ids=seen[0].ids[::3], pixels=seen[0].pixels[::3]), *seen[1:]]
    observations = Observations.of(part)
    assert np.count_nonzero(observations.weights) == sum(len(view.ids) for view in part)
    problem = BoardProblem(scene.camera.model, scene.board, observations, np.arange(9))
    state = replace(state_of(scene, (), np.random.default_rng(0)), offsets=np.zeros((scene.board.count, 3)))
    residuals = problem.residuals(state)[:, observations.weights > 0]
    assert np.abs(residuals).max() < 1e-9  # noise-free views at the truth


def test_shared_parameters_are_named_in_their_order():
    scene = make_scene(count=3)
    problem = BoardProblem(
        scene.camera.model, scene.board, Observations.of(scene.observe(1)), np.array([0, 1]), ("xy",), offsets=True
    )
    assert problem.shared_names[:6] == ("fx", "fy", "xy", "point 0 x", "point 0 y", "point 0 z")
    assert len(problem.shared_names) == problem.shared


@pytest.mark.parametrize("model", MODELS.values(), ids=lambda model: model.name)
def test_lens_priors_leave_the_focal_length_and_centre_free(model):
    spread = model.prior_std((1600, 1200), 1200.0)
    assert np.isinf(spread[:2]).all()
    assert (np.isinf(spread[2:4]) == model.is_central).all()
    assert np.isfinite(spread[4:]).all()


def test_whitened_distances_are_those_of_mahalanobis_over_the_typical_covariance():
    rng = np.random.default_rng(7)
    scene = make_scene(count=3)
    shapes = rng.normal(size=(3, scene.board.count, 2, 2))
    covariances = 0.1 * np.eye(2) + shapes @ shapes.swapaxes(2, 3)
    observations = Observations.of(scene.observe(1)).weighted(covariances)
    problem = BoardProblem(scene.camera.model, scene.board, observations, np.arange(9))
    residuals = rng.normal(size=(2, 3, scene.board.count))
    squared = np.einsum("ivp,vpij,jvp->vp", residuals, np.linalg.inv(covariances), residuals)
    typical = np.exp(np.mean(np.log(np.linalg.det(covariances))) / 2)  # px²: the geometric mean of both axes of all
    np.testing.assert_allclose(problem.distances(residuals), np.sqrt(squared * typical), rtol=1e-9)


@pytest.mark.parametrize(("off_px", "solved_with"), [(0.0, False), (20.0, True)], ids=["fits", "gross"])
def test_a_corner_that_fits_may_not_leave_the_domain_of_the_lens(off_px, solved_with):
    """A lens whose image turns back within the board: its formula has an image of the corners beyond, too."""
    scene = make_scene(count=3)
    lens = np.array([1000.0, 1000.0, 800.0, 600.0, -1.2, 0.0, 0.0, 0.0, 0.0])
    problem = BoardProblem(scene.camera.model, scene.board, Observations.of(scene.observe(1)), np.arange(9), sigma=0.1)
    state = replace(
        state_of(scene, (), np.random.default_rng(0)), parameters=lens, offsets=np.zeros((scene.board.count, 3))
    )
    beyond = np.isnan(problem.residuals(state)).any(axis=0)
    assert 0 < beyond.sum() < beyond.size
    by_formula = problem.derivatives(state).residuals.reshape(2, *beyond.shape)
    shifted = replace(problem.observations, pixels=problem.observations.pixels + by_formula + off_px * beyond)
    assert (replace(problem, observations=shifted).blocks(state) is not None) == solved_with
