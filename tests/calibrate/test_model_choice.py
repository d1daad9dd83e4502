"""Lens models chosen by prediction: against solving again without a view, density, margin, and the choice itself.

That real lenses are served well is not proved here: these are simulated, each by one of the candidates.
"""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from observed import PARAMETERS, SIZE, make_scene
from scipy.optimize import least_squares
from scipy.stats import multivariate_t

from camcal.calibrate import jackknife
from camcal.calibrate.fit import ShapeOptions, fit_briefly, fit_like
from camcal.calibrate.intrinsics import CandidateModel, Options, calibrate, compare_models
from camcal.calibrate.jackknife import influence, predict_views
from camcal.cameras.catalogue import DEFAULT_MODEL, model_named
from camcal.cameras.directions import in_hull, lens_difference
from camcal.cameras.observations import Observations
from camcal.cameras.validity import field_of_view, folds_inside
from camcal.errors import InsufficientData, InvalidInput, NotConverged
from camcal.geometry import rotation as so3
from camcal.quality.lens_choice import GAIN, chosen, rank_models
from camcal.simulate import render
from camcal.solve.descent import Stopping
from camcal.solve.least_squares import minimise
from camcal.targets.board import Board
from camcal.tasks.calibration import model_selection
from camcal.tasks.calibration.model_selection import CANDIDATES, select, solve, solve_given

FLAT = ShapeOptions(smooth=False, offsets=False)
OPTIONS = Options(model_named(DEFAULT_MODEL), shape=FLAT)  # the model does not matter
FINE = Stopping(relative_decrease=1e-12, iterations=100)
FLOOR = 0.01 / (np.pi * 20**2)  # 1 % of the corners anywhere within 20 px
NAMES = [name for name in CANDIDATES if name not in ("pinhole", "opencv4")]  # opencv5 contains these
MODELS = [model_named(name) for name in NAMES]
WIDE = {
    "opencv5": [800.0, 803.0, 805.0, 590.0, -0.25, 0.06, 0.0005, -0.0003, -0.004],
    "kannala_brandt4": [600.0, 601.0, 803.0, 596.0, 0.02, -0.01, 0.004, -0.001],
    "kannala_brandt5t": PARAMETERS["kannala_brandt5t"],
    "opencv8": [700.0, 702.0, 805.0, 590.0, 1.2, 0.3, 0.0005, -0.0003, 0.01, 1.6, 0.65, 0.05],
}


def lens(name, count, seed=1):
    """A scene of a wide lens, and what is seen of it."""
    scene = make_scene(name, count=count, seed=seed, parameters=WIDE[name])
    return scene, scene.observe(seed, noise_px=0.1)


def choice(views, scene, shape=FLAT):
    return chosen(compare_models(views, scene.board, replace(OPTIONS, shape=shape), MODELS), DEFAULT_MODEL).name


# One lens model after another


@pytest.mark.parametrize(
    ("first", "name"), [*(("kannala_brandt4", name) for name in NAMES), ("opencv5", "kannala_brandt5t")]
)
def test_a_lens_model_that_goes_on_from_another_comes_to_where_it_would_alone(first, name):
    scene, views = lens(name, 12)
    other, model = plain_estimate(first, views, scene.board)[0], model_named(name)
    free = np.full(len(model.parameter_names), np.nan)
    like, turns = fit_like(other, np.zeros(12, np.intp), model, SIZE, free)
    alone = plain_estimate(name, views, scene.board)[0]
    std = np.sqrt(np.diag(alone.posterior.shared))[: len(free)]
    np.testing.assert_allclose((like.state.parameters - alone.state.parameters) / std, 0, atol=0.1)
    assert like.noise.sigma == pytest.approx(alone.noise.sigma, rel=1e-3)
    assert not turns.any()


def test_parameters_that_are_held_are_so_when_a_lens_model_goes_on_from_another():
    scene, views = lens("opencv5", 12)
    model = model_named("opencv5")
    held = np.full(len(model.parameter_names), np.nan)
    held[[0, 4]] = 801.0, -0.24
    like, _ = fit_like(
        plain_estimate("kannala_brandt4", views, scene.board)[0], np.zeros(12, np.intp), model, SIZE, held
    )
    np.testing.assert_array_equal(like.state.parameters[[0, 4]], [801.0, -0.24])


