"""The priors of the variances of effects, and when the search for them takes another step."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from mixed_model import VIEWS, columns_of, mixed, moved, scales, slope_and_information, unlikeliness
from scipy.stats import invgamma, norm

from camcal.calibrate import effects
from camcal.calibrate.effects import EffectScales, fit_effects, likelihood_gain

COUNT = 3 + 3 * VIEWS


def prior_density(start):
    """Of log τ: normal, three wide; of a view's share: inverse χ² of four degrees of freedom about one, by its log."""
    shares = invgamma(2.0, scale=2.0).logpdf(start.shares) + np.log(start.shares)
    return norm(np.log(start.typical), 3.0).logpdf(np.log(start.variances)).sum() + shares.sum()


def test_variances_are_log_normal_about_the_typical_ones_and_shares_inverse_chi_squared_about_one():
    start, other = scales(2), scales(3, spread=2.0)
    expected = prior_density(other) - prior_density(start)
    assert abs(expected) > 1.0
    assert other.log_prior() - start.log_prior() == pytest.approx(expected, rel=1e-9)


def test_slopes_and_curvatures_are_those_of_the_prior():
    start, length = scales(4), 1e-4

    def slope(at):
        return np.concatenate([part.ravel() for part in at.prior_slopes()])

    ways = length * np.eye(COUNT)
    numeric = [moved(start, way).log_prior() - moved(start, -way).log_prior() for way in ways]
    np.testing.assert_allclose(slope(start), np.array(numeric) / (2 * length), rtol=1e-6, atol=1e-7)
    bend = np.array([slope(moved(start, way)) - slope(moved(start, -way)) for way in ways]) / (2 * length)
    curvatures = np.concatenate([part.ravel() for part in start.prior_curvatures()])
    np.testing.assert_allclose(-bend, np.diag(curvatures), rtol=1e-6, atol=1e-7)


def test_scales_move_by_the_exponentials_of_a_change():
    start, change = scales(5), np.random.default_rng(5).normal(size=(1 + VIEWS, 3))
    found, expected = start.moved(change.ravel()), moved(start, change.ravel())
    np.testing.assert_allclose(found.variances, expected.variances, rtol=1e-12)
    np.testing.assert_allclose(found.shares, expected.shares, rtol=1e-12)
    np.testing.assert_array_equal(found.typical, start.typical)


def test_effects_with_one_share_are_larger_or_smaller_together_in_a_view():
    model, typical = mixed(seed=3), np.full(3, 0.1)
    apart = EffectScales(typical, np.ones((VIEWS, 3)), typical)
    joined = EffectScales(typical, np.ones((VIEWS, 2)), typical, np.array([0, 0, 1]), np.array([4.0, 1.0]))
    effect = columns_of(model).effect
    for _ in range(20):
        joined = fit_effects(model.equations(), effect, joined)
    np.testing.assert_allclose(
        joined.std(effect)[:, effect == 1] ** 2 / joined.std(effect)[:, effect == 0][:, :1] ** 2,
        joined.variances[1] / joined.variances[0],
        rtol=1e-12,
    )
    search = effects._Search.of(model.equations(), effect)
    best, length = search.at(joined), 1e-3
    for way in np.eye(3 + 2 * VIEWS):
        there, back = (search.at(joined.moved(sign * length * way)).unlikeliness for sign in (1, -1))
        # level, as far as the last step promised a thousandth of a logarithm at most
        assert abs(there - back) / (2 * length) < 0.1
        assert there + back > 2 * best.unlikeliness, "the likeliest, not the least likely"
    assert np.abs(np.log(joined.shares)).max() > 0.05, "views differ"
    assert search.at(apart).unlikeliness > best.unlikeliness


def likeliest(model):
    start = scales()
    for _ in range(20):
        start = fit_effects(model.equations(), columns_of(model).effect, start)
    slope, information = slope_and_information(model, start)
    return moved(start, np.linalg.solve(information, slope))


def promise(model, start):
    """What a whole scoring step gains to second order."""
    slope, information = slope_and_information(model, start)
    return 0.5 * slope @ np.linalg.solve(information, slope)


def test_a_step_promises_half_of_the_slope_along_it_also_where_it_is_cut():
    model, typical = mixed(), np.full(3, 1e-12)
    far = EffectScales(typical * np.exp(10.0), np.ones((VIEWS, 3)), typical)  # of effects that are not seen
    search = effects._Search.of(model.equations(), columns_of(model).effect)
    for start, cut in ((scales(), False), (far, True)):
        change, promised = search.step(search.at(start))
        assert (np.abs(change).max() == 2.0) == cut
        slope, _ = slope_and_information(model, start)
        assert promised == pytest.approx(0.5 * slope @ change.ravel(), rel=1e-5)  # differences


