"""The matrix identities behind the solver, each against a numerical derivative: a page to learn them from.

Numerator layout throughout: the derivative of a vector f (m,) by a vector x (n,) is the m × n matrix
J[i, j] = ∂f_i/∂x_j, so the derivative of a scalar is a row, and its gradient is that row turned into a column.
Textbooks that mix this with the transposed (denominator) layout get d(Ax)/dx = Aᵀ, and with it Fᵀ P F where F P Fᵀ is
meant.

The derivative of a scalar by a matrix X is written as the matrix G[i, j] = ∂f/∂X[i, j], as the trace table usually is;
then df = tr(Gᵀ dX).
"""

import numpy as np
import pytest

from camcal.solve.differentiate import central_jacobian, complex_jacobian

A, B, C, NOISE = np.random.default_rng(11).normal(size=(4, 3, 3))
X = NOISE + 3 * np.eye(3)  # far from singular
ROUNDING = 1e-12  # complex steps are exact to the rounding of a dozen products of numbers near 10


@pytest.fixture
def rng():
    return np.random.default_rng(12)


def derivative_by_matrix(function, at):
    """G[i, j] = ∂f/∂X[i, j] of a scalar function of a matrix, by complex steps."""
    return complex_jacobian(lambda x: function(x.reshape(at.shape)), at.ravel()).reshape(at.shape)


def power(matrix, exponent):
    return np.linalg.matrix_power(matrix, exponent)


# Vectors by vectors


def test_the_derivative_of_a_linear_map_is_its_matrix_not_the_transpose(rng):
    wide, x = rng.normal(size=(2, 3)), rng.normal(size=3)
    jacobian = complex_jacobian(lambda v: wide @ v, x)
    assert jacobian.shape == (2, 3)  # a row for each value, a column for each variable
    np.testing.assert_allclose(jacobian, wide, atol=ROUNDING)


def test_the_derivative_of_a_quadratic_form_is_a_row_and_its_gradient_the_column(rng):
    x = rng.normal(size=3)
    row = complex_jacobian(lambda v: np.array([v @ A @ v]), x)
    assert row.shape == (1, 3)
    np.testing.assert_allclose(row, x[None] @ (A + A.T), atol=ROUNDING)
    gradient = row.T[:, 0]
    np.testing.assert_allclose(gradient, (A + A.T) @ x, atol=ROUNDING)
    symmetric = A + A.T
    np.testing.assert_allclose(complex_jacobian(lambda v: v @ symmetric @ v, x), 2 * symmetric @ x, atol=ROUNDING)


def test_the_derivative_of_an_inner_product_is_the_other_vector(rng):
    a, x = rng.normal(size=(2, 3))
    np.testing.assert_allclose(complex_jacobian(lambda v: a @ v, x), a, atol=ROUNDING)
    np.testing.assert_allclose(complex_jacobian(lambda v: v @ a, x), a, atol=ROUNDING)


def test_chained_jacobians_multiply_in_the_order_of_the_functions():
    x = np.array([0.3, -0.7, 0.5])

    def inner(v):
        return np.stack([v[0] * v[1], np.sin(v[2])])

    def outer(u):
        return np.stack([u[0] ** 2, u[0] * u[1], np.exp(u[1])])

    whole = complex_jacobian(lambda v: outer(inner(v)), x)
    parts = complex_jacobian(outer, inner(x)) @ complex_jacobian(inner, x)
    np.testing.assert_allclose(whole, parts, atol=ROUNDING)


def test_the_gradient_of_half_the_squared_residuals_is_the_jacobian_transposed_times_them(rng):
    x, data = np.array([0.4, -0.2]), rng.normal(size=5)
    at = np.linspace(0, 1, 5)

    def residuals(p):
        return np.exp(p[0] * at + p[1]) - data

    jacobian = complex_jacobian(residuals, x)
    gradient = central_jacobian(lambda p: 0.5 * np.sum(residuals(p) ** 2), x)
    # central differences of fourth order at steps of 1e-3 leave 1e-11
    np.testing.assert_allclose(gradient, jacobian.T @ residuals(x), atol=1e-10)


def test_covariances_pass_through_a_jacobian_with_the_transpose_on_the_right(rng):
    step = 1.0
    F = np.array([[1, step], [0, 1]])  # position and velocity of constant velocity
    P = np.diag([1.0, 3.0])
    propagated = F @ P @ F.T
    samples = rng.multivariate_normal(np.zeros(2), P, size=200_000) @ F.T
    # 200 000 samples: standard error of a variance of 4 is 0.013
    np.testing.assert_allclose(np.cov(samples.T), propagated, atol=0.06)
    assert propagated[0, 0] == 4.0
    assert (F.T @ P @ F)[0, 0] == 1.0  # what the other layout gives: the position would never grow uncertain


