"""Curves with names: their starts are good enough, and their figures mean what they say."""

import numpy as np
import pytest

from camcal.errors import InsufficientData, InvalidInput
from camcal.estimate.curves.curve import Data, predictions
from camcal.estimate.curves.families import FAMILIES, family_named
from camcal.estimate.curves.fit import fit_curve

X = np.linspace(0.5, 6, 60)
NOISE = 0.01
TRUTHS = {
    "poly:3": {"a0": 1.0, "a1": -2.0, "a2": 0.5, "a3": 0.1},
    "expquad": {"a": -0.1, "b": 1.0, "c": 0.2},
    "gauss": {"a": -3.0, "mu": 2.0, "s": 0.3, "b": 1.0},
    "thin_lens": {"f": 0.3},
    "gamma": {"a": 2.0, "g": 2.2, "b": 0.5},
    "noise": {"v0": 3.0, "k": 0.5},
    "edge": {"b": 4.0, "a": -3.0, "x0": 3.1, "s": 0.4},
}


def fitted(name, columns):
    family = family_named(name)
    curve, start = family.build(columns)
    target = columns["y"] if family.explicit else None
    return fit_curve(curve, Data({role: columns[role] for role in family.roles}, target), start)


def value(fit, name):
    return fit.parameters[name].value


def shaken(points, seed=0):
    return points + NOISE * np.random.default_rng(seed).normal(size=points.shape)


@pytest.mark.parametrize("name", TRUTHS)
def test_curves_are_found_from_starts_of_their_own(name):
    truth = TRUTHS[name]
    curve, _ = family_named(name).build({"x": X, "y": X})
    exact = predictions(curve, {"x": X}, np.array([truth[each] for each in curve.parameters]), len(X))[:, 0]
    fit = fitted(name, {"x": X, "y": shaken(exact)})
    assert fit.converged
    for each, expected in truth.items():
        assert abs(value(fit, each) - expected) < 4 * fit.parameters[each].std
    assert fit.goodness.sigma == pytest.approx(NOISE, rel=0.3)  # three standard errors of 56 degrees of freedom


def test_every_family_is_tested_here():
    assert set(FAMILIES) == {name.partition(":")[0] for name in TRUTHS} - {"poly"} | {
        "circle", "line2d", "plane", "line3d"
    }  # fmt: skip


def test_a_circle_is_found_from_a_short_arc():
    angles = np.linspace(0.2, 1.2, 80)
    fit = fitted("circle", {"x": shaken(5 + 2 * np.cos(angles)), "y": shaken(-3 + 2 * np.sin(angles), 1)})
    for name, expected in {"cx": 5, "cy": -3, "r": 2}.items():
        assert abs(value(fit, name) - expected) < 4 * fit.parameters[name].std
    assert fit.derived["diameter"].value == pytest.approx(2 * value(fit, "r"))
    assert fit.derived["diameter"].std == pytest.approx(2 * fit.parameters["r"].std)


@pytest.mark.parametrize("angle", np.radians([0, 30, 90, 135, 179, 270]))
def test_a_line_in_the_plane_is_found_in_any_direction(angle):
    along = np.linspace(-4, 4, 50)
    normal, direction = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    x, y = shaken(2.5 * normal + along[:, None] * direction).T
    fit = fitted("line2d", {"x": x, "y": y})
    found = np.array([np.cos(value(fit, "theta")), np.sin(value(fit, "theta"))])
    assert found @ normal == pytest.approx(1, abs=1e-5)
    assert value(fit, "d") == pytest.approx(2.5, abs=5e-3)  # four standard errors of 50 points


@pytest.mark.parametrize("normal", [*np.eye(3).tolist(), [1, 2, -2], [-3, 0.1, 1]])
def test_a_plane_is_found_in_any_direction(normal):
    normal = np.asarray(normal) / np.linalg.norm(normal)
    rng = np.random.default_rng(4)
    points = rng.uniform(-2, 2, (60, 3))
    points -= np.outer(points @ normal - 1.5, normal)
    x, y, z = shaken(points).T
    fit = fitted("plane", {"x": x, "y": y, "z": z})
    found = np.array([fit.derived[name].value for name in ("nx", "ny", "nz")])
    assert abs(found @ normal) == pytest.approx(1, abs=1e-4)
    assert abs(fit.derived["d"].value) == pytest.approx(1.5, abs=6e-3)  # four standard errors of 60 points
    assert np.abs(fit.residuals).max() < 5 * NOISE  # distances, not heights