def test_another_step_is_taken_where_it_promises_a_thousandth_of_a_logarithm():
    model = mixed(seed=3)
    end, way = likeliest(model), np.random.default_rng(2).normal(size=COUNT)
    for wanted, taken in ((0.9e-3, False), (1.1e-3, True)):
        size = 1e-2
        for _ in range(2):  # a promise grows with the square of the distance
            size *= np.sqrt(wanted / promise(model, moved(end, size * way)))
        start = moved(end, size * way)
        assert promise(model, start) == pytest.approx(wanted, rel=0.02)
        found = fit_effects(model.equations(), columns_of(model).effect, start)
        assert (found is not start) == taken


@pytest.mark.parametrize("factor", [8.0, -1.0])
def test_a_step_that_leads_too_far_is_shortened_and_one_that_leads_astray_is_not_taken(monkeypatch, factor):
    model, start, step = mixed(seed=3), scales(), effects._Search.step

    def too_far(self, point):
        change, promised = step(self, point)
        return factor * change, abs(factor) * promised

    monkeypatch.setattr(effects, "_ROUNDS", 1)
    straight = fit_effects(model.equations(), columns_of(model).effect, start)
    monkeypatch.setattr(effects._Search, "step", too_far)
    found = fit_effects(model.equations(), columns_of(model).effect, start)
    change, whole = (np.log(end.variances / start.variances) for end in (found, straight))
    if factor < 0:
        np.testing.assert_array_equal(change, 0)
    else:
        assert unlikeliness(model, found) < unlikeliness(model, start)
        np.testing.assert_allclose(change / change[0], whole / whole[0], rtol=1e-9)
        assert 0.1 < change[0] / whole[0] < 5


class Step:
    """Scales that are a share of a step away from where the search is."""

    def __init__(self, share):
        self.share = share

    def moved(self, change):
        return Step(change)


def gone(monkeypatch, cost):
    """The share of a step that one round goes where the unlikeliness along it is a cost of slope -2."""
    monkeypatch.setattr(
        effects._Search, "at", lambda self, way: SimpleNamespace(scales=way, unlikeliness=cost(way.share))
    )
    monkeypatch.setattr(effects._Search, "step", lambda self, here: (1.0, 1.0))
    return effects._Search(None, None).best(Step(0.0), 1).scales.share


@pytest.mark.parametrize(
    ("bend", "share"),
    [(1.0, 1), (0.5, 1), (-1.0, 1), (1.3, 1), (1.36, 1 / 1.36), (4.0, 1 / 4), (6.4, 0.2), (7.0, 1 / 7), (12.0, 1 / 12)],
)
def test_a_step_is_as_long_as_the_likelihood_along_it_is_highest(monkeypatch, bend, share):
    assert gone(monkeypatch, lambda way: -2 * way + bend * way**2) == pytest.approx(share, rel=1e-9)


@pytest.mark.parametrize(("within", "share"), [(0.01, 0.008), (0.002, 0.0016), (0.001, 0.0)])
def test_steps_where_there_is_no_likelihood_are_a_fifth_as_long_five_times_over(monkeypatch, within, share):
    assert gone(monkeypatch, lambda way: -2 * way if way < within else np.inf) == pytest.approx(share)


def test_a_linearisation_is_used_for_four_steps(monkeypatch):
    model = mixed(seed=3)
    start = EffectScales(np.full(3, 1e-4), np.ones((VIEWS, 3)), np.full(3, 0.1))
    found = fit_effects(model.equations(), columns_of(model).effect, start)
    monkeypatch.setattr(effects, "_ROUNDS", 1)
    steps = [start]
    for _ in range(5):
        steps.append(fit_effects(model.equations(), columns_of(model).effect, steps[-1]))
    np.testing.assert_allclose(found.variances, steps[4].variances, rtol=1e-9)
    assert np.abs(np.log(steps[4].variances / steps[3].variances)).max() > 0.01
    assert np.abs(np.log(steps[5].variances / steps[4].variances)).max() > 0.01


def test_the_gain_does_not_depend_on_where_the_search_begins():
    model, shares, typical = mixed(seed=3), np.ones((VIEWS, 3)), np.full(3, 0.1)
    starts = [EffectScales(size * typical, shares, typical) for size in (1e-6, 1.0, 1e4)]
    gains = [likelihood_gain(model.equations(), columns_of(model).effect, start) for start in starts]
    assert np.ptp(gains) < 0.1  # ends where steps promise less than 0.001 of a logarithm, priors included


def test_equal_scales_gain_the_same_whatever_their_priors():
    model, typical = mixed(seed=3), np.full(3, 0.1)
    start = EffectScales(typical, np.ones((VIEWS, 3)), typical)
    search = effects._Search.of(model.equations(), columns_of(model).effect)
    best = search.best(start, 100).scales
    nothing = replace(best, variances=1e-14 * best.variances)
    expected = model.restricted(best) - model.restricted(nothing)
    assert likelihood_gain(model.equations(), columns_of(model).effect, best) == pytest.approx(expected, abs=1e-6)
