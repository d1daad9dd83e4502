"""How far effects within views are believed in: not at all on noise, fully where corners share their errors."""

from dataclasses import replace

import numpy as np
import pytest
from observed import make_scene

from camcal.calibrate import evidence, jackknife
from camcal.calibrate import fit as fitting
from camcal.calibrate.camera_part import AdditionalParameters
from camcal.calibrate.effects import SMOOTH
from camcal.calibrate.estimator import estimate
from camcal.calibrate.evidence import evidence_of_effects
from camcal.calibrate.fit import ShapeOptions, fit, fit_briefly, fit_plain
from camcal.calibrate.intrinsics import Options, calibrate
from camcal.calibrate.problem import BoardProblem, State
from camcal.cameras.observations import Observations
from camcal.geometry import rotation as so3
from camcal.targets.board import Board, normalised


def plain(scene, views):
    """The estimate that takes all errors for noise, from the truth."""
    observations = Observations.of(views)
    state = State(
        np.array(scene.camera.parameters),
        np.stack([pose.rotation for pose in scene.poses]),
        np.stack([pose.translation for pose in scene.poses]),
        np.zeros(0),
        np.zeros((scene.board.count, 3)),
    )
    problem = BoardProblem(scene.camera.model, scene.board, observations, np.arange(len(state.parameters)))
    return estimate(problem, state, AdditionalParameters(smooth=False, points=False))


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
    shares = [evidence_of_effects(plain(scene, scene.observe(seed, noise_px=0.1))).share for seed in range(4)]
    assert shares == [0.0] * 4


@pytest.mark.slow
def test_noise_alone_is_no_evidence_on_a_board_of_ten_thousand_corners():
    scene = make_scene(board=Board("chessboard", 125, 80, 0.003), count=12)
    found = calibrate(scene.observe(1, noise_px=0.1), scene.board, Options(scene.camera.model))
    assert found.sigma_px == pytest.approx(0.1, rel=0.02)
    assert found.within_views.share == 0


@pytest.mark.slow
def test_belief_grows_with_the_errors_that_corners_share_from_nothing_to_all():
    scene = make_scene(count=12)
    views = scene.observe(1, noise_px=0.1)
    shares = [evidence_of_effects(plain(scene, bent(scene, views, size))).share for size in np.linspace(0, 0.12, 25)]
    assert shares[0] == 0.0
    assert shares[-1] == 1.0
    assert 0.05 < np.max(np.diff(shares)) < 0.7  # by and by, not at once
    assert np.min(np.diff(shares)) >= 0.0


def test_of_many_views_some_are_looked_at(monkeypatch):
    scene = make_scene(count=12)
    views = bent(scene, scene.observe(1, noise_px=0.1), 0.06)
    whole = evidence_of_effects(plain(scene, views)).share
    monkeypatch.setattr(evidence, "_VIEWS", 4)
    assert evidence_of_effects(plain(scene, views)).share < whole == 1.0


@pytest.mark.parametrize(("size", "names"), [(0.0, [()]), (0.2, [(), (SMOOTH.name,), ("smooth", "rolling", "flex")])])
def test_effects_are_estimated_where_there_is_evidence(size, names):
    scene = make_scene(count=12)
    views = bent(scene, scene.observe(1, noise_px=0.1), size)
    found = solved(scene, views)
    assert [own.additional.effects for own in found.estimates] == names
    assert found.weights.sum() == pytest.approx(1.0)


def solved(scene, views, shape=None):
    count = len(scene.camera.parameters)
    held = np.full(count, np.nan)
    shape = shape or ShapeOptions(smooth=False)
    seen, size = Observations.of(views), (1600, 1200)
    brief = fit_briefly(scene.camera.model, scene.board, seen, size, held, None, shape)
    return fit(*fit_plain(*brief, shape), size)


