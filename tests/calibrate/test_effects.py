"""The columns of errors within views: what each moves, how far, and against differences of the projection."""

from dataclasses import replace

import numpy as np
import pytest
from observed import make_scene

from camcal.calibrate.effects import EFFECTS, FLEX, ROLLING, SMOOTH, columns_at, effect_columns
from camcal.calibrate.problem import BoardProblem, State
from camcal.cameras.observations import Observations
from camcal.solve.least_squares import assemble
from camcal.solve.steps import Step
from camcal.targets.board import Board, basis

NAMES = tuple(effect.name for effect in EFFECTS)
OUT_OF_PLANE = ("xy", "P2(x)", "P2(y)", "P3(x)", "P2(x)y", "xP2(y)", "P3(y)")


@pytest.fixture(scope="module")
def seen():
    """Problem, state and present corners of four views without noise, of which two are seen in part."""
    scene = make_scene(count=4)
    full = scene.observe(1)
    views = [
        replace(full[0], ids=full[0].ids[::2], pixels=full[0].pixels[::2]),
        replace(full[1], ids=full[1].ids[5:], pixels=full[1].pixels[5:]),
        *full[2:],
    ]
    observations = Observations.of(views)
    problem = BoardProblem(scene.camera.model, scene.board, observations, np.arange(4))
    state = State(
        np.array(scene.camera.parameters),
        np.stack([pose.rotation for pose in scene.poses]),
        np.stack([pose.translation for pose in scene.poses]),
        np.zeros(0),
        np.zeros((scene.board.count, 3)),
    )
    return problem, state, observations.weights > 0


def columns_of(problem, state, effects=NAMES):
    return columns_at(problem, state, problem.derivatives(state), effects)


def slope(problem, moved, length):
    """The central difference of the projection along a way through states."""
    return (problem.residuals(moved(length)) - problem.residuals(moved(-length))) / (2 * length)


def fine_field(board):
    """The smooth columns (2, m, C) of one view that sees all of a board, and weights (C,) of an integral over it."""
    ids = np.arange(board.count)[None]
    points = board.points()[:, :2]
    result = effect_columns(
        board,
        ids,
        np.moveaxis(points, 1, 0)[:, None] * 1e3,
        np.ones((2, 6, 1, board.count)),
        np.ones((2, 1, board.count)),
        np.ones((1, board.count), bool),
    )
    weights = np.ones(board.count)
    for axis in range(2):
        edge = (points[:, axis] == points[:, axis].min()) | (points[:, axis] == points[:, axis].max())
        weights[edge] *= 0.5
    return result.of([EFFECTS.index(SMOOTH)]).values[:, :, 0], weights / weights.sum()


def test_every_effect_has_its_columns(seen):
    columns = columns_of(*seen[:2])
    views, points = seen[2].shape
    assert [SMOOTH.columns, ROLLING.columns, FLEX.columns] == [18, 6, 7]
    assert [effect.of_board for effect in EFFECTS] == [False, False, True]
    assert columns.values.shape == (2, 31, views, points)
    np.testing.assert_array_equal(columns.effect, [0] * 18 + [1] * 6 + [2] * 7)


def test_effects_may_be_taken_by_themselves(seen):
    columns = columns_of(*seen[:2])
    np.testing.assert_array_equal(columns.of([1]).values, columns.values[:, 18:24])
    assert columns.of([1]).values.flags.c_contiguous
    two = columns.of([0, 2])
    np.testing.assert_array_equal(two.values, np.delete(columns.values, np.s_[18:24], axis=1))
    np.testing.assert_array_equal(two.effect, [0] * 18 + [2] * 7)
    assert columns.of([]).values.shape[1] == 0
    np.testing.assert_array_equal(columns_of(*seen[:2], effects=("flex",)).values, columns.values[:, 24:])


def test_corners_that_are_not_there_are_not_moved(seen):
    columns, present = columns_of(*seen[:2]), seen[2]
    assert not present.all()
    assert (columns.values[:, :, ~present] == 0).all()
    assert np.abs(columns.values[:, :, present]).max(axis=(0, 2)).min() > 0


