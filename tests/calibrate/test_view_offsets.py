"""Offsets of single views against a dense solution of the same least squares; changes and their chance."""

import numpy as np
import pytest
from scipy.stats import norm

from camcal.calibrate.single_views import Found, ViewOffsets, followed
from camcal.solve.least_squares import assemble
from camcal.solve.steps import Block, Jacobian

VIEWS, ROWS, POSE, EFFECTS, LENS = 8, 15, 6, 3, 4
NOISE = 1e-3


def linear(own=1, seed=1):
    """Views with a pose, effects and parameters of their own, and a common lens."""
    rng = np.random.default_rng(seed)
    group = rng.normal(size=(VIEWS, ROWS, 2, POSE + EFFECTS + own))
    lens = rng.normal(size=(VIEWS, ROWS, 2, LENS))
    std = rng.uniform(0.3, 3, (VIEWS, EFFECTS))
    return group, lens, std, rng.normal(size=(VIEWS, ROWS, 2))


def offsets(group, lens, std, residuals, noise=1.0):
    rows = VIEWS * ROWS
    block = Block(
        residuals.reshape(rows, 2),
        (Jacobian(lens.reshape(rows, 2, LENS), np.arange(LENS)),),
        group.reshape(rows, 2, -1),
        rows_per_group=ROWS,
        weights=np.full(rows, noise**-2),
    )
    left = followed(assemble([block], LENS, VIEWS, group.shape[-1]), POSE, std)
    return ViewOffsets.of(left, range(group.shape[-1] - POSE - EFFECTS))


def dense(group, lens, std, residuals):
    """The normal matrix and right side of the views' own parameters, all others eliminated in one dense system."""
    own = group.shape[-1] - POSE - EFFECTS
    size, flat = group.shape[-1], residuals.reshape(VIEWS, -1)
    columns = np.zeros((VIEWS, 2 * ROWS, VIEWS, size))
    for view in range(VIEWS):
        columns[view, :, view] = group[view].reshape(2 * ROWS, size)
    design = np.concatenate([columns.reshape(-1, VIEWS * size), lens.reshape(-1, LENS)], axis=1)
    matrix = design.T @ design
    effects = np.concatenate([view * size + POSE + np.arange(EFFECTS) for view in range(VIEWS)])
    matrix[effects, effects] += std.ravel() ** -2.0
    right = -design.T @ flat.ravel()
    kept = np.concatenate([view * size + POSE + EFFECTS + np.arange(own) for view in range(VIEWS)])
    others = np.setdiff1d(np.arange(len(matrix)), kept)
    follow = np.linalg.solve(
        matrix[np.ix_(others, others)], np.column_stack([matrix[np.ix_(others, kept)], right[others]])
    )
    return (
        matrix[np.ix_(kept, kept)] - matrix[np.ix_(kept, others)] @ follow[:, :-1],
        right[kept] - matrix[np.ix_(kept, others)] @ follow[:, -1],
    )


@pytest.mark.parametrize("own", [1, 2])
def test_what_views_say_of_their_own_parameters_is_what_a_dense_system_says(own):
    problem = linear(own)
    found, (matrix, right) = offsets(*problem), dense(*problem)
    mixing = found.mixing.reshape(len(found.values), -1)
    np.testing.assert_allclose(mixing.T @ mixing, matrix, atol=1e-8 * np.abs(matrix).max())
    np.testing.assert_allclose(mixing.T @ found.values, right, atol=1e-8 * np.abs(right).max())
    assert len(found.information) == own * VIEWS


@pytest.mark.parametrize("own", [1, 2])
def test_the_likeliest_change_is_the_one_that_was_made_with_its_size(own):
    group, lens, std, residuals = linear(own)
    after = np.arange(VIEWS) >= 3
    sizes = np.array([0.02, -0.01])[:own]
    change = np.einsum("vpik,k,v->vpi", group[..., -own:], sizes, after)
    found = offsets(group, lens, std, NOISE * residuals - change, NOISE)
    steps = (np.arange(VIEWS)[:, None] >= np.arange(2, 7)).astype(float)
    best = found.likeliest(steps)
    assert best.index == 1
    np.testing.assert_allclose(best.size, sizes, atol=1e-3)
    assert best.gain > 50


def test_a_change_that_is_there_already_gains_nothing_and_leaves_the_next_one():
    group, lens, std, residuals = linear()
    change = group[..., -1] * np.where(np.isin(np.arange(VIEWS), (2, 5)), 0.02, 0)[:, None, None]
    found = offsets(group, lens, std, NOISE * residuals - change, NOISE)
    first = found.likeliest(np.eye(VIEWS)).index
    second = found.likeliest(np.eye(VIEWS), np.eye(VIEWS)[:, [first]]).index
    assert {first, second} == {2, 5}


def test_offsets_without_order_have_their_spread_and_no_step():
    group, lens, std, residuals = linear()
    change = group[..., -1] * (0.01 * np.tile([1, -1], VIEWS // 2))[:, None, None]
    found = offsets(group, lens, std, NOISE * residuals - change, NOISE)
    spread, clear = found.unordered()
    assert spread == pytest.approx(0.01, rel=0.5)
    assert clear > 5
    steps = (np.arange(VIEWS)[:, None] >= np.arange(2, 7)).astype(float)
    assert found.likeliest(steps).clear(4) < 2


def test_noise_of_the_size_that_is_stated_gains_little():
    gains = [offsets(*linear(seed=seed)).likeliest(np.eye(VIEWS)[:, :1]).gain for seed in range(60)]
    assert np.mean(gains) < 2.5  # that of one parameter is a chi-square of one degree of freedom, or less


def test_how_clear_a_gain_is_is_its_chance_among_all_places_as_a_normal_deviate():
    assert Found(0, np.zeros(1), 9.0).clear(1) == pytest.approx(3.0)
    chance = 5 * np.exp(-6)  # of a chi-square of two degrees of freedom beyond 12, at five places
    assert Found(0, np.zeros(2), 12.0).clear(5) == pytest.approx(norm.isf(chance / 2))
    assert Found(0, np.zeros(1), 0.1).clear(10) == 0.0
    assert Found(0, np.zeros(1), 1e6).clear(10) == np.inf