def test_a_lens_model_that_has_no_image_of_all_corners_does_not_go_on_from_another():
    scene = make_scene("kannala_brandt4", count=8, parameters=[330.0, 330.0, 803.0, 596.0, 0.02, -0.01, 0.004, -0.001])
    other = plain_estimate("kannala_brandt4", scene.observe(1, noise_px=0.1), scene.board)[0]
    state = other.state
    translations = state.translations.copy()
    translations[:, 2] = -0.02  # a little behind the camera
    behind = replace(other, state=replace(state, translations=translations))
    assert np.isfinite(behind.problem.residuals(behind.state)).any()
    model = model_named("pinhole")
    assert fit_like(behind, np.zeros(8, np.intp), model, SIZE, np.full(len(model.parameter_names), np.nan)) is None


# Prediction of left-out views


def plain_estimate(name, views, board):
    observations, model = Observations.of(views), model_named(name)
    free = np.full(len(model.parameter_names), np.nan)
    plain, _ = fit_briefly(model, board, observations, SIZE, free, None, FLAT)
    return plain, observations.weights > 0


def solved_without(plain, view):
    """Residuals (P,) px of a view under the lens of the others, with the weights of all and its pose fitted anew."""
    problem, state = plain.problem, plain.state
    others = np.delete(np.arange(len(problem.observations.ids)), view)
    rest = replace(problem, observations=problem.observations.take(others), noise=problem.noise[others])
    found = minimise(rest, state.take(others), FINE)
    own = replace(problem, observations=problem.observations.take(np.array([view])), noise=None)
    posed, bare = own.poses_only(replace(state.take(np.array([view])), parameters=found.state.parameters))
    pose = minimise(posed, bare, FINE)
    assert found.converged
    assert pose.converged
    return np.hypot(*posed.residuals(pose.state))[0]


def leverages(plain):
    """The largest share (V,) that each view has in what is known of the lens."""
    root = np.linalg.cholesky(plain.posterior.shared)
    return np.linalg.eigvalsh(root.T @ plain.factors.group_information() @ root).max(axis=1)


@pytest.mark.parametrize(("name", "tolerance"), [("opencv5", 0.02), ("kannala_brandt4", 0.02), ("opencv8", 0.08)])
def test_one_step_predicts_a_left_out_view_as_solving_without_it_does(name, tolerance):
    scene = make_scene(name, Board("chessboard", 7, 5, 0.040), count=20)
    views = scene.observe(1, noise_px=0.1)
    ids, pixels = views[3].ids[:-4], views[3].pixels[:-4].copy()
    pixels[5] += [6.0, 5.0]  # a corner that has no weight is predicted like the others; a view that has fewer
    views = [*views[:3], replace(views[3], ids=ids, pixels=pixels), *views[4:]]
    plain, present = plain_estimate(name, views, scene.board)
    before = np.hypot(*plain.problem.residuals(plain.state))
    predicted = jackknife._left_out(plain, influence(plain))
    # beyond a leverage of 2/3 the step is shortened, see jackknife.influence
    free = np.flatnonzero(leverages(plain) < 2 / 3)
    assert len(free) >= 19
    for view in free:
        seen = present[view]
        exact = solved_without(plain, view)[seen] - before[view, seen]
        error = predicted[view, seen] - before[view, seen] - exact
        # what is left is of second order in a step of about a standard deviation; valleys of rational lenses are bent
        assert np.linalg.norm(error) < tolerance * np.linalg.norm(exact)
    assert predicted[3, 5] > 7.0


def test_views_are_scored_by_the_density_of_their_predicted_corners():
    scene = make_scene(board=Board("chessboard", 7, 5, 0.040), count=12, partial=True)
    plain, present = plain_estimate("opencv5", scene.observe(1, noise_px=0.1), scene.board)
    assert not present.all()
    scores, sigma_px = predict_views(plain, influence(plain))
    distances = jackknife._left_out(plain, influence(plain))
    for view, score in enumerate(scores):
        assert score == pytest.approx(log_density(distances[view, present[view]], sigma_px).sum(), rel=1e-9)
    assert CandidateModel("any", scores, present.sum()).score == pytest.approx(scores.sum() / present.sum(), rel=1e-12)


