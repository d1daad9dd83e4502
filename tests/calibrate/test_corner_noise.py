"""The errors of corners beyond what their images say: common to all, and repeating with the pixels."""

from dataclasses import replace

import numpy as np
import pytest

from camcal.calibrate.noise import CornerNoise, estimate_noise, period_shares

AMPLITUDE = 0.087  # px, as of a real camera that interpolates its colours
EDGE = 40.0  # px


def claims(rng, count, std=0.02):
    shapes = std * rng.normal(size=(count, 2, 2))
    return shapes @ shapes.swapaxes(1, 2) + (std / 7) ** 2 * np.eye(2)


def drawn(rng, covariances):
    return np.einsum("nij,nj->ni", np.linalg.cholesky(covariances), rng.normal(size=(len(covariances), 2)))


def turned(degrees, length=EDGE):
    angle = np.deg2rad(np.atleast_1d(degrees))
    c, s = np.cos(angle), np.sin(angle)
    return length * np.moveaxis(np.array([[c, -s], [s, c]]), 2, 0)


def shift(rng, covered, period, amplitude):
    """Errors of an edge over `covered` pixels, RMS `amplitude` at each of its points, simulated point by point."""
    along = np.linspace(-0.5, 0.5, 401) * covered[:, None] + period * rng.random((len(covered), 1))
    return np.sqrt(2) * amplitude * np.sin(2 * np.pi * along / period).mean(axis=1)


def periodic(rng, degrees, period=2, amplitude=AMPLITUDE):
    covered = EDGE * np.abs(np.sin(np.deg2rad(degrees)))
    return np.column_stack([shift(rng, covered, period, amplitude) for _ in range(2)])


def none(count):
    return np.zeros((count, 2, 1))


def views(rng, count):
    """Angles of corners in views of which half are aligned to a few degrees, the others turned at random."""
    return np.where(rng.random(count) < 0.5, rng.normal(0, 1.5, count), rng.uniform(-45, 45, count))


@pytest.mark.parametrize("floor", [0.05, 0.2])
def test_the_floor_is_found_among_corners_of_different_covariance(floor):
    rng = np.random.default_rng(2)
    claimed = claims(rng, 4000)
    residuals = drawn(rng, claimed + floor**2 * np.eye(2))
    found = estimate_noise(residuals, claimed, none(4000), np.ones(4000), 1.0)
    assert found.constant_px == pytest.approx(floor, rel=0.05)  # 8000 numbers know it to 1 %
    assert found.period_px == {2: 0.0}  # no corner shows any


def test_what_is_typically_added_is_the_geometric_mean_of_what_covariances_get():
    rng = np.random.default_rng(2)
    shares = period_shares(turned(views(rng, 500)))
    noise = CornerNoise(0.03, {2: 0.08})
    added = noise.covariances(np.zeros((500, 2, 2)), shares)
    expected = np.exp(np.mean(np.log(np.diagonal(added, axis1=1, axis2=2))) / 2)
    assert noise.typical(shares) == pytest.approx(expected, rel=1e-9)
    assert 0.03 < noise.typical(shares) < 0.08
    assert CornerNoise(0.0).typical(shares) == 0.0


def test_there_is_none_where_the_covariances_say_it_all():
    rng = np.random.default_rng(3)
    claimed = claims(rng, 4000)
    found = estimate_noise(drawn(rng, claimed), claimed, none(4000), np.ones(4000), 1.0)
    assert found.constant_px < 0.002  # a tenth of a typical error


def test_corners_better_than_they_claim_have_neither_floor_nor_period():
    rng = np.random.default_rng(3)
    claimed = claims(rng, 4000)
    shares = period_shares(turned(views(rng, 4000)))
    found = estimate_noise(0.7 * drawn(rng, claimed), claimed, shares, np.ones(4000), 1.0)
    assert found == CornerNoise(0.0, {2: 0.0})


def test_residuals_of_a_fit_are_too_small_and_that_is_allowed_for():
    rng = np.random.default_rng(4)
    residuals = 0.1 * np.sqrt(0.5) * rng.normal(size=(4000, 2))
    found = estimate_noise(residuals, np.tile(1e-6 * np.eye(2), (4000, 1, 1)), none(4000), np.ones(4000), 0.5)
    assert found.constant_px == pytest.approx(0.1, rel=0.05)


