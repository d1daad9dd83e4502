"""The offsets of single points with everything else held: against differences of the cost, and all points at once."""

from dataclasses import replace

import numpy as np
import pytest
from observed import make_scene, true_state
from scipy.linalg import block_diag

from camcal.calibrate.problem import BoardProblem
from camcal.calibrate.shape import PointEquations, point_equations, scale_of
from camcal.cameras.observations import Observations
from camcal.targets.board import CORNER_CLASSES, IN_PLANE, OUT_OF_PLANE, Board

BOARD = Board("chessboard", 4, 3, 0.040)
VIEWS, SIGMA = 5, 0.3
POINTS = 12


@pytest.fixture(scope="module")
def seen():
    """A problem whose corners have covariances, weights and noise of their own, a state, and what effects move."""
    rng = np.random.default_rng(1)
    scene = make_scene(board=BOARD, count=VIEWS)
    views = scene.observe(2, noise_px=0.3)
    observations = Observations.of([replace(views[0], ids=views[0].ids[::2], pixels=views[0].pixels[::2]), *views[1:]])
    weights = observations.weights * rng.uniform(0.2, 1, observations.weights.shape)
    shapes = rng.normal(size=(*weights.shape, 2, 2))
    observations = observations.weighted(0.1 * np.eye(2) + shapes @ shapes.swapaxes(2, 3))
    problem = BoardProblem(
        scene.camera.model,
        BOARD,
        replace(observations, weights=weights),
        np.arange(4),
        ("xy", "P2(x)"),
        sigma=SIGMA,
        noise=rng.uniform(0.5, 3, VIEWS),
    )
    state = replace(true_state(scene, [1e-3, -2e-3]), offsets=1e-3 * rng.normal(size=(POINTS, 3)))
    return problem, state, rng.normal(size=(2, *weights.shape))


def whitened(problem, state, field):
    """The residuals (V, P, 2) in standard deviations at a state."""
    inside = problem.residuals(state) + field
    values = np.einsum("ijvp,jvp->vpi", problem.observations.whitening, inside)
    return values * np.sqrt(problem.observations.weights / problem.noise[:, None])[..., None] / SIGMA


def test_the_equations_of_points_are_those_of_the_cost_with_everything_else_held(seen):
    problem, state, field = seen
    found = point_equations(problem, state, problem.derivatives(state), field)
    here = whitened(problem, state, field)
    columns = []
    for axis in 1e-6 * np.eye(3 * POINTS):
        moved = [replace(state, offsets=state.offsets + sign * axis.reshape(-1, 3)) for sign in (1, -1)]
        columns.append((whitened(problem, moved[0], field) - whitened(problem, moved[1], field)).ravel() / 2e-6)
    jacobian = np.array(columns).T
    normal, gradient = jacobian.T @ jacobian, jacobian.T @ here.ravel()
    expected = normal.reshape(POINTS, 3, POINTS, 3)
    assert np.abs(block_diag(*found.information) - normal).max() < 1e-6 * normal.max()  # points do not meet
    by_point = np.zeros_like(found.information)
    np.add.at(by_point, found.ids, found.by_corner)
    np.testing.assert_allclose(by_point, found.information, atol=1e-9 * found.information.max())
    for point in range(POINTS):
        own = expected[point, :, point]
        np.testing.assert_allclose(found.information[point], own, atol=1e-6 * own.max())
        # Λ x, where the cost has no slope at the offset x of this point alone
        vector = own @ state.offsets[point] - gradient.reshape(-1, 3)[point]
        np.testing.assert_allclose(found.vector[point], vector, atol=1e-6 * np.abs(vector).max())


def drawn(seed):
    rng = np.random.default_rng(seed)
    roots = rng.normal(size=(POINTS, 3, 3)) * 1e4
    information = roots @ roots.swapaxes(1, 2)
    ids = np.stack([rng.permutation(POINTS) for _ in range(2)])  # two views, the first of which says four times as much
    by_corner = np.array([0.8, 0.2])[:, None, None, None] * information[ids]
    return PointEquations(information, 1e4 * rng.normal(size=(POINTS, 3)), by_corner, ids)


def test_offsets_are_the_minimum_of_data_and_prior():
    equations, std = drawn(2), np.array([1e-4, 2e-4, 5e-5])
    offsets = equations.offsets(std)
    slopes = np.einsum("cij,cj->ci", equations.information, offsets) - equations.vector + offsets / std**2
    assert np.abs(offsets).max() > 1e-6
    np.testing.assert_allclose(slopes, 0, atol=1e-9 * np.abs(equations.vector).max())


def test_offsets_take_the_degrees_of_freedom_by_which_they_follow_the_data():
    equations, std = drawn(3), np.array([1e-4, 2e-4, 5e-5])
    followed = 0.0
    for axis in range(3):
        # the data's own value of every point moved by one unit: all is linear
        moved = replace(equations, vector=equations.vector + equations.information[:, :, axis])
        followed += np.sum(moved.offsets(std)[:, axis] - equations.offsets(std)[:, axis])
    assert 1 < followed < 3 * POINTS - 1
    np.testing.assert_allclose(equations.spent(std), [0.8 * followed, 0.2 * followed], rtol=1e-9)


@pytest.mark.parametrize(("name", "axes"), [(IN_PLANE, [0, 1]), (OUT_OF_PLANE, [2])])
@pytest.mark.parametrize("left", [1.0, 0.6])
def test_scales_are_those_of_all_points_at_once_as_shares_of_the_board(name, axes, left):
    equations, side, prior = drawn(4), 0.12, CORNER_CLASSES[name]
    information = left * block_diag(*equations.information[:, axes][:, :, axes])
    vector = left * equations.vector[:, axes].ravel()
    expected = scale_of(side**2 * information, side * vector, prior.median, prior.spread)
    found = equations.scales(side, left)
    assert set(found) == {IN_PLANE, OUT_OF_PLANE}
    assert 0.01 < expected.present < 0.9999
    for value in ("effective", "mean", "std", "present"):
        assert getattr(found[name], value) == pytest.approx(getattr(expected, value), rel=1e-9)
