"""Block-tridiagonal matrices against the same matrices written out in full."""

import numpy as np
import pytest

from camcal.solve.steps import factorise_tridiagonal

SIZE, COUNT = 3, 5


@pytest.fixture
def system():
    """Blocks of a positive definite matrix, and the matrix (15, 15)."""
    rng = np.random.default_rng(1)
    blocks = np.stack([np.cov(rng.normal(size=(SIZE, 9))) + 2 * np.eye(SIZE) for _ in range(COUNT)])
    beside = 0.4 * rng.normal(size=(COUNT - 1, SIZE, SIZE))
    full = np.zeros((COUNT, SIZE, COUNT, SIZE))
    for k in range(COUNT):
        full[k, :, k] = blocks[k]
    for k in range(COUNT - 1):
        full[k + 1, :, k], full[k, :, k + 1] = beside[k], beside[k].T
    full = full.reshape(COUNT * SIZE, -1)
    assert np.linalg.eigvalsh(full).min() > 0
    return factorise_tridiagonal(blocks, beside), full


def test_solutions_are_those_of_the_whole_matrix(system):
    factor, full = system
    right = np.random.default_rng(2).normal(size=(COUNT, SIZE))
    np.testing.assert_allclose(factor.solve(right).ravel(), np.linalg.solve(full, right.ravel()), rtol=1e-10)


def test_covariances_are_the_blocks_of_the_inverse(system):
    factor, full = system
    inverse = np.linalg.inv(full).reshape(COUNT, SIZE, COUNT, SIZE)
    diagonal, beside = factor.covariances()
    for k in range(COUNT):
        np.testing.assert_allclose(diagonal[k], inverse[k, :, k], atol=1e-12)
    for k in range(COUNT - 1):
        np.testing.assert_allclose(beside[k], inverse[k, :, k + 1], atol=1e-12)


def test_what_blocks_add_to_the_determinant_is_that_of_the_leading_parts(system):
    factor, full = system
    parts = [np.linalg.slogdet(full[: SIZE * (k + 1), : SIZE * (k + 1)])[1] for k in range(COUNT)]
    np.testing.assert_allclose(np.cumsum(factor.log_determinants()), parts, rtol=1e-12)
