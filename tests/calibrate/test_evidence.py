"""How far effects within views are believed in: not at all on noise, fully where corners share their errors."""

from dataclasses import replace

import numpy as np
import pytest
from observed import make_scene

from camcal.calibrate import evidence
from camcal.calibrate.effects import SMOOTH
from camcal.calibrate.estimator import Freedom, Views, estimate
from camcal.calibrate.evidence import evidence_of_effects
from camcal.calibrate.fit import ShapeOptions, fit
from camcal.calibrate.problem import BoardProblem, Observations, State
from camcal.targets.surface import normalised


def plain(scene, views):
    """The estimate that takes all errors for noise, from the truth, and what was seen."""
    observations = Observations.of(views)
    state = State(
        np.array(scene.camera.parameters),
        np.stack([pose.rotation for pose in scene.poses]),
        np.stack([pose.translation for pose in scene.poses]),
        np.zeros(0),
        np.zeros((scene.board.count, 3)),
    )
    problem = BoardProblem(scene.camera.model, scene.board, observations, np.arange(len(state.parameters)))
    seen = Views(observations.weights > 0)
    return estimate(problem, state, seen, Freedom(smooth=False, points=False)), seen


def bent(scene, views, size, seed=3):
    """The views with a smooth field of `size` px in each, a different one in every view."""
    rng = np.random.default_rng(seed)
    x, y = normalised(scene.board).T
    fields = np.stack([x**2 - 1 / 3, x * y, y**2 - 1 / 3, x**3 - 3 / 5 * x])
    return [
        replace(view, pixels=view.pixels + size * np.einsum("km,mp->pk", rng.normal(size=(2, 4)), fields[:, view.ids]))
        for view in views
    ]


@pytest.mark.parametrize("count", [5, 12, 25])
def test_noise_alone_is_no_evidence(count):
    scene = make_scene(count=count)
    shares = [evidence_of_effects(*plain(scene, scene.observe(seed, noise_px=0.1))).share for seed in range(4)]
    assert shares == [0.0] * 4


def test_belief_grows_with_the_errors_that_corners_share_from_nothing_to_all():
    scene = make_scene(count=12)
    views = scene.observe(1, noise_px=0.1)
    shares = [evidence_of_effects(*plain(scene, bent(scene, views, size))).share for size in np.linspace(0, 0.12, 25)]
    assert shares[0] == 0.0
    assert shares[-1] == 1.0
    assert 0.05 < np.max(np.diff(shares)) < 0.7  # by and by, not at once
    assert np.min(np.diff(shares)) >= 0.0


def test_of_many_views_some_are_looked_at(monkeypatch):
    scene = make_scene(count=12)
    views = bent(scene, scene.observe(1, noise_px=0.1), 0.06)
    whole = evidence_of_effects(*plain(scene, views)).share
    monkeypatch.setattr(evidence, "_VIEWS", 4)
    assert evidence_of_effects(*plain(scene, views)).share < whole == 1.0


@pytest.mark.parametrize(("size", "names"), [(0.0, [()]), (0.2, [(), (SMOOTH.name,), ("smooth", "rolling", "flex")])])
def test_effects_are_estimated_where_there_is_evidence(size, names):
    scene = make_scene(count=12)
    views = bent(scene, scene.observe(1, noise_px=0.1), size)
    count = len(scene.camera.parameters)
    found = fit(
        scene.camera.model, scene.board, Observations.of(views), (1600, 1200), np.full(count, np.nan), None,
        ShapeOptions(smooth=False),
    )  # fmt: skip
    assert [own.freedom.effects for own in found.estimates] == names
    assert found.weights.sum() == pytest.approx(1.0)