def test_a_view_that_the_lens_cannot_take_costs_the_floor_of_all_its_corners():
    scene = make_scene(board=Board("chessboard", 7, 5, 0.040), count=12)
    plain, present = plain_estimate("opencv5", scene.observe(1, noise_px=0.1), scene.board)
    before, _ = predict_views(plain, influence(plain))
    translations = plain.state.translations.copy()
    translations[4] *= -1  # behind the camera
    after, _ = predict_views(replace(plain, state=replace(plain.state, translations=translations)), influence(plain))
    assert after[4] == pytest.approx(present[4].sum() * np.log(FLOOR), rel=1e-9)
    others = np.arange(12) != 4
    np.testing.assert_allclose(after[others], before[others], rtol=1e-3, atol=0.5)  # sigma hardly moves


# Density of prediction errors


def log_density(distances, sigma):
    points = np.column_stack([distances, 0 * distances])
    return np.log(0.99 * multivariate_t(np.zeros(2), sigma**2 * np.eye(2), 4).pdf(points) + FLOOR)


def drawn(rng, sigma, count):
    """Lengths of Student vectors (nu = 4) in the plane; of these 1 % are anywhere within 20 px instead."""
    lengths = np.hypot(*rng.normal(size=(2, count))) * sigma / np.sqrt(rng.chisquare(4, count) / 4)
    return np.where(rng.random(count) < 0.01, 20 * np.sqrt(rng.random(count)), lengths)


@pytest.mark.parametrize("sigma", [0.03, 0.3, 1.5])
@pytest.mark.parametrize("seed", range(4))
def test_the_likeliest_sigma_is_that_of_which_distances_were_drawn(sigma, seed):
    distances = drawn(np.random.default_rng(seed), sigma, 4000)
    found, densities = jackknife._likeliest(distances)
    # Fisher's information of log sigma is 2 d nu / (d + nu + 2) = 2 a corner: 1.1 % for 4000; 3.5 of these
    assert np.log(found / sigma) == pytest.approx(0, abs=3.5 / np.sqrt(2 * 4000))
    np.testing.assert_allclose(densities, log_density(distances, found), rtol=1e-9)
    for factor in (0.99, 1.01):
        assert log_density(distances, factor * found).sum() < densities.sum()


def test_the_density_integrates_to_one():
    radii = np.geomspace(1e-5, 20, 4001)  # half of them below 0.014 px, so that sigma is small
    sigma, densities = jackknife._likeliest(radii)
    assert sigma < 0.1
    total = np.trapezoid(2 * np.pi * radii**2 * np.exp(densities), np.log(radii))
    # the trapezoids of a logarithmic step of 0.0036; (1 + (20 / 2 sigma)²)⁻² lies beyond
    assert total == pytest.approx(1.0, abs=1e-4)


def test_corners_without_image_cost_the_logarithm_of_the_floor():
    distances = np.append(drawn(np.random.default_rng(1), 0.1, 500), [np.inf, 1e9])
    sigma, densities = jackknife._likeliest(distances)
    np.testing.assert_allclose(densities[-2:], np.log(FLOOR), rtol=1e-9)
    assert densities.min() >= np.log(FLOOR)
    assert sigma == pytest.approx(jackknife._likeliest(distances[:-2])[0], rel=1e-4)


def test_noise_free_corners_have_a_finite_density():
    sigma, densities = jackknife._likeliest(np.zeros(50))
    assert sigma == pytest.approx(1e-4, rel=1e-3)
    assert np.isfinite(densities).all()


# Margin


def candidates(**scores):
    """Contenders of views with ten corners each."""
    return [
        CandidateModel(name, None if own is None else np.array(own), 0 if own is None else 10 * len(own))
        for name, own in scores.items()
    ]


def pick(preferred="default", **scores):
    return chosen(candidates(**scores), preferred).name