@pytest.mark.parametrize("direction", [*np.eye(3).tolist(), [1, 2, -2], [-3, 0.1, 1]])
def test_a_line_in_space_is_found_in_any_direction(direction):
    direction = np.asarray(direction) / np.linalg.norm(direction)
    points = shaken(np.array([0.3, -1.0, 2.0]) + np.linspace(-3, 3, 50)[:, None] * direction)
    fit = fitted("line3d", dict(zip("xyz", points.T, strict=True)))
    # the residuals are the distances from the line through the mean along the widest spread, which is its least one
    spread = points - points.mean(axis=0)
    singular = np.linalg.svd(spread, compute_uv=False)
    assert fit.goodness.sum_of_squares == pytest.approx(singular[1] ** 2 + singular[2] ** 2, rel=1e-9)
    assert fit.goodness.degrees_of_freedom == 2 * 50 - 4
    assert fit.goodness.sigma == pytest.approx(NOISE, rel=0.25)  # three standard errors of 96 degrees of freedom


def test_an_edge_gives_its_modulation_transfer():
    truth = TRUTHS["edge"]
    curve, _ = family_named("edge").build({"x": X, "y": X})
    exact = predictions(curve, {"x": X}, np.array(list(truth.values())), len(X))[:, 0]
    fit = fitted("edge", {"x": X, "y": shaken(exact)})
    spread = value(fit, "s")
    # the transfer of a Gaussian of deviation s is exp(-2 π² s² f²)
    assert np.exp(-2 * (np.pi * spread * fit.derived["mtf50"].value) ** 2) == pytest.approx(0.5)
    fine = np.linspace(0, 6, 20001)
    share = (predictions(curve, {"x": fine}, fit.values, len(fine))[:, 0] - value(fit, "b")) / value(fit, "a")
    rise = fine[np.argmin(np.abs(share - 0.9))] - fine[np.argmin(np.abs(share - 0.1))]
    assert fit.derived["rise_10_90"].value == pytest.approx(rise, abs=1e-3)  # of a scale of 3e-4


def test_errors_of_derived_figures_follow_from_the_covariance():
    fit = fitted("noise", {"x": X, "y": shaken(3 + 0.5 * X)})
    (v0, k), covariance = fit.values, fit.covariance
    slopes = np.array([0.5 / np.sqrt(v0) / k, -np.sqrt(v0) / k**2])
    assert fit.derived["read_noise_e"].value == pytest.approx(np.sqrt(v0) / k)
    assert fit.derived["read_noise_e"].std == pytest.approx(np.sqrt(slopes @ covariance @ slopes), rel=1e-9)


def test_a_negative_read_variance_gives_no_read_noise_rather_than_a_wrong_one():
    fit = fitted("noise", {"x": X, "y": -1 + 0.5 * X})
    assert value(fit, "v0") == pytest.approx(-1)
    assert np.isnan(fit.derived["read_noise"].value)
    assert fit.derived["read_noise"].std is None


@pytest.mark.parametrize("name", [name for name in FAMILIES if FAMILIES[name].explicit])
def test_starts_are_finite_for_any_data(name):
    for y in (np.zeros(9), np.full(9, -2.0), np.linspace(3, -3, 9)):
        for x in (np.linspace(0, 1, 9), np.zeros(9), np.linspace(-5, -1, 9)):
            with np.errstate(all="ignore"):
                _, start = FAMILIES[name].build({"x": x, "y": y})
            assert np.isfinite(list(start.values())).all()


def test_points_that_are_one_point_are_refused():
    one = np.ones(5)
    with pytest.raises(InsufficientData, match="all points coincide"):
        FAMILIES["plane"].build({"x": one, "y": one, "z": one})


@pytest.mark.parametrize("name", ["poly", "poly:x", "poly:-1", "poly:21"])
def test_degrees_that_are_none_are_refused(name):
    with pytest.raises(InvalidInput, match="write poly:N"):
        family_named(name)


def test_dashes_and_underscores_name_the_same_family():
    assert family_named("thin-lens") is family_named("thin_lens")
    assert family_named("a*x + b") is None