def test_freedom_that_differs_between_corners_is_allowed_for_and_corners_with_less_of_it_tell_less():
    rng = np.random.default_rng(5)
    dof = np.repeat([0.9, 0.1], 2000)
    residuals = 0.1 * np.sqrt(dof)[:, None] * rng.normal(size=(4000, 2))
    claimed = np.tile(1e-6 * np.eye(2), (4000, 1, 1))
    found = estimate_noise(residuals, claimed, none(4000), np.ones(4000), dof)
    assert found.constant_px == pytest.approx(0.1, rel=0.03)
    # REML: so many squares per so many degrees of freedom
    expected = np.sqrt((residuals**2).sum() / (2 * dof.sum()))
    assert found.constant_px == pytest.approx(expected, rel=2e-4)  # 1e-6 px² of 0.01 px² are claimed already


def test_no_residuals_no_noise():
    assert estimate_noise(np.zeros((5, 2)), np.tile(np.eye(2), (5, 1, 1)), none(5), np.ones(5), 1.0) == CornerNoise(0.0)
    assert estimate_noise(np.ones((5, 2)), np.tile(np.eye(2), (5, 1, 1)), none(5), np.zeros(5), 1.0) == CornerNoise(0.0)


def test_corners_count_by_their_weights():
    rng = np.random.default_rng(6)
    claimed, shares = claims(rng, 4000), period_shares(turned(views(rng, 4000)))
    residuals = drawn(rng, CornerNoise(0.05, {2: 0.1}).covariances(claimed, shares))
    twice = np.repeat(np.arange(2000), 2)
    a = estimate_noise(residuals[twice], claimed[twice], shares[twice], np.ones(4000), 0.8)
    b = estimate_noise(residuals[:2000], claimed[:2000], shares[:2000], np.full(2000, 1.0), 0.8)
    halved = np.repeat([1.0, 0.5], 1000)
    c = estimate_noise(residuals[:2000], claimed[:2000], shares[:2000], halved, 0.8)
    mixed = np.r_[np.repeat(np.arange(1000), 2), np.arange(1000, 2000)]
    d = estimate_noise(residuals[mixed], claimed[mixed], shares[mixed], np.ones(3000), 0.8)
    assert a.constant_px == pytest.approx(b.constant_px, rel=1e-3)  # up to the prior, which is worth a few corners
    assert c.constant_px == pytest.approx(d.constant_px, rel=1e-3)
    assert c.period_px[2] == pytest.approx(d.period_px[2], rel=2e-3)


def test_a_corner_without_weight_has_no_say_even_if_it_has_no_residual():
    rng = np.random.default_rng(7)
    claimed, shares = claims(rng, 500), period_shares(turned(views(rng, 500)))
    residuals = drawn(rng, claimed + 0.05**2 * np.eye(2))
    weights = np.r_[np.ones(400), np.zeros(100)]
    expected = estimate_noise(residuals[:400], claimed[:400], shares[:400], weights[:400], np.full(400, 0.8))
    residuals[400:], shares[450:] = np.nan, np.nan
    assert estimate_noise(residuals, claimed, shares, weights, np.full(500, 0.8)) == expected


def test_the_amplitude_of_a_period_is_recovered_from_aligned_and_unaligned_views():
    rng = np.random.default_rng(8)
    degrees = views(rng, 8000)
    claimed = claims(rng, 8000, 0.01)
    residuals = drawn(rng, claimed + 0.02**2 * np.eye(2)) + periodic(rng, degrees)
    found = estimate_noise(residuals, claimed, period_shares(turned(degrees)), np.ones(8000), 1.0)
    assert found.period_px[2] == pytest.approx(AMPLITUDE, rel=0.1)
    assert found.constant_px == pytest.approx(0.02, rel=0.1)


