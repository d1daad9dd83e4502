"""What views do to an estimate: against solving again without them; weights and covariances against closed forms."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from camcal import calibrate
from camcal.calibrate.effects import posterior, scaled
from camcal.calibrate.jackknife import averaged, covariance_of, image_metric, influence, weights_of
from camcal.calibrate.problem import BoardProblem, State
from camcal.geometry import rotation as so3
from camcal.solve.least_squares import assemble
from camcal.solve.steps import Block, Jacobian, factorise

VIEWS, ROWS, LENS, GROUP = 7, 20, 3, 6


class Linear:
    """Views with a pose each and a common lens: y = pose p + lens x + noise, and effects of a given variance."""

    def __init__(self, seed=1, effects=0, prior=None, points=None):
        rng = np.random.default_rng(seed)
        self.group = rng.normal(size=(VIEWS, ROWS, 2, GROUP + effects))
        self.lens = rng.normal(size=(VIEWS, ROWS, 2, LENS)) * np.linspace(0.5, 1.5, VIEWS)[:, None, None, None]
        self.weights = rng.uniform(0.5, 2, (VIEWS, ROWS))
        self.observed = rng.normal(size=(VIEWS, ROWS, 2)) / np.sqrt(self.weights)[..., None]
        self.std = np.full((VIEWS, effects), 0.7)
        self.prior, self.points = prior, points
        self.point = rng.normal(size=(VIEWS, ROWS, 2, 1))

    @property
    def shared(self):
        return LENS + (ROWS if self.points else 0)

    def block(self, residuals, views=slice(None)):
        """The rows of views."""
        flat = [part[views].reshape(-1, *part.shape[2:]) for part in (self.lens, self.group, self.point)]
        jacobians = [Jacobian(flat[0], np.arange(LENS))]
        if self.points:
            runs = len(flat[2]) // ROWS
            jacobians.append(Jacobian(flat[2], LENS + np.tile(np.arange(ROWS), runs)[:, None]))
        return Block(
            residuals.reshape(-1, 2),
            tuple(jacobians),
            flat[1],
            rows_per_group=ROWS,
            weights=self.weights[views].ravel(),
        )

    def factors(self, observed=None, views=None, at=None):
        """The factors of the views' equations; at: values of the shared parameters and groups to linearise at."""
        views = np.arange(VIEWS) if views is None else views
        residuals = -(self.observed if observed is None else observed)[views]
        shared = np.zeros(self.shared) if at is None else at.shared
        if at is not None:
            by = np.concatenate([np.ones((VIEWS, GROUP)), self.std], axis=1)
            # effects start at nothing in every pass
            poses = (by * at.groups)[:, :GROUP]
            residuals = residuals + np.einsum("vrik,k->vri", self.lens[views], shared[:LENS])
            residuals += np.einsum("vrik,vk->vri", self.group[views][..., :GROUP], poses[views])
            if self.points:
                residuals += self.point[views][..., 0] * shared[LENS:][:, None]
        blocks = [self.block(residuals, views)]
        if self.prior:
            blocks.append(held(shared[:LENS], self.prior, 0))
        if self.points:
            blocks.append(held(shared[LENS:], self.points, LENS))
        equations = assemble(blocks, self.shared, len(views), GROUP + self.std.shape[1])
        return factorise(scaled(equations, self.std[views]))

    def solution(self, observed=None, views=None):
        """The shared parameters at the minimum."""
        return self.factors(observed, views).solve().shared

    def estimate(self, observed=None):
        """The equations at the minimum, as the last pass of an estimate leaves them."""
        factors = self.factors(observed, at=self.factors(observed).solve())
        problem = SimpleNamespace(observed=lambda residuals: [self.block(residuals)])
        return SimpleNamespace(
            problem=problem, linearised=np.zeros((VIEWS, ROWS, 2)), factors=factors, posterior=posterior(factors)
        )


def held(values, std, start):
    """A prior of given standard deviation about zero."""
    columns = start + np.arange(len(values))[:, None]
    return Block((values / std)[:, None], (Jacobian(np.full((len(values), 1, 1), 1 / std), columns),))


