"""The board's shape in the equations: against problems solved without its priors, and against differences."""

from dataclasses import replace

import numpy as np
import pytest
from observed import make_scene, true_state

from camcal.calibrate.effects import posterior
from camcal.calibrate.problem import BoardProblem, State
from camcal.calibrate.shape import (
    Scale,
    board_scales,
    first_scales,
    hold_to_print,
    odd_terms,
    offset_std,
    scale_of,
    spent_on_offsets,
    surface_of,
    with_priors,
    with_terms,
)
from camcal.cameras.observations import Observations
from camcal.solve.steps import factorise
from camcal.targets.board import CLASSES, CORNER_CLASSES, IN_PLANE, OUT_OF_PLANE, RATIOS, TERMS, Board

BOARD = Board("chessboard", 6, 4, 0.040)
SIDE = 0.2  # its longer one, m
LENS = 3
ODD = ("P3(x)", "P2(x)y", "xP2(y)", "P3(y)")


@pytest.fixture(scope="module")
def bent():
    """Problem and state of eight views of a bent board whose points are off, three lens parameters free."""
    rng = np.random.default_rng(3)
    scene = make_scene(board=BOARD, count=8)
    observations = Observations.of(scene.observe(4, noise_px=0.2))
    problem = BoardProblem(
        scene.camera.model,
        BOARD,
        replace(observations, weights=observations.weights * rng.uniform(0.3, 1, observations.weights.shape)),
        np.arange(LENS),
        TERMS,
        offsets=True,
        sigma=0.2,
        lens_spread=np.full(9, 3000.0),
        term_std=2e-4 * rng.uniform(0.5, 2, len(TERMS)),
        offset_std=np.array([5e-5, 5e-5, 9e-5]),
    )
    state = true_state(scene, 2e-4 * rng.normal(size=len(TERMS)))
    state = replace(state, offsets=1e-4 * rng.normal(size=(BOARD.count, 3)))
    return problem, state


def factors_at(problem, state):
    return factorise(problem.equations(state, problem.derivatives(state)))


def solved(problem, state):
    """The factors of one linearisation and the state at its minimum."""
    factors = factors_at(problem, state)
    return factors, problem.retract(state, factors.solve())


def said(problem, state, chosen):
    """What is known of some shared parameters, everything else following: information and vector."""
    factors, end = solved(problem, state)
    information = np.linalg.inv(factors.shared_covariance()[np.ix_(chosen, chosen)])
    values = np.concatenate([end.parameters[:LENS], end.shape, end.offsets.ravel()])
    return information, information @ values[chosen]


def assert_alike(found, information, vector, unit, own):
    expected = scale_of(unit**2 * information, unit * vector, own.median, own.spread)
    for name in ("effective", "mean", "std", "present"):
        # a standard deviation of 1 stands for no prior: a millionth of the information
        assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=1e-4)


@pytest.mark.parametrize("name", CLASSES)
def test_the_scale_of_a_class_is_that_of_what_the_data_say_without_its_prior(bent, name):
    problem, state = bent
    factors, end = solved(problem, state)
    own = CLASSES[name]
    place = np.array([TERMS.index(term) for term in own.terms])
    std = problem.term_std.copy()
    std[place] = 1.0
    data = said(replace(problem, term_std=std), state, LENS + place)
    unit = 1.0 if own.terms[0] in RATIOS else SIDE
    assert_alike(board_scales(problem, end, factors)[name], *data, unit, own)


@pytest.mark.parametrize(("name", "axes"), [(IN_PLANE, [0, 1]), (OUT_OF_PLANE, [2])])
def test_the_scale_of_single_points_is_that_of_what_the_data_say_without_their_prior(bent, name, axes):
    problem, state = bent
    factors, end = solved(problem, state)
    place = [LENS + len(TERMS) + 3 * point + axis for point in range(BOARD.count) for axis in axes]
    std = problem.offset_std.copy()
    std[axes] = 1.0
    data = said(replace(problem, offset_std=std), state, np.array(place))
    assert_alike(board_scales(problem, end, factors)[name], *data, SIDE, CORNER_CLASSES[name])