def test_two_periods_are_told_apart(monkeypatch):
    monkeypatch.setattr("camcal.calibrate.noise.PERIODS", (2, 8))
    rng = np.random.default_rng(9)
    claimed, shares = claims(rng, 20000, 0.01), period_shares(turned(rng.uniform(-15, 15, 20000)))
    added = 0.03**2 + 0.06**2 * shares[..., 0] + 0.1**2 * shares[..., 1]
    truth = claimed + added[..., None] * np.eye(2)
    found = estimate_noise(drawn(rng, truth), claimed, shares, np.ones(20000), 1.0)
    assert found.constant_px == pytest.approx(0.03, rel=0.1)
    assert found.period_px[2] == pytest.approx(0.06, rel=0.1)
    assert found.period_px[8] == pytest.approx(0.1, rel=0.05)
    np.testing.assert_allclose(CornerNoise(0.03, {8: 0.1, 2: 0.06}).covariances(claimed, shares), truth, rtol=1e-12)
    with_one = estimate_noise(drawn(rng, claimed), claimed, shares, np.ones(20000), 1.0, CornerNoise(0.1))
    assert max(with_one.constant_px, *with_one.period_px.values()) < 0.003


def test_an_aligned_edge_keeps_all_of_its_errors_and_one_over_many_pixels_next_to_none():
    covered = np.array([0.0, 2.0, 20.0])
    shares = period_shares(turned(np.rad2deg(np.arcsin(covered / EDGE))))[..., 0]
    np.testing.assert_array_equal(shares[0], 1.0)
    assert (shares[1] < 0.102).all()  # the first zero of the sinc² is filled up to its envelope, 1 / π²
    assert (shares[2] < 0.0011).all()


@pytest.mark.slow
def test_a_share_is_what_an_average_along_the_edge_leaves():
    rng = np.random.default_rng(10)
    for covered in (0.2, 0.5, 0.9):
        errors = shift(rng, np.full(20000, covered), 2, 1.0)
        share = period_shares(turned(np.rad2deg(np.arcsin(covered / EDGE))))[0, :, 0]
        np.testing.assert_allclose(share, np.mean(errors**2), rtol=0.03)  # 20 000 squares


def test_the_share_falls_steadily_and_without_a_leap_and_covers_what_is_left():
    covered = np.linspace(0, 6, 6001)
    share = period_shares(covered[:, None, None] * np.ones((2, 2)))[:, 0, 0]
    steps = np.diff(share)
    assert (steps[1:] < 0).all()
    assert np.abs(steps).max() < 1e-3
    assert np.abs(np.diff(steps)).max() < 1e-5  # nor a kink
    assert (share >= np.sinc(covered / 2) ** 2 - 1e-12).all()


def test_u_follows_the_edges_closest_to_vertical_and_v_those_closest_to_horizontal():
    leaning = np.array([[[30.0, 0.5], [1.5, 30.0]]])  # x falls by 1.5 rows, y leans by 0.5 columns
    (u,), (v,) = period_shares(leaning)[0]
    assert (u, v) == pytest.approx((np.sinc(0.25) ** 2, 1 / (np.pi * 0.75) ** 2))
    exchanged = period_shares(leaning[:, :, ::-1])  # a board lying on its side
    mirrored = period_shares(-leaning)
    np.testing.assert_array_equal(exchanged[0, :, 0], [u, v])
    np.testing.assert_array_equal(mirrored[0, :, 0], [u, v])
    np.testing.assert_array_equal(period_shares(leaning[:, ::-1])[0, :, 0], [v, u])


def test_where_nothing_repeats_little_is_added_and_nothing_is_lost():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        claimed, shares = claims(rng, 1000), period_shares(turned(views(rng, 1000)))
        truth = claimed + 0.03**2 * np.eye(2)
        found = estimate_noise(drawn(rng, truth), claimed, shares, np.ones(1000), 1.0)
        variances = np.diagonal(truth, axis1=1, axis2=2)
        assert (found.period_px[2] ** 2 * shares[..., 0] / variances).mean() < 0.05
        total = np.diagonal(found.covariances(claimed, shares), axis1=1, axis2=2)
        # the mean of unit weights over their best: 1 - efficiency, as Var = Σ w² v / (Σ w)²
        weights = 1 / total
        assert np.sum(weights**2 * variances) / np.sum(weights) ** 2 * np.sum(1 / variances) < 1.005