def without(views):
    return np.delete(np.arange(VIEWS), views)


@pytest.mark.parametrize("model", [{}, {"effects": 3}, {"prior": 0.2}])
def test_the_jackknife_moves_the_lens_as_solving_again_without_a_view(model):
    linear = Linear(**model)
    found = influence(linear.estimate())
    moved = np.array([linear.solution(views=without([view])) for view in range(VIEWS)]) - linear.solution()
    np.testing.assert_allclose(found, moved * np.sqrt((VIEWS - 1) / VIEWS), rtol=1e-9, atol=1e-12)  # linear: exact


@pytest.mark.parametrize("model", [{"points": 0.05}, {"points": 0.2, "effects": 2}, {"points": 5.0, "seed": 4}])
def test_the_jackknife_determines_the_points_of_the_board_anew_without_a_view(model, monkeypatch):
    monkeypatch.setattr(calibrate.jackknife, "_SAFETY", 1e9)
    linear = Linear(**model)
    estimate = linear.estimate()
    moved = np.array([linear.solution(views=without([view])) for view in range(VIEWS)]) - linear.solution()
    found = influence(estimate) / np.sqrt((VIEWS - 1) / VIEWS)
    assert found.shape == (VIEWS, LENS)
    np.testing.assert_allclose(found, moved[:, :LENS], rtol=1e-3, atol=1e-4 * np.abs(moved).max())
    held = linear.factors(at=linear.factors().solve())
    first_order = held.group_scores() @ held.shared_covariance()[:, :LENS]
    assert np.linalg.norm(first_order - moved[:, :LENS]) > 0.1 * np.linalg.norm(moved[:, :LENS])


def test_a_view_that_alone_determines_the_lens_is_not_divided_by_zero():
    linear = Linear(seed=5)
    linear.lens[1:] *= 1e-9
    found = influence(linear.estimate())
    assert np.isfinite(found).all()
    # a leverage cut at 99 % leaves 0.01, of which a third counts under the root
    root = np.linalg.cholesky(linear.estimate().posterior.shared)
    pull = root @ root.T @ linear.estimate().factors.group_scores()[0]
    np.testing.assert_allclose(found[0], pull / np.sqrt(0.01 / 3) * np.sqrt((VIEWS - 1) / VIEWS), rtol=1e-6)


