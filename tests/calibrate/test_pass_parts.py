"""The parts of a pass by themselves: costs by hand, noise that was drawn, steps that go to and fro as told."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from observed import make_scene, true_state

from camcal.calibrate import estimator
from camcal.calibrate.camera_part import AdditionalParameters, KnownNoise, Place
from camcal.calibrate.effects import EFFECTS, EffectScales, Posterior
from camcal.calibrate.noise import CornerNoise, ViewNoise
from camcal.calibrate.problem import BoardProblem
from camcal.calibrate.shape import point_equations
from camcal.cameras.observations import Observations
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.simulate.scene import observe
from camcal.solve.steps import Step
from camcal.targets.board import Board

VIEWS = 6
BARE = AdditionalParameters(smooth=False, points=False)


def scene_of(columns=6, rows=5):
    return make_scene(board=Board("chessboard", columns, rows, 0.040), count=VIEWS)


def passes_of(scene, additional=BARE, noise=0.1, claimed=None, start=None, views=None):
    """The passes before the first one, from the truth."""
    observations = replace(Observations.of(views or scene.observe(1, noise_px=noise)), covariance=claimed)
    problem = BoardProblem(scene.camera.model, scene.board, observations, np.arange(4))
    return estimator._Passes(problem, true_state(scene), additional, start, brief=False)


def test_the_cost_of_a_place_is_that_of_corners_priors_and_effects():
    rng = np.random.default_rng(1)
    passes = passes_of(scene_of(), AdditionalParameters(smooth=True, points=False, effects=("smooth", "flex")))
    shape = passes.present.shape
    roots = rng.normal(size=(*shape, 2, 2))
    observations = passes.problem.observations.weighted(0.1 * np.eye(2) + roots @ roots.swapaxes(2, 3))
    weights, views = rng.uniform(0.2, 1, shape), rng.uniform(0.5, 3, VIEWS)
    weights[2, 3] = 0.0
    terms = len(passes.problem.terms)
    passes.problem = replace(
        passes.problem,
        observations=replace(observations, weights=weights),
        sigma=0.3,
        noise=views,
        term_std=np.full(terms, 1e-3),
        lens_spread=np.full(9, 500.0),
    )
    passes.noise = ViewNoise(0.3, views)
    state = replace(passes.place.state, shape=1e-3 * rng.normal(size=terms))
    count = passes.columns.values.shape[1]
    coefficients, std = 0.1 * rng.normal(size=(VIEWS, count)), rng.uniform(0.1, 0.5, (VIEWS, count))
    place = Place(state, passes.problem.derivatives(state), coefficients)
    field = np.einsum("imvp,vm->ivp", passes.columns.values, coefficients)
    away = np.einsum("ijvp,jvp->ivp", observations.whitening, passes.problem.residuals(state) + field)
    corners = np.sum(weights / views[:, None] * np.sum(away**2, axis=0)) / 0.3**2
    priors = np.sum((state.shape / 1e-3) ** 2) + np.sum((state.parameters[:4] / 500) ** 2)
    expected = 0.5 * (corners + priors + np.sum((coefficients / std) ** 2))
    assert passes._cost(place, std) == pytest.approx(expected, rel=1e-12)
    lost = replace(place.derivatives, valid=np.arange(place.derivatives.valid.size) != 2 * shape[1] + 3)
    assert passes._cost(replace(place, derivatives=lost), std) == pytest.approx(expected, rel=1e-12)  # of no weight
    np.testing.assert_allclose(passes.field(place), field, atol=1e-12)
    np.testing.assert_allclose(passes.residuals(place), passes.problem.residuals(state) + field, atol=1e-9)


def test_a_part_of_a_step_leads_that_part_of_the_way():
    rng = np.random.default_rng(2)
    passes = passes_of(scene_of(), AdditionalParameters(smooth=False, points=False, effects=("rolling",)))
    here = replace(passes.place, coefficients=rng.normal(size=(VIEWS, 6)))
    step = Step(rng.normal(size=4), 1e-3 * rng.normal(size=(VIEWS, 12)))
    found = passes._towards(here, step, 0.25)
    np.testing.assert_allclose(found.state.parameters[:4], here.state.parameters[:4] + 0.25 * step.shared, rtol=1e-12)
    np.testing.assert_allclose(found.state.translations, here.state.translations + 0.25 * step.groups[:, :3])
    turned = so3.log(found.state.rotations @ here.state.rotations.transpose(0, 2, 1))
    np.testing.assert_allclose(turned, 0.25 * step.groups[:, 3:6], rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(found.coefficients, 0.75 * here.coefficients + 0.25 * step.groups[:, 6:], rtol=1e-12)
    moved = passes.problem.residuals(found.state).reshape(2, -1)
    np.testing.assert_allclose(found.derivatives.residuals, moved, atol=1e-9)


def to_and_fro(monkeypatch, moves, *, offsets=None):
    """The passes after some that move the lens so, in standard deviations, and what each returned."""
    passes, std = passes_of(scene_of()), np.array([2.0, 0.5, 1.0, 4.0])
    passes.problem = replace(passes.problem, offsets=offsets is not None)
    spent, series = np.arange(1.0, VIEWS + 1), iter(moves)

    def move(self):
        parameters = self.place.state.parameters.copy()
        parameters[:4] += std * next(series)
        self.place = replace(self.place, state=replace(self.place.state, parameters=parameters))
        return None, None

    monkeypatch.setattr(estimator._Passes, "judge", lambda self, *, first: None)
    monkeypatch.setattr(estimator._Passes, "_move", move)
    monkeypatch.setattr(estimator, "posterior", lambda factors: Posterior(np.diag(std**2), spent))
    monkeypatch.setattr(estimator, "board_scales", lambda *problem: {})
    monkeypatch.setattr(estimator, "spent_on_offsets", lambda *problem: offsets)
    returned = [passes._pass(first=number == 0) for number in range(len(moves))]
    return passes, returned


@pytest.mark.parametrize(("degrees", "share"), [(180, 0.7), (122, 0.7), (118, 1.0), (27, 1.0)])
@pytest.mark.parametrize("length", [0.1, 4.0])
def test_a_pass_that_takes_back_what_the_one_before_did_shortens_the_way_from_then_on(
    monkeypatch, degrees, share, length
):
    first, aside = np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0, 0.0])
    turn = np.radians(degrees)
    second = length * (np.cos(turn) * first + np.sin(turn) * aside)
    passes, returned = to_and_fro(monkeypatch, [-5.0 * second, first, second])
    assert passes.share == pytest.approx(share)
    # the first one has yet to learn how large everything is
    assert to_and_fro(monkeypatch, [first, -first])[0].share == 1.0
    np.testing.assert_allclose([own[2] for own in returned[1:]], [1.0, np.abs(second).max()], rtol=1e-9)


@pytest.mark.parametrize(
    ("degrees", "first", "second", "share"),
    [
        (0, 0.2, 0.1, 2.0),  # 0.1 + 0.05 + 0.025 …: twice as far
        (0, 0.2, 0.14, 1 / 0.3),
        (0, 0.2, 0.16, 4.0),  # five times as far would be too much
        (0, 0.2, 0.29, 4.0),  # a series that grows
        (0, 0.6, 0.31, 1.0),  # not calm yet
        (25, 0.2, 0.1, 1 / (1 - 0.5 * np.cos(np.radians(25)))),
        (27, 0.2, 0.1, 1.0),
    ],
)
def test_passes_that_go_on_in_one_direction_are_summed_up(monkeypatch, degrees, first, second, share):
    turn = np.radians(degrees)
    ways = first * np.array([1.0, 0, 0, 0]), second * np.array([np.cos(turn), 0, np.sin(turn), 0])
    passes, _ = to_and_fro(monkeypatch, [np.zeros(4), *ways])
    assert passes.share == pytest.approx(share)
    assert passes.damped == 1.0


def test_leaps_become_fewer_where_they_do_not_get_on(monkeypatch):
    way = np.array([0.1, 0.0, 0.0, 0.0])
    start = [np.zeros(4), 2 * way, way, way, way]
    assert to_and_fro(monkeypatch, [*start, 0.8 * way, 0.71 * way])[0].share == 1.0
    assert to_and_fro(monkeypatch, [*start, 0.8 * way, 0.69 * way])[0].share == 4.0


def test_a_leap_and_the_pass_after_it_say_nothing_of_the_next(monkeypatch):
    way = np.array([0.1, 0.0, 0.0, 0.0])
    start = [np.zeros(4), 2 * way, way]
    back = [-way, way, -way, way]
    for count, share in ((1, 1.0), (2, 1.0), (3, 1.0), (4, 0.7)):
        assert to_and_fro(monkeypatch, [*start, *back[:count]])[0].share == pytest.approx(share)
    assert to_and_fro(monkeypatch, [*start, *[0.5 * way] * 4])[0].share == pytest.approx(4.0)


def test_the_way_is_never_shorter_than_three_tenths(monkeypatch):
    way = np.array([1.0, -1.0, 2.0, 0.0])
    shares = [
        to_and_fro(monkeypatch, [way * (-1) ** number for number in range(count)])[0].share for count in range(2, 8)
    ]
    np.testing.assert_allclose(shares, [1.0, 0.7, 0.49, 0.343, 0.3, 0.3])


def test_every_view_pays_for_what_its_corners_spend_on_offsets(monkeypatch):
    offsets = np.linspace(2.0, 1.0, VIEWS)
    passes, returned = to_and_fro(monkeypatch, [np.zeros(4)], offsets=offsets)
    np.testing.assert_allclose(passes.spent, np.arange(1.0, VIEWS + 1) + offsets)
    np.testing.assert_array_equal(returned[0][1].spent, passes.spent)
    np.testing.assert_allclose(to_and_fro(monkeypatch, [np.zeros(4)])[0].spent, np.arange(1.0, VIEWS + 1))


def test_what_is_left_per_coordinate_is_what_parameters_have_not_spent():
    passes = passes_of(scene_of())
    passes.spent = np.full(VIEWS, 15.0)
    # 60 coordinates a view; a weight of all corners counts as 1 / 0.99 of Gaussian ones
    assert passes.unspent() == pytest.approx(0.75, abs=0.005)
    passes.spent = np.full(VIEWS, 59.9)
    assert passes.unspent() == 0.05


def test_passes_begin_with_poses_paid_for_and_points_of_small_boards_together():
    for columns, rows, together in ((10, 6, True), (61, 1, False)):
        board = Board("chessboard", columns, max(rows, 2), 0.040)
        scene = make_scene(board=board, count=3)
        passes = passes_of(scene, AdditionalParameters(smooth=True, points=True))
        assert passes.problem.offsets == together
        np.testing.assert_array_equal(passes.spent, [6.0] * 3)
        assert (passes.share, passes.damped) == (1.0, 1.0)
    assert not passes_of(scene_of(), BARE).problem.offsets
    assert not passes_of(scene_of(), AdditionalParameters(smooth=True, points=False)).problem.offsets


def test_noise_is_at_least_four_tenths_of_what_images_claim_of_a_typical_corner():
    scene = scene_of()
    claimed = np.tile(np.diag([0.02**2, 0.04**2]), (VIEWS, scene.board.count, 1, 1))
    claimed[:2] *= 100
    assert passes_of(scene, claimed=claimed).finest == pytest.approx(0.4 * np.sqrt((0.02**2 + 0.04**2) / 2))
    assert passes_of(scene).finest == 1e-4


def test_an_estimate_goes_on_with_the_effects_that_another_had():
    rng = np.random.default_rng(3)
    scene = scene_of()
    first, every = passes_of(scene), tuple(effect.name for effect in EFFECTS)
    scales = EffectScales(np.array([4.0, 9.0, 1e-8]), rng.uniform(0.5, 2, (VIEWS, 3)), np.ones(3))
    start = SimpleNamespace(
        additional=AdditionalParameters(effects=("rolling",)),
        known=KnownNoise(ViewNoise(0.2, np.ones(VIEWS)), CornerNoise(0.7), np.full(VIEWS, 9.0)),
        board={name: replace(scale, effective=0.7) for name, scale in first.board.items()},
        effect_scales=scales,
        coefficients=rng.normal(size=(VIEWS, 6)),
    )
    found = passes_of(scene, AdditionalParameters(smooth=False, points=False, effects=every), start=start)
    begun = EffectScales.start(VIEWS, 0.2, max(scene.board.extent))
    np.testing.assert_allclose(found.effect_scales.variances, [begun.variances[0], 9.0, begun.variances[2]])
    np.testing.assert_allclose(found.effect_scales.shares[:, 1], scales.shares[:, 1])
    np.testing.assert_allclose(found.effect_scales.shares[:, [0, 2]], 1.0)
    np.testing.assert_array_equal(found.place.coefficients[:, 18:24], start.coefficients)
    assert not found.place.coefficients[:, :18].any()
    assert not found.place.coefficients[:, 24:].any()
    assert not found.fresh
    assert (found.noise, found.corners, found.board) == (start.known.views, start.known.corners, start.board)
    start.effect_scales = None
    bare = passes_of(scene, AdditionalParameters(smooth=False, points=False, effects=every), start=start)
    np.testing.assert_allclose(bare.effect_scales.variances, begun.variances)
    np.testing.assert_array_equal(found.spent, [9.0] * VIEWS)


# Noise of corners, beyond what their images claim

FLOOR = 0.06


def weighed(rng, claimed_std=0.05):
    """Passes of views whose second one is five times as noisy, and residuals as they have them, of which half of the
    degrees of freedom are spent.
    """
    scene = make_scene(board=Board("chessboard", 20, 16, 0.020), count=4)
    claimed = np.tile(claimed_std**2 * np.eye(2), (4, scene.board.count, 1, 1)) * rng.uniform(
        0.2, 2, (4, scene.board.count, 1, 1)
    )
    passes = passes_of(scene, claimed=claimed)
    passes.shares = np.zeros_like(passes.shares)
    passes.noise, passes.spent = ViewNoise(0.1, np.array([1.0, 25.0, 1.0, 1.0])), np.full(4, 320.0)
    std = np.sqrt(0.5 * (claimed[..., 0, 0] + FLOOR**2) * passes.noise.views[:, None])
    residuals = std * rng.normal(size=(2, *std.shape))
    residuals[:, 2, :10] = 50.0
    residuals[0, 3, :40] = np.nan
    residuals[1, 3, :40] = 0.0
    passes.present[0, :200], residuals[:, 0, :200] = False, 0.3
    return passes, residuals


def test_a_floor_is_found_beside_gross_errors_views_of_more_noise_and_spent_freedom():
    passes, residuals = weighed(np.random.default_rng(4))
    passes.weigh(residuals)
    # 2500 numbers: 1.4 % of a variance of which the floor is two thirds; ten gross ones, cut at four deviations
    assert passes.corners.constant_px == pytest.approx(FLOOR, rel=0.06)
    whitening = passes.problem.observations.whitening
    covariances = np.linalg.inv(np.einsum("ijvp,ikvp->vpjk", whitening, whitening))
    total = passes.claimed[..., 0, 0] + passes.corners.constant_px**2
    np.testing.assert_allclose(covariances[..., 0, 0] / covariances[0, 0, 0, 0], total / total[0, 0], rtol=1e-6)


def test_a_new_floor_goes_a_share_of_the_way_in_variances():
    passes, residuals = weighed(np.random.default_rng(5))
    passes.weigh(residuals)
    first, passes.share = passes.corners.constant_px, 0.3
    passes.weigh(3 * residuals)
    third = weighed(np.random.default_rng(5))[0]
    third.weigh(3 * residuals)
    expected = np.sqrt(0.7 * first**2 + 0.3 * third.corners.constant_px**2)
    assert passes.corners.constant_px == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(
    ("board", "side"),
    [
        (Board("chessboard", 6, 5, 0.040), 0.040),
        (Board("charuco", 6, 5, 0.040, marker=0.030, dictionary="4x4_50"), 0.040),
        (Board("aprilgrid", 3, 3, 0.050, marker=0.030, dictionary="tag36h11"), 0.030),
        (Board("circles", 6, 5, 0.040), None),
    ],
    ids=["chessboard", "charuco", "tags", "circles"],
)
@pytest.mark.parametrize("degrees", [0.0, 2.0, 40.0])
def test_errors_of_a_period_average_out_over_the_pixels_that_an_edge_crosses(board, side, degrees):
    rotation = so3.exp(np.array([0.0, 0.0, np.radians(degrees)]))
    scene = scene_of()
    camera = replace(scene.camera, parameters=np.array([1200.0, 1200.0, 800.0, 600.0, 0, 0, 0, 0, 0]))
    poses = [Pose(rotation, np.array([0.0, 0.0, 1.0]) - rotation @ np.array([*board.extent, 0.0]) / 2)]
    scene = replace(scene, camera=camera, board=board, poses=tuple(poses))
    views = observe(camera, board, poses, rng=np.random.default_rng(1))[0].views
    claimed = np.tile(1e-4 * np.eye(2), (1, board.count, 1, 1))
    shares = passes_of(scene, claimed=claimed, views=views).shares
    if side is None:  # no edges
        assert not shares.any()
        return
    periods = 1200 * side * abs(np.sin(np.radians(degrees))) / 2
    expected = np.sinc(periods) ** 2 if periods < 0.5 else 1 / (np.pi * periods) ** 2
    np.testing.assert_allclose(shares, expected, rtol=1e-6)
    assert not passes_of(scene, views=views).shares.any()  # nothing is claimed


# Points and lost views


def test_points_move_to_where_their_equations_say():
    scene = scene_of(13, 5)
    passes = passes_of(scene, AdditionalParameters(smooth=False, points=True), noise=0.5)
    assert not passes.problem.offsets
    passes.judge(first=True)
    for _ in range(2):  # from where they are drawn, and from there
        here = passes.place
        equations = point_equations(passes.problem, here.state, here.derivatives, np.zeros((2, *passes.present.shape)))
        expected = equations.scales(max(scene.board.extent), passes.unspent())
        spent = passes._move_points()
        for name, scale in expected.items():
            assert passes.board[name].effective == pytest.approx(scale.effective, rel=1e-9)
        assert "bow" in passes.board
        flat, height = (max(scene.board.extent) * scale.effective for scale in expected.values())
        std = np.array([flat, flat, height])
        np.testing.assert_allclose(passes.place.state.offsets, equations.offsets(std), rtol=1e-9)
        np.testing.assert_allclose(spent, equations.spent(std), rtol=1e-9)
        moved = passes.problem.residuals(passes.place.state)
        # linear to a thousandth, and everything else held
        np.testing.assert_allclose(passes.place.derivatives.residuals.reshape(moved.shape), moved, atol=2e-3)
        np.testing.assert_array_equal(passes.place.state.parameters, here.state.parameters)
        passes.spent = passes.spent + 2.0


def test_views_that_have_lost_their_corners_are_posed_again_and_no_others():
    scene = scene_of()
    passes = passes_of(scene, noise=0.0)
    rng = np.random.default_rng(6)
    rotations, translations = passes.place.state.rotations.copy(), passes.place.state.translations.copy()
    for view in (1, 4):
        rotations[view] = so3.exp(0.02 * rng.normal(size=3)) @ rotations[view]
        translations[view] += 0.01 * rng.normal(size=3)
    state = replace(passes.place.state, rotations=rotations, translations=translations)
    passes.place = replace(passes.place, state=state, derivatives=passes.problem.derivatives(state))
    weights = passes.problem.observations.weights.copy()
    weights[1], weights[4] = 0.49, 0.51
    passes.problem = replace(passes.problem, observations=replace(passes.problem.observations, weights=weights))
    before = rotations.copy(), translations.copy()
    passes._pose_lost_views()
    np.testing.assert_array_equal(state.rotations, before[0])  # those of before stay as they were
    np.testing.assert_array_equal(state.translations, before[1])
    away = np.abs(passes.problem.residuals(passes.place.state)).max(axis=(0, 2))
    assert away[1] < 1e-3
    assert away[4] > 1.0
    np.testing.assert_array_equal(passes.place.state.rotations[4], rotations[4])
    np.testing.assert_array_equal(passes.place.state.parameters, state.parameters)
    np.testing.assert_array_equal(passes.problem.observations.weights, weights)
    residuals = passes.problem.residuals(passes.place.state).reshape(2, -1)
    np.testing.assert_allclose(passes.place.derivatives.residuals, residuals, atol=1e-9)
