"""The solver on problems whose answer is known: scipy's, a closed form, or the same problem posed without groups."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.optimize import least_squares

from camcal.solve.descent import Stopping
from camcal.solve.least_squares import assemble, minimise
from camcal.solve.losses import Cauchy, Huber
from camcal.solve.steps import Block, Jacobian, SingularError, Step, factorise


@dataclass(frozen=True)
class Rosenbrock:
    """The classic valley; minimum at (1, 1)."""

    shared = 2
    groups = (0, 0)

    def blocks(self, state):
        x, y = state
        jacobian = np.array([[[-20 * x, 10.0]], [[-1.0, 0.0]]])
        return [Block(np.array([[10 * (y - x * x)], [1 - x]]), (Jacobian(jacobian, np.arange(2)),))]

    def retract(self, state, step):
        return state + step.shared


@dataclass(frozen=True)
class Lines:
    """Parallel lines: one shared slope, one offset per group; a linear problem with eliminated groups."""

    x: np.ndarray  # (G, P)
    y: np.ndarray
    weights: np.ndarray | None = None
    loss: object = None
    sparse: bool = False

    shared = 1

    @property
    def groups(self):
        return len(self.x), 1

    def blocks(self, state):
        slope, offsets = state
        residuals = (slope * self.x + offsets[:, None] - self.y).reshape(-1, 1)
        by_slope = self.x.reshape(-1, 1, 1)
        columns = np.zeros((len(residuals), 1), int) if self.sparse else np.arange(1)
        weights = None if self.weights is None else self.weights.ravel()
        group = np.ones((len(residuals), 1, 1))
        return [
            Block(
                residuals,
                (Jacobian(by_slope, columns),),
                group,
                rows_per_group=self.x.shape[1],
                weights=weights,
                loss=self.loss,
            )
        ]

    def retract(self, state, step):
        return state[0] + step.shared[0], state[1] + step.groups[:, 0]


@pytest.fixture
def lines():
    rng = np.random.default_rng(3)
    x = rng.normal(size=(4, 6))
    return Lines(x, 2.0 * x + np.arange(4)[:, None] + 0.1 * rng.normal(size=x.shape))


def dense_answer(lines):
    groups, points = lines.x.shape
    design = np.column_stack([lines.x.ravel(), np.repeat(np.eye(groups), points, axis=0)])
    return design, np.linalg.lstsq(design, lines.y.ravel(), rcond=None)[0]


def test_curved_valley_is_followed_to_its_minimum():
    solution = minimise(Rosenbrock(), np.array([-1.2, 1.0]))
    assert solution.converged
    np.testing.assert_allclose(solution.state, [1, 1], atol=1e-8)  # quadratic convergence ends below this


@pytest.mark.parametrize("sparse", [False, True])
def test_eliminating_groups_gives_the_same_answer_as_one_dense_solve(lines, sparse):
    problem = Lines(lines.x, lines.y, sparse=sparse)
    solution = minimise(problem, (0.0, np.zeros(4)))
    design, expected = dense_answer(lines)
    np.testing.assert_allclose([solution.state[0], *solution.state[1]], expected, atol=1e-9)  # linear: exact
    covariance = np.linalg.inv(design.T @ design)
    factors = solution.factors()
    np.testing.assert_allclose(factors.shared_covariance(), covariance[:1, :1], rtol=1e-9)
    np.testing.assert_allclose(factors.group_covariances()[:, 0, 0], np.diag(covariance)[1:], rtol=1e-9)


def test_scores_of_the_groups_sum_to_zero_at_the_minimum(lines):
    solution = minimise(lines, (0.0, np.zeros(4)))
    scores = solution.factors().group_scores()
    assert np.abs(scores).max() > 1e-3
    assert np.abs(scores.sum(axis=0)).max() < 1e-9


def test_weight_zero_removes_a_row(lines):
    weights = np.ones(lines.x.shape)
    weights[1, 2] = 0.0
    spoilt = lines.y.copy()
    spoilt[1, 2] += 100.0
    weighted = minimise(Lines(lines.x, spoilt, weights), (0.0, np.zeros(4)))
    clean = minimise(Lines(lines.x, lines.y, weights), (0.0, np.zeros(4)))
    assert weighted.state[0] == pytest.approx(clean.state[0], abs=1e-10)


@pytest.mark.parametrize(("loss", "scipy_name"), [(Huber(0.2), "huber"), (Cauchy(0.2), "cauchy")])
def test_robust_losses_agree_with_scipy(lines, loss, scipy_name):
    spoilt = lines.y.copy()
    spoilt[0, 0] += 50.0
    solution = minimise(Lines(lines.x, spoilt, loss=loss), (2.0, np.arange(4.0)), Stopping(1e-14))

    def residuals(state):
        return (state[0] * lines.x + state[1:, None] - spoilt).ravel()

    expected = least_squares(residuals, [2.0, 0, 1, 2, 3], loss=scipy_name, f_scale=0.2, xtol=1e-14, ftol=1e-14)
    assert solution.cost == pytest.approx(expected.cost, rel=1e-9)
    assert solution.state[0] == pytest.approx(expected.x[0], abs=1e-5)  # scipy's own stopping
    assert solution.state[0] == pytest.approx(2.0, abs=0.2)


def test_parameters_that_cannot_be_told_apart_are_reported_not_solved():
    twins = Jacobian(np.ones((5, 1, 2)), np.arange(2))
    equations = assemble([Block(np.ones((5, 1)), (twins,))], 2, 0, 0)
    with pytest.raises(SingularError):
        factorise(equations)


def test_restricted_equations_equal_those_of_the_smaller_problem():
    rng = np.random.default_rng(5)
    values, residuals = rng.normal(size=(30, 2, 3)), rng.normal(size=(30, 2))
    group = rng.normal(size=(30, 2, 2))

    def equations(columns):
        jacobian = Jacobian(values[:, :, columns], np.arange(len(columns)))
        return assemble([Block(residuals, (jacobian,), group, rows_per_group=10)], len(columns), 3, 2)

    small, large = equations([0, 2]), equations([0, 1, 2]).restricted(np.array([0, 2]))
    np.testing.assert_allclose(factorise(small).solve().shared, factorise(large).solve().shared, rtol=1e-10)


def test_sparse_columns_add_up_like_dense_ones():
    rng = np.random.default_rng(6)
    residuals, group = rng.normal(size=(40, 2)), rng.normal(size=(40, 2, 3))
    common, own = rng.normal(size=(40, 2, 2)), rng.normal(size=(40, 2, 2))
    columns = rng.permuted(np.tile(np.arange(2, 6), (40, 1)), axis=1)[:, :2]
    widened = np.zeros((40, 2, 6))
    widened[:, :, :2] = common
    np.put_along_axis(widened, np.repeat(columns[:, None], 2, axis=1), own, axis=2)
    weights = rng.uniform(0.5, 2, 40)
    kinds = {
        "sparse": (Jacobian(common, np.arange(2)), Jacobian(own, columns)),
        "dense": (Jacobian(widened, np.arange(6)),),
        "two sparse": (
            Jacobian(common, np.tile(np.arange(2), (40, 1))),
            Jacobian(own, columns),
        ),
    }
    results = {
        name: assemble([Block(residuals, shared, group, rows_per_group=10, weights=weights)], 6, 4, 3)
        for name, shared in kinds.items()
    }
    for name in ("sparse", "two sparse"):
        for part in ("group_group", "group_shared", "shared_shared", "group_gradients"):
            np.testing.assert_allclose(
                getattr(results[name], part), getattr(results["dense"], part), atol=1e-12, err_msg=f"{name} {part}"
            )
        np.testing.assert_allclose(results[name].gradient.shared, results["dense"].gradient.shared, atol=1e-12)


@pytest.mark.parametrize("step", [1, 3])
@pytest.mark.parametrize("last", [None, 0])
def test_columns_that_every_run_of_rows_repeats_add_up_like_any_others(step, last):
    rng = np.random.default_rng(9)
    residuals, group = rng.normal(size=(40, 2)), rng.normal(size=(40, 2, 3))
    common, own = rng.normal(size=(40, 2, 2)), rng.normal(size=(40, 2, 2))
    run = 2 + step * np.arange(10)[:, None] + np.arange(2)
    columns = np.tile(run, (4, 1))
    if last is not None:
        columns[-1] = columns[last]  # no longer evenly spaced: the sums are scattered
    weights = rng.uniform(0.5, 2, 40)
    count = columns.max() + 1
    widened = np.zeros((40, 2, count))
    widened[:, :, :2] = common
    np.put_along_axis(widened, np.repeat(columns[:, None], 2, axis=1), own, axis=2)
    found, expected = (
        assemble([Block(residuals, shared, group, rows_per_group=10, weights=weights)], count, 4, 3)
        for shared in (
            (Jacobian(common, np.arange(2)), Jacobian(own, columns)),
            (Jacobian(widened, np.arange(count)),),
        )
    )
    for part in ("group_group", "group_shared", "shared_shared", "group_gradients"):
        np.testing.assert_allclose(getattr(found, part), getattr(expected, part), atol=1e-12, err_msg=part)
    np.testing.assert_allclose(found.gradient.shared, expected.gradient.shared, atol=1e-12)
    np.testing.assert_allclose(found.gradient.groups, expected.gradient.groups, atol=1e-12)


@dataclass(frozen=True)
class Grouped:
    """Random rows of four groups: columns that all rows have, in two parts, and one that differs from row to row."""

    residuals: np.ndarray
    group: np.ndarray
    common: np.ndarray  # of shared parameters 0, 1 and 3
    own: np.ndarray  # of one of 4, 5 and 6
    place: np.ndarray
    weights: np.ndarray

    @classmethod
    def drawn(cls, seed=8):
        rng = np.random.default_rng(seed)
        shapes = (40, 2), (40, 2, 3), (40, 2, 3), (40, 2, 1)
        return cls(*(rng.normal(size=shape) for shape in shapes), rng.integers(4, 7, (40, 1)), rng.uniform(0.5, 2, 40))

    def blocks(self, rows=slice(None), **how):
        shared = (
            Jacobian(self.common[rows][:, :, :2], np.array([0, 1])),
            Jacobian(self.own[rows], self.place[rows]),
            Jacobian(self.common[rows][:, :, 2:], np.array([3])),
        )
        return Block(self.residuals[rows], shared, self.group[rows], weights=self.weights[rows], **how)

    def equations(self):
        # parameter 2 and single places have nothing but this prior, which belongs to no group
        prior = Block(np.ones((7, 1)), (Jacobian(np.full((7, 1, 1), 0.7), np.arange(7)[:, None]),))
        everywhere = Block(np.zeros((7, 1)), (Jacobian(0.5 * np.eye(7)[:, None], np.arange(7)),))
        return assemble([self.blocks(rows_per_group=10), prior, everywhere], 7, 4, 3)

    def wide(self):
        """The Jacobian (4, 20, 4) of every group by the first four shared parameters, and of the group itself."""
        values = np.zeros((40, 2, 4))
        values[:, :, [0, 1, 3]] = self.common
        root = np.sqrt(self.weights)[:, None, None]
        return (root * values).reshape(4, 20, 4), (root * self.group).reshape(4, 20, 3)


def test_products_of_a_group_are_its_own_part_of_what_all_rows_share():
    grouped = Grouped.drawn()
    equations, (wide, _) = grouped.equations(), grouped.wide()
    assert equations.group_products.shape == (4, 4, 4)
    np.testing.assert_allclose(equations.group_products, wide.transpose(0, 2, 1) @ wide, atol=1e-12)
    priors = (0.49 + 0.25) * np.eye(4)
    np.testing.assert_allclose(
        equations.group_products.sum(axis=0) + priors, equations.shared_shared[:4, :4], atol=1e-12
    )


@pytest.mark.parametrize("groups", [None, np.array([2, 0, 3, 1])])
def test_equations_without_products_are_the_same_otherwise(groups):
    block = Grouped.drawn().blocks(rows_per_group=10, groups=groups)
    full, lean = (assemble([block], 7, 4, 3, products=products) for products in (True, False))
    assert lean.group_products.shape == (4, 0, 0)
    assert lean.cost == full.cost
    for name in ("group_group", "group_shared", "shared_shared", "group_gradients"):
        np.testing.assert_allclose(getattr(lean, name), getattr(full, name), atol=1e-12, err_msg=name)
    for name in ("shared", "groups"):
        np.testing.assert_allclose(getattr(lean.gradient, name), getattr(full.gradient, name), atol=1e-12)


def test_products_of_a_group_add_up_over_blocks_that_name_it():
    grouped = Grouped.drawn()
    whole = assemble([grouped.blocks(rows_per_group=10)], 7, 4, 3)
    rows = np.arange(40).reshape(4, 2, 5)
    halves = [
        grouped.blocks(rows[::-1, 0].ravel(), rows_per_group=5, groups=np.array([3, 2, 1, 0])),
        grouped.blocks(rows[[1, 3, 0, 2], 1].ravel(), rows_per_group=5, groups=np.array([1, 3, 0, 2])),
    ]
    np.testing.assert_allclose(assemble(halves, 7, 4, 3).group_products, whole.group_products, atol=1e-12)


def test_information_of_a_group_is_what_its_rows_say_when_the_group_follows():
    grouped = Grouped.drawn()
    wide, group = grouped.wide()
    factors = factorise(grouped.equations())
    for index, found in enumerate(factors.group_information()):
        # what is left of the columns when those of the group are projected out
        left = wide[index] - group[index] @ np.linalg.lstsq(group[index], wide[index], rcond=None)[0]
        np.testing.assert_allclose(found, left.T @ left, atol=1e-10)
    schur = factors.shared_root @ factors.shared_root.T
    np.testing.assert_allclose(factors.group_information().sum(axis=0) + 0.74 * np.eye(4), schur[:4, :4], atol=1e-10)


def test_restricted_equations_keep_the_products_of_what_remains():
    grouped = Grouped.drawn()
    whole = grouped.equations()
    for columns, dense in (([0, 3, 5], [0, 3]), ([0, 1, 2, 3], [0, 1, 2, 3]), ([4, 6], [])):
        found = whole.restricted(np.array(columns))
        np.testing.assert_array_equal(found.group_products, whole.group_products[:, dense][:, :, dense])
        assert found.shared_shared.shape == (len(columns), len(columns))
    np.testing.assert_allclose(
        factorise(whole.restricted(np.arange(4))).group_information(), factorise(whole).group_information(), atol=1e-12
    )


@pytest.mark.parametrize("count", [1, 2])
def test_eliminating_a_part_of_each_group_leaves_the_step_of_the_rest(count):
    whole = Grouped.drawn().equations()
    rest = whole.without_first(count)
    step, expected = factorise(rest).solve(), factorise(whole).solve()
    np.testing.assert_allclose(step.shared, expected.shared, rtol=1e-9)
    np.testing.assert_allclose(step.groups, expected.groups[:, count:], rtol=1e-9)
    assert rest.cost - factorise(rest).decrease() == pytest.approx(whole.cost - factorise(whole).decrease(), rel=1e-12)
    for part in ("group_information", "group_scores", "shared_covariance"):
        np.testing.assert_allclose(
            getattr(factorise(rest), part)(), getattr(factorise(whole), part)(), rtol=1e-8, atol=1e-12, err_msg=part
        )


def test_the_determinant_is_that_of_the_whole_normal_matrix():
    equations = Grouped.drawn().equations()
    groups, size, shared = equations.group_shared.shape
    whole = np.zeros((groups * size + shared,) * 2)
    for index in range(groups):
        own = slice(index * size, (index + 1) * size)
        whole[own, own] = equations.group_group[index]
        whole[own, groups * size :] = equations.group_shared[index]
    whole[groups * size :, : groups * size] = whole[: groups * size, groups * size :].T
    whole[groups * size :, groups * size :] = equations.shared_shared
    assert factorise(equations).log_determinant() == pytest.approx(np.linalg.slogdet(whole)[1], rel=1e-10)


def test_groups_without_shared_parameters_have_no_products():
    grouped = Grouped.drawn()
    block = Block(grouped.residuals, (), grouped.group, rows_per_group=10)
    assert assemble([block], 0, 4, 3).group_products.shape == (4, 0, 0)
    alone = Block(grouped.residuals, (Jacobian(grouped.own, grouped.place - 4),), grouped.group, rows_per_group=10)
    equations = assemble([alone], 3, 4, 3)
    assert equations.group_products.shape == (4, 0, 0)
    assert factorise(equations).group_information().shape == (4, 0, 0)


def test_the_inverse_root_of_a_group_inverts_its_block():
    factors = factorise(Grouped.drawn().equations())
    inverse = factors.group_inverse
    identity = np.broadcast_to(np.eye(3), (4, 3, 3))
    np.testing.assert_allclose(inverse @ factors.group_root, identity, atol=1e-12)
    block = factors.equations.group_group
    np.testing.assert_allclose(inverse.transpose(0, 2, 1) @ inverse @ block, identity, atol=1e-12)


def test_blocks_may_share_groups_through_an_index():
    rng = np.random.default_rng(7)
    residuals, group = rng.normal(size=(12, 1)), rng.normal(size=(12, 1, 2))
    shared = (Jacobian(rng.normal(size=(12, 1, 1)), np.arange(1)),)
    whole = assemble([Block(residuals, shared, group, rows_per_group=4)], 1, 3, 2)
    halves = [
        Block(
            residuals[part],
            (Jacobian(shared[0].values[part], np.arange(1)),),
            group[part],
            rows_per_group=2,
            groups=np.array([0, 1, 2]),
        )
        for part in (np.array([0, 1, 4, 5, 8, 9]), np.array([2, 3, 6, 7, 10, 11]))
    ]
    split = assemble(halves, 1, 3, 2)
    np.testing.assert_allclose(split.group_shared, whole.group_shared, atol=1e-14)
    np.testing.assert_allclose(split.group_group, whole.group_group, atol=1e-14)


def test_a_start_outside_the_domain_is_a_programming_error():
    class Nowhere(Rosenbrock):
        def blocks(self, state):
            return None

    with pytest.raises(ValueError, match="outside the domain"):
        minimise(Nowhere(), np.zeros(2))


def test_steps_outside_the_domain_are_shortened():
    class Logarithm:
        """Minimise (ln x - 1)² from far left: full steps leave x > 0."""

        shared, groups = 1, (0, 0)

        def blocks(self, state):
            if state[0] <= 0:
                return None
            return [Block(np.array([[np.log(state[0]) - 1]]), (Jacobian(np.array([[[1 / state[0]]]]), np.arange(1)),))]

        def retract(self, state, step):
            return state + step.shared

    solution = minimise(Logarithm(), np.array([50.0]))
    assert solution.converged
    assert solution.state[0] == pytest.approx(np.e, abs=1e-6)  # the stopping rule is on the cost, x to its root


def test_step_inner_product_counts_groups_and_shared():
    step = Step(np.array([1.0, 2.0]), np.array([[3.0]]))
    assert step.dot(step) == 14.0
