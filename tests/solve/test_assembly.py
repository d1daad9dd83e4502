"""Normal equations and their factors: against matrices of everything, row by row and without any structure."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from camcal.solve import least_squares
from camcal.solve.least_squares import assemble
from camcal.solve.losses import Cauchy
from camcal.solve.steps import Block, Jacobian, NormalEquations, SingularError, Step, factorise

GROUPS, SIZE, SHARED = 4, 3, 9


@dataclass(frozen=True)
class Plain:
    """The cost, gradient and normal matrix of blocks: columns of all groups first, then the shared ones."""

    cost: float
    gradient: np.ndarray
    matrix: np.ndarray
    own_gradients: np.ndarray  # (G, S)
    own_matrices: np.ndarray  # (G, S, S)


def plain(blocks):
    """What `assemble` sums up, by a loop over rows."""
    count = GROUPS * SIZE + SHARED
    cost, gradient, matrix = 0.0, np.zeros(count), np.zeros((count, count))
    own_gradients, own_matrices = np.zeros((GROUPS, SHARED)), np.zeros((GROUPS, SHARED, SHARED))
    for block in blocks:
        for row, residual in enumerate(block.residuals):
            columns = np.zeros((len(residual), count))
            for part in block.shared:
                places = part.columns if part.columns.ndim == 1 else part.columns[row]
                for place, values in zip(places, part.values[row].T, strict=True):
                    columns[:, GROUPS * SIZE + place] += values
            weight = 1.0 if block.weights is None else block.weights[row]
            squared = weight * residual @ residual
            cost += 0.5 * float(squared if block.loss is None else block.loss.cost(squared))
            weight *= 1.0 if block.loss is None else block.loss.weight(squared)
            if block.rows_per_group:
                group = row // block.rows_per_group
                group = group if block.groups is None else block.groups[group]
                own = columns[:, GROUPS * SIZE :]
                own_gradients[group] += weight * own.T @ residual
                own_matrices[group] += weight * own.T @ own
                if block.group is not None:
                    inside = np.arange(SIZE) if block.group_columns is None else block.group_columns
                    columns[:, group * SIZE + inside] = block.group[row]
            gradient += weight * columns.T @ residual
            matrix += weight * columns.T @ columns
    return Plain(cost, gradient, matrix, own_gradients, own_matrices)


def agree(found, expected, dense):
    """Hold equations to what was summed row by row; dense: how many shared parameters have products of their own."""
    wide = GROUPS * SIZE
    assert found.cost == pytest.approx(expected.cost, rel=1e-12)
    np.testing.assert_allclose(found.gradient.groups.ravel(), expected.gradient[:wide], atol=1e-10)
    np.testing.assert_allclose(found.gradient.shared, expected.gradient[wide:], atol=1e-10)
    for group in range(GROUPS):
        own = slice(group * SIZE, (group + 1) * SIZE)
        block = expected.matrix[own, own]
        np.testing.assert_allclose(found.group_group[group], block if block.any() else np.eye(SIZE), atol=1e-10)
        np.testing.assert_allclose(found.group_shared[group], expected.matrix[own, wide:], atol=1e-10)
    np.testing.assert_allclose(found.shared_shared, expected.matrix[wide:, wide:], atol=1e-10)
    np.testing.assert_allclose(found.group_gradients, expected.own_gradients, atol=1e-10)
    np.testing.assert_allclose(found.group_products, expected.own_matrices[:, :dense, :dense], atol=1e-10)


def common(rng, rows, columns):
    return Jacobian(rng.normal(size=(rows, 2, len(columns))), np.array(columns))


def scattered(rng, rows, columns, count=2):
    """A Jacobian by some of these columns, others in every row."""
    places = rng.permuted(np.tile(columns, (rows, 1)), axis=1)[:, :count]
    return Jacobian(rng.normal(size=(rows, 2, count)), places)


def repeated(rng, runs, length, first=3, step=2, uneven=0):
    """A Jacobian by two columns that move on evenly from row to row and begin anew in every run."""
    run = first + step * np.arange(length)[:, None] + np.arange(2)
    run[-1] += uneven
    places = np.tile(run, (runs, 1))
    return Jacobian(rng.normal(size=(runs * length, 2, 2)), places)


def block_of(rng, runs, length, shared, **how):
    rows = runs * length
    fields = {"group": rng.normal(size=(rows, 2, SIZE)), "weights": rng.uniform(0.3, 2, rows), "rows_per_group": length}
    return Block(rng.normal(size=(rows, 2)), tuple(shared), **(fields | how))


def cases(rng):
    """Blocks by what they are, and how many shared parameters all rows of a group may depend on."""
    indexed = {"groups": np.array([3, 1, 2])}
    partly = {"group_columns": np.array([2, 0]), "group": rng.normal(size=(9, 2, 2))}
    return {
        "some parameters": ([block_of(rng, 3, 3, [common(rng, 9, [0, 2, 3])], **partly)], 4),
        "some parameters of named groups": (
            [
                block_of(rng, 4, 5, [common(rng, 20, [0, 1])]),
                block_of(
                    rng, 3, 3, [common(rng, 9, [3, 1]), repeated(rng, 3, 3, first=4, step=1)], **indexed, **partly
                ),
                block_of(rng, 3, 3, [common(rng, 9, [0]), scattered(rng, 9, np.arange(4, 9))], **indexed, **partly),
            ],
            4,
        ),
        "dense": ([block_of(rng, 4, 5, [common(rng, 20, [0, 1, 2, 3])])], 4),
        "dense with gaps": ([block_of(rng, 4, 5, [common(rng, 20, [4, 0]), common(rng, 20, [2])])], 5),
        "without weights": ([block_of(rng, 4, 5, [common(rng, 20, [0, 1])], weights=None)], 2),
        "robust": ([block_of(rng, 4, 5, [common(rng, 20, [0, 1])], loss=Cauchy(0.7))], 2),
        "scattered": ([block_of(rng, 4, 5, [common(rng, 20, [0, 1]), scattered(rng, 20, np.arange(2, 9))])], 2),
        "scattered twice": (
            [block_of(rng, 4, 5, [scattered(rng, 20, np.arange(2, 6)), scattered(rng, 20, np.arange(6, 9), 3)])],
            0,
        ),
        "repeated": ([block_of(rng, 4, 3, [common(rng, 12, [0, 1]), repeated(rng, 4, 3)])], 2),
        "repeated unevenly": (
            [block_of(rng, 4, 3, [common(rng, 12, [0, 1]), repeated(rng, 4, 3, step=1, uneven=1)])],
            2,
        ),
        "repeated without step": ([block_of(rng, 4, 3, [common(rng, 12, [2]), repeated(rng, 4, 3, step=0)])], 3),
        "repeated backwards": (
            [block_of(rng, 4, 3, [common(rng, 12, [2]), repeated(rng, 4, 3, first=7, step=-2)])],
            3,
        ),
        "repeated rows of one": ([block_of(rng, 4, 1, [common(rng, 4, [1]), repeated(rng, 4, 1)])], 2),
        "named groups": ([block_of(rng, 3, 5, [common(rng, 15, [0, 2, 3])], **indexed)], 4),
        "named and scattered": (
            [block_of(rng, 3, 5, [common(rng, 15, [0, 1]), scattered(rng, 15, np.arange(2, 9))], **indexed)],
            2,
        ),
        "named and repeated": (
            [block_of(rng, 3, 3, [common(rng, 9, [0, 1]), repeated(rng, 3, 3)], **indexed)],
            2,
        ),
        "without shared": ([block_of(rng, 4, 5, [])], 0),
        "without groups": (
            [
                Block(rng.normal(size=(6, 2)), (common(rng, 6, [8, 1]), scattered(rng, 6, np.arange(2, 5)))),
                block_of(rng, 4, 5, [common(rng, 20, [0, 1])]),
            ],
            2,
        ),
        "some groups twice": (
            [
                block_of(rng, 4, 5, [common(rng, 20, [0, 1])]),
                block_of(rng, 3, 2, [common(rng, 6, [1, 2, 3])], **indexed),
            ],
            4,
        ),
    }


@pytest.mark.parametrize("rows", [5, 4000])
@pytest.mark.parametrize("name", cases(np.random.default_rng(0)))
def test_equations_are_the_sums_of_all_rows(monkeypatch, name, rows):
    monkeypatch.setattr(least_squares, "_PART_ROWS", rows)  # in parts of a group or two, and at once
    blocks, dense = cases(np.random.default_rng(1))[name]
    found = assemble(blocks, SHARED, GROUPS, SIZE)
    assert found.group_products.shape == (GROUPS, dense, dense)
    agree(found, plain(blocks), dense)


# Factors


def whole(equations):
    """The normal matrix and gradient, groups first."""
    groups, size, shared = equations.group_shared.shape
    count = groups * size
    matrix = np.zeros((count + shared, count + shared))
    for group in range(groups):
        own = slice(group * size, (group + 1) * size)
        matrix[own, own], matrix[own, count:] = equations.group_group[group], equations.group_shared[group]
        matrix[count:, own] = equations.group_shared[group].T
    matrix[count:, count:] = equations.shared_shared
    return matrix, np.concatenate([equations.gradient.groups.ravel(), equations.gradient.shared])


def drawn(shared, seed=2):
    rng = np.random.default_rng(seed)
    rows = GROUPS * 9
    block = Block(
        rng.normal(size=(rows, 2)),
        (Jacobian(rng.normal(size=(rows, 2, shared)), np.arange(shared)),),
        rng.normal(size=(rows, 2, SIZE)),
        rows_per_group=9,
    )
    return assemble([block], shared, GROUPS, SIZE)


@pytest.mark.parametrize("shared", [0, 2, 3, 8])
def test_step_decrease_and_covariances_are_those_of_the_whole_matrix(shared):
    equations = drawn(shared)
    factors, (matrix, gradient) = factorise(equations), whole(equations)
    inverse, count = np.linalg.inv(matrix), GROUPS * SIZE
    step, expected = factors.solve(), -inverse @ gradient
    np.testing.assert_allclose(step.groups.ravel(), expected[:count], rtol=1e-9)
    np.testing.assert_allclose(step.shared, expected[count:], rtol=1e-9)
    assert factors.decrease() == pytest.approx(0.5 * gradient @ inverse @ gradient, rel=1e-10)
    assert factors.log_determinant() == pytest.approx(np.linalg.slogdet(matrix)[1], rel=1e-10)
    np.testing.assert_allclose(factors.shared_covariance(), inverse[count:, count:], rtol=1e-8, atol=1e-12)
    for group in range(GROUPS):
        own = slice(group * SIZE, (group + 1) * SIZE)
        np.testing.assert_allclose(factors.group_covariances()[group], inverse[own, own], rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(factors.group_covariances(2)[group], inverse[own, own][:2, :2], rtol=1e-8)
    fall = matrix[count:, :count] @ np.linalg.solve(matrix[:count, :count], gradient[:count])
    np.testing.assert_allclose(factors.reduced_gradient(), gradient[count:] - fall, rtol=1e-8, atol=1e-10)


def test_a_group_is_as_uncertain_as_it_is_by_itself_and_by_the_shared_parameters_it_is_told_of():
    equations, rng = drawn(8), np.random.default_rng(3)
    root = rng.normal(size=(5, 5))
    told = root @ root.T  # of the first five
    found = factorise(equations).group_covariances(2, told)
    for group in range(GROUPS):
        alone = np.linalg.inv(equations.group_group[group])
        follows = alone @ equations.group_shared[group][:, :5]
        np.testing.assert_allclose(found[group], (alone + follows @ told @ follows.T)[:2, :2], rtol=1e-9)


def test_scores_are_the_slopes_of_every_group_when_it_follows_the_shared_parameters():
    equations = drawn(4)
    for group, score in enumerate(factorise(equations).group_scores()):
        coupling = equations.group_shared[group].T @ np.linalg.inv(equations.group_group[group])
        expected = equations.group_gradients[group] - coupling @ equations.gradient.groups[group]
        np.testing.assert_allclose(score, expected, rtol=1e-9, atol=1e-12)


def test_damping_adds_its_share_to_every_diagonal_element():
    equations = drawn(4)
    before, after = whole(equations)[0], whole(equations.damped(0.3))[0]
    np.testing.assert_allclose(after, before + 0.3 * np.diag(np.diag(before)), rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(whole(equations)[0], before)


def test_damping_holds_what_no_residual_depends_on():
    equations = drawn(4)
    shared, groups = 1e-6 * equations.shared_shared, 1e-6 * equations.group_group
    shared[2] = shared[:, 2] = 0.0
    groups[1] = 0.0
    held = replace(equations, shared_shared=shared, group_group=groups).damped(0.5)
    assert held.shared_shared[2, 2] == pytest.approx(0.5e-12 * np.diag(shared).max())
    largest = np.einsum("gii->gi", groups).max()
    np.testing.assert_allclose(held.group_group[1], 0.5e-12 * largest * np.eye(SIZE))
    nothing = NormalEquations(
        0.0,
        Step(np.zeros(2), np.zeros((0, 3))),
        np.zeros((0, 3, 3)),
        np.zeros((0, 3, 2)),
        np.zeros((2, 2)),
        np.zeros((0, 2)),
        np.zeros((0, 0, 0)),
    )
    np.testing.assert_allclose(nothing.damped(0.5).shared_shared, 0.5e-12 * np.eye(2))


def test_parameters_of_very_different_units_are_told_apart():
    equations = drawn(4)
    units = np.array([1e9, 1.0, 1e-9, 1e-3])
    scaled = replace(
        equations,
        gradient=Step(equations.gradient.shared * units, equations.gradient.groups),
        group_shared=equations.group_shared * units,
        shared_shared=equations.shared_shared * np.outer(units, units),
    )
    np.testing.assert_allclose(factorise(scaled).solve().shared * units, factorise(equations).solve().shared, rtol=1e-9)


def test_a_matrix_without_an_inverse_is_refused():
    equations = drawn(4)
    blocks, shared, coupling = (
        part.copy() for part in (equations.group_group, equations.shared_shared, equations.group_shared)
    )
    blocks[2, 1] = blocks[2, :, 1] = 0.0
    shared[1] = shared[:, 1] = coupling[:, :, 1] = 0.0
    for changed in ({"group_group": blocks}, {"shared_shared": shared, "group_shared": coupling}):
        with pytest.raises(SingularError):
            factorise(replace(equations, **changed))