# Gains of as many views of ten corners each: views that agree, and views that scatter so that their sum has a standard
# error of 25, 8 and 4 nat. How much is just enough: 0.10 nat a corner and 1.5 standard errors, or 0.02 nat and 2.5
# errors, to be taken for the preferred one; 0.005 nat a corner and 1.5 errors for a simpler one.
AGREED = np.zeros(16)
SPREAD = np.tile([6.0, -6.0], 8)
ERROR = float(np.std(SPREAD, ddof=1)) * 4
MUCH = [(SPREAD, 1.5 * ERROR), (SPREAD * 8 / ERROR, 16.0), (SPREAD * 4 / ERROR, 10.0), (AGREED, 3.2)]
LITTLE = [(SPREAD, 1.5 * ERROR), (SPREAD * 4 / ERROR, 6.0), (AGREED, 0.8)]


def gains(pattern, total):
    """Gains of views that scatter as a pattern does and have a sum."""
    return pattern + total / len(pattern)


def test_the_gain_that_lenses_may_cost_is_the_larger_one():
    assert GAIN == 0.10


@pytest.mark.parametrize(("pattern", "margin"), MUCH, ids=["errors", "gain", "clear errors", "clear gain"])
def test_the_preferred_candidate_stays_within_the_margin(pattern, margin):
    below, above = gains(pattern, 0.999 * margin), gains(pattern, 1.001 * margin)
    base = np.linspace(-3, 12, 16)
    assert pick(simple=base - 50, default=base, other=base + below) == "default"
    assert pick(simple=base - 50, default=base, other=base + above) == "other"
    assert pick(simple=base + below, default=base, other=base - 50) == "default"
    assert pick(simple=base + above, default=base, other=base - 50) == "simple"


@pytest.mark.parametrize(("pattern", "margin"), LITTLE, ids=["errors", "less scatter", "gain"])
def test_the_simplest_that_is_not_beaten_wins_where_the_preferred_one_is(pattern, margin):
    best = np.linspace(-3, 12, 16)
    near, far = best - gains(pattern, 0.999 * margin), best - gains(pattern, 1.001 * margin)
    assert pick(simple=far, other=near, default=best - 50, last=best) == "other"
    assert pick(simple=near, other=near, default=best - 50, last=best) == "simple"
    assert pick(simple=far, other=far, default=best - 50, last=best) == "last"


def test_a_candidate_without_scores_is_beaten_by_any_other():
    poor = np.full(3, -100.0)
    assert pick(simple=None, default=None, other=poor) == "other"
    assert pick(simple=None, default=poor, other=None) == "default"
    assert pick(simple=poor, other=poor + 0.04) == "simple"  # the preferred one is not among them
    assert candidates(one=None)[0].score == -np.inf


def test_one_view_beats_nothing():
    assert pick(default=[0.0], other=[1000.0]) == "default"


# The choice on simulated lenses


def map_error(camera, truth, corners):
    """RMS distance, px, between two cameras' images of directions where corners are, but for a rotation."""
    grid = np.stack(np.meshgrid(np.linspace(0, 1599, 24), np.linspace(0, 1199, 18)), axis=-1).reshape(-1, 2)
    grid = grid[in_hull(grid, corners)]
    rays = truth.unproject(grid).directions

    def off(turn):
        return np.nan_to_num(camera.project(rays @ so3.exp(turn).T).pixels - grid, nan=20.0).ravel()

    return np.sqrt(2 * np.mean(least_squares(off, np.zeros(3)).fun ** 2))


def test_the_fisheye_sees_about_150_degrees():
    camera = make_scene("kannala_brandt4", count=1, parameters=WIDE["kannala_brandt4"]).camera
    assert np.degrees(field_of_view(camera)[0]) == pytest.approx(150, abs=3)


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
@pytest.mark.parametrize("count", [8, 20])
@pytest.mark.parametrize("name", ["opencv5", "kannala_brandt4", "kannala_brandt5t"])
def test_a_lens_takes_the_model_that_it_was_made_with(name, count, seed):
    scene, views = lens(name, count, seed)
    assert choice(views, scene, ShapeOptions()) == name


@pytest.mark.parametrize("count", [8, 20])
def test_a_pinhole_keeps_the_default_model(count):
    scene = make_scene("pinhole", count=count)
    found = compare_models(scene.observe(1, noise_px=0.1), scene.board, OPTIONS, [model_named(n) for n in CANDIDATES])
    assert chosen(found, DEFAULT_MODEL).name == DEFAULT_MODEL
    assert [own.name for own in found] == list(CANDIDATES)