def test_a_smooth_field_of_unit_coefficients_has_a_mean_square_of_one_and_no_mean():
    field, weights = fine_field(Board("chessboard", 90, 70, 0.01))
    half = field.shape[1] // 2
    assert (field[1, :half] == 0).all()  # the first half moves u
    assert (field[0, half:] == 0).all()
    # the trapezoid rule over 70 points of polynomials of degree 6: some of (2 / 69)² / 12 · 42, a share of 0.3 %
    products = np.einsum("imc,inc,c->mn", field, field, weights)
    np.testing.assert_allclose(products - np.diag(np.diag(products)), 0, atol=5e-3)
    assert np.trace(products[:half, :half]) == pytest.approx(1.0, rel=5e-3)
    np.testing.assert_allclose(products[:half, :half], products[half:, half:], atol=1e-12)
    np.testing.assert_allclose(field @ weights, 0, atol=5e-3)


def test_the_spectrum_of_a_smooth_field_falls_with_its_degree():
    board = Board("chessboard", 90, 70, 0.01)
    field, weights = fine_field(board)
    squares = np.sort(np.einsum("mc,c->m", field[0, :9] ** 2, weights))
    # two modes of degree 1, three of degree 2 and four of degree 3, each of its share
    expected = np.repeat([0.12, 0.3, 1.0], [4, 3, 2]) / 3.38
    np.testing.assert_allclose(squares, expected, rtol=1e-2)  # the trapezoid rule
    x, y = (board.points()[:, :2] / np.array(board.extent) * 2 - 1).T
    shares = field[0, :9] ** 2 @ weights
    for degree, share in ((1, expected[8]), (2, expected[4]), (3, expected[0])):
        modes = field[0, :9][np.isclose(shares, share, rtol=0.02)]
        powers = np.array([x**i * y**j for i in range(4) for j in range(4) if i + j <= degree])
        left = modes.T - powers.T @ np.linalg.lstsq(powers.T, modes.T, rcond=None)[0]
        np.testing.assert_allclose(left, 0, atol=1e-9)  # polynomials of that degree, to rounding


def test_a_smooth_field_belongs_to_points_of_the_board_wherever_they_are_listed(seen):
    problem, state, present = seen
    values = columns_of(problem, state, ("smooth",)).values
    ids = problem.observations.ids
    full = values[:, :, 3]
    assert present[3].all()
    for view in range(3):
        for place in np.flatnonzero(present[view]):
            other = np.flatnonzero(ids[3] == ids[view, place])[0]
            np.testing.assert_array_equal(values[:, :, view, place], full[:, :, other])


def test_rolling_is_a_motion_about_the_middle_of_the_board_that_grows_with_the_row(seen):
    problem, state, present = seen
    values = columns_of(problem, state, ("rolling",)).values
    rows = problem.observations.pixels[1]
    time = (rows - rows[present].mean()) / rows[present].std()
    points = problem.board.points()
    middle = points.mean(axis=0)
    edge = np.sqrt(np.mean(np.sum((points - middle) ** 2, axis=1)))

    def moved(parameter, length):
        """The state after a shift by `length`, or a turn about the middle that moves the edge as far."""
        step = np.zeros((len(state.rotations), 6))
        step[:, parameter] = length if parameter < 3 else length / edge
        turned = posed(problem, state, step)
        back = (state.rotations - turned.rotations) @ middle
        return turned if parameter < 3 else replace(turned, translations=state.translations + back)

    # differences over 1e-6 m, 1e-3 px: third-order terms and rounding are 1e-7 of them
    motion = np.stack([slope(problem, lambda length, own=own: moved(own, length), 1e-6) for own in range(6)], axis=1)
    for view, here in enumerate(present):
        own = motion[:, :, view, here]
        shift = np.sqrt(np.mean(np.sum(own[:, :2] ** 2, axis=(0, 1)) / 2))
        np.testing.assert_allclose(values[:, :, view, here], time[view, here] * own / shift, rtol=1e-4, atol=1e-6)


def posed(problem, state, step):
    return problem.retract(state, Step(np.zeros(problem.shared), step))