def test_where_no_view_is_aligned_the_period_stays_small():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        claimed = claims(rng, 3000)
        shares = period_shares(turned(rng.uniform(10, 80, 3000)))
        found = estimate_noise(drawn(rng, claimed + 0.03**2 * np.eye(2)), claimed, shares, np.ones(3000), 1.0)
        assert (found.period_px[2] ** 2 * shares).max() < 0.1 * 0.03**2
        assert found.period_px[2] < 0.1  # unbounded without a prior
        assert found.constant_px == pytest.approx(0.03, rel=0.05)


def test_the_covariances_gain_floor_and_periods_in_their_variances_alone():
    claimed = np.array([[[4.0, 1.0], [1.0, 9.0]]]) * 1e-4
    shares = np.array([[[0.5], [0.25]]])
    total = CornerNoise(0.01, {2: 0.02}).covariances(claimed, shares)
    np.testing.assert_allclose(total, [[[4e-4 + 1e-4 + 2e-4, 1e-4], [1e-4, 9e-4 + 1e-4 + 1e-4]]], rtol=1e-12)
    assert claimed[0, 0, 0] == 4e-4


def sample(seed=11, count=3000, amplitude=AMPLITUDE):
    rng = np.random.default_rng(seed)
    degrees = views(rng, count)
    claimed = claims(rng, count)
    residuals = drawn(rng, claimed + 0.02**2 * np.eye(2)) + periodic(rng, degrees, 2, amplitude)
    return residuals, claimed, period_shares(turned(degrees)), rng.uniform(0.5, 1, count), 0.9


def test_the_start_changes_nothing():
    data = sample()
    cold = estimate_noise(*data)
    for start in (CornerNoise(0.0), CornerNoise(5.0), CornerNoise(0.0, {2: 5.0}), CornerNoise(1e-4, {2: 1e-4}), cold):
        warm = estimate_noise(*data, start)
        # a relative change of the variances by 1e-6 ends the iteration
        assert warm.constant_px == pytest.approx(cold.constant_px, rel=1e-5)
        assert warm.period_px[2] == pytest.approx(cold.period_px[2], rel=1e-5)


def test_a_good_start_saves_steps(monkeypatch):
    data = sample()
    found = estimate_noise(*data)
    monkeypatch.setattr("camcal.calibrate.noise._ITERATIONS", 1)
    again = estimate_noise(*data, found)
    assert again.constant_px == pytest.approx(found.constant_px, rel=1e-5)
    assert again.period_px[2] == pytest.approx(found.period_px[2], rel=1e-5)
    assert estimate_noise(*data).period_px[2] != pytest.approx(found.period_px[2], rel=1e-3)


def test_one_corner_among_many_may_be_the_only_one_to_show_a_period():
    residuals = 0.02 * np.random.default_rng(12).normal(size=(1000, 2))
    residuals[0] = [1.0, -1.0]
    shares = none(1000)
    shares[0] = 1.0
    noise = estimate_noise(residuals, np.tile(1e-8 * np.eye(2), (1000, 1, 1)), shares, np.ones(1000), 1.0)
    assert noise.constant_px == pytest.approx(0.02, rel=0.05)
    # the largest of the posterior density exp(-2 V / (2 s)) exp(-2 / (2 V)) / V of its variance V, s its prior mean
    prior = np.mean(residuals**2)
    variance = prior / 2 * (np.sqrt(1 + 4 / prior) - 1)
    assert noise.constant_px**2 + noise.period_px[2] ** 2 == pytest.approx(variance, rel=1e-4)


def test_corners_that_claim_no_error_at_all_are_allowed():
    residuals = 0.02 * np.random.default_rng(14).normal(size=(1000, 2))
    for start in (None, CornerNoise(0.0)):
        found = estimate_noise(residuals, np.zeros((1000, 2, 2)), none(1000), np.ones(1000), 1.0, start)
        assert found.constant_px == pytest.approx(np.sqrt(np.mean(residuals**2)), rel=1e-5)