def expected_scatter(linear):
    """The expectation of the summed squares of influences: of one unit error after the other, steps are linear."""
    count = VIEWS * ROWS * 2
    moved = np.zeros((count, VIEWS, LENS))
    for index in range(count):
        errors = np.zeros(count)
        errors[index] = 1 / np.sqrt(linear.weights.ravel()[index // 2])
        moved[index] = influence(linear.estimate(errors.reshape(VIEWS, ROWS, 2)))
    return np.einsum("nvi,nvj->ij", moved, moved)


def test_the_scatter_from_view_to_view_errs_on_the_safe_side_where_errors_are_alike():
    linear = Linear(seed=6)
    expected = expected_scatter(linear)
    estimate = linear.estimate()
    truth = estimate.posterior.shared
    assert np.linalg.eigvalsh(expected - truth).min() > 0
    # Σ_v C^½ A_v (1 - A_v)⁻¹ C^½, A_v the share of a view in the information
    root = np.linalg.cholesky(truth)
    share = root.T @ estimate.factors.group_information() @ root
    sums = np.sum(share @ np.linalg.inv(np.eye(LENS) - share), axis=0)
    np.testing.assert_allclose(expected, (VIEWS - 1) / VIEWS * root @ sums @ root.T, rtol=1e-8)


@pytest.mark.parametrize("factor", [8.0, 15.0, 30.0])
def test_the_scatter_of_a_view_that_determines_much_is_at_most_three_times_what_equal_views_have(factor):
    linear = Linear(seed=6)
    linear.lens[0] *= factor
    estimate = linear.estimate()
    root = np.linalg.cholesky(estimate.posterior.shared)
    leverages, vectors = np.linalg.eigh(root.T @ estimate.factors.group_information() @ root)
    assert leverages[0].max() > 0.7
    assert leverages[1:].max() < 0.5
    shares = np.minimum(leverages / (1 - leverages), 3 * leverages)
    sums = np.einsum("vij,vj,vkj->ik", vectors, shares, vectors)
    np.testing.assert_allclose(
        expected_scatter(linear), (VIEWS - 1) / VIEWS * root @ sums @ root.T, rtol=1e-8, atol=1e-14
    )


def test_the_metric_of_the_image_is_the_mean_square_of_what_moves_in_it():
    rng = np.random.default_rng(7)
    displacements, change = rng.normal(size=(30, 2, LENS)), rng.normal(size=LENS)
    moves = [np.sum((displacement @ change) ** 2) for displacement in displacements]
    assert change @ image_metric(displacements) @ change == pytest.approx(np.mean(moves), rel=1e-12)


def drawn(rng, *stds, common=0.0, terms=2, views=400):
    """What leaving out views moves in several estimates, of which a part is common."""
    shared = common * rng.normal(size=(views, LENS + terms))
    return [shared + std * rng.normal(size=shared.shape) for std in stds]


def metric_of(rng):
    return image_metric(rng.normal(size=(30, 2, LENS)))


def weight_of_first(one, other, metric):
    """The minimum of k a w² + k c (1 - w)² + 2 b w (1 - w): the own scatter of each counts k = 1 + 10/V times."""
    a, b, c = (
        np.einsum("vi,ij,vj", x[:, :LENS], metric, y[:, :LENS]) for x, y in ((one, one), (one, other), (other, other))
    )
    k = 1 + 10 / len(one)
    return np.clip((k * c - b) / (k * a + k * c - 2 * b), 0, 1)


@pytest.mark.parametrize("views", [5, 20, 400])
def test_two_estimates_are_weighed_by_the_closed_form(views):
    rng = np.random.default_rng(8)
    metric, moved = metric_of(rng), drawn(rng, 1.0, 1.5, common=0.8, views=views)
    weights = weights_of(moved, metric)
    # a ridge of 1e-9 of the trace
    np.testing.assert_allclose(weights[0], weight_of_first(*moved, metric), rtol=1e-7)
    assert weights.sum() == pytest.approx(1.0, abs=1e-12)


def test_weights_of_many_estimates_have_the_least_spread():
    rng = np.random.default_rng(18)
    metric, moved = metric_of(rng), drawn(rng, 1.0, 1.2, 1.5, 0.9, common=0.8)
    weights = weights_of(moved, metric)

    def spread(trial):
        total = sum(weight * own for weight, own in zip(trial, moved, strict=True))[:, :LENS]
        own = sum(
            weight**2 * np.sum((one[:, :LENS] @ metric) * one[:, :LENS])
            for weight, one in zip(trial, moved, strict=True)
        )
        return np.sum((total @ metric) * total) + 10 / 400 * own

    assert weights.min() > 0.05
    for first in range(4):
        for second in range(first):
            change = np.zeros(4)
            change[[first, second]] = 0.01, -0.01
            assert spread(weights + change) > spread(weights) < spread(weights - change)


def test_only_parameters_of_the_lens_and_only_what_moves_the_image_count():
    rng = np.random.default_rng(9)
    metric, moved = image_metric(rng.normal(size=(30, 2, LENS)) * [1.0, 1.0, 0.0]), drawn(rng, 1.0, 1.0)
    disturbed = [moved[0], moved[1] * np.array([1, 1, 50, 50, 50])]
    np.testing.assert_allclose(weights_of(disturbed, metric), weights_of(moved, metric), rtol=1e-9)


def test_the_steadier_estimate_counts_for_more():
    rng = np.random.default_rng(10)
    weights = weights_of(drawn(rng, 1.0, 2.0, 3.0), metric_of(rng))
    # independent: by the inverse of their variances; 1200 squares of each: 4 %
    np.testing.assert_allclose(weights, np.array([36, 9, 4]) / 49, atol=0.03)


def test_no_weight_is_negative():
    rng = np.random.default_rng(11)
    one, other = drawn(rng, 0.1, 0.1, common=2.0)
    weights = weights_of([one, 3 * other], metric_of(rng))
    np.testing.assert_allclose(weights, [1.0, 0.0], atol=1e-12)


def test_equal_estimates_share_their_weight_and_one_has_all_of_it():
    rng = np.random.default_rng(12)
    metric, moved = metric_of(rng), drawn(rng, 1.0)
    np.testing.assert_allclose(weights_of(moved, metric), [1.0])
    np.testing.assert_allclose(weights_of(moved * 3, metric), np.full(3, 1 / 3), rtol=1e-7)  # the ridge


def test_weights_are_followed_as_far_as_effects_are_believed_in():
    rng = np.random.default_rng(11)
    left_out, metric = drawn(rng, 1.0, 0.5, 0.8), metric_of(rng)
    whole = weights_of(left_out, metric)
    np.testing.assert_allclose(weights_of(left_out, metric, 0.0), [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(weights_of(left_out, metric, 0.3), 0.3 * whole + [0.7, 0, 0], rtol=1e-12)


def made(rng, moved, claimed=None, *, shared=None, lens_std=np.inf, term_std=None):
    """Estimates of a lens whose first parameter is held and of two terms, with what leaving out views moves in them."""
    free = np.arange(1, LENS + 1)
    result = []
    for index in range(len(moved)):
        problem = BoardProblem(None, None, None, free, ("xy", "P2(x)"))
        problem = replace(
            problem,
            lens_spread=np.append(5.0, np.full(LENS, lens_std)),
            term_std=None if term_std is None else np.full(2, term_std),
        )
        values = np.zeros(LENS + 2) if shared is None else shared[index]
        parameters = np.append(7.0 + index, values[:LENS])
        root = rng.normal(size=(LENS + 2, LENS + 2))
        covariance = root @ root.T if claimed is None else claimed
        result.append(
            SimpleNamespace(
                problem=problem,
                state=State(parameters, np.zeros((0, 3, 3)), np.zeros((0, 3)), values[LENS:], np.zeros((0, 3))),
                posterior=SimpleNamespace(shared=covariance),
            )
        )
    return result, list(moved)


def in_image(covariance, metric):
    return np.trace(covariance[:LENS, :LENS] @ metric)


def test_the_covariance_is_the_scatter_of_views_drawn_towards_what_is_claimed():
    rng = np.random.default_rng(19)
    views, size = 6, LENS + 2
    metric, moved = metric_of(rng), drawn(rng, 1.0, 1.4, common=0.5, views=views)
    shared, weights = rng.normal(size=(2, size)), np.array([0.7, 0.3])
    estimates, influences = made(rng, moved, shared=shared, lens_std=2.0, term_std=0.5)
    scatter = np.zeros((size, size))
    shares = []
    for view in range(views):  # under the weights that the others give
        share = weight_of_first(*[np.delete(own, view, axis=0) for own in moved], metric)
        mean = share * moved[0][view] + (1 - share) * moved[1][view]
        scatter += np.outer(mean, mean)
        shares.append(share)
    assert np.ptp(shares) > 0.05
    # what the estimates disagree in
    scatter += np.cov(shared.T, aweights=weights, ddof=0)
    # what the priors leave open: of 2 of the lens, of 0.5 of the terms
    claims = [own.posterior.shared for own in estimates]
    precision = np.diag([0.25] * LENS + [4.0] * 2)
    scatter += sum(weight * claim @ precision @ claim for weight, claim in zip(weights, claims, strict=True))
    claimed = 0.7 * claims[0] + 0.3 * claims[1]
    level = in_image(scatter, metric)
    assert level > in_image(claimed, metric)
    # six views, and as if five more had the claimed shape
    expected = 6 / 11 * scatter + 5 / 11 * claimed * level / in_image(claimed, metric)
    found = covariance_of(estimates, influences, metric, weights)
    np.testing.assert_allclose(found, expected, atol=1e-7 * np.abs(expected).max())  # a ridge of 1e-9


@pytest.mark.parametrize("factor", [1e-3, 0.9, 1.1, 1e3])
def test_the_covariance_moves_the_image_as_the_scatter_does_and_no_less_than_is_claimed(factor):
    rng = np.random.default_rng(20)
    metric, (moved,) = metric_of(rng), drawn(rng, 1.0, views=8)
    scatter, claimed = moved.T @ moved, np.diag(np.arange(1.0, LENS + 3))
    claimed *= factor * in_image(scatter, metric) / in_image(claimed, metric)
    found = covariance_of(*made(rng, [moved], claimed), metric, np.ones(1))
    assert in_image(found, metric) == pytest.approx(max(1.0, factor) * in_image(scatter, metric), rel=1e-9)
    np.testing.assert_allclose(found, found.T, rtol=1e-12)


def test_blocks_of_the_covariance_have_the_scale_and_as_far_as_views_show_it_the_shape_of_their_own_scatter():
    rng = np.random.default_rng(22)
    metric, (moved,) = np.eye(LENS), drawn(rng, 1.0, views=8)
    blocks = slice(0, 1), slice(1, LENS)
    moved[:, :1] *= 5.0
    scatter, claimed = moved.T @ moved, np.eye(LENS + 2)
    claimed *= 0.1 * in_image(scatter, metric) / in_image(claimed, metric)
    given = *made(rng, [moved], claimed), metric, np.ones(1)
    found, whole = covariance_of(*given, blocks=blocks), covariance_of(*given)
    for block in blocks:
        own = np.trace(scatter[block, block])
        assert np.trace(found[block, block]) == pytest.approx(max(own, np.trace(claimed[block, block])), rel=1e-9)
        count, alike = block.stop - block.start, claimed[block, block] / np.trace(claimed[block, block])
        drawn_to = (8 * scatter[block, block] / own + count * alike) / (8 + count)
        np.testing.assert_allclose(found[block, block] / np.trace(found[block, block]), drawn_to, rtol=1e-9)
    assert found[0, 0] > whole[0, 0], "one scale for all takes from what scatters more"
    assert np.linalg.eigvalsh(found).min() > 0


def test_errors_that_cancel_between_blocks_do_so_in_the_covariance_whatever_the_scales_of_the_blocks():
    rng = np.random.default_rng(24)
    root = np.eye(LENS + 2)
    root[1, :2] = 1.0, 0.01  # the second follows the first to 1 %, as a baseline does a focal length
    moved = rng.normal(size=(8, LENS + 2)) / np.sqrt(8) @ root.T
    moved[:, 2] *= 5.0  # another one of the second block scatters more than is claimed
    given = *made(rng, [moved], root @ root.T), np.eye(LENS), np.ones(1)
    found = covariance_of(*given, blocks=(slice(0, 1), slice(1, LENS)))
    difference = np.array([1.0, -1.0, 0.0, 0.0, 0.0])
    assert 1e-4 / 2 < difference @ found @ difference < 25 * 1e-4  # no more than the scale of the second block
    assert found[2, 2] > 5.0


def test_weights_by_predictions_do_not_depend_on_the_noise_that_all_estimates_have_in_common():
    rng = np.random.default_rng(23)
    metric, moved = metric_of(rng), drawn(rng, 1.0, 1.0, 1.0)
    own = np.array([1.0, 2.0, 3.0])[:, None] * rng.normal(size=(3, 40 * VIEWS))
    found = []
    for noise in (0.0, 30.0):
        # at right angles to the errors of the estimates: what is left of chance would count
        common = rng.normal(size=own.shape[1])
        common -= own.T @ np.linalg.solve(own @ own.T, own @ common)
        errors = (own + noise * common).reshape(3, VIEWS, -1)
        found.append(weights_of(moved, metric, products=np.einsum("avn,bvn->vab", errors, errors)))
    np.testing.assert_allclose(found[0], found[1], atol=1e-5)
    assert found[0][0] > found[0][1] > found[0][2]
    assert weights_of(moved, metric)[2] > found[0][2], "by the scatter of the estimates they are alike"


def test_many_views_give_the_covariance_its_shape():
    rng = np.random.default_rng(21)
    metric, (moved,) = metric_of(rng), drawn(rng, 1.0, views=500)
    claimed = 100.0 * np.diag(np.arange(1.0, LENS + 3))
    found = covariance_of(*made(rng, [moved], claimed), metric, np.ones(1))
    np.testing.assert_allclose(found, moved.T @ moved, atol=0.02 * np.abs(found).max())  # 5 of 505 parts are claimed


@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_units_of_the_image_do_not_matter(factor):
    rng = np.random.default_rng(13)
    metric, moved = metric_of(rng), drawn(rng, 1.0, 1.4, 0.9, common=0.5)
    np.testing.assert_allclose(weights_of(moved, factor * metric), weights_of(moved, metric), rtol=1e-9)


def state(rng, centre=None, size=0.01):
    """A state of three views and four points near another one."""
    start = centre or State(
        np.array([1200.0, 800.0]),
        so3.exp(rng.normal(size=(3, 3))),
        rng.normal(size=(3, 3)),
        np.ones(2),
        np.ones((4, 3)),
    )
    turns = so3.exp(size * rng.normal(size=(3, 3)))
    moved = [values + size * rng.normal(size=values.shape) for values in (start.parameters, start.translations)]
    board = [values + size * rng.normal(size=values.shape) for values in (start.shape, start.offsets)]
    return State(moved[0], turns @ start.rotations, moved[1], *board)


def test_equal_states_have_themselves_as_their_mean():
    one = state(np.random.default_rng(14))
    found = averaged([one, one, one], np.array([0.2, 0.5, 0.3]))
    for name in ("parameters", "rotations", "translations", "shape", "offsets"):
        np.testing.assert_allclose(getattr(found, name), getattr(one, name), rtol=1e-14, atol=1e-15)


def test_lens_translations_and_board_are_weighted_means():
    rng = np.random.default_rng(15)
    centre = state(rng)
    states, weights = [state(rng, centre) for _ in range(3)], np.array([0.5, 0.1, 0.4])
    found = averaged(states, weights)
    for name in ("parameters", "translations", "shape", "offsets"):
        expected = sum(weight * getattr(own, name) for weight, own in zip(weights, states, strict=True))
        np.testing.assert_allclose(getattr(found, name), expected, rtol=1e-14)


def test_rotations_are_averaged_along_the_turn_between_them():
    rng = np.random.default_rng(16)
    one = state(rng)
    axes = np.array([[0.3, 0.0, 0.0], [0.0, -0.5, 0.2], [1.0, 1.0, 1.0]])
    other = replace(one, rotations=one.rotations @ so3.exp(axes))
    found = averaged([one, other], np.array([0.75, 0.25])).rotations
    np.testing.assert_allclose(found, one.rotations @ so3.exp(0.25 * axes), atol=1e-14)
    np.testing.assert_allclose(found.transpose(0, 2, 1) @ found, np.tile(np.eye(3), (3, 1, 1)), atol=1e-14)
    exchanged = averaged([other, one], np.array([0.25, 0.75])).rotations
    np.testing.assert_allclose(exchanged, found, atol=1e-14)  # two rotations have one way between them


def test_the_mean_of_several_rotations_leaves_no_turn_on_average():
    rng = np.random.default_rng(17)
    centre = state(rng)
    states, weights = [state(rng, centre, 0.02) for _ in range(4)], np.array([0.4, 0.3, 0.2, 0.1])
    mean = averaged(states, weights).rotations.transpose(0, 2, 1)
    left = sum(weight * so3.log(mean @ own.rotations) for weight, own in zip(weights, states, strict=True))
    np.testing.assert_allclose(left, 0, atol=2e-5)  # the third order of turns of 0.05
