"""What views share of their residuals: chances by random signs, and lens models that do not fit beside two cameras."""

import numpy as np
import pytest

from camcal.calibrate.refusals import _are_alike
from camcal.calibrate.view_records import CellSums

ONE = np.full((16, 12), 1 / 16)  # as many corners in each cell in all


def test_errors_that_each_view_has_to_itself_are_taken_for_a_pattern_as_rarely_as_chance_has_it():
    rng = np.random.default_rng(2)
    chances = []
    for _ in range(2000):
        seen = rng.random((16, 12)) < 0.5  # which views show which cells
        tilt = rng.normal(size=(16, 1, 2)) + 0.3 * rng.normal(size=(16, 12, 2))  # much the same all over a view
        chances.append(CellSums(seen[..., None] * tilt, ONE[:16]).chance)
    for limit in (0.05, 0.01):
        assert 0.4 * limit < np.mean(np.array(chances) < limit) < 1.6 * limit
    assert np.mean(np.array(chances) < 1e-3) <= 0.004


def test_the_chance_has_the_moments_of_random_signs():
    rng = np.random.default_rng(3)
    rows = rng.normal([1.0, 0.0, 0.0, 0.0], size=(9, 4))
    matrix = rows @ rows.T
    np.fill_diagonal(matrix, 0.0)
    signs = np.array(np.meshgrid(*[[-1, 1]] * 9)).reshape(9, -1)
    sums = np.einsum("vs,vw,ws->s", signs, matrix, signs)
    assert np.mean(sums) == pytest.approx(0, abs=1e-9)
    assert np.mean(sums**2) == pytest.approx(2 * np.trace(matrix @ matrix))
    assert np.mean(sums**3) == pytest.approx(8 * np.trace(matrix @ matrix @ matrix))
    exact = np.mean(sums >= matrix.sum() - 1e-9)
    assert CellSums(rows.reshape(9, 2, 2), ONE[:9, :2]).chance == pytest.approx(exact, rel=0.5)


def one_corner_each(*residuals, cells=1):
    """The pixels (2, V, 1), residuals and presence of views with one corner each, in `cells` places alike."""
    left = np.tile(np.array(residuals, float), cells)
    places = np.repeat(np.linspace(50, 950, cells), len(residuals))
    return np.stack([places, places])[..., None], np.stack([left, 0 * left])[..., None], np.ones((len(left), 1), bool)


@pytest.mark.parametrize(("share", "of_lens"), [(0.35, False), (0.9, True)])
def test_a_lens_model_that_does_not_fit_leaves_more_than_half_as_much_in_common_as_apart(share, of_lens):
    rng = np.random.default_rng(4)
    views, part = 30, share / 29
    middles = np.stack(np.meshgrid(np.arange(50, 1000, 100), np.arange(50, 800, 100))).reshape(2, 1, -1)
    common, own = rng.normal(size=middles.shape), rng.normal(size=(2, views, middles.shape[2]))
    pixels = np.broadcast_to(middles, own.shape)
    residuals = np.sqrt(part) * common + np.sqrt(1 - part) * own
    assert _are_alike(pixels, residuals, np.ones(own.shape[1:], bool)) == of_lens


@pytest.mark.parametrize(("views", "of_lens"), [(3, False), (4, True)])
def test_what_three_views_have_in_common_may_be_chance(views, of_lens):
    assert _are_alike(*one_corner_each(*[1.0] * views)) == of_lens


@pytest.mark.parametrize(("alike", "of_lens"), [(2, False), (4, True)])
def test_a_corner_that_is_far_off_counts_with_ten_medians(alike, of_lens):
    assert _are_alike(*one_corner_each(*[1.0] * alike, 1000.0, cells=8)) == of_lens