def test_a_floor_far_below_the_errors_of_most_corners_is_found():
    rng = np.random.default_rng(15)
    claimed = np.repeat([1e-10, 1.0], [500, 1500])[:, None, None] * np.eye(2)
    residuals = drawn(rng, claimed + 1e-3**2 * np.eye(2))
    found = estimate_noise(residuals, claimed, none(2000), np.ones(2000), 1.0)
    assert found.constant_px == pytest.approx(1e-3, rel=0.1)


def test_a_found_noise_is_likelier_than_any_near_it():
    residuals, claimed, shares, weights, dof = sample()
    found = estimate_noise(residuals, claimed, shares, weights, dof)

    def unlikeliness(noise):
        variances = np.diagonal(noise.covariances(claimed, shares), axis1=1, axis2=2)
        return np.sum(weights[:, None] * (dof * np.log(variances) + residuals**2 / variances))

    best = unlikeliness(found)
    for factor in (0.98, 1.02):
        assert unlikeliness(replace(found, constant_px=factor * found.constant_px)) > best
        assert unlikeliness(replace(found, period_px={2: factor * found.period_px[2]})) > best


@pytest.mark.parametrize("amplitude", [AMPLITUDE, 0.03, 0.01])
def test_a_millionth_of_a_pixel_makes_no_difference(amplitude):
    residuals, claimed, shares, weights, dof = sample(amplitude=amplitude)
    before = estimate_noise(residuals, claimed, shares, weights, dof)
    for seed in range(5):
        moved = residuals + 1e-6 * np.random.default_rng(seed).normal(size=residuals.shape)
        after = estimate_noise(moved, claimed, shares, weights, dof)
        assert abs(after.constant_px - before.constant_px) < 1e-5
        assert abs(after.period_px[2] - before.period_px[2]) < 1e-5


def test_a_period_that_fades_vanishes_without_a_leap():
    residuals, claimed, shares, weights, dof = sample(amplitude=0.0)
    rng = np.random.default_rng(13)
    pattern = np.sqrt(shares[..., 0]) * rng.normal(size=residuals.shape)
    amplitudes = np.linspace(0, 0.02, 201)
    noises = [estimate_noise(residuals + a * pattern, claimed, shares, weights, dof) for a in amplitudes]
    squared = np.array([noise.period_px[2] ** 2 for noise in noises])
    assert squared[-1] > 10 * squared[0]
    assert np.abs(np.diff(squared)).max() < 3 * 0.02 * 1e-4  # steps of a²: 2 a Δa, as of what was put in


@pytest.mark.parametrize("iterations", [1, 50])  # on the way as at the end
def test_units_do_not_matter(iterations, monkeypatch):
    monkeypatch.setattr("camcal.calibrate.noise._ITERATIONS", iterations)
    residuals, claimed, shares, weights, dof = sample()
    found = estimate_noise(residuals, claimed, shares, weights, dof)
    scaled = estimate_noise(1e3 * residuals, 1e6 * claimed, shares, weights, dof)
    assert scaled.constant_px == pytest.approx(1e3 * found.constant_px, rel=1e-5)
    assert scaled.period_px[2] == pytest.approx(1e3 * found.period_px[2], rel=1e-5)


@pytest.mark.parametrize("factor", [1e-5, 1e3])
def test_units_do_not_matter_where_nothing_is_claimed(factor):
    residuals, claimed, *others = sample(count=500)
    plain, found = (estimate_noise(unit * residuals, 0 * claimed, *others) for unit in (1.0, factor))
    assert found.constant_px == pytest.approx(factor * plain.constant_px, rel=1e-4)
    assert found.period_px[2] == pytest.approx(factor * plain.period_px[2], rel=1e-4)


def test_a_share_of_the_way_to_another_noise_is_one_of_variances():
    found = CornerNoise(0.1, {2: 0.2}).towards(CornerNoise(0.3, {2: 0.6}), 0.25)
    assert found.constant_px**2 == pytest.approx(0.75 * 0.01 + 0.25 * 0.09)
    assert found.period_px[2] ** 2 == pytest.approx(0.75 * 0.04 + 0.25 * 0.36)
