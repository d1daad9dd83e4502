"""What gains of the likelihood mean, and how large effects are: against closed forms of views that face the board."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from camcal.calibrate import evidence
from camcal.calibrate.camera_part import AdditionalParameters
from camcal.calibrate.effects import EFFECTS, FLEX, FLEX_TERMS, ROLLING, SMOOTH, EffectScales
from camcal.calibrate.evidence import Evidence, evidence_of_effects, within_views
from camcal.calibrate.fit import ShapeOptions, fit, fit_briefly, fit_plain
from camcal.calibrate.noise import ViewNoise
from camcal.calibrate.problem import BoardProblem, State
from camcal.cameras.catalogue import model_named
from camcal.cameras.observations import Observations
from camcal.targets.board import Board, basis

BOARD = Board("chessboard", 6, 5, 0.040)
NAMES = tuple(effect.name for effect in EFFECTS)
COLUMNS = SMOOTH.columns + ROLLING.columns + FLEX.columns
HEIGHT = 1200


def facing(count, seen=None):
    """Problem, state and present corners of a board that faces the camera, 1 m away and somewhere else each time."""
    rng = np.random.default_rng(1)
    present = np.ones((count, BOARD.count), bool) if seen is None else seen
    state = State(
        np.array([1000.0, 1000.0, 800.0, 600.0]),
        np.tile(np.eye(3), (count, 1, 1)),
        np.column_stack([rng.uniform(-0.3, 0.1, (count, 2)), np.ones(count)]),
        np.zeros(0),
        np.zeros((BOARD.count, 3)),
    )
    blank = Observations(
        np.tile(np.arange(BOARD.count), (count, 1)), np.zeros((2, count, BOARD.count)), present.astype(float)
    )
    problem = BoardProblem(model_named("pinhole"), BOARD, blank, np.arange(4))
    pixels = problem.residuals(state)
    return replace(problem, observations=replace(blank, pixels=pixels)), state, present


def looked_at(monkeypatch, count, gains):
    """The evidence where effects bring these gains, by their names, and what was asked for."""
    asked = []

    def gain(equations, effect, start):
        names = tuple(NAMES[index] for index in np.unique(effect))
        asked.append((names, equations, start))
        return gains[names]

    monkeypatch.setattr(evidence, "likelihood_gain", gain)
    problem, state, _ = facing(count)
    noise = ViewNoise(0.3, 1.0 + np.arange(count))
    plain = SimpleNamespace(problem=replace(problem, offsets=True, sigma=0.3), state=state, noise=noise)
    return evidence_of_effects(plain), asked


@pytest.mark.parametrize(("gain", "share"), [(-1.0, 0), (2.9, 0), (6.5, 0.5), (8.6, 0.8), (10.1, 1), (19.9, 1)])
def test_effects_are_believed_in_from_a_gain_of_three_on_and_fully_from_ten(monkeypatch, gain, share):
    found, asked = looked_at(monkeypatch, 3, {NAMES: gain})
    assert found.share == pytest.approx(share, abs=1e-12)
    assert (found.rolling, found.flex) == (0.0, 0.0)
    assert len(asked) == 1


def test_rolling_and_flex_gain_what_is_lost_without_them(monkeypatch):
    gains = {NAMES: 120.0, ("smooth", "flex"): 90.0, ("smooth", "rolling"): 115.0}
    found, _ = looked_at(monkeypatch, 3, gains)
    assert found == Evidence(1.0, rolling=30.0, flex=5.0)


def test_up_to_forty_views_are_looked_at_from_the_first_to_the_last(monkeypatch):
    for count in (39, 40, 79):
        _, ((_, equations, start),) = looked_at(monkeypatch, count, {NAMES: 5.0})
        assert len(equations.group_group) == min(count, 40)
        assert start.shares.shape == (min(count, 40), 3)
        assert equations.shared_shared.shape == (4, 4)  # offsets of single points are not asked for
        np.testing.assert_allclose(np.sqrt(start.variances), [0.09, 0.09, 0.2 * 1e-4])  # by the noise and the board
    # every other of 79 views, by its own noise: what it knows of its tx
    weights = np.einsum("vii->vi", equations.group_group)[:, 0] / (1000.0**2 * BOARD.count / 0.3**2)
    np.testing.assert_allclose(weights, 1 / (1.0 + np.arange(0, 79, 2)), rtol=1e-9)


def test_a_lens_that_is_held_asks_for_no_evidence():
    problem, state, present = facing(4)
    away = np.random.default_rng(4).normal(size=(2, *present.shape)).cumsum(axis=2)
    observations = replace(problem.observations, pixels=problem.observations.pixels + 0.3 * away)
    shape = ShapeOptions(smooth=False, offsets=False)
    size = 1600, HEIGHT
    brief = fit_briefly(problem.model, BOARD, observations, size, state.parameters, None, shape)
    found = fit(*fit_plain(*brief, shape), size)
    assert len(found.estimates) == 1
    assert (found.errors.share, found.errors.rolling_px, found.errors.flex) == (0.0, None, None)


def everything(coefficients, left, variances, seen=None):
    """An estimate of all effects: their coefficients (V, m), variances of these left open, of standard deviations."""
    problem, state, _ = facing(len(coefficients), seen)
    covariances = np.zeros((len(coefficients), 6 + COLUMNS, 6 + COLUMNS))
    covariances[:, 6:, 6:] = left
    covariances[:, :6] = covariances[:, :, :6] = 1e6  # of poses: of no concern
    return SimpleNamespace(
        problem=problem,
        state=state,
        additional=AdditionalParameters(effects=NAMES),
        effect_scales=EffectScales(np.array(variances), np.ones((len(coefficients), 3)), np.ones(3)),
        coefficients=coefficients,
        factors=SimpleNamespace(group_covariances=lambda: covariances),
    )


def along_x(*sizes):
    """Coefficients of views that move along x, by so many pixels RMS where the row is one standard deviation off."""
    coefficients = np.zeros((len(sizes), COLUMNS))
    coefficients[:, SMOOTH.columns] = sizes
    return coefficients


def named(estimate, **gains):
    return within_views(Evidence(0.9, **gains), estimate, HEIGHT)


def test_rolling_is_told_by_what_rows_are_apart_over_the_image():
    sizes = np.array([0.3, 0.1, -0.9, 0.2])
    seen = np.random.default_rng(2).random((4, BOARD.count)) < 0.8
    estimate = everything(along_x(*sizes), 0.0, [1.0, 4.0, 1.0], seen)
    rows = estimate.problem.observations.pixels[1][seen]
    over_image = HEIGHT * np.abs(sizes) / rows.std()
    found = named(estimate, rolling=20.0)
    assert found.rolling_px == pytest.approx((np.median(over_image), over_image[2]), rel=1e-9)
    assert found.flex is None
    assert found.share == 0.9


def test_what_the_data_leave_open_counts_as_part_of_an_effect():
    sizes, left = np.array([0.3, 0.4, 0.5]), np.zeros((COLUMNS, COLUMNS))
    left[SMOOTH.columns, SMOOTH.columns] = 0.01  # of a variance of 4: 0.2 px
    estimate = everything(along_x(*sizes), left, [1.0, 4.0, 1.0])
    over_image = HEIGHT * np.sqrt(sizes**2 + 0.2**2) / estimate.problem.observations.pixels[1].std()
    found = named(estimate, rolling=25.0).rolling_px
    assert found == pytest.approx((over_image[1], over_image[2]), rel=1e-9)


def test_flex_is_told_by_the_heights_of_all_points():
    rng = np.random.default_rng(3)
    coefficients = np.zeros((5, COLUMNS))
    coefficients[:, -FLEX.columns :] = 1e-4 * rng.normal(size=(5, FLEX.columns))
    root = 0.3 * rng.normal(size=(FLEX.columns, FLEX.columns))
    left = np.zeros((COLUMNS, COLUMNS))
    left[-FLEX.columns :, -FLEX.columns :] = root @ root.T
    estimate = everything(coefficients, left, [1.0, 4.0, 1e-8])
    heights = basis(BOARD, FLEX_TERMS)[:, 2] @ coefficients[:, -FLEX.columns :].T
    opened = 1e-4 * basis(BOARD, FLEX_TERMS)[:, 2] @ root
    sizes = np.sqrt(np.mean(heights**2 + np.sum(opened**2, axis=1)[:, None], axis=0))
    found = named(estimate, flex=20.0)
    assert found.flex == pytest.approx((np.median(sizes), sizes.max()), rel=1e-9)
    assert found.rolling_px is None


def test_effects_of_smaller_gains_are_not_named():
    found = named(everything(along_x(1.0, 1.0), 0.0, [1.0, 1.0, 1.0]), rolling=19.9, flex=19.9)
    assert (found.rolling_px, found.flex) == (None, None)