def test_noise_of_measured_corners_is_not_in_the_columns_that_shall_explain_it(seen):
    problem, state, _ = seen
    noise = np.random.default_rng(4).normal(size=problem.observations.pixels.shape)
    noisy = replace(problem, observations=replace(problem.observations, pixels=problem.observations.pixels + noise))
    found, expected = (columns_of(own, state).values for own in (noisy, problem))
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_rows_exposed_at_once_do_not_divide_by_zero():
    board = Board("chessboard", 5, 4, 0.04)
    ids = np.arange(20)[None]
    pixels = np.stack([np.arange(20.0), np.full(20, 100.0)])[:, None]
    by_pose = np.ones((2, 6, 1, 20))
    values = effect_columns(board, ids, pixels, by_pose, by_pose[:, 0], np.ones((1, 20), bool)).values
    assert np.isfinite(values).all()
    assert (values[:, 18:24] == 0).all()


def test_time_is_counted_over_corners_that_are_there():
    board = Board("chessboard", 5, 4, 0.04)
    rng = np.random.default_rng(3)
    ids, present = np.tile(np.arange(20), (2, 1)), rng.random((2, 20)) < 0.7
    pixels, motion = 300 * rng.random((2, 2, 20)), rng.normal(size=(2, 6, 2, 20)) * present
    values = effect_columns(board, ids, pixels, motion, motion[:, 0], present).values
    pixels[:, ~present] = 1e6
    np.testing.assert_array_equal(effect_columns(board, ids, pixels, motion, motion[:, 0], present).values, values)


def test_a_view_without_corners_has_columns_of_zeros():
    board = Board("chessboard", 5, 4, 0.04)
    rng = np.random.default_rng(4)
    present = np.array([[True] * 20, [False] * 20])
    by_pose = rng.normal(size=(2, 6, 2, 20)) * present
    values = effect_columns(
        board, np.tile(np.arange(20), (2, 1)), 300 * rng.random((2, 2, 20)), by_pose, by_pose[:, 0], present
    ).values
    assert (values[:, :, 1] == 0).all()
    assert np.isfinite(values).all()


def test_flex_moves_points_out_of_the_board(seen):
    problem, state, present = seen
    values = columns_of(problem, state, ("flex",)).values
    heights = basis(problem.board, OUT_OF_PLANE)[:, 2]
    drawn = problem.board.points()
    for term in range(len(OUT_OF_PLANE)):

        def bent(length, height=heights[:, term]):
            return replace(problem, points=drawn + length * np.outer(height, [0.0, 0.0, 1.0])).residuals(state)

        numeric = (bent(1e-5) - bent(-1e-5)) / 2e-5  # of 10 µm at some 0.5 m: relative 1e-9, and rounding of 1e-7
        np.testing.assert_allclose(values[:, term][:, present], numeric[:, present], rtol=1e-5, atol=1e-4)


def test_columns_are_derivatives_of_the_residuals_weighed_and_whitened_like_them(seen):
    problem, state, present = seen
    rng = np.random.default_rng(5)
    shapes = rng.normal(size=(*present.shape, 2, 2))
    observations = problem.observations.weighted(0.1 * np.eye(2) + shapes @ shapes.swapaxes(2, 3))
    weights = present * rng.uniform(0.2, 1, present.shape)
    noise = np.array([1.0, 3.0, 0.5, 2.0])
    observations = replace(observations, pixels=observations.pixels + rng.normal(size=(2, *present.shape)))
    problem = replace(problem, observations=replace(observations, weights=weights), sigma=0.7, noise=noise)
    columns = columns_of(problem, state)
    derivatives = problem.derivatives(state)
    equations = assemble([problem.data(state, derivatives, columns.values)], problem.shared, 4, 37)
    coefficients = rng.normal(size=(4, 31)) * np.where(columns.effect == 2, 1e-3, 1.0)

    def cost(length):
        residuals = problem.residuals(state) + length * np.einsum("imvp,vm->ivp", columns.values, coefficients)
        squares = np.nan_to_num(problem.distances(residuals)) ** 2
        return 0.5 * np.sum(weights * squares / noise[:, None]) / 0.7**2

    gradient, curvature = (cost(1) - cost(-1)) / 2, cost(1) + cost(-1) - 2 * cost(0)
    own = equations.group_group[:, 6:, 6:]
    assert equations.cost == pytest.approx(cost(0), rel=1e-12)
    # a quadratic: differences are exact
    assert np.sum(equations.gradient.groups[:, 6:] * coefficients) == pytest.approx(gradient, rel=1e-9)
    assert np.einsum("vi,vij,vj", coefficients, own, coefficients) == pytest.approx(curvature, rel=1e-9)