def test_only_what_is_solved_for_has_scales(bent):
    problem, state = bent
    flat, plane = replace(problem, terms=(), term_std=None), replace(state, shape=np.zeros(0))
    factors, end = solved(flat, plane)
    assert set(board_scales(flat, end, factors)) == {IN_PLANE, OUT_OF_PLANE}
    smooth = replace(problem, offsets=False)
    factors, end = solved(smooth, state)
    assert set(board_scales(smooth, end, factors)) == set(CLASSES)


def hat_traces(problem, state):
    """The traces (V,) of each view's part of the hat matrix, from one dense Jacobian by everything."""
    block, (views, corners) = problem.data(state, problem.derivatives(state)), problem.observations.ids.shape
    rows, start = np.arange(views * corners), 6 * views
    jacobian = np.zeros((len(rows), 2, start + problem.shared))
    own = 6 * (rows // corners)[:, None] + np.arange(6)
    parts = [(block.group, own), *((part.values, start + part.columns) for part in block.shared)]
    for values, columns in parts:
        np.put_along_axis(jacobian, np.broadcast_to(np.atleast_2d(columns)[:, None], values.shape), values, axis=2)
    jacobian = (jacobian * np.sqrt(block.weights)[:, None, None]).reshape(2 * len(rows), -1)
    precision = [np.zeros(start), problem.lens_spread[problem.free] ** -2.0]
    if problem.terms:
        precision.append(problem.term_std**-2.0)
    precision.append(np.tile(problem.offset_std**-2.0, problem.board.count))
    inverse = np.linalg.inv(jacobian.T @ jacobian + np.diag(np.concatenate(precision)))
    return np.sum((jacobian @ inverse) * jacobian, axis=1).reshape(views, -1).sum(axis=1)


@pytest.mark.parametrize("terms", [True, False])
def test_with_offsets_a_view_has_spent_the_trace_of_its_part_of_the_hat_matrix(bent, terms):
    problem, state = bent
    if not terms:
        problem, state = replace(problem, terms=(), term_std=None), replace(state, shape=np.zeros(0))
    factors = factors_at(problem, state)
    found = posterior(factors).spent + spent_on_offsets(problem, state, problem.derivatives(state), factors)
    expected = hat_traces(problem, state)
    assert expected.max() > 1.1 * expected.min()
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_every_view_pulls_on_the_cubic_terms_as_it_does_by_itself(bent):
    problem, state = bent
    pulls, information = odd_terms(problem, state, factors_at(problem, state))
    assert pulls.shape == (8, 4)
    terms = np.array([TERMS.index(term) for term in ODD])
    prior = state.shape[terms] / problem.term_std[terms] ** 2
    for view, pull in enumerate(pulls):
        alone = replace(problem, observations=problem.observations.take(np.array([view])))
        gradient = factors_at(alone, state.take(np.array([view]))).reduced_gradient()
        np.testing.assert_allclose(pull, gradient[LENS + terms] - prior, rtol=1e-6, atol=1e-6 * np.abs(pulls).max())
    std = problem.term_std.copy()
    std[terms] = 1.0
    expected, _ = said(replace(problem, term_std=std), state, LENS + terms)
    np.testing.assert_allclose(information, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())


def test_scales_begin_at_the_medians_of_all_classes():
    found = first_scales()
    assert set(found) == {*CLASSES, *CORNER_CLASSES}
    assert found["bow"] == Scale(1e-3, 1e-3, 0.0, 0.5)


def test_terms_that_are_known_are_kept_where_all_are_estimated(bent):
    problem, state = bent
    some = replace(problem, terms=("shear", "xy"))
    whole, begun = with_terms(some, replace(state, shape=np.array([3.0, 4.0])))
    assert whole.terms == TERMS
    assert {term: value for term, value in zip(TERMS, begun.shape, strict=True) if value} == {"shear": 3.0, "xy": 4.0}


def test_priors_are_scales_times_the_longer_side_but_for_ratios(bent):
    problem, _ = bent
    scales = {name: Scale(1e-3 * place, 7.0, 7.0, 0.7) for place, name in enumerate(first_scales(), start=1)}
    found = with_priors(problem, scales)
    stds = dict(zip(TERMS, found.term_std, strict=True))
    assert (stds["xy"], stds["P2(y)"], stds["P3(y)"]) == pytest.approx((SIDE * 1e-3, SIDE * 2e-3, SIDE * 3e-3))
    assert (stds["x/y scale"], stds["shear"], stds["keystone y"]) == pytest.approx((5e-3, 6e-3, SIDE * 7e-3))
    np.testing.assert_allclose(found.offset_std, SIDE * np.array([8e-3, 8e-3, 9e-3]), rtol=1e-12)
    np.testing.assert_array_equal(found.offset_std, offset_std(scales, SIDE))
    none = with_priors(replace(problem, terms=(), offsets=False, term_std=None, offset_std=None), scales)
    assert none.term_std is None
    assert none.offset_std is None


def test_a_prior_is_never_narrower_than_a_ten_thousandth_of_its_class(bent):
    scales = {name: replace(own, effective=0.0) for name, own in first_scales().items()}
    found = with_priors(bent[0], scales)
    stds = dict(zip(TERMS, found.term_std, strict=True))
    assert (stds["P2(x)"], stds["shear"]) == pytest.approx((SIDE * 1e-7, 6e-8))
    np.testing.assert_allclose(found.offset_std, SIDE * 1e-8, rtol=1e-12)


def surface(shape, offsets, covariance=None, *, free=False):
    terms = ("P2(x)", "xy", "P3(y)")
    problem = BoardProblem(None, BOARD, None, np.arange(2), terms, free, offset_std=np.array([1.0, 2.0, 3e-4]))
    state = State(np.zeros(4), np.zeros((0, 3, 3)), np.zeros((0, 3)), shape, offsets)
    covariance = np.zeros((5, 5)) if covariance is None else covariance
    return surface_of(problem, state, first_scales(), covariance)


def test_the_deflection_is_from_the_highest_to_the_lowest_point_over_the_plane_through_all():
    rng = np.random.default_rng(6)
    shape, offsets = 1e-3 * rng.normal(size=3), 1e-4 * rng.normal(size=(BOARD.count, 3))
    points = surface(shape, offsets).points()
    drawn = BOARD.points()[:, :2]
    tilts = np.column_stack([np.ones(len(drawn)), drawn])
    normal = np.linalg.solve(tilts.T @ tilts, tilts.T @ points[:, 2])
    found = surface(shape, offsets)
    assert found.deflection == pytest.approx(np.ptp(points[:, 2] - tilts @ normal), rel=1e-9)
    tilted = offsets + np.column_stack([0 * drawn, 1e-2 * drawn @ [1.0, -2.0] + 5e-3])
    assert surface(shape, tilted).deflection == pytest.approx(found.deflection, rel=1e-9)
    assert surface(shape, 0 * offsets).offsets is None
    single = offsets * (np.arange(BOARD.count) == 3)[:, None]  # the others were not seen
    np.testing.assert_array_equal(surface(shape, single).offsets, single)
    assert found.classes["bow"] == (1e-3, 0.0)


def test_the_deflection_is_known_as_its_slope_and_the_two_points_say():
    rng = np.random.default_rng(7)
    shape, offsets = 1e-3 * rng.normal(size=3), 1e-4 * rng.normal(size=(BOARD.count, 3))
    root = 1e-4 * rng.normal(size=(5, 5))
    found = surface(shape, offsets, root @ root.T)
    length = 1e-6
    slope = [
        (surface(shape + step, offsets).deflection - surface(shape - step, offsets).deflection) / (2 * length)
        for step in length * np.eye(3)
    ]
    own = (root @ root.T)[2:, 2:]
    assert found.deflection_std == pytest.approx(np.sqrt(slope @ own @ slope), rel=1e-6)
    np.testing.assert_allclose(found.coefficients_std(), np.sqrt(np.diag(own)), rtol=1e-12)
    points = surface(shape, offsets, root @ root.T, free=True)
    assert points.deflection_std == pytest.approx(np.sqrt(slope @ own @ slope + 2 * 3e-4**2), rel=1e-6)


PRINTED = np.array([CLASSES["stretch"].median, CLASSES["shear"].median])


def held(bent, stretch, stretch_std, shear=0.0, shear_std=1e-4, between=0.3):
    """What printers make of these terms, of which the x/y scale trades with fx: the steps of the lens and of the two
    terms, values and covariance before, and the covariance after.
    """
    problem, state = bent
    std = np.concatenate([[2.0, 2.0, 2.0], np.full(len(TERMS), 1e-4)])
    places = [LENS + TERMS.index(term) for term in RATIOS]
    std[places] = stretch_std, shear_std
    correlations = np.eye(len(std))
    correlations[0, places[0]] = correlations[places[0], 0] = -0.9
    correlations[places[0], places[1]] = correlations[places[1], places[0]] = between
    before = correlations * std[:, None] * std
    values = dict(zip(TERMS, state.shape, strict=True)) | dict(zip(RATIOS, (stretch, shear), strict=True))
    state = replace(state, shape=np.array(list(values.values())))
    end, after = hold_to_print(problem, state, values, before)
    step = np.concatenate([end.parameters[:LENS] - state.parameters[:LENS], end.shape - state.shape])
    np.testing.assert_array_equal(end.offsets, state.offsets)
    return step, places, before, after


def test_printers_hold_what_views_hardly_know_as_a_measurement_of_nothing_would(bent):
    values = np.array([1e-3, 3e-4])
    step, places, before, after = held(bent, values[0], 2e-3, values[1], 5e-4)
    measured = np.eye(len(before))[places]
    gain = before @ measured.T @ np.linalg.inv(measured @ before @ measured.T + np.diag(PRINTED**2))
    np.testing.assert_allclose(step, -gain @ values, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(after, before - gain @ measured @ before, rtol=1e-9, atol=1e-15)


def test_what_views_know_well_stays_whatever_printers_do(bent):
    step, places, _, after = held(bent, 5e-3, 2e-5)
    assert abs(step[places[0]]) < 1e-3 * 5e-3
    assert np.sqrt(after[0, 0]) == pytest.approx(2.0, rel=1e-3)


@pytest.mark.parametrize(("factor", "kept"), [(0.5, 0.8), (1.0, 0.5), (2.0, 0.2)])
def test_the_lens_follows_the_print_where_views_know_as_little(bent, factor, kept):
    stretch = PRINTED[0]
    step, places, _, _ = held(bent, stretch, factor * stretch, between=0.0)
    assert step[places[0]] == pytest.approx((kept - 1) * stretch)
    assert step[0] == pytest.approx(0.9 * 2.0 / factor * (1 - kept))


@pytest.mark.parametrize(("std", "least", "most"), [(4e-4, 0.95, 1.0), (1e-3, 0.6, 0.9), (4e-3, 0.02, 0.12)])
def test_boards_that_no_usual_printer_makes_stay_where_views_are_sure_of_them(bent, std, least, most):
    step, places, _, _ = held(bent, 4e-3, std)
    assert least < 1 + step[places[0]] / 4e-3 < most


def test_a_board_as_drawn_has_no_print_to_hold_to(bent):
    problem, state = bent
    end, after = hold_to_print(problem, state, {}, np.eye(4))
    assert end is state
    np.testing.assert_array_equal(after, np.eye(4))
