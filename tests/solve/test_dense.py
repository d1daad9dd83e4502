"""The dense step: against the normal equations, and what it says of parameters the data do not tell apart."""

import numpy as np
import pytest

from camcal.solve.dense import assemble_dense
from camcal.solve.least_squares import assemble
from camcal.solve.losses import Cauchy
from camcal.solve.steps import Block, Jacobian, SingularError, factorise

NAMES = ("a", "b", "c")


@pytest.fixture
def rng():
    return np.random.default_rng(8)


def some_blocks(rng, loss=None):
    """Blocks of two kinds: dense columns with weights, and columns that differ from row to row."""
    columns = np.array([[0, 1], [1, 2], [2, 3], [3, 0], [0, 1], [1, 2]])
    dense = Jacobian(rng.normal(size=(8, 2, 3)), np.array([0, 2, 3]))
    return [
        Block(rng.normal(size=(8, 2)), (dense,), weights=rng.uniform(0.1, 3, 8), loss=loss),
        Block(rng.normal(size=(6, 1)), (Jacobian(rng.normal(size=(6, 1, 2)), columns),)),
    ]


def equations_of(jacobian, residuals=None):
    residuals = np.ones(len(jacobian)) if residuals is None else residuals
    count = jacobian.shape[1]
    return assemble_dense([Block(residuals[:, None], (Jacobian(jacobian[:, None], np.arange(count)),))], count)


@pytest.mark.parametrize("loss", [None, Cauchy(0.5)])
def test_cost_gradient_and_normal_matrix_are_those_of_the_normal_equations(loss, rng):
    blocks = some_blocks(rng, loss)
    dense, arrow = assemble_dense(blocks, 4), assemble(blocks, 4, 0, 0)
    assert dense.cost == pytest.approx(arrow.cost, rel=1e-14)
    np.testing.assert_allclose(dense.gradient, arrow.gradient.shared, atol=1e-13)
    np.testing.assert_allclose(dense.jacobian.T @ dense.jacobian, arrow.shared_shared, atol=1e-13)


def test_step_and_covariance_are_those_of_the_normal_equations(rng):
    blocks = some_blocks(rng)
    dense, arrow = assemble_dense(blocks, 4), factorise(assemble(blocks, 4, 0, 0))
    np.testing.assert_allclose(dense.factors().solve(-dense.residuals), arrow.solve().shared, atol=1e-12)
    np.testing.assert_allclose(dense.factors().covariance(), arrow.shared_covariance(), atol=1e-12)


def test_blocks_with_eliminated_groups_are_refused():
    block = Block(np.ones((2, 1)), group=np.ones((2, 1, 1)), rows_per_group=2)
    with pytest.raises(ValueError, match="no eliminated groups"):
        assemble_dense([block], 1)


def test_orthogonal_factors_keep_the_digits_that_normal_equations_lose():
    x = np.linspace(0, 1, 40)
    jacobian = np.stack([np.ones(40), x, x + 1e-9 * x**2], axis=1)
    target = jacobian @ np.array([1.0, 2.0, 3.0])
    found = equations_of(jacobian).factors().solve(target)
    # condition 2e10: ten of sixteen digits are lost, where JᵀJ has a condition of 4e20 and no digit left
    np.testing.assert_allclose(found, [1, 2, 3], atol=1e-4)
    by_normal_equations = np.linalg.lstsq(jacobian.T @ jacobian, jacobian.T @ target, rcond=None)[0]
    assert np.abs(by_normal_equations - [1, 2, 3]).max() > 0.1


def test_units_of_the_parameters_change_nothing_but_units(rng):
    jacobian, residuals = rng.normal(size=(10, 3)), rng.normal(size=10)
    units = np.array([1e-8, 1.0, 1e9])
    plain, scaled = equations_of(jacobian, residuals).factors(), equations_of(jacobian * units, residuals).factors()
    np.testing.assert_allclose(scaled.solve(-residuals) * units, plain.solve(-residuals), rtol=1e-12)
    assert scaled.condition == pytest.approx(plain.condition, rel=1e-9)
    assert scaled.rank == 3


def test_damping_shortens_the_step_and_never_reaches_the_covariance(rng):
    jacobian, residuals = rng.normal(size=(10, 3)), rng.normal(size=10)
    factors = equations_of(jacobian, residuals).factors()
    before = factors.covariance()
    lengths = [np.linalg.norm(factors.solve(-residuals, damping)) for damping in (0, 0.1, 1, 10)]
    assert lengths == sorted(lengths, reverse=True)
    np.testing.assert_array_equal(factors.covariance(), before)
    np.testing.assert_allclose(before, np.linalg.inv(jacobian.T @ jacobian), rtol=1e-10)


def test_what_cannot_be_told_apart_is_named(rng):
    jacobian = rng.normal(size=(10, 3))
    jacobian[:, 2] = 2 * jacobian[:, 0]  # c up by 1 does what a does by 2
    factors = equations_of(jacobian).factors()
    assert factors.rank == 2
    assert factors.condition == np.inf
    (parts,) = factors.null_space(NAMES)
    assert parts == pytest.approx({"a": 1.0, "c": -0.5})
    np.testing.assert_array_equal(factors.unobserved, [True, False, True])
    covariance = factors.covariance()
    assert np.isnan(covariance[[0, 2], [0, 2]]).all()
    # b is as well known as without either of them
    expected = np.linalg.inv(jacobian[:, :2].T @ jacobian[:, :2])[1, 1]
    assert covariance[1, 1] == pytest.approx(expected, rel=1e-10)


def test_unrelated_combinations_are_named_apart(rng):
    jacobian = rng.normal(size=(10, 5))
    jacobian[:, 1], jacobian[:, 4] = 2 * jacobian[:, 0], -jacobian[:, 2]
    found = equations_of(jacobian).factors().null_space("abcde")
    assert sorted(map(sorted, found)) == [["a", "b"], ["c", "e"]]


def test_a_parameter_without_influence_is_named_alone(rng):
    jacobian = rng.normal(size=(10, 3))
    jacobian[:, 1] = 0
    assert equations_of(jacobian).factors().null_space(NAMES) == [{"b": 1.0}]


def test_fewer_residuals_than_parameters_leave_combinations_open(rng):
    factors = equations_of(rng.normal(size=(2, 3))).factors()
    assert factors.rank == 2
    assert len(factors.null_space(NAMES)) == 1


def test_an_undamped_step_needs_full_rank():
    factors = equations_of(np.ones((5, 2))).factors()
    with pytest.raises(SingularError, match="rank 1 of 2"):
        factors.solve(np.ones(5))
    # with damping the two share what either could do
    np.testing.assert_allclose(factors.solve(np.ones(5), 1e-9), [0.5, 0.5], rtol=1e-8)


def test_leverages_are_the_diagonal_of_the_hat_matrix(rng):
    jacobian = rng.normal(size=(10, 3))
    hat = jacobian @ np.linalg.solve(jacobian.T @ jacobian, jacobian.T)
    leverage = equations_of(jacobian).factors().leverage()
    np.testing.assert_allclose(leverage, np.diag(hat), atol=1e-12)
    assert leverage.sum() == pytest.approx(3)
