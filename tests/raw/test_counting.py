"""Noise before it was rounded to counts: sums against drawn counts, and the way back."""

import numpy as np
import pytest

from camcal.errors import InsufficientData
from camcal.raw.level import Counted, before_counting, counted


def measured(mean, std, spread, degrees=500_000):
    """Return what an endless draw would measure, with the uncertainty of one with that many degrees of freedom."""
    middle, temporal, spatial = counted(mean, std, spread)
    return Counted(middle, temporal, temporal * np.sqrt(2 / degrees), spatial, spatial * np.sqrt(2 / degrees) + 1e-6)


@pytest.mark.parametrize(("mean", "std", "spread"), [(64.3, 0.4, 0.0), (64.0, 0.7, 0.5), (1.0, 2.0, 1.0), (0, 5, 0)])
def test_the_sums_are_those_of_drawn_counts(mean, std, spread):
    rng = np.random.default_rng(3)
    means = mean + spread * rng.standard_normal(40_000)
    counts = np.maximum(np.rint(means + std * rng.standard_normal((20, 40_000))), 0)
    temporal = counts.var(axis=0, ddof=1).mean()
    spatial = counts.mean(axis=0).var() - temporal / 20
    # 3 standard deviations of a variance with 800 000 and 40 000 samples, and their mean's
    assert counted(mean, std, spread) == pytest.approx(
        [counts.mean(), temporal, spatial], abs=0.02 * (spread**2 + std**2 / 20) + 0.005 * std + 0.003, rel=0.01
    )


@pytest.mark.parametrize("mean", [0.0, 0.7, 12.0, 64.0, 64.5])
@pytest.mark.parametrize("std", [0.5, 1.0, 2.5, 8.0])
@pytest.mark.parametrize("spread", [0.0, 0.4, 3.0])
def test_noise_is_found_again_whatever_rounding_and_zero_did(mean, std, spread):
    noise = before_counting(measured(mean, std, spread))
    assert noise.std == pytest.approx(std, rel=0.01)  # 1/12 counts² taken off is exact to 2 % of the variance at 0.5
    if spread:
        assert noise.spread == pytest.approx(spread, rel=0.02)
    assert noise.mean == pytest.approx(mean, abs=0.02 * std)


def test_coarse_noise_takes_the_twelfth_off_without_a_solver():
    noise = before_counting(Counted(500.0, 100.0, 0.1, 4.0, 0.1))
    assert noise.std**2 == pytest.approx(100 - 1 / 12)
    assert noise.std_uncertainty == pytest.approx(0.1 / 2 / 10, rel=1e-3)
    assert not noise.limited


def test_noise_below_the_limit_of_the_standard_is_said_to_be_limited():
    assert before_counting(measured(64.2, 0.35, 0.0)).limited
    assert not before_counting(measured(64.2, 0.6, 0.0)).limited


def test_noise_that_rounding_hides_has_a_large_uncertainty():
    hidden, seen = (before_counting(measured(64.5, std, 0.0)) for std in (0.2, 1.0))
    assert hidden.limited
    assert hidden.std_uncertainty / hidden.std > 0.1 > seen.std_uncertainty / seen.std


def test_counts_that_are_all_the_same_give_the_upper_limit():
    noise = before_counting(Counted(64.0, 0.0, 0.0, 0.0, 1e-6))
    assert (noise.limited, noise.std) == (True, pytest.approx(0.396, abs=0.001))  # 0.40 in EMVA 1288


def test_counts_that_are_all_zero_are_refused():
    with pytest.raises(InsufficientData, match="noise clipped; increase the black level of the camera"):
        before_counting(Counted(0.0, 0.0, 0.0, 0.0, 0.0))