@pytest.mark.parametrize("parameters", [PARAMETERS["opencv8"], WIDE["opencv8"]], ids=["narrow", "wide"])
@pytest.mark.parametrize("count", [8, 20])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_rational_lens_takes_a_model_that_is_about_as_right(parameters, count, seed):
    scene = make_scene("opencv8", count=count, seed=seed, parameters=parameters)
    views = scene.observe(seed, noise_px=0.1)
    name, corners = choice(views, scene), np.concatenate([view.pixels for view in views])

    def error(taken):
        calibration = calibrate(views, scene.board, replace(OPTIONS, model=model_named(taken)))
        return map_error(calibration.camera, scene.camera, corners)

    if name != "opencv8":
        assert error(name) < 1.4 * error("opencv8")
    assert name == ("opencv8" if parameters is WIDE["opencv8"] else DEFAULT_MODEL)


@pytest.mark.slow
@pytest.mark.parametrize("name", WIDE)
def test_jitter_of_a_thousandth_of_a_pixel_does_not_change_the_choice(name):
    scene, views = lens(name, 8)
    expected, rng = choice(views, scene), np.random.default_rng(3)
    for _ in range(8):
        assert choice(jittered(views, rng), scene) == expected == name


@pytest.mark.slow
def test_jitter_of_a_thousandth_of_a_pixel_does_not_change_how_a_rational_lens_predicts():
    scene, views = lens("opencv8", 8)
    rng, model = np.random.default_rng(6), model_named("opencv8")
    scores = [compare_models(jittered(views, rng), scene.board, OPTIONS, [model])[0].score for _ in range(8)]
    assert np.ptp(scores) < 0.02  # 0.7 where corners beyond its domain may pull at it


def jittered(views, rng):
    return [replace(view, pixels=view.pixels + 0.001 * rng.normal(size=view.pixels.shape)) for view in views]


@pytest.mark.slow
@pytest.mark.parametrize(("count", "view"), [(8, 0), (20, 5)])
@pytest.mark.parametrize("name", WIDE)
def test_one_view_with_shuffled_ids_does_not_change_the_choice(name, count, view):
    scene, views = lens(name, count)
    views = list(views)
    views[view] = replace(views[view], ids=np.random.default_rng(3).permutation(views[view].ids))
    assert choice(views, scene) == name


# compare_models


def test_models_that_fail_say_why_and_the_others_are_compared():
    scene, views = lens("opencv5", 8)
    found = compare_models(views, scene.board, replace(OPTIONS, fixed=("p1",)), MODELS)
    assert [own.name for own in found] == NAMES
    assert found[0].scores is None
    assert "kannala_brandt4 has no parameter 'p1'" in found[0].reason
    assert all(own.reason is None and own.sigma_px > 0 for own in found[1:])
    assert all(own.scores.shape == (8,) and own.corners == 8 * scene.board.count for own in found[1:])


def test_a_lens_that_no_start_is_found_for_has_no_score():
    scene, views = lens("opencv5", 8)
    scene = replace(scene, board=replace(scene.board, square=None))
    guess = replace(scene.camera, parameters=np.array([800.0, 803.0, 805.0, 590.0, -5.0, 0.0, 0.0, 0.0, 0.0]))
    (found,) = compare_models(views, scene.board, replace(OPTIONS, guess=guess), [guess.model])
    assert found.scores is None
    assert "no start was found" in found.reason


def test_too_few_views_are_refused():
    scene, views = lens("opencv5", 8)
    with pytest.raises(InsufficientData, match="view"):
        compare_models(views[:2], scene.board, OPTIONS, MODELS)


# select


def test_a_default_that_predicts_well_is_no_remark():
    scene, views = lens("opencv5", 8)
    found = select(views, scene.board, OPTIONS)
    assert found.calibration.camera.model.name == DEFAULT_MODEL
    assert (found.warnings, found.lines) == ((), ())
    assert [own.name for own in found.candidates] == NAMES


