"""The passes: they settle where steps overshoot, go on from an estimate, and agree however points are solved for."""

from dataclasses import replace

import numpy as np
import pytest
from observed import make_scene

from camcal.calibrate import camera_part, estimator
from camcal.calibrate.camera_part import AdditionalParameters
from camcal.calibrate.estimator import estimate
from camcal.calibrate.problem import BoardProblem, State
from camcal.cameras.observations import Observations
from camcal.solve.steps import Step
from camcal.targets.board import Board


def started(scene, views, offset=0.0):
    """The problem, a state at the truth or `offset` standard deviations of 1 px from it."""
    observations = Observations.of(views)
    rng = np.random.default_rng(5)
    parameters = np.array(scene.camera.parameters)
    state = State(
        parameters + offset * rng.normal(size=len(parameters)) * [1, 1, 1, 1, *[1e-3] * (len(parameters) - 4)],
        np.stack([pose.rotation for pose in scene.poses]),
        np.stack([pose.translation for pose in scene.poses]),
        np.zeros(0),
        np.zeros((scene.board.count, 3)),
    )
    problem = BoardProblem(scene.camera.model, scene.board, observations, np.arange(len(parameters)))
    return problem, state


def print_errors(columns, rows, count, size):
    """A board whose corners are off by `size` metres each, seen `count` times with a noise of 0.05 px."""
    scene = make_scene(board=Board("chessboard", columns, rows, 0.040), count=count)
    offsets = size * np.random.default_rng(2).normal(size=(scene.board.count, 3))
    views = []
    for view, pose in zip(scene.observe(1, noise_px=0.05), scene.poses, strict=True):
        true = scene.camera.project(pose.apply(scene.board.points() + offsets)).pixels
        drawn = scene.camera.project(pose.apply(scene.board.points())).pixels
        views.append(replace(view, pixels=view.pixels + (true - drawn)[view.ids]))
    return scene, views


@pytest.fixture(scope="module")
def printed():
    return print_errors(11, 9, 12, 5e-5)


def test_few_views_of_a_board_with_print_errors_have_the_noise_that_they_have():
    problem, state = started(*print_errors(9, 6, 4, 2e-4))
    found = estimate(problem, state, AdditionalParameters(smooth=True, points=True))
    # 250 degrees of freedom are left: a standard deviation of 4.5 %
    assert found.noise.sigma == pytest.approx(0.05, rel=0.12)
    # the offsets follow the view that sees the board from near most, whose corners are no better for that
    assert found.noise.views.max() < 2 * found.noise.views.min()


@pytest.mark.slow
def test_points_solved_for_in_turn_and_together_lead_to_the_same_lens(printed, monkeypatch):
    problem, state = started(*printed)
    free = AdditionalParameters(smooth=True, points=True)
    together = estimate(problem, state, free)
    monkeypatch.setattr(camera_part, "AT_ALL_TOGETHER", 0)
    monkeypatch.setattr(camera_part, "_SETTLED", 1e-4)
    in_turn = estimate(problem, state, free)
    assert together.problem.offsets
    assert not in_turn.problem.offsets
    std = np.sqrt(np.diag(together.posterior.shared))[: len(state.parameters)]
    assert np.abs((in_turn.state.parameters - together.state.parameters) / std).max() < 0.2
    np.testing.assert_allclose(in_turn.state.offsets, together.state.offsets, atol=2e-5)
    assert np.abs(together.state.offsets).max() > 5e-5


def test_an_estimate_that_goes_on_from_another_stays_there(printed):
    problem, state = started(*printed)
    free = AdditionalParameters(smooth=True, points=True, effects=("smooth",))
    first = estimate(problem, state, free)
    again = estimate(first.problem, first.state, free, first)
    std = np.sqrt(np.diag(first.posterior.shared))[: len(state.parameters)]
    assert np.abs((again.state.parameters - first.state.parameters) / std).max() < 0.03
    np.testing.assert_allclose(again.coefficients, first.coefficients, atol=0.05)


def test_the_start_does_not_matter(printed):
    free = AdditionalParameters(smooth=True, points=True)
    near, far = (estimate(problem, state, free) for problem, state in (started(*printed), started(*printed, 5.0)))
    std = np.sqrt(np.diag(near.posterior.shared))[: len(near.state.parameters)]
    assert np.abs((far.state.parameters - near.state.parameters) / std).max() < 0.05


class Overshooting(BoardProblem):
    """A problem whose steps lead twice as far as they say."""

    def retract(self, state, step):
        return super().retract(state, Step(2 * step.shared, 2 * step.groups))


def test_steps_that_overshoot_are_shortened_and_the_passes_settle(printed):
    problem, state = started(*printed)
    free = AdditionalParameters(smooth=False, points=False)
    straight = estimate(problem, state, free)
    fields = {name: getattr(problem, name) for name in problem.__dataclass_fields__}
    bent = estimate(Overshooting(**fields), state, free)
    assert bent.converged
    assert bent.passes < 2 * straight.passes
    std = np.sqrt(np.diag(straight.posterior.shared))
    assert np.abs((bent.state.parameters - straight.state.parameters) / std).max() < 0.02


def test_a_corner_that_leaves_the_image_makes_a_step_too_long(printed):
    problem, state = started(*printed)
    passes = estimator._Passes(problem, state, AdditionalParameters(smooth=False, points=False), None, brief=False)
    behind = replace(passes.place.derivatives, valid=passes.place.derivatives.valid & False)
    assert np.isfinite(passes._cost(passes.place, np.zeros((12, 0))))
    assert passes._cost(replace(passes.place, derivatives=behind), np.zeros((12, 0))) == np.inf
