"""One pass of an estimate and the end of all: closed forms of series, costs by hand, steps that overshoot as told."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from observed import make_scene, true_state

from camcal.calibrate import estimator
from camcal.calibrate.estimator import Freedom, Views
from camcal.calibrate.problem import BoardProblem, Observations
from camcal.targets.board import Board

VIEWS = 6
BARE = Freedom(smooth=False, points=False)


def scene_of(columns=6, rows=5):
    return make_scene(board=Board("chessboard", columns, rows, 0.040), count=VIEWS)


def passes_of(scene, freedom=BARE, noise=0.1, claimed=None, **how):
    """The passes before the first one, from the truth."""
    observations = Observations.of(scene.observe(1, noise_px=noise))
    problem = BoardProblem(scene.camera.model, scene.board, observations, np.arange(4), **how)
    return estimator._Passes(problem, true_state(scene), Views(observations.weights > 0, claimed), freedom, None)


# The end of the passes


@dataclass(frozen=True)
class Points:
    """As much of a problem as the end of the passes looks at."""

    board: SimpleNamespace
    offsets: bool = False


def run(monkeypatch, moves, *, brief=False, fresh=True, points=False, count=99):
    """The estimate after passes that move the lens by so much each, and in which of them points were free."""
    seen, series = [], iter(moves)

    def one(self, *, first):
        seen.append((first, self.problem.offsets))
        return None, None, next(series)

    monkeypatch.setattr(estimator._Passes, "_pass", one)
    passes = object.__new__(estimator._Passes)
    passes.freedom, passes.fresh = Freedom(smooth=False, points=points), fresh
    passes.problem = Points(SimpleNamespace(count=count))
    passes.place = SimpleNamespace(state=None, coefficients=None)
    passes.noise = passes.corners = passes.board = passes.effect_scales = None
    return passes.run(brief=brief), seen


def falling(rate, first=1.0, count=200):
    return [first * rate**number for number in range(count)]


@pytest.mark.parametrize(
    ("moves", "passes"),
    [
        (falling(0.5), 8),  # 2⁻⁷ = 0.0078 is the first whose remainder, as much again, is less than 0.01
        (falling(0.25), 5),  # 4⁻⁴ = 0.0039; what remains is less than the change itself
        (falling(0.8), 28),  # 4 times as much remains: 0.8²⁷ = 0.0024
        (falling(0.9), 60),  # nine times: 0.9⁶⁵ would do
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


def together(seen):
    return [offsets for _, offsets in seen].index(True) if any(offsets for _, offsets in seen) else None


@pytest.mark.parametrize(
    ("moves", "free_from"),
    [
        ([1.0, 0.49, 0.24, 0.11, 0.05, 0.02, 0.008, *[0.0] * 9], 7),  # as fast as need be: free when settled
        ([1.0, 0.9, 0.51, *[0.0] * 9], 3),  # the third hardly gets on; of the first two it is not asked
        ([1.0, 0.9, 0.4, 0.19, *[0.0] * 9], 5),
        ([0.08, 0.08, 0.055, *[0.0] * 9], 3),
        ([0.08, 0.08, 0.045, 0.02, *[0.0] * 9], 5),  # a creep that small may settle
    ],
)
def test_points_are_solved_for_together_where_turns_hardly_get_on_or_have_settled(monkeypatch, moves, free_from):
    found, seen = run(monkeypatch, moves, points=True)
    assert together(seen) == free_from
    assert found.problem.offsets


def test_points_of_large_boards_and_of_brief_estimates_are_not_solved_for_together(monkeypatch):
    assert together(run(monkeypatch, falling(0.5), points=True, count=401)[1]) is None
    assert together(run(monkeypatch, falling(0.5), points=True, count=400)[1]) == 8
    assert together(run(monkeypatch, falling(0.5), points=True, brief=True)[1]) is None
    assert together(run(monkeypatch, falling(0.5))[1]) is None
    # nor do they make a brief estimate any shorter
    assert together(run(monkeypatch, falling(0.9), points=True, brief=True)[1]) == 3


# A step


def line_search(monkeypatch, cost, promised=None):
    """The share of a step that is gone where its parts cost so much (share -> cost over what the whole promises, with
    a slope of -2); promised: the share of the cost that the whole step does.
    """
    passes = passes_of(scene_of())
    passes._judge(first=True)
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