def test_another_model_is_named_with_prediction_errors_and_gain():
    scene, views = lens("kannala_brandt4", 8)
    found = select(views, scene.board, OPTIONS)
    assert found.calibration.camera.model.name == "kannala_brandt4"
    own = {one.name: one for one in found.candidates}
    (line,) = found.lines
    words = re.fullmatch(
        r"lens model kannala_brandt4: prediction error of left-out views (\S+) px, opencv5 (\S+) px"
        r"(?:; projection uncertainty over the image \S+ px, \S+ px)?",
        line,
    )
    taken, default = own["kannala_brandt4"], own["opencv5"]
    expected = [taken.sigma_px, default.sigma_px]
    np.testing.assert_allclose([float(word) for word in words.groups()], expected, rtol=0.05)  # two digits
    assert taken.sigma_px < 0.11 < 1 < default.sigma_px


def test_models_that_the_default_contains_are_compared_where_it_fails():
    scene, views = lens("opencv5", 8)
    found = select(views, scene.board, replace(OPTIONS, fixed=("k4",)))  # opencv5 has none
    assert [own.name for own in found.candidates] == list(CANDIDATES)
    name = found.calibration.camera.model.name
    (warning,) = found.warnings
    assert warning.code == "lens_model_failed"
    assert warning.text.startswith(f"lens model opencv5 failed, {name} is used instead: --fix: opencv5 has no")


def test_the_next_best_model_is_used_where_the_first_one_does_not_settle(monkeypatch):
    scene, views = lens("kannala_brandt4", 8)
    real, tried = model_selection.intrinsics.calibrate, []

    def failing(detections, board, options, start):
        tried.append(options.model.name)
        if len(tried) == 1:
            raise NotConverged("it did not settle")
        return real(detections, board, options, start)

    monkeypatch.setattr(model_selection.intrinsics, "calibrate", failing)
    found = select(views, scene.board, OPTIONS)
    order = rank_models(found.candidates, DEFAULT_MODEL)
    assert tried[:2] == [own.name for own in order[:2]]
    assert tried[0] == "kannala_brandt4"
    assert found.calibration.camera.model.name == tried[1]


def test_the_failure_of_every_model_is_that_of_the_first(monkeypatch):
    scene, views = lens("opencv5", 8)
    with pytest.raises(InvalidInput, match="opencv5 has no parameter 'k9'"):
        select(views, scene.board, replace(OPTIONS, fixed=("k9",)))
    with pytest.raises(InsufficientData, match="view"):
        select(views[:2], scene.board, OPTIONS)

    def failing(detections, board, options, start):
        raise NotConverged(f"{options.model.name} did not settle")

    monkeypatch.setattr(model_selection.intrinsics, "calibrate", failing)
    with pytest.raises(NotConverged, match="opencv5"):
        select(views, scene.board, OPTIONS)


def test_a_lens_that_is_not_invertible_in_the_image_gives_way_to_one_that_predicts_alike():
    lens_parameters = [1000.0, 1001.0, 803.0, 596.0, -0.02, -0.01, 0.0, 0.0]
    scene = make_scene("kannala_brandt4", Board("chessboard", 12, 9, 0.030), 20, parameters=lens_parameters)
    views = []
    for view in scene.observe(1, noise_px=0.4):  # corners in the middle of the image only
        near = np.hypot(*(view.pixels - [799.5, 599.5]).T) < 0.8 * 1000
        views.append(replace(view, ids=view.ids[near], pixels=view.pixels[near]))
    assert folds_inside(calibrate(views, scene.board, OPTIONS).camera).folds
    found = select(views, scene.board, OPTIONS)
    assert not folds_inside(found.calibration.camera).folds
    assert found.assessment.trustworthy


def verdicts(monkeypatch, failing, brief):
    """Calibrations whose verdict is known by their models' names: failing ones, and ones that fail when brief."""

    def judge(candidates, _circle):
        return tuple(replace(own, failures=("lens_model",) if own.name in brief else ()) for own in candidates)

    def assess(calibration, _circle=None, candidates=()):
        trustworthy = calibration.camera.model.name not in failing
        failures = () if trustworthy else (SimpleNamespace(code="known_region"),)
        return SimpleNamespace(trustworthy=trustworthy, failures=failures, candidates=candidates)

    monkeypatch.setattr(model_selection, "judge", judge)
    monkeypatch.setattr(model_selection, "assess", assess)