def test_views_and_priors_are_what_the_last_linear_solve_knows():
    scene = make_scene(count=8)
    views = bent(scene, scene.observe(1, noise_px=0.1), 0.2)
    seen = np.random.default_rng(2).uniform(size=(len(views), len(views[0].ids))) < 0.9
    seen[:, 0] = True  # the number that corners which are not there have
    views = [replace(view, ids=view.ids[own], pixels=view.pixels[own]) for view, own in zip(views, seen, strict=True)]
    found = solved(scene, views, ShapeOptions())
    assert len(found.estimates) > 1
    for own in found.estimates:
        matrix = own.factors.shared_root @ own.factors.shared_root.T
        assert len(matrix) > len(own.posterior.shared)  # offsets of points
        blocks = own.problem.observed(own.linearised)
        unit = np.sqrt(np.outer(np.diag(matrix), np.diag(matrix)))
        reduced = own.factors.reduced
        parts = np.stack([jackknife._information(blocks, reduced[view], view) for view in range(len(views))]) / unit
        assert np.linalg.eigvalsh(parts).min() > -1e-9
        shared = len(own.posterior.shared)
        priors = np.zeros_like(matrix[:shared])
        priors[:, :shared] = own.problem.prior_precision(own.state)
        np.testing.assert_allclose((matrix / unit - parts.sum(axis=0))[:shared], priors / unit[:shared], atol=1e-9)


def test_a_lens_that_holds_nowhere_is_that_of_the_plain_estimate(monkeypatch):
    scene = make_scene(count=6)
    monkeypatch.setattr(fitting, "displacements", lambda *_: np.zeros((0, 2, len(scene.camera.parameters))))
    found = solved(scene, bent(scene, scene.observe(1, noise_px=0.1), 0.2))
    assert found.estimates == (found.plain,)
    np.testing.assert_array_equal(found.state.parameters, found.plain.state.parameters)
    np.testing.assert_array_equal(found.covariance, found.plain.posterior.shared)


def ways(scene, pose):
    """The image's displacements (6, C, 2) of the board's corners by a motion along and about each axis, 1 px RMS."""
    points = scene.board.points()
    seen = scene.camera.project(pose.apply(points)).pixels
    result = []
    for axis in 1e-5 * np.eye(6):
        moved = pose.apply(points) @ so3.exp(axis[3:]).T + axis[:3]
        way = scene.camera.project(moved).pixels - seen
        result.append(way / np.sqrt(np.mean(np.sum(way**2, axis=1))))
    return np.array(result)


def test_a_rolling_shutter_is_named_with_the_way_of_a_corner_over_the_image():
    scene = make_scene(count=15)
    rng = np.random.default_rng(4)
    views, sizes = [], []
    for view, pose in zip(scene.observe(1, noise_px=0.05), scene.poses, strict=True):
        way = np.tensordot(0.4 * rng.normal(size=6), ways(scene, pose), axes=1)[view.ids]
        views.append(replace(view, pixels=view.pixels + way * (view.pixels[:, 1:] / 1200 - 0.5)))
        sizes.append(np.sqrt(np.mean(np.sum(way**2, axis=1))))
    errors = solved(scene, views).errors
    assert errors.share == 1.0
    assert errors.flex is None
    assert errors.rolling_px == pytest.approx((np.median(sizes), max(sizes)), rel=0.25)


def test_a_board_that_bends_is_named_with_its_height():
    scene = make_scene(count=15)
    x, y = normalised(scene.board).T
    shapes = np.column_stack([x**2 - 1 / 3, x * y, y**2 - 1 / 3])
    rng = np.random.default_rng(4)
    heights = 3e-4 * rng.normal(size=(15, 3)) @ shapes.T
    views = []
    for view, pose, height in zip(scene.observe(1, noise_px=0.05), scene.poses, heights, strict=True):
        points = scene.board.points()
        moved = (
            scene.camera.project(pose.apply(points + height[:, None] * [0, 0, 1])).pixels
            - scene.camera.project(pose.apply(points)).pixels
        )
        views.append(replace(view, pixels=view.pixels + moved[view.ids]))
    errors = solved(scene, views).errors
    plane = np.column_stack([np.ones_like(x), x, y])
    bent = heights.T - plane @ np.linalg.lstsq(plane, heights.T, rcond=None)[0]
    sizes = np.sqrt(np.mean(bent**2, axis=0))
    assert errors.rolling_px is None
    assert errors.flex == pytest.approx((np.median(sizes), sizes.max()), rel=0.3)