# Traces by matrices

TRACE_TABLE = {
    "tr X": (np.trace, lambda x: np.eye(3)),
    "tr AX": (lambda x: np.trace(A @ x), lambda x: A.T),
    "tr AXᵀ": (lambda x: np.trace(A @ x.T), lambda x: A),
    "tr AXB": (lambda x: np.trace(A @ x @ B), lambda x: A.T @ B.T),
    "tr AXᵀB": (lambda x: np.trace(A @ x.T @ B), lambda x: B @ A),
    "tr X²": (lambda x: np.trace(x @ x), lambda x: 2 * x.T),
    "tr XᵀX": (lambda x: np.trace(x.T @ x), lambda x: 2 * x),
    "tr Xᵏ, k = 4": (lambda x: np.trace(power(x, 4)), lambda x: 4 * power(x, 3).T),
    "tr XᵀAX": (lambda x: np.trace(x.T @ A @ x), lambda x: (A + A.T) @ x),
    "tr AXBX": (lambda x: np.trace(A @ x @ B @ x), lambda x: A.T @ x.T @ B.T + B.T @ x.T @ A.T),
    "tr AXBXᵀ": (lambda x: np.trace(A @ x @ B @ x.T), lambda x: A.T @ x @ B.T + A @ x @ B),
    "tr X⁻¹": (lambda x: np.trace(np.linalg.inv(x)), lambda x: -power(np.linalg.inv(x), 2).T),
}


@pytest.mark.parametrize("row", TRACE_TABLE)
def test_the_trace_table_holds(row):
    function, slope = TRACE_TABLE[row]
    expected = slope(X)
    # the fourth power of numbers near 5 is near 600, known to 1e-13
    np.testing.assert_allclose(derivative_by_matrix(function, X), expected, atol=1e-10)


@pytest.mark.parametrize("row", TRACE_TABLE)
def test_the_differential_of_a_trace_is_the_trace_of_its_derivative_transposed_with_the_change(row, rng):
    function, slope = TRACE_TABLE[row]
    change = rng.normal(size=X.shape)
    along = complex_jacobian(lambda t: function(X + t[0] * change), np.zeros(1))[0]
    assert along == pytest.approx(np.trace(slope(X).T @ change), abs=1e-10)


def test_the_derivative_of_the_trace_of_the_inverse_has_a_minus():
    positive = X @ X.T
    gradient = derivative_by_matrix(lambda x: np.trace(np.linalg.inv(x)), positive)
    grown = np.trace(np.linalg.inv(positive + 0.1 * np.eye(3)))
    assert grown < np.trace(np.linalg.inv(positive))  # a larger matrix has a smaller inverse
    assert np.trace(gradient) < 0


def test_the_inverse_changes_by_minus_inverse_change_inverse(rng):
    change, inverse = rng.normal(size=X.shape), np.linalg.inv(X)
    along = complex_jacobian(lambda t: np.linalg.inv(X + t[0] * change), np.zeros(1))[..., 0]
    np.testing.assert_allclose(along, -inverse @ change @ inverse, atol=ROUNDING)


def test_the_logarithm_of_the_determinant_has_the_inverse_transposed_for_its_derivative():
    gradient = central_jacobian(lambda x: np.linalg.slogdet(x.reshape(3, 3))[1], X.ravel()).reshape(3, 3)
    np.testing.assert_allclose(gradient, np.linalg.inv(X).T, atol=1e-9)  # fourth order at steps of 1e-3


def test_a_normal_matrix_is_positive_definite_only_if_the_columns_are_independent(rng):
    independent, repeated = rng.normal(size=(5, 2)), np.ones((5, 2))
    assert np.linalg.eigvalsh(independent.T @ independent).min() > 0
    assert np.linalg.eigvalsh(repeated.T @ repeated).min() == pytest.approx(0, abs=1e-12)
    assert np.linalg.norm(repeated) > 0  # that the matrix is not zero proves nothing


def test_whitening_by_cholesky_gives_the_weighted_cost_for_any_covariance(rng):
    W, residual = C @ C.T + np.eye(3), rng.normal(size=3)
    whitened = np.linalg.solve(np.linalg.cholesky(W), residual)
    assert whitened @ whitened == pytest.approx(residual @ np.linalg.solve(W, residual), rel=1e-12)
    by_deviations = residual / np.sqrt(np.diag(W))  # right for a diagonal W only
    assert by_deviations @ by_deviations != pytest.approx(whitened @ whitened, rel=1e-3)