@pytest.mark.parametrize(
    ("failing", "brief", "taken"),
    [
        ((), ("opencv5",), "kannala_brandt5t"),  # not chosen while another one passes
        ((), ("opencv5", "kannala_brandt4", "kannala_brandt5t", "opencv8"), "opencv5"),  # they are all alike
        (("opencv5",), (), "opencv8"),  # refused, and the next one is not
        (("opencv5",), ("opencv8", "kannala_brandt4", "kannala_brandt5t"), "opencv5"),  # nothing better is known
        (("opencv5", "opencv8"), (), "opencv5"),  # two are tried
    ],
)
def test_a_lens_model_that_does_not_pass_is_not_used_while_another_one_does(monkeypatch, failing, brief, taken):
    scene, views = lens("opencv5", 8)
    verdicts(monkeypatch, failing, brief)
    found = select(views, scene.board, OPTIONS)
    order = [own.name for own in rank_models(found.candidates, DEFAULT_MODEL)]
    if failing == ("opencv5",) and not brief:
        taken = order[1]
    if brief == ("opencv5",):
        taken = order[0]
        assert taken != "opencv5"
    assert found.calibration.camera.model.name == taken
    assert found.assessment.trustworthy == (taken not in failing)
    if not found.assessment.trustworthy:  # those that were refused are not proposed
        assert all(own.failures for own in found.assessment.candidates if own.name in failing)


@pytest.mark.parametrize(
    ("code", "tried"), [("known_region", 2), ("lens_model", 2), ("several_cameras", 1), ("focal_change", 1)]
)
def test_a_second_lens_model_is_tried_only_for_what_it_may_remedy(monkeypatch, code, tried):
    scene, views = lens("opencv5", 8)
    names = []

    def assess(calibration, _circle=None, candidates=()):
        names.append(calibration.camera.model.name)
        return SimpleNamespace(trustworthy=False, failures=(SimpleNamespace(code=code),), candidates=candidates)

    monkeypatch.setattr(model_selection, "judge", lambda candidates, _circle: tuple(candidates))
    monkeypatch.setattr(model_selection, "assess", assess)
    select(views, scene.board, OPTIONS)
    assert len(set(names)) == tried


def test_views_that_no_lens_model_fits_are_calibrated_once_and_compared_with_no_other(monkeypatch):
    scene, views = lens("opencv5", 12)
    rng = np.random.default_rng(1)
    mixed = [replace(view, ids=rng.permutation(view.ids)) if index < 3 else view for index, view in enumerate(views)]
    briefly, full = [], []
    compare, solve_fully = model_selection.compare_models, model_selection.intrinsics.calibrate

    def compare_and_note(views, board, options, models, start=None, **how):
        briefly.extend(model.name for model in models)
        return compare(views, board, options, models, start, **how)

    def calibrate_and_note(views, board, options, start=None):
        full.append(options.model.name)
        return solve_fully(views, board, options, start)

    monkeypatch.setattr(model_selection, "compare_models", compare_and_note)
    monkeypatch.setattr(model_selection.intrinsics, "calibrate", calibrate_and_note)
    with pytest.raises(InsufficientData, match=r"3 of 12 views rejected .*: leave out view0000.png, view0001.png"):
        select(mixed, scene.board, OPTIONS)
    assert (len(briefly), len(full)) == (1, 1)


def test_views_that_two_lens_models_find_parallel_are_compared_with_no_third(monkeypatch):
    scene, views = lens("opencv5", 6)
    flat = [replace(view, pixels=views[0].pixels + 3.0 * index, ids=views[0].ids) for index, view in enumerate(views)]
    names, compare = [], model_selection.compare_models

    def compare_and_note(views, board, options, models, start=None, **how):
        names.extend(model.name for model in models)
        return compare(views, board, options, models, start, **how)

    monkeypatch.setattr(model_selection, "compare_models", compare_and_note)
    with pytest.raises(InsufficientData, match="nearly parallel views"):
        select([replace(view, covariance=None) for view in flat], scene.board, OPTIONS)
    assert names == ["kannala_brandt4", "opencv5"]


def test_a_given_lens_model_that_another_one_beats_is_refused_without_a_whole_calibration(monkeypatch):
    scene, views = lens("kannala_brandt4", 10)
    monkeypatch.setattr(model_selection.intrinsics, "calibrate", lambda *_: pytest.fail("a whole calibration"))
    with pytest.raises(InsufficientData, match="does not fit these views: use --model"):
        solve_given(views, scene.board, replace(OPTIONS, model=model_named("pinhole")))


