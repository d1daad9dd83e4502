"""One pass of an estimate and the end of all: closed forms of series, costs by hand, steps that overshoot as told."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from observed import make_scene, true_state

from camcal.calibrate import estimator
from camcal.calibrate.camera_part import AdditionalParameters
from camcal.calibrate.effects import Posterior
from camcal.calibrate.noise import corner_weights, view_noise
from camcal.calibrate.problem import BoardProblem
from camcal.calibrate.shape import Scale, first_scales
from camcal.cameras.observations import Observations
from camcal.targets.board import TERMS, Board

VIEWS = 6
BARE = AdditionalParameters(smooth=False, points=False)


def scene_of(columns=6, rows=5):
    return make_scene(board=Board("chessboard", columns, rows, 0.040), count=VIEWS)


def passes_of(scene, additional=BARE, noise=0.1, claimed=None, **how):
    """The passes before the first one, from the truth."""
    observations = replace(Observations.of(scene.observe(1, noise_px=noise)), covariance=claimed)
    problem = BoardProblem(scene.camera.model, scene.board, observations, np.arange(4), **how)
    return estimator._Passes(problem, true_state(scene), additional, None, brief=False)


# The end of the passes


@dataclass(frozen=True)
class Points:
    """As much of a problem as the end of the passes looks at."""

    board: SimpleNamespace
    offsets: bool = False


def run(monkeypatch, moves, *, brief=False, fresh=True, points=False, count=99, effects=(), together=False, spent=1.1):
    """The estimate after passes that move the lens by so much each, and in which of them points were free.

    spent: the degrees of freedom that single points take.
    """
    seen, series = [], iter(moves)

    def one(self, *, first):
        seen.append((first, self.problem.offsets))
        return None, None, next(series)

    monkeypatch.setattr(estimator._Passes, "_pass", one)
    passes = object.__new__(estimator._Passes)
    passes.additional, passes.fresh = AdditionalParameters(smooth=False, points=points, effects=effects), fresh
    passes.problem = Points(SimpleNamespace(count=count), together)
    passes.place = SimpleNamespace(state=None, coefficients=None)
    passes.noise = passes.corners = passes.board = passes.linearised = None
    passes.on_points, passes.brief = spent, brief
    passes.effect_scales = "their scales"
    return passes.run(), seen


def falling(rate, first=1.0, count=200):
    return [first * rate**number for number in range(count)]


@pytest.mark.parametrize(
    ("moves", "passes"),
    [
        (falling(0.5), 8),  # 2⁻⁷ = 0.0078 is the first whose remainder, as much again, is less than 0.01
        (falling(0.25), 5),  # 4⁻⁴ = 0.0039; what remains is less than the change itself
        (falling(0.8), 28),  # 4 times as much remains: 0.8²⁷ = 0.0024
        (falling(0.9), 66),  # nine times: 0.9⁶⁵ = 0.00106
        (falling(0.94), 100),  # 16 times: 0.94¹¹⁹ would do
        ([0.0] * 5, 2),
        ([0.009, 0.009, 0.009, 0.0001], 4),  # no less than before: 19 times as much may remain
        ([0.009, 0.00051, 0.0], 2),
    ],
)
def test_passes_end_where_what_remains_is_a_hundredth_of_a_standard_deviation(monkeypatch, moves, passes):
    found, seen = run(monkeypatch, moves)
    assert found.passes == passes == len(seen)
    assert [first for first, _ in seen] == [True] + [False] * (passes - 1)


def test_one_pass_may_do_where_noise_and_scales_are_known(monkeypatch):
    found, seen = run(monkeypatch, [0.009, 0.009], fresh=False)
    assert found.passes == 1
    assert seen == [(False, False)]


def test_a_brief_estimate_takes_ten_passes_and_may_be_used_if_it_is_calm(monkeypatch):
    assert run(monkeypatch, [1.0] * 9 + [0.29], brief=True)[0].converged
    found, _ = run(monkeypatch, [1.0] * 9 + [0.31], brief=True)
    assert (found.passes, found.converged) == (10, False)
    assert run(monkeypatch, falling(0.5), brief=True)[0].passes == 8


def first_together(seen):
    return [offsets for _, offsets in seen].index(True) if any(offsets for _, offsets in seen) else None


@pytest.mark.parametrize(
    ("moves", "free_from"),
    [
        ([1.0, 0.49, 0.24, 0.11, 0.05, 0.02, 0.008, *[0.0] * 9], 7),  # as fast as need be: free when settled
        ([1.0, 0.9, 0.51, *[0.0] * 9], 3),  # the third hardly gets on; of the first two it is not asked
        ([1.0, 0.9, 0.4, 0.19, *[0.0] * 9], 5),
        ([0.08, 0.08, 0.055, *[0.0] * 9], 3),
        ([0.018, 0.018, 0.0105, *[0.0] * 9], 3),
        ([0.018, 0.018, 0.0095, 0.004, *[0.0] * 9], 4),  # a creep that small may settle
    ],
)
def test_points_are_solved_for_together_where_turns_hardly_get_on_or_have_settled(monkeypatch, moves, free_from):
    found, seen = run(monkeypatch, moves, points=True)
    assert first_together(seen) == free_from
    assert found.problem.offsets


def test_points_of_large_boards_are_not_solved_for_together(monkeypatch):
    assert first_together(run(monkeypatch, falling(0.5), points=True, count=401)[1]) is None
    assert first_together(run(monkeypatch, falling(0.5), points=True, count=400)[1]) == 8
    assert first_together(run(monkeypatch, falling(0.5), points=True, count=61, brief=True)[1]) is None
    assert first_together(run(monkeypatch, falling(0.9), points=True, count=61, brief=True)[1]) is None
    assert first_together(run(monkeypatch, falling(0.5))[1]) is None


@pytest.mark.parametrize(("rate", "passes"), [(0.5, 8), (0.9, 10)])
def test_a_brief_estimate_has_the_points_of_a_small_board_together_in_a_last_pass(monkeypatch, rate, passes):
    found, seen = run(monkeypatch, falling(rate), points=True, count=60, brief=True)
    assert found.passes == len(seen) == passes + 1
    assert first_together(seen) == passes
    assert first_together(run(monkeypatch, falling(rate), points=True, count=60, spent=0.9, brief=True)[1]) is None


def test_points_that_hardly_move_are_not_solved_for_together(monkeypatch):
    assert first_together(run(monkeypatch, falling(0.5), points=True, spent=0.9)[1]) is None
    assert first_together(run(monkeypatch, falling(0.9), points=True, spent=0.9)[1]) is None
    assert run(monkeypatch, falling(0.5), points=True, spent=0.9)[0].passes == 8


def test_points_that_are_together_from_the_start_take_no_further_passes(monkeypatch):
    assert run(monkeypatch, falling(0.5), points=True, together=True)[0].passes == 8


def test_scales_of_effects_are_told_where_there_are_effects(monkeypatch):
    assert run(monkeypatch, falling(0.5))[0].effect_scales is None
    assert run(monkeypatch, falling(0.5), effects=("flex",))[0].effect_scales == "their scales"


def test_estimates_are_brief_if_asked_for(monkeypatch):
    monkeypatch.setattr(estimator._Passes, "__init__", lambda self, *start, brief: setattr(self, "brief", brief))
    monkeypatch.setattr(estimator._Passes, "run", lambda self: self.brief)
    assert estimator.estimate(None, None, None, BARE) is False
    assert estimator.estimate(None, None, None, BARE, brief=True) is True


# A pass


OF_DATA = Scale(1e-3, 1e-3, 1e-4, 0.9)


def parts(monkeypatch, additional=BARE, *, first=False, at_once=False):
    """The passes after one of which the parts only tell that they were asked for, and these parts."""
    told = []
    passes = passes_of(scene_of(13, 5), additional)
    passes.problem = replace(passes.problem, offsets=at_once)
    left = Posterior(np.eye(4), np.full(VIEWS, 7.0))
    apart, together = np.arange(VIEWS) + 6.0, np.arange(VIEWS) + 12.0
    for name, result in (
        ("judge", None),
        ("_move_points", apart),
        ("_move", (None, None)),
        ("_pose_lost_views", None),
    ):
        monkeypatch.setattr(
            estimator._Passes, name, lambda self, own=name, end=result, **how: (told.append(own), end)[1]
        )
    monkeypatch.setattr(estimator, "posterior", lambda factors: left)
    monkeypatch.setattr(estimator, "board_scales", lambda *what: {"bow": OF_DATA})
    monkeypatch.setattr(estimator, "spent_on_offsets", lambda *what: together)
    passes._pass(first=first)
    return passes, told


ALL = ["judge", "_move", "_pose_lost_views"]
FREE = AdditionalParameters(smooth=True, points=True)


@pytest.mark.parametrize(
    ("additional", "how", "told", "offsets"),
    [
        (BARE, {}, ALL, None),
        (FREE, {}, ["judge", "_move_points", "_move", "_pose_lost_views"], 6.0),
        (FREE, {"first": True}, ALL, None),
        (FREE, {"at_once": True}, ALL, 12.0),
    ],
)
def test_points_are_solved_for_apart_but_in_the_first_pass_and_where_they_are_together(
    monkeypatch, additional, how, told, offsets
):
    passes, found = parts(monkeypatch, additional, **how)
    assert found == told
    np.testing.assert_allclose(
        passes.spent, np.full(VIEWS, 7.0) if offsets is None else 7.0 + offsets + np.arange(VIEWS)
    )
    assert passes.board["bow"] == OF_DATA
    assert passes.board["cubic"] == first_scales()["cubic"]


def test_all_terms_of_the_shape_are_estimated_where_it_is_free():
    assert passes_of(scene_of(), AdditionalParameters(smooth=True, points=False)).problem.terms == TERMS
    assert passes_of(scene_of()).problem.terms == ()


def judged(claimed, share):
    """Passes that have been judged once, and once more by corners of which one has no image now and all are noisier."""
    passes = passes_of(scene_of(), claimed=claimed)
    told = []
    passes.weigh = told.append
    before, passes.share = passes.noise, share
    passes.judge(first=True)
    weights = passes.problem.observations.weights
    assert passes.noise is before  # by medians, as good as it gets without weights
    first = corner_weights(np.hypot(*passes.residuals(passes.place)), passes.present, before, passes.spent)
    np.testing.assert_allclose(weights, first, rtol=1e-12)
    assert weights.min() < 0.99
    rng = np.random.default_rng(3)
    residuals = 0.3 * rng.normal(size=passes.place.derivatives.residuals.shape)
    valid = np.arange(residuals.shape[1]) != 4
    derivatives = replace(passes.place.derivatives, residuals=residuals.copy(), valid=valid)
    residuals[:, 4] = np.nan
    passes.place = replace(passes.place, derivatives=derivatives)
    assert not told  # the first pass has no noise yet to weigh by
    passes.judge(first=False)
    return passes, before, weights, residuals.reshape(2, *passes.present.shape), told


@pytest.mark.parametrize("share", [1.0, 0.3])
def test_noise_and_weights_go_a_share_of_the_way(share):
    passes, before, weights, residuals, told = judged(None, share)
    assert not told
    distances, present = np.hypot(*residuals), passes.present
    expected = view_noise(distances, present, weights, passes.spent, before, share)
    assert expected.sigma > 1.2 * before.sigma
    assert passes.noise.sigma == pytest.approx(expected.sigma, rel=1e-12)
    np.testing.assert_allclose(passes.noise.views, expected.views, rtol=1e-12)
    new = corner_weights(distances, present, expected, passes.spent)
    mixed = np.where(new > 0, share * new + (1 - share) * weights, 0.0)
    assert mixed.ravel()[4] == 0.0
    np.testing.assert_allclose(passes.problem.observations.weights, mixed, rtol=1e-12)
    assert passes.problem.sigma == passes.noise.sigma
    np.testing.assert_array_equal(passes.problem.noise, passes.noise.views)


def test_corners_whose_images_claim_covariances_are_weighed_by_them():
    claimed = np.tile(1e-6 * np.eye(2), (VIEWS, 30, 1, 1))
    passes, _, _, residuals, told = judged(claimed, 1.0)
    assert len(told) == 1
    np.testing.assert_array_equal(told[0], residuals)
    assert passes.problem.term_std is None


def test_priors_of_the_board_are_those_of_its_scales():
    passes = passes_of(scene_of(), FREE)
    passes.board["bow"] = replace(passes.board["bow"], effective=0.01)
    passes.judge(first=True)
    assert passes.problem.term_std[TERMS.index("P2(x)")] == pytest.approx(0.01 * 0.2)
    assert passes.problem.offset_std is not None


# A step


def line_search(monkeypatch, cost, promised=None):
    """The share of a step that is gone where its parts cost so much (share -> cost over what the whole promises, with
    a slope of -2); promised: the share of the cost that the whole step does.
    """
    passes = passes_of(scene_of())
    passes.judge(first=True)
    here = passes.place
    end = passes._cost(here, np.zeros((VIEWS, 0))) - passes._move()[0].decrease()
    level = 2 * end if promised is None else end / (1 - promised)
    monkeypatch.setattr(passes, "place", here)
    monkeypatch.setattr(passes, "_towards", lambda place, step, share: share)
    monkeypatch.setattr(passes, "_cost", lambda at, std: level if at is here else level + (level - end) * cost(at))
    passes._move()
    return passes.place


def parabola(bend):
    return lambda share: -2 * share + bend * share**2


@pytest.mark.parametrize(
    ("bend", "share"),
    [(1.0, 1), (0.5, 1), (-1.0, 1), (1.3, 1), (1.36, 1 / 1.36), (4.0, 1 / 4), (6.4, 0.2), (7.0, 1 / 7), (12.0, 1 / 12)],
)
def test_a_step_is_as_long_as_the_cost_along_it_is_lowest(monkeypatch, bend, share):
    # ends where the minimum is at three quarters; a trial is a fifth of the one before at least
    assert line_search(monkeypatch, parabola(bend)) == pytest.approx(share, rel=1e-6)


def test_steps_out_of_the_image_are_a_fifth_as_long_time_after_time(monkeypatch):
    inside = parabola(1.0)
    assert line_search(monkeypatch, lambda share: np.inf if share > 0.05 else inside(share)) == pytest.approx(0.04)
    assert line_search(monkeypatch, lambda share: np.inf) == pytest.approx(0.2**11)


@pytest.mark.parametrize(("promised", "share"), [(0.9e-11, 1.0), (1.1e-11, 0.25)])
def test_what_rounding_hides_does_not_shorten_a_step(monkeypatch, promised, share):
    assert line_search(monkeypatch, parabola(4.0), promised) == pytest.approx(share, rel=1e-2)  # rounding of the cost


def test_effects_go_with_the_step_to_where_they_are_likeliest():
    passes = passes_of(scene_of(), AdditionalParameters(smooth=False, points=False, effects=("smooth", "flex")))
    sizes = 0.5 * np.random.default_rng(7).normal(size=(VIEWS, 1))
    observations = passes.problem.observations
    passes.problem = replace(
        passes.problem,
        observations=replace(observations, pixels=observations.pixels + passes.columns.values[:, 3] * sizes),
    )
    state = passes.place.state
    passes.place = replace(passes.place, derivatives=passes.problem.derivatives(state))
    passes.judge(first=True)
    started = passes.effect_scales
    factors, end = passes._move()
    step, std = factors.solve().groups, passes.effect_scales.std(passes.columns.effect)
    np.testing.assert_allclose(passes.place.coefficients, std * step[:, 6:], rtol=1e-9)
    # held towards zero, as what has been bent was noise so far
    assert np.corrcoef(passes.place.coefficients[:, 3], sizes[:, 0])[0, 1] > 0.9
    np.testing.assert_allclose(end.translations - state.translations, step[:, :3], rtol=1e-6, atol=1e-12)
    assert passes.effect_scales.variances[0] > 1.1 * started.variances[0]


def test_scales_of_effects_that_are_not_estimated_stay_as_they_are():
    passes = passes_of(scene_of())
    passes.judge(first=True)
    before = passes.effect_scales
    passes._move()
    assert passes.effect_scales is before