def test_a_refused_lens_model_is_answered_by_one_that_was_tried_and_passes():
    scene, views = lens("kannala_brandt4", 10)
    try:
        found = solve_given(views, scene.board, replace(OPTIONS, model=model_named("pinhole")))
    except InsufficientData as error:
        said = error.message
    else:
        said = "; ".join(message.text for message in found.assessment.failures)
    (named,) = set(re.findall(r"use --model (\w+), which passes", said))
    again = solve_given(views, scene.board, replace(OPTIONS, model=model_named(named)))
    assert again.assessment.trustworthy
    assert again.candidates == ()


@pytest.mark.parametrize(
    ("true", "given", "said"),
    [("kannala_brandt5t", "kannala_brandt4", True), ("opencv8", "opencv8", False), ("opencv5", "opencv8", False)],
)
def test_a_given_lens_model_that_predicts_much_worse_says_so_and_its_uncertainty_too(true, given, said):
    scene, views = lens(true, 12)
    found = solve_given(views, scene.board, replace(OPTIONS, model=model_named(given)))
    codes = {message.code for message in found.assessment.messages}
    assert ("better_model" in codes) == said
    best = select(views, scene.board, OPTIONS).calibration.camera
    rms_px = np.sqrt(np.nanmean(lens_difference(found.calibration.camera, best, found.calibration.pixels) ** 2))
    assert found.assessment.uncertainty.figures()["inside_rms_px"] > 0.5 * rms_px
    if said:  # unless parameters are held, which others do not know
        held = replace(OPTIONS, model=model_named(given), fixed=("k3",), guess=found.calibration.camera)
        assert "better_model" not in {own.code for own in solve_given(views, scene.board, held).assessment.messages}


def test_a_lens_model_that_makes_the_views_look_parallel_is_named_as_the_cause():
    scene, views = lens("kannala_brandt4", 10)
    with pytest.raises(InsufficientData) as refused:
        solve_given(views, scene.board, replace(OPTIONS, model=model_named("pinhole")))
    cause = r"the lens model pinhole does not fit these views: use --model \w+, which passes all checks in a brief.*"
    assert re.fullmatch(cause, refused.value.message)


def test_a_refused_lens_model_is_not_called_the_cause_because_its_own_brief_calibration_passes():
    own, other = CandidateModel("opencv5", np.ones(2), 20), CandidateModel("opencv8", np.ones(2), 20, failures=("any",))
    refused = NotConverged("calibration not converged")
    text = model_selection._with_remedy(refused, "opencv5", [own, other]).message
    assert text.startswith("calibration not converged; none of opencv8 passes all checks in a brief calibration either")
    text = model_selection._with_remedy(refused, "opencv5", [own, replace(other, failures=())]).message
    assert text.startswith("the lens model opencv5 does not fit these views: use --model opencv8, which passes")


# A board that is held flat


@pytest.mark.parametrize("choose", [True, False])
@pytest.mark.parametrize("bow_m", [0.004, 0.009])
def test_a_bent_board_that_is_held_flat_is_the_cause_that_is_named(bow_m, choose):
    scene = make_scene(count=10, seed=3)
    views = scene.observe(3, noise_px=0.1, shape=render.bow(bow_m, 0.0))
    words = rf"the board is bent by {1e3 * bow_m:.0f}\.\d\d mm, and --flat-board holds it flat: calibrate without it"
    if bow_m > 0.005:
        with pytest.raises(InsufficientData, match=words) as caught:
            solve(views, scene.board, OPTIONS, choose=choose)
        codes = [message.code for message in caught.value.failures]
    else:
        found = solve(views, scene.board, OPTIONS, choose=choose).assessment
        assert re.match(words, found.failures[0].text)
        codes = [message.code for message in found.messages]
    assert codes == ["board_not_flat"]
    assert solve(views, scene.board, replace(OPTIONS, shape=ShapeOptions()), choose=choose).assessment.trustworthy


def test_a_board_that_is_flat_is_no_cause():
    scene = make_scene(count=4, seed=3)
    found = solve(scene.observe(3, noise_px=1.0), scene.board, OPTIONS).assessment
    assert not found.trustworthy
    assert "board_not_flat" not in [message.code for message in found.messages]
